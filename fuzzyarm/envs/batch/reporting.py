"""What a step or a beginning leaves behind: the results of a block of lanes, and what each of them lets be observed."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.layout import CLOCK, SCALARS, Layout, Noise, Results, Scalars, Vectors
from fuzzyarm.envs.batch.randomness import noise_counter, normal_pair
from fuzzyarm.envs.batch.schedule import reference_record
from fuzzyarm.envs.observation import starts
from fuzzyarm.envs.physics.records import BLOCK, in_rows, joint_by_joint, places, reader, size
from fuzzyarm.envs.termination import reason_of

__all__ = ["ANGLE_ROOM", "VELOCITY_ROOM", "inside", "observe_of", "report_of"]

ANGLE_ROOM, VELOCITY_ROOM = 0.5, 10.0
"""What the observation space allows beyond the limits: the observation that ends an episode lies outside of them.

A share of the range of angles at either end of it, and a factor of the velocity limit.
"""

_S = places(Scalars)


@register_jitable(forceinline=True)
def inside(row: int, rows: int) -> int:
    """Return a row of a table: the given one, except where several threads use an environment, which is for one only.

    Its results are wrong then, but nothing beyond the table is read.
    """
    return min(max(row, 0), rows - 1)


def _vector_rows(layout: Layout) -> Vectors:
    """Return where the first number of each of the vectors stands in `work`."""
    at, state = layout.WORK, layout.WORK.hold.state
    return Vectors(
        tip=at.assessment.tip.x,
        tip_reference=at.target.position.x,
        q_motor=state.motor.joint1,
        dq_motor=state.motor_velocity.joint1,
        q_link=state.link.joint1,
        dq_link=state.link_velocity.joint1,
        torque=at.command.joint1,
        friction_torque=at.assessment.friction_torque.joint1,
        external_force=at.hold.force.mean.x,
    )


@functools.cache
def report_of(layout: Layout) -> Any:
    """Return ``report(work, lanes, clock, first, period, results, place)``.

    It writes what the `lanes` lanes from `first` on have come to into the flat results from `place` on.
    """
    at, longest, lengths = layout.WORK, layout.longest, layout.lengths
    rows, full = tuple(_vector_rows(layout)), min(lengths) == longest
    scalar_rows = tuple(getattr(at.assessment, name) for name in SCALARS[_S.tip_error : _S.torque_clipped])
    finite, angles, velocities = at.finite, at.assessment.angles_inside, at.assessment.velocities_inside
    clipped, copied = at.clipped, _S.tip_error

    @register_jitable(forceinline=True)
    def report(
        work: np.ndarray, lanes: int, clock: np.ndarray, first: int, period: float, results: Results, place: int
    ) -> None:
        vectors, scalars, total = results.vectors, results.scalars, len(results.scalars) // len(SCALARS)
        for k in range(len(rows)):
            row, to = rows[k], longest * (k * total + place)
            for i in range(lanes):
                for axis in range(longest):
                    number = work[(row + axis) * BLOCK + i]
                    vectors[to + longest * i + axis] = number if full or axis < lengths[k] else 0.0
        for i in range(lanes):
            row_now, row_first = clock[CLOCK.row, first + i], clock[CLOCK.first, first + i]
            scalars[_S.time * total + place + i] = (row_now - row_first) * period
        for k in range(len(scalar_rows)):
            for i in range(lanes):
                scalars[(copied + k) * total + place + i] = work[scalar_rows[k] * BLOCK + i]
        for i in range(lanes):
            reason = reason_of(work[finite * BLOCK + i], work[angles * BLOCK + i], work[velocities * BLOCK + i])
            over = clock[CLOCK.row, first + i] == clock[CLOCK.last, first + i]
            scalars[_S.torque_clipped * total + place + i] = work[clipped * BLOCK + i]
            scalars[_S.truncated * total + place + i] = 1.0 if reason == 0.0 and over else 0.0
            scalars[_S.reason * total + place + i] = reason

    return report


@functools.cache
def observe_of(layout: Layout) -> Any:
    """Return ``observe(values, clock, table, lane, results, place)``.

    It writes the motor readings, with noise if there is any, within the observation space; and the reference.
    """
    physics, lane_at, numbers = layout.physics, layout.LANE, layout.observed
    joints, start, angle_range = physics.joints, starts(physics.joints), physics.angle_range
    lane_state, lane_limits = (
        reader(physics.State, in_rows, lane_at.state),
        reader(physics.Limits, in_rows, lane_at.limits),
    )
    lane_noise, reference_columns = reader(Noise, in_rows, lane_at.noise), size(reference_record(joints))
    counter, per_step = noise_counter(joints), np.uint64(2 * joints)
    low_of, high_of = joint_by_joint(_lowest, physics.PerJoint, 2), joint_by_joint(_highest, physics.PerJoint, 2)

    @register_jitable(forceinline=True)
    def observe(
        values: np.ndarray, clock: np.ndarray, table: np.ndarray, lane: int, results: Results, place: int
    ) -> None:
        observation, row, to = results.observation, inside(clock[CLOCK.row, lane], len(table)), numbers * place
        state, limits, noise = lane_state(values, lane), lane_limits(values, lane), lane_noise(values, lane)
        for joint in range(joints):
            observation[to + start.q_motor + joint] = state.motor[joint]
            observation[to + start.dq_motor + joint] = state.motor_velocity[joint]
        if noise.angle > 0.0 or noise.velocity > 0.0:
            key = np.uint64(clock[CLOCK.key, lane])
            word = counter + per_step * np.uint64(row - clock[CLOCK.first, lane])
            for k in range(0, 2 * joints, 2):
                first, second = normal_pair(key, word + np.uint64(k))
                observation[to + k] += (noise.angle if k < joints else noise.velocity) * first
                observation[to + k + 1] += (noise.angle if k + 1 < joints else noise.velocity) * second
        lowest, highest = angle_range(limits)
        low, high = low_of(lowest, highest), high_of(lowest, highest)
        for joint in range(joints):
            at = to + start.q_motor + joint
            observation[at] = min(max(observation[at], low[joint]), high[joint])
            at, room = to + start.dq_motor + joint, VELOCITY_ROOM * limits.velocity[joint]
            observation[at] = min(max(observation[at], -room), room)
        for k in range(reference_columns):
            observation[to + start.q_reference + k] = table[row, k]

    return observe


@register_jitable(forceinline=True)
def _lowest(low: Any, high: Any) -> Any:
    return low - ANGLE_ROOM * (high - low)


@register_jitable(forceinline=True)
def _highest(low: Any, high: Any) -> Any:
    return high + ANGLE_ROOM * (high - low)
