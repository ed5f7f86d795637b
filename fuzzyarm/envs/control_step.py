"""The control step of an arm: its torques are held, the equations take sub-steps, and what comes of it is assessed.

Plain functions of numbers, see `numbers.functions`. The environments, closed loops and whatever else steps an arm run
these.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from fuzzyarm.envs.batch.layout import Noise
from fuzzyarm.envs.batch.randomness import noise_counter, normal_pair
from fuzzyarm.envs.physics.hold import held_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.task import assess_of, clipped, finite, reason_of
from fuzzyarm.numbers.functions import flat, like, maximum, minimum, select, when, whole

__all__ = ["ANGLE_ROOM", "VELOCITY_ROOM", "Moved", "assessed_of", "control_step_of", "reading_of"]

ANGLE_ROOM, VELOCITY_ROOM = 0.5, 10.0
"""What the observation space allows beyond the limits: the observation that ends an episode lies outside of them.

A share of the range of angles at either end of it, and a factor of the velocity limit.
"""


class Moved(NamedTuple):
    """An arm at the end of a control step."""

    state: Any  # of the arm; that at the start of the step where the one at its end is not finite
    torque: Any  # of the motors, within their limits [N m]
    force: Any  # mean of the tip force over the step [N]
    found: Any  # a `task.Assessment`
    clipped: Any  # 1.0 where torques were beyond the limits, else 0.0
    reason: Any  # a `Termination`, as a float


@functools.cache
def control_step_of(physics: Physics) -> Callable[..., Moved]:
    """Return ``control_step(state, command, now, target, arm, limits, factor, h, substeps)``.

    `command` are the controller's torques [N m]; `now` is the row of the schedule at the start of the step, whose force
    is multiplied by `factor`, and `target` what the tip is compared with at its end; the others as for `held_of`.
    """
    PerJoint, held, assessed = physics.PerJoint, held_of(physics), assessed_of(physics)

    def control_step(
        state: Any, command: Any, now: Any, target: Any, arm: Any, limits: Any, factor: Any, h: Any, substeps: Any
    ) -> Moved:
        torque = PerJoint(*map(clipped, command, limits.torque))
        applied = PerJoint(*(u + b for u, b in zip(torque, now.bias, strict=True)))
        mean, change = ([f * factor for f in part] for part in now.force)
        reached = held(state, applied, mean, change, arm, h, substeps)
        return assessed(state, reached, command, torque, now.bias, mean, target, arm, limits)

    return control_step


@functools.cache
def assessed_of(physics: Physics) -> Callable[..., Moved]:
    """Return ``assessed(before, reached, command, torque, bias, force, target, arm, limits)``, a `Moved`."""
    assess = assess_of(physics)

    def assessed(
        before: Any, reached: Any, command: Any, torque: Any, bias: Any, force: Any, target: Any, arm: Any, limits: Any
    ) -> Moved:
        sound = finite(reached)
        pairs = zip(flat(reached), flat(before), strict=True)
        state = like(reached, (select(sound > 0.0, new, old) for new, old in pairs))
        found = assess(state, torque, bias, arm, limits, target)
        differs = [u != asked for u, asked in zip(torque, command, strict=True)]
        beyond = differs[0]
        for one in differs[1:]:
            beyond = beyond | one
        reason = reason_of(sound, found.angles_inside, found.velocities_inside)
        return Moved(state, torque, force, found._replace(reward=found.reward * sound), 1.0 * beyond, reason)

    return assessed


@functools.cache
def reading_of(physics: Physics) -> Callable[..., tuple[Any, Any]]:
    """Return ``reading(state, limits, noise, key, steps)``: q and dq as the motors' encoders give them.

    `noise` is a `Noise`; it is drawn from the stream `key`, a uint64, for the instant after so many steps. Readings
    are within the observation space.
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
