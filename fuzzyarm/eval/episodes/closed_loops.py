"""Tip errors of many episodes in one kernel: law, limits, delay and plant of some lanes, from their start to their end.

The steps are those of `loop.episodes` with `FuzzyArmVectorEnv`, in the same order and with the same bits. A group of
lanes does all its steps before the next group begins, so that what a step touches stays in the cache. It serves
policies with a `fuzzy_policy.law`; lanes with encoder noise, whose draws are no numbers of an equation, take the
ordinary loop.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import CLOCK, Layout
from fuzzyarm.envs.batch.reporting import bounds_of_reading
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.records import columns, places, size
from fuzzyarm.envs.task import assess_of, clipped, finite_of
from fuzzyarm.envs.termination import reason_of
from fuzzyarm.eval.episodes.loop import TipErrors
from fuzzyarm.fuzzy_policy.law import Law, constants_array, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import flat, like, maximum, minimum, repeat, row, select, zeros
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.symbols import Program

__all__ = ["Channel", "closed_loops"]


class Channel(NamedTuple):
    """What is between plant and policy in each lane.

    Attributes:
        noise: f (lanes,): the policy reads q + f (y - q), y the reading of the environment and q the truth; None: y.
        delay: by how many control periods (lanes,) the torques are late, whole numbers.
    """

    noise: np.ndarray | None
    delay: np.ndarray


class _Episode(NamedTuple):
    """Where a lane is: its row, its last row, 1 while it runs, by how many steps its torques are late; what was found.

    The largest tip error [m], the sum of their squares, the steps, 1 if it came to its end, and 1 if a torque was no
    finite number.
    """

    at: Any
    last: Any
    running: Any
    late: Any
    largest: Any
    squares: Any
    steps: Any
    completed: Any
    failed: Any


def closed_loops(
    lanes: Lanes, observation: np.ndarray, policy: Policy, law: Law, channel: Channel
) -> TipErrors | None:
    """Run the episodes that have begun in all lanes to their ends, and return their tip errors; the lanes stay there.

    Args:
        lanes: whose episodes have just begun.
        observation: what the policy sees of their beginning, (lanes, 5 n).
        policy: what acts.
        law: its law.
        channel: between both.

    Returns:
        The errors; None where a torque was no finite number, which the ordinary loop refuses with a message, and for
        lanes with encoder noise.
    """
    values, clock, table, period, substeps = lanes.arrays
    layout, count = lanes.layout, lanes.count
    noise = columns(layout.Lane).noise
    if lanes.numbers(noise).any():
        return None
    depth, joints = int(channel.delay.max()) + 1, layout.physics.joints
    kernel = _kernel_of(layout, law.act, *_shapes(law), policy.integral_at, depth)
    carried = np.ascontiguousarray(lanes.numbers(slice(0, noise.start)).T)
    episode = np.zeros((count, len(_Episode._fields)))
    episode[:, : _Episode._fields.index("largest")] = np.stack(
        [clock[CLOCK.row], clock[CLOCK.last], np.ones(count), channel.delay], axis=1
    )
    memory, reading = np.zeros((count, policy.memory_size)), observation[:, : 2 * joints].copy()
    sent = np.zeros((count, depth * joints))
    limit = tuple(np.asarray(policy.torque_limit, dtype=np.float64).tolist())
    constants = constants_array(law, limit, period / substeps, float(substeps))
    kernel((memory, carried, reading, sent, episode), constants, (*law.tables, table), lanes.longest_episode)
    found = _Episode(*episode.T)
    if found.failed.any():
        return None
    errors = TipErrors(count)
    for name in ("largest", "squares", "steps", "completed"):
        getattr(errors, name)[:] = getattr(found, name)
    return errors


def _shapes(law: Law) -> tuple[Any, ...]:
    """Return memory, constants and tables of a law by their shapes alone, for a cache."""
    return zeros(law.memory), zeros(law.constants), tuple(table.shape[1] for table in law.tables)


@functools.lru_cache(maxsize=64)
def _kernel_of(
    layout: Layout, act: Any, memory: Any, constants: Any, tables: Any, integral_at: int | None, depth: int
) -> Kernel:
    """Return the kernel of a law and arms with these equations; torques are late by fewer than `depth` steps."""
    physics = layout.physics
    PerJoint, joints = physics.PerJoint, physics.joints
    Row, command = row_record(joints, physics.axes), within_limits(Law(act, memory, constants), joints, integral_at)
    plant = places(layout.Lane)[: columns(layout.Lane)._fields.index("noise")]
    advance = _advance_of(layout)

    def step(
        remembered: Any, carried: Any, reading: Any, sent: Any, lane: _Episode, given: Any, *looked_up: Any
    ) -> tuple[Any, ...]:
        of_law, limit, h, substeps = given
        *own, schedule = looked_up
        state, *fixed = carried
        now, after = (like(places(Row), iter(row(schedule, place))) for place in (lane.at, lane.at + 1.0))
        seen = Observation(*reading, *now.reference)
        remembered, torque = command(remembered, seen, (of_law, limit), *own)
        on = lane.running > 0.0
        total = sum(torque[1:], torque[0])
        failed = on & (total - total != 0.0)
        # What was sent in the last steps; at the first step, as if it had always been sent.
        first = lane.steps == 0.0
        before = [PerJoint(*(select(first, u, old) for u, old in zip(torque, past, strict=True))) for past in sent]
        sent = (torque, *before[:-1])
        for steps, past in enumerate(sent):
            torque = PerJoint(*(select(lane.late == steps, p, u) for p, u in zip(past, torque, strict=True)))
        state, reading, found, reason = advance(state, torque, now, after, *fixed, h, substeps)
        at = lane.at + 1.0
        last, error = at == lane.last, found.tip_error
        lane = lane._replace(
            at=select(on, at, lane.at),
            running=1.0 * (on & ~(last | (reason != 0.0))),
            largest=select(on, maximum(lane.largest, error), lane.largest),
            squares=select(on, lane.squares + error * error, lane.squares),
            steps=select(on, lane.steps + 1.0, lane.steps),
            completed=select(on, 1.0 * (last & (reason == 0.0)), lane.completed),
            failed=select(failed, 1.0, lane.failed),
        )
        return remembered, (state, *fixed), reading, sent, lane

    nothing = PerJoint(*[0.0] * joints)
    ports = memory, plant, (nothing, nothing), (nothing,) * depth, zeros(_Episode(*[0.0] * len(_Episode._fields)))
    program = Program(step, ports, (constants, tuple(nothing), 0.0, 0.0), (*tables, size(Row)))
    return Kernel(program, repeated=True)


def _advance_of(layout: Layout) -> Callable[..., tuple[Any, Any, Any, Any]]:
    """Return the control step of an arm: its state then, what its motors read, the assessment and the reason to end."""
    physics = layout.physics
    Point, PerJoint = physics.Point, physics.PerJoint
    assess, finite_in, bounds = assess_of(physics), finite_of(physics), bounds_of_reading(physics)

    def advance(
        state: Any, torque: Any, now: Any, after: Any, arm: Any, limits: Any, factor: Any, h: Any, substeps: Any
    ) -> tuple[Any, Any, Any, Any]:
        torque = PerJoint(*(clipped(u, most) for u, most in zip(torque, limits.torque, strict=True)))
        applied = PerJoint(*(u + b for u, b in zip(torque, now.bias, strict=True)))
        mean, change = ([f * factor for f in part] for part in now.force)

        def sub_step(carried: Any) -> Any:
            number, state = carried
            share = (number + 0.5) / substeps - 0.5
            force = Point(*(m + share * c for m, c in zip(mean, change, strict=True)))
            return number + 1.0, physics.step(state, applied, force, arm, h)

        _, reached = repeat(substeps, sub_step, (0.0, state))
        finite = finite_in(reached)
        kept = (select(finite > 0.0, new, old) for new, old in zip(flat(reached), flat(state), strict=True))
        state = like(state, kept)
        found = assess(state, torque, now.bias, arm, limits, after.target)
        low, high, slowest, fastest = bounds(limits)
        q = PerJoint(*map(_between, state.motor, low, high))
        dq = PerJoint(*map(_between, state.motor_velocity, slowest, fastest))
        return state, (q, dq), found, reason_of(finite, found.angles_inside, found.velocities_inside)

    return advance


def _between(number: Any, low: Any, high: Any) -> Any:
    return minimum(maximum(number, low), high)
