"""A control step in the compiled code of the adaptive observer, see `envs.physics.hold`."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.hold import force_line
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import (
    BLOCK,
    in_block,
    in_rows,
    joint_by_joint,
    places,
    reader,
    record_type,
    size,
    writer,
)

__all__ = ["hold_of"]


@functools.cache
def hold_record(physics: Physics) -> Any:
    """Return the record of what one arm needs for a control step: state, constants, motor torques and tip force."""
    fields = {"arm": physics.Arm, "torque": physics.PerJoint, "force": force_line(physics.axes)}
    return record_type("Hold", state=physics.State, **fields)


@register_jitable(forceinline=True)
def _on_line(mean: Any, change: Any, share: Any) -> Any:
    return mean + share * change


@functools.cache
def hold_block_of(physics: Physics) -> Any:
    """Return the compiled ``hold_block(work, lanes, h, substeps)`` that advances `lanes` <= BLOCK arms, in place.

    The loop over lanes is the innermost one and all it touches is one small array whose row length is a constant:
    only then does the compiler see that lanes are independent, and turn the loop into SIMD code. The arguments: `work`,
    a block that begins with the rows of `hold_record`, see `records.in_block`; how many numbers of each row are in use;
    sub-step [s]; number of sub-steps.
    """
    Hold, step = hold_record(physics), physics.step
    read_hold = reader(Hold, in_block)
    write_state = writer(physics.State, in_block, places(Hold).state)
    on_line = joint_by_joint(_on_line, physics.Point, 2, shared=1)

    def hold_block(work: np.ndarray, lanes: int, h: float, substeps: int) -> None:
        for substep in range(substeps):
            share = (substep + 0.5) / substeps - 0.5
            for lane in range(lanes):
                now = read_hold(work, lane)
                force = on_line(now.force.mean, now.force.change, share)
                write_state(work, lane, step(now.state, now.torque, force, now.arm, h))

    # The name reaches the machine code: no two of them may have the same.
    hold_block.__qualname__ = f"hold_block_{physics.digest}"
    return register_jitable(hold_block)


@functools.cache
def hold_of(physics: Physics) -> Any:
    """Return the kernel ``hold(state, torque, force, arm, h, substeps)`` that advances lanes over one control step.

    Of its arguments `state` (numbers of the state, lanes) changes in place; `torque` (joints, lanes) [N m] is held;
    `force` has the rows of `force_line` [N], and in between the force is linear, each sub-step takes it at its own
    middle; `arm` has the rows of the constants; then the sub-step [s] and the number of sub-steps. It raises ValueError
    if an array has another shape.
    """
    Hold, hold_block = hold_record(physics), hold_block_of(physics)
    kinds = physics.State, physics.Arm, physics.PerJoint, force_line(physics.axes)
    state_of, arm_of, torque_of, force_of = (reader(kind, in_rows) for kind in kinds)
    state_rows, arm_rows, torque_rows, force_rows = map(size, kinds)
    write_hold, store_state = writer(Hold, in_block), writer(physics.State, in_rows)
    read_state, work_size = reader(physics.State, in_block, places(Hold).state), size(Hold) * BLOCK
    wrong_force = f"force must have {force_rows} rows, the mean and its change, and a column for each lane"
    wrong = (
        f"state, torque and arm must have {state_rows}, {torque_rows} and {arm_rows} rows, and a column for each lane"
    )

    @kernel_for(physics.digest)
    def hold(
        state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int
    ) -> None:
        lanes = state.shape[1]
        if force.shape != (force_rows, lanes):
            raise ValueError(wrong_force)
        if state.shape[0] != state_rows or torque.shape != (torque_rows, lanes) or arm.shape != (arm_rows, lanes):
            raise ValueError(wrong)
        work = np.empty(work_size)
        for start in range(0, lanes, BLOCK):
            count = min(BLOCK, lanes - start)
            for lane in range(count):
                at = start + lane
                whole = Hold(state_of(state, at), arm_of(arm, at), torque_of(torque, at), force_of(force, at))
                write_hold(work, lane, whole)
            hold_block(work, count, h, substeps)
            for lane in range(count):
                store_state(state, start + lane, read_state(work, lane))

    return hold
