"""The beginning of an arm's episode, and its control steps, which consist of sub-steps under held torques.

These are plain functions of numbers, see `numbers.functions`; every simulation of an arm uses them.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from fuzzyarm.envs.batch.layout import Clock, Layout, Noise, Start
from fuzzyarm.envs.batch.randomness import NEXT_KEY, RANDOMISATION, draw, noise_counter, normal_pair, uniform
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import Physics, filled, places
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.envs.task import assess, clipped, finite, reason_of
from fuzzyarm.numbers.functions import bits, flat, floor, like, maximum, minimum, row, select, when, whole, word

__all__ = [
    "ANGLE_ROOM", "VELOCITY_ROOM", "Given", "Moved", "assessed", "begun", "control_step", "drawn_of",
    "reading_of", "resting",
]  # fmt: skip

ANGLE_ROOM, VELOCITY_ROOM = 0.5, 10.0
"""Room in the observation space beyond the limits, because the observation that ends an episode lies outside them.

`ANGLE_ROOM` is a share of the angle range, added at both ends; `VELOCITY_ROOM` is a factor of the velocity limit.
"""


class Moved(NamedTuple):
    """An arm at the end of a control step."""

    state: Any  # of the arm after the step; the state before the step if that is not finite
    torque: Any  # of the motors, within their limits [N m]
    force: Any  # mean of the tip force over the step [N]
    found: Any  # the result of `task.assess`
    clipped: Any  # 1.0 where torques were beyond the limits, else 0.0
    reason: Any  # a `Termination`, as a float


def control_step(
    physics: Physics, state: Any, command: Any, now: Any, target: Any, arm: Any, limits: Any, factor: Any, h: Any,
    substeps: Any,
) -> Moved:  # fmt: skip
    """Return the state and its assessment after one control step under a controller's torques, `command` [N m].

    `now` is the schedule's row at the start of the step, whose tip force is multiplied by the lane's `factor`; `target`
    is the tip's target at the end of the step; `limits` are those of the arm; other arguments are as for `held_of`.
    """
    torque = physics.PerJoint(*map(clipped, command, limits.torque))
    applied = physics.PerJoint(*(u + b for u, b in zip(torque, now.bias, strict=True)))
    mean, change = ([f * factor for f in part] for part in now.force)
    reached = held_of(physics)(state, applied, mean, change, arm, h, substeps)
    return assessed(physics, state, reached, command, torque, now.bias, mean, target, arm, limits)


def assessed(
    physics: Physics, before: Any, reached: Any, command: Any, torque: Any, bias: Any, force: Any, target: Any,
    arm: Any, limits: Any,
) -> Moved:  # fmt: skip
    """Return the `Moved` of a step from state `before` to `reached`; other arguments are named as in `control_step`."""
    sound = finite(reached)
    pairs = zip(flat(reached), flat(before), strict=True)
    state = like(reached, (select(sound > 0.0, new, old) for new, old in pairs))
    found = assess(physics, state, torque, bias, arm, limits, target)
    beyond = functools.reduce(operator.or_, (u != asked for u, asked in zip(torque, command, strict=True)))
    reason = reason_of(sound, found.angles_inside, found.velocities_inside)
    return Moved(state, torque, force, found._replace(reward=found.reward * sound), 1.0 * beyond, reason)


@functools.cache
def reading_of(physics: Physics) -> Callable[..., tuple[Any, Any]]:
    """Return ``reading(state, limits, noise, key, steps)``: motor angles and velocities as the encoders measure them.

    `noise` is a `Noise`; its samples for the instant after `steps` steps are drawn from the stream with the key `key`
    (uint64). Readings are clipped to the observation space, which exceeds the arm's `limits`.
    """
    PerJoint, joints = physics.PerJoint, physics.joints
    first, each = noise_counter(joints), 2 * joints

    def reading(state: Any, limits: Any, noise: Noise, key: Any, steps: Any) -> tuple[Any, Any]:
        true = (*state.motor, *state.motor_velocity)

        def noisy() -> tuple[Any, ...]:
            word, read = whole(steps) * each + first, []
            for k in range(0, 2 * joints, 2):
                for at, normal in zip((k, k + 1), normal_pair(key, word + k), strict=True):
                    read.append(true[at] + (noise.angle if at < joints else noise.velocity) * normal)
            return tuple(read)

        read = when((noise.angle > 0.0) | (noise.velocity > 0.0), noisy, true)
        low, high = physics.angle_range(limits)
        room = [ANGLE_ROOM * (b - a) for a, b in zip(low, high, strict=True)]
        bounds = zip(read[:joints], low, high, room, strict=True)
        q = PerJoint(*(_between(one, a - r, b + r) for one, a, b, r in bounds))
        fastest = [VELOCITY_ROOM * most for most in limits.velocity]
        return q, PerJoint(*(_between(one, -most, most) for one, most in zip(read[joints:], fastest, strict=True)))

    return reading


def _between(number: Any, low: Any, high: Any) -> Any:
    return minimum(maximum(number, low), high)


class Given(NamedTuple):
    """What a lane's episode begins with: indices of its plant and schedule, and its payload's position on the link."""

    plant: Any  # index of the lane's plant
    start: Any  # index of the schedule to begin, or of the first one of a family
    place: Any  # where the payload is, see `Physics.payload_place`


def begun(
    layout: Layout, clock: Clock, given: Given, initial: Any, ranges: Any, plants: Any, starts: Any, schedule: Any
) -> tuple[Any, Any, Any, Any]:
    """Return a lane, its clock and its draws at the beginning of an episode, and the first row of its schedule.

    `clock` has the key of the last episode. `initial` is the initial state; if its first entry is nan, the arm begins
    at rest on the reference. `ranges` are pairs (low, high), one for each number of `draw_record`. The rows of the
    tables `plants`, `starts` and `schedule` are of the types `Plant`, `Start` and `row_record`.
    """
    physics, PerJoint = layout.physics, layout.physics.PerJoint
    key = draw(word(clock.key), NEXT_KEY)
    drawn = drawn_of(physics.joints)(key, ranges)
    family = filled(Start, row(starts, given.start)).family > 0.0
    start = filled(Start, row(starts, select(family, given.start + drawn.reference, given.start)))
    nominal = filled(physics.Plant, row(plants, given.plant))
    now = filled(row_record(physics.joints, physics.axes), row(schedule, start.first))
    arm = physics.constants(physics.varied(nominal, drawn), start.payload, given.place, drawn.payload)
    link = PerJoint(*(q + a for q, a in zip(now.reference.q, drawn.angle, strict=True)))
    rest = resting(physics, nominal, link, 0.0)
    free = flat(initial)[0] != flat(initial)[0]
    pairs = zip(flat(rest), flat(initial), strict=True)
    state = like(rest, (select(free, own, asked) for own, asked in pairs))
    first = bits(whole(start.first))
    lane = layout.Lane(state, arm, physics.limits(nominal), drawn.force, start.noise)
    return lane, Clock(first, first, bits(whole(start.last)), bits(key)), drawn, now


@functools.cache
def drawn_of(joints: int) -> Callable[[Any, Any], Any]:
    """Return ``drawn(key, ranges)``: a `draw_record`, each number uniform in its range; `reference` is rounded down."""
    at = places(draw_record(joints))  # here, because torch cannot compile a look-up in a cache

    def drawn(key: Any, ranges: Any) -> Any:
        def number(low: Any, high: Any, counter: int) -> Any:
            return when(low < high, lambda: (low + (high - low) * uniform(key, counter),), (low,))[0]

        draws = like(at, (number(low, high, RANDOMISATION + k) for k, (low, high) in enumerate(ranges)))
        return draws._replace(reference=floor(draws.reference))

    return drawn


def resting(physics: Physics, nominal: Any, link: Any, zero: Any) -> Any:
    """Return the state of an arm at rest at link angles [rad]; `zero` is a 0 of their type.

    The motors hold the gravity torque of the nominal arm, so a drawn plant or a payload moves the arm from the start.
    """
    still = physics.PerJoint(*[zero] * physics.joints)
    weight = physics.gravity(link, physics.constants(nominal, zero, zero, zero))
    stiffness = physics.stiffness(nominal)
    motor = physics.PerJoint(*(q + g / k for q, g, k in zip(link, weight, stiffness, strict=True)))
    return physics.State(motor, link, still, still)
