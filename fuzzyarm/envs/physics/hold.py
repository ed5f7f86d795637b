"""A control step of any arm: its torque is held, the tip force is a line in time, and the equations take sub-steps."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import places, point, record_type
from fuzzyarm.numbers.functions import repeat, zeros
from fuzzyarm.numbers.machine import Kernel, Layout
from fuzzyarm.numbers.program import Program

__all__ = ["force_line", "held_of", "hold_of"]


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
