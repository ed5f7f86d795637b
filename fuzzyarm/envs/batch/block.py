"""One control step of a block of lanes: its numbers are gathered into `work`, advanced and assessed.

`work` is a flat array of shape (rows of `Layout.Work` times `BLOCK`,). The physics and the assessment run over it as
SIMD code (`hold.hold_block_of`). No lane sees another, so its numbers do not depend on how many others there are.

The functions of a layout are compiled into the kernels of its physics; `reporting` has those that write the results.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.batch.layout import CLOCK, Layout, Noise, Results
from fuzzyarm.envs.batch.reporting import inside, observe_of, report_of
from fuzzyarm.envs.batch.schedule import row_record
from fuzzyarm.envs.physics.elementwise import select
from fuzzyarm.envs.physics.hold import force_line, hold_block_of
from fuzzyarm.envs.physics.records import (
    BLOCK,
    columns,
    in_block,
    in_columns,
    joint_by_joint,
    over_joints,
    reader,
    size,
    writer,
)
from fuzzyarm.envs.task import assess_of, clipped, finite_of, target_record

__all__ = ["advance_block_of", "assess_block_of", "clip_of", "gather_of", "loads_of", "move_block_of"]


class Part(NamedTuple):
    """Rows of a record: the first one in `values`, the first one in `work`, and how many there are."""

    lane: int
    work: int
    rows: int


@functools.cache
def advance_block_of(layout: Layout) -> Any:
    """Return ``advance_block(work, lanes, values, clock, table, period, substeps, first, results)``.

    It advances the `lanes` <= BLOCK lanes from `first` on, whose commands are in `work`; arguments as in
    `kernels.advance_of`.
    """
    (gather, copy_back), move_block = gather_of(layout), move_block_of(layout)
    report, observe = report_of(layout), observe_of(layout)

    @register_jitable(forceinline=True)
    def advance_block(
        work: np.ndarray,
        lanes: int,
        values: np.ndarray,
        clock: np.ndarray,
        table: np.ndarray,
        period: float,
        substeps: int,
        first: int,
        results: Results,
    ) -> None:
        block = values[first // BLOCK]
        gather(work, lanes, block)
        move_block(work, lanes, block, clock, table, period, substeps, first)
        copy_back(work, lanes, block)
        report(work, lanes, clock, first, period, results, first)
        observe(work, lanes, clock, table, first, results, first)

    return advance_block


@functools.cache
def move_block_of(layout: Layout) -> Any:
    """Return ``move_block(work, lanes, block, clock, table, period, substeps, first)``.

    It advances and assesses the lanes of a block in `work`, where `gather` has put them, and moves their clocks.
    """
    load, clip, assess_block = loads_of(layout).load, clip_of(layout), assess_block_of(layout)
    hold_block = hold_block_of(layout.physics)

    @register_jitable(forceinline=True)
    def move_block(
        work: np.ndarray,
        lanes: int,
        block: np.ndarray,
        clock: np.ndarray,
        table: np.ndarray,
        period: float,
        substeps: int,
        first: int,
    ) -> None:
        load(work, lanes, block, clock, table, first)
        clip(work, lanes)
        hold_block(work, lanes, period / substeps, substeps)
        assess_block(work, lanes)

    return move_block


@functools.cache
def gather_of(layout: Layout) -> tuple[Any, Any]:
    """Return ``gather(work, lanes, block)`` and ``copy_back(work, lanes, block)``.

    The one copies state, arm, limits and noise of the first `lanes` lanes of a block (numbers of `Lane`, `BLOCK`) into
    `work`, the other keeps the new state.
    """
    lane, work_at, physics = columns(layout.Lane), columns(layout.Work), layout.physics
    hold = layout.WORK.hold
    state_part = Part(lane.state.start, hold.state.motor.joint1, size(physics.State))
    arm_part = Part(lane.arm.start, hold.arm[0], size(physics.Arm))
    limits_part = Part(lane.limits.start, work_at.limits.start, size(physics.Limits))
    noise_part = Part(lane.noise.start, work_at.noise.start, size(Noise))

    @register_jitable(forceinline=True)
    def gather(work: np.ndarray, lanes: int, block: np.ndarray) -> None:
        _gather_part(work, lanes, block, state_part)
        _gather_part(work, lanes, block, arm_part)
        _gather_part(work, lanes, block, limits_part)
        _gather_part(work, lanes, block, noise_part)

    @register_jitable(forceinline=True)
    def copy_back(work: np.ndarray, lanes: int, block: np.ndarray) -> None:
        for k in range(state_part.rows):
            for i in range(lanes):
                block[state_part.lane + k, i] = work[(state_part.work + k) * BLOCK + i]

    return gather, copy_back


@register_jitable(forceinline=True)
def _gather_part(work: np.ndarray, lanes: int, block: np.ndarray, part: Part) -> None:
    for k in range(part.rows):
        for i in range(lanes):
            work[(part.work + k) * BLOCK + i] = block[part.lane + k, i]


class Loads(NamedTuple):
    """What `loads_of` returns.

    Attributes:
        load: ``load(work, lanes, block, clock, table, first)`` writes force, bias and target of the step that begins,
            and moves the clocks to its end.
        load_nothing: ``load_nothing(work, table, row)`` writes no command, bias nor force in the block's first lane,
            and the target of a row.
    """

    load: Any
    load_nothing: Any


@functools.cache
def loads_of(layout: Layout) -> Loads:
    """Return the functions that write what acts on the lanes of a block."""
    physics, work_at = layout.physics, layout.WORK
    PerJoint, Point, ForceLine = physics.PerJoint, physics.Point, force_line(physics.axes)
    read_row = reader(row_record(physics.joints, physics.axes), in_columns)
    write_force, write_bias = writer(ForceLine, in_block, work_at.hold.force), writer(PerJoint, in_block, work_at.bias)
    write_command = writer(PerJoint, in_block, work_at.command)
    write_target = writer(target_record(physics.axes), in_block, work_at.target)
    times = joint_by_joint(_times, Point, 1, shared=1)
    factor_at, nothing, no_force = (
        layout.LANE.force_factor,
        PerJoint(*[0.0] * physics.joints),
        Point(*[0.0] * physics.axes),
    )

    @register_jitable(forceinline=True)
    def load(work: np.ndarray, lanes: int, block: np.ndarray, clock: np.ndarray, table: np.ndarray, first: int) -> None:
        for i in range(lanes):
            at = inside(clock[CLOCK.row, first + i], len(table) - 1)
            now, factor = read_row(table, at), block[factor_at, i]
            write_force(work, i, ForceLine(times(now.force.mean, factor), times(now.force.change, factor)))
            write_bias(work, i, now.bias)
            write_target(work, i, read_row(table, at + 1).target)
            clock[CLOCK.row, first + i] = at + 1

    @register_jitable(forceinline=True)
    def load_nothing(work: np.ndarray, table: np.ndarray, row: int) -> None:
        write_command(work, 0, nothing)
        write_bias(work, 0, nothing)
        write_force(work, 0, ForceLine(no_force, no_force))
        write_target(work, 0, read_row(table, row).target)

    return Loads(load, load_nothing)


@functools.cache
def clip_of(layout: Layout) -> Any:
    """Return ``clip(work, lanes)``.

    It clips the commanded torques, adds the bias, and keeps the state in case the step fails.
    """
    PerJoint, State, at = layout.physics.PerJoint, layout.physics.State, layout.WORK
    read_command, write_command = reader(PerJoint, in_block, at.command), writer(PerJoint, in_block, at.command)
    read_bias, write_torque = reader(PerJoint, in_block, at.bias), writer(PerJoint, in_block, at.hold.torque)
    read_limits = reader(layout.physics.Limits, in_block, at.limits)
    read_state, write_before = reader(State, in_block, at.hold.state), writer(State, in_block, at.before)
    clip_each, add_each = joint_by_joint(clipped, PerJoint, 2), joint_by_joint(_plus, PerJoint, 2)
    any_differs, flag = over_joints(_differs, PerJoint, 2, "|"), at.clipped

    @register_jitable(forceinline=True)
    def clip(work: np.ndarray, lanes: int) -> None:
        for i in range(lanes):
            asked = read_command(work, i)
            torque = clip_each(asked, read_limits(work, i).torque)
            work[flag * BLOCK + i] = 1.0 * any_differs(torque, asked)
            write_torque(work, i, add_each(torque, read_bias(work, i)))
            write_command(work, i, torque)
        for i in range(lanes):
            write_before(work, i, read_state(work, i))

    return clip


@functools.cache
def assess_block_of(layout: Layout) -> Any:
    """Return ``assess_block(work, lanes)``: put back the states that are not finite, then assess every lane."""
    physics, at = layout.physics, layout.WORK
    PerJoint, finite, assess = physics.PerJoint, finite_of(physics), assess_of(physics)
    read_state, read_arm = reader(physics.State, in_block, at.hold.state), reader(physics.Arm, in_block, at.hold.arm)
    read_command, read_bias = reader(PerJoint, in_block, at.command), reader(PerJoint, in_block, at.bias)
    read_limits = reader(physics.Limits, in_block, at.limits)
    read_target = reader(target_record(physics.axes), in_block, at.target)
    write_assessment = writer(type(at.assessment), in_block, at.assessment)
    state, before, rows = at.hold.state.motor.joint1, at.before.motor.joint1, size(physics.State)
    flag, reward = at.finite, at.assessment.reward

    @register_jitable(forceinline=True)
    def assess_block(work: np.ndarray, lanes: int) -> None:
        for i in range(lanes):
            work[flag * BLOCK + i] = finite(read_state(work, i))
        for k in range(rows):
            for i in range(lanes):
                good = work[flag * BLOCK + i] > 0.0
                work[(state + k) * BLOCK + i] = select(
                    good, work[(state + k) * BLOCK + i], work[(before + k) * BLOCK + i]
                )
        for i in range(lanes):
            found = assess(
                read_state(work, i),
                read_command(work, i),
                read_bias(work, i),
                read_arm(work, i),
                read_limits(work, i),
                read_target(work, i),
            )
            write_assessment(work, i, found)
            work[reward * BLOCK + i] = found.reward * work[flag * BLOCK + i]

    return assess_block


@register_jitable(forceinline=True)
def _times(number: Any, factor: Any) -> Any:
    return number * factor


@register_jitable(forceinline=True)
def _plus(a: Any, b: Any) -> Any:
    return a + b


@register_jitable(forceinline=True)
def _differs(a: Any, b: Any) -> Any:
    return a != b
