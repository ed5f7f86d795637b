"""A control step of any arm: its torque is held, the tip force is a line in time, and the equations take sub-steps."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import (
    BLOCK,
    in_block,
    joint_by_joint,
    places,
    point,
    reader,
    record_type,
    size,
    writer,
)
from fuzzyarm.numbers.functions import repeat, zeros
from fuzzyarm.numbers.machine import Kernel, Layout
from fuzzyarm.numbers.symbols import Program

__all__ = ["force_line", "held", "held_of", "hold_block_of", "hold_of", "hold_record"]


@functools.cache
def force_line(axes: int) -> Any:
    """Return the record of a tip force that is linear in time over a control step: mean and change over it [N]."""
    return record_type("ForceLine", mean=point(axes), change=point(axes))


@functools.cache
def held_of(physics: Physics) -> Callable[..., Any]:
    """Return ``held(state, torque, mean, change, arm, h, substeps)``, the state one control step later.

    Torques [N m], a record, are held. The tip force is a line in time with a mean and a change over the step [N]; each
    of the `substeps` sub-steps of h [s] takes it at its own middle.
    """
    Point = physics.Point

    def held(state: Any, torque: Any, mean: Any, change: Any, arm: Any, h: Any, substeps: Any) -> Any:
        def sub_step(carried: Any) -> Any:
            number, state = carried
            share = (number + 0.5) / substeps - 0.5
            force = Point(*(m + share * c for m, c in zip(mean, change, strict=True)))
            return number + 1.0, physics.step(state, torque, force, arm, h)

        return repeat(substeps, sub_step, (0.0, state))[1]

    return held


@functools.cache
def hold_record(physics: Physics) -> Any:
    """Return the record of what one arm needs for a control step: state, constants, motor torques and tip force."""
    fields = {"arm": physics.Arm, "torque": physics.PerJoint, "force": force_line(physics.axes)}
    return record_type("Hold", state=physics.State, **fields)


@register_jitable(forceinline=True)
def _on_line(mean: Any, change: Any, share: Any) -> Any:
    return mean + share * change


def held(
    physics: Physics, state: Any, torque: Sequence[Any], force: Sequence[Any], arm: Any, h: float, substeps: int
) -> Any:
    """Advance arrays or tensors of lanes over one control step; arguments in shapes and units of `hold_of`, by rows."""
    mean, change = force[: physics.axes], force[physics.axes :]
    for substep in range(substeps):
        share = (substep + 0.5) / substeps - 0.5
        now = physics.Point(*(_on_line(m, c, share) for m, c in zip(mean, change, strict=True)))
        state = physics.step(state, physics.PerJoint(*torque), now, arm, h)
    return state


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
def hold_of(physics: Physics) -> Callable[..., None]:
    """Return ``hold(state, torque, force, arm, h, substeps)`` that advances lanes over one control step.

    Of its arguments `state` (numbers of the state, lanes) changes in place; `torque` (joints, lanes) [N m] is held;
    `force` has the rows of `force_line` [N], and in between the force is linear, each sub-step takes it at its own
    middle; `arm` has the rows of the constants; then the sub-step [s] and the number of sub-steps. It raises ValueError
    if an array has another shape.
    """
    ForceLine, advance = force_line(physics.axes), held_of(physics)
    kinds = physics.State, physics.PerJoint, ForceLine, physics.Arm

    def step(state: Any, torque: Any, force: Any, arm: Any, given: Any) -> tuple[Any, ...]:
        return advance(state, torque, *force, arm, *given), torque, force, arm

    program = Program(step, [zeros(places(kind)) for kind in kinds], (0.0, 0.0))
    kernel = Kernel(program, [Layout.COLUMNS] * len(kinds))

    def hold(
        state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int
    ) -> None:
        kernel((state, torque, force, arm), np.array([h, substeps], dtype=np.float64))

    return hold
