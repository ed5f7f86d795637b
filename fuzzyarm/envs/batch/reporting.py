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
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import BLOCK, in_block, joint_by_joint, places, reader, size, writer
from fuzzyarm.envs.termination import reason_of

__all__ = ["ANGLE_ROOM", "VELOCITY_ROOM", "bounds_of_reading", "inside", "observe_of", "report_of"]

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
    clipped, copied, block, wide = at.clipped, _S.tip_error, np.uint64(BLOCK), np.uint64(longest)

    @register_jitable(forceinline=True)
    def report(
        work: np.ndarray, lanes: int, clock: np.ndarray, first: int, period: float, results: Results, place: int
    ) -> None:
        vectors, scalars, total = results.vectors, results.scalars, len(results.scalars) // len(SCALARS)
        for k in range(len(rows)):
            row, to = rows[k], longest * (k * total + place)
            # Without a sign, an index needs no look whether it counts from the end, and the loop is SIMD code.
            into, source = np.uint64(to), np.uint64(row * BLOCK)
            for i in range(np.uint64(lanes)):
                for axis in range(wide):
                    number = work[source + axis * block + i]
                    vectors[into + wide * i + axis] = number if full or axis < lengths[k] else 0.0
        for i in range(lanes):
            row_now, row_first = clock[CLOCK.row, first + i], clock[CLOCK.first, first + i]
            scalars[_S.time * total + place + i] = (row_now - row_first) * period
        for k in range(len(scalar_rows)):
            into, source = np.uint64((copied + k) * total + place), np.uint64(scalar_rows[k] * BLOCK)
            for i in range(np.uint64(lanes)):
                scalars[into + i] = work[source + i]
        for i in range(lanes):
            reason = reason_of(work[finite * BLOCK + i], work[angles * BLOCK + i], work[velocities * BLOCK + i])
            over = clock[CLOCK.row, first + i] == clock[CLOCK.last, first + i]
            scalars[_S.torque_clipped * total + place + i] = work[clipped * BLOCK + i]
            scalars[_S.truncated * total + place + i] = 1.0 if reason == 0.0 and over else 0.0
            scalars[_S.reason * total + place + i] = reason

    return report


@functools.cache
def observe_of(layout: Layout) -> Any:
    """Return ``observe(work, lanes, clock, table, first, results, place)``.

    It writes what the `lanes` lanes from `first` on read of their motors, with noise if there is any, within the
    observation space, and their references, into the flat results from `place` on.
    """
    physics, at, numbers = layout.physics, layout.WORK, layout.observed
    joints, start, PerJoint = physics.joints, starts(physics.joints), physics.PerJoint
    reference_columns, own = size(reference_record(joints)), start.q_reference
    read_state, read_limits = (
        reader(physics.State, in_block, at.hold.state),
        reader(physics.Limits, in_block, at.limits),
    )
    read_reading, write_reading = (make(type(at.reading), in_block, at.reading) for make in (reader, writer))
    Reading, noisy, add_noise = type(at.reading), _noisy_of(layout), _add_noise_of(layout)
    bounds, between = bounds_of_reading(physics), joint_by_joint(_between, PerJoint, 3)
    first_row = at.reading.q.joint1

    @register_jitable(forceinline=True)
    def observe(
        work: np.ndarray, lanes: int, clock: np.ndarray, table: np.ndarray, first: int, results: Results, place: int
    ) -> None:
        for i in range(lanes):
            state = read_state(work, i)
            write_reading(work, i, Reading(state.motor, state.motor_velocity))
        if noisy(work, lanes):
            add_noise(work, lanes, clock, first)
        for i in range(lanes):
            read, (low, high, slowest, fastest) = read_reading(work, i), bounds(read_limits(work, i))
            write_reading(work, i, Reading(between(read.q, low, high), between(read.dq, slowest, fastest)))
        observation = results.observation
        for i in range(lanes):
            row, to = np.uint64(inside(clock[CLOCK.row, first + i], len(table))), np.uint64(numbers * (place + i))
            for k in range(np.uint64(own)):
                observation[to + k] = work[(np.uint64(first_row) + k) * np.uint64(BLOCK) + np.uint64(i)]
            for k in range(np.uint64(reference_columns)):
                observation[to + np.uint64(own) + k] = table[row, k]

    return observe


@functools.cache
def bounds_of_reading(physics: Physics) -> Any:
    """Return the compiled function that gives the bounds of an observation, of angles and of velocities, by limits."""
    low_of, high_of = joint_by_joint(_lowest, physics.PerJoint, 2), joint_by_joint(_highest, physics.PerJoint, 2)
    slowest_of, fastest_of = (
        joint_by_joint(_slowest, physics.PerJoint, 1),
        joint_by_joint(_fastest, physics.PerJoint, 1),
    )
    angle_range = physics.angle_range

    @register_jitable(forceinline=True)
    def bounds(limits: Any) -> tuple[Any, Any, Any, Any]:
        low, high = angle_range(limits)
        return low_of(low, high), high_of(low, high), slowest_of(limits.velocity), fastest_of(limits.velocity)

    return bounds


@functools.cache
def _noisy_of(layout: Layout) -> Any:
    """Return ``noisy(work, lanes)``: whether any of these lanes has encoder noise."""
    angle, velocity = layout.WORK.noise.angle, layout.WORK.noise.velocity

    @register_jitable(forceinline=True)
    def noisy(work: np.ndarray, lanes: int) -> bool:
        found = 0.0
        for i in range(lanes):
            found = max(found, max(work[angle * BLOCK + i], work[velocity * BLOCK + i]))
        return found > 0.0

    return noisy


@functools.cache
def _add_noise_of(layout: Layout) -> Any:
    """Return ``add_noise(work, lanes, clock, first)``: it adds to the readings what is drawn for this instant."""
    joints, read_noise = layout.physics.joints, reader(Noise, in_block, layout.WORK.noise)
    row, counter, per_step = layout.WORK.reading.q.joint1, noise_counter(joints), np.uint64(2 * joints)

    @register_jitable
    def add_noise(work: np.ndarray, lanes: int, clock: np.ndarray, first: int) -> None:
        for i in range(lanes):
            noise = read_noise(work, i)
            if noise.angle > 0.0 or noise.velocity > 0.0:
                key = np.uint64(clock[CLOCK.key, first + i])
                word = counter + per_step * np.uint64(clock[CLOCK.row, first + i] - clock[CLOCK.first, first + i])
                for k in range(0, 2 * joints, 2):
                    one, other = normal_pair(key, word + np.uint64(k))
                    work[(row + k) * BLOCK + i] += (noise.angle if k < joints else noise.velocity) * one
                    work[(row + k + 1) * BLOCK + i] += (noise.angle if k + 1 < joints else noise.velocity) * other

    return add_noise


@register_jitable(forceinline=True)
def _between(number: Any, low: Any, high: Any) -> Any:
    return min(max(number, low), high)


@register_jitable(forceinline=True)
def _slowest(limit: Any) -> Any:
    return -(VELOCITY_ROOM * limit)


@register_jitable(forceinline=True)
def _fastest(limit: Any) -> Any:
    return VELOCITY_ROOM * limit


@register_jitable(forceinline=True)
def _lowest(low: Any, high: Any) -> Any:
    return low - ANGLE_ROOM * (high - low)


@register_jitable(forceinline=True)
def _highest(low: Any, high: Any) -> Any:
    return high + ANGLE_ROOM * (high - low)
