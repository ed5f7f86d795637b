"""The plant's time step: half drift, kick with exact stick, half drift; second order.

Over a sub-step h the positions move half-way, the accelerations are taken there, and the velocities jump:

    x_m = x + h/2 v,    v_m = v + h/2 a(x_m, v),    v' = v + h a(x_m, v_m),    x' = x_m + h/2 v'.

The configuration-dependent terms (sines, mass matrix, gravity, tip force) are computed once a sub-step, at x_m;
only the velocity-dependent ones are computed twice. The motors' velocities are advanced by `stick_slip`, so
stick is exact. The torque is held over the control step; the tip force is linear in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import (
    Arm,
    State,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    solve_mass_matrix,
    tip_force_torque,
)
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.records import BLOCK, PerJoint, Point, in_block, in_rows, places, reader, size, writer

__all__ = ["BLOCK", "ForceLine", "Hold", "held", "hold", "hold_block", "hold_numpy", "kick", "kick_twice", "step"]


@register_jitable(forceinline=True)
def kick(
    start: State,
    middle: State,
    torque1: Any,
    torque2: Any,
    outer1: Any,
    outer2: Any,
    sin2: Any,
    cos2: Any,
    arm: Arm,
    duration: Any,
) -> tuple[tuple[Any, Any, Any, Any], tuple[Any, Any]]:
    """Advance the velocities of `start` over `duration` with the accelerations at `middle`.

    Returns:
        The four velocities [rad/s] in the order of `State`, and the angles the motors travelled [rad].
    """
    joint1, joint2 = joint_torque(middle, arm)
    inverse1, inverse2 = 1.0 / arm.motor_inertia1, 1.0 / arm.motor_inertia2  # products cost less than quotients
    coriolis1, coriolis2 = coriolis_torque(sin2, middle.link_velocity1, middle.link_velocity2, arm)
    acceleration1, acceleration2 = solve_mass_matrix(
        cos2, joint1 + outer1 - coriolis1, joint2 + outer2 - coriolis2, arm
    )
    motor_velocity1, travelled1 = stick_slip(
        start.motor_velocity1,
        (torque1 - joint1 - arm.viscous1 * middle.motor_velocity1) * inverse1,
        stribeck_magnitude(middle.motor_velocity1, arm.coulomb1, arm.static1, arm.stribeck_velocity) * inverse1,
        duration,
    )
    motor_velocity2, travelled2 = stick_slip(
        start.motor_velocity2,
        (torque2 - joint2 - arm.viscous2 * middle.motor_velocity2) * inverse2,
        stribeck_magnitude(middle.motor_velocity2, arm.coulomb2, arm.static2, arm.stribeck_velocity) * inverse2,
        duration,
    )
    link_velocity1 = start.link_velocity1 + duration * acceleration1
    link_velocity2 = start.link_velocity2 + duration * acceleration2
    return (motor_velocity1, motor_velocity2, link_velocity1, link_velocity2), (travelled1, travelled2)


@register_jitable(forceinline=True)
def kick_twice(
    start: State,
    middle: State,
    torque1: Any,
    torque2: Any,
    outer1: Any,
    outer2: Any,
    sin2: Any,
    cos2: Any,
    arm: Arm,
    h: Any,
) -> State:
    """Return the state a sub-step h [s] after `start`, from the mid positions on; `middle` has the velocities of start.

    The accelerations are evaluated twice: with the old velocities over h/2, then with those over h.
    """
    half = 0.5 * h
    velocities, _ = kick(start, middle, torque1, torque2, outer1, outer2, sin2, cos2, arm, half)
    middle = State(
        middle.motor1,
        middle.motor2,
        middle.link1,
        middle.link2,
        *velocities,
    )
    velocities, travelled = kick(start, middle, torque1, torque2, outer1, outer2, sin2, cos2, arm, h)
    _, _, link_velocity1, link_velocity2 = velocities
    return State(
        start.motor1 + travelled[0],
        start.motor2 + travelled[1],
        middle.link1 + half * link_velocity1,
        middle.link2 + half * link_velocity2,
        *velocities,
    )


@register_jitable(forceinline=True)
def step(state: State, torque1: Any, torque2: Any, force_x: Any, force_y: Any, arm: Arm, h: Any) -> State:
    """Advance the elastic arm by one sub-step h [s] under motor torques [N m] and a tip force [N]."""
    half = 0.5 * h
    motor1 = state.motor1 + half * state.motor_velocity1
    motor2 = state.motor2 + half * state.motor_velocity2
    link1 = state.link1 + half * state.link_velocity1
    link2 = state.link2 + half * state.link_velocity2
    sin1, cos1 = sine_cosine(link1)
    sin12, cos12 = sine_cosine(link1 + link2)
    sin2, cos2 = sin12 * cos1 - cos12 * sin1, cos12 * cos1 + sin12 * sin1
    force1, force2 = tip_force_torque(sin1, cos1, sin12, cos12, force_x, force_y, arm)
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
    outer1, outer2 = force1 - gravity1, force2 - gravity2
    middle = State(
        motor1,
        motor2,
        link1,
        link2,
        state.motor_velocity1,
        state.motor_velocity2,
        state.link_velocity1,
        state.link_velocity2,
    )
    after: State = kick_twice(state, middle, torque1, torque2, outer1, outer2, sin2, cos2, arm, h)
    return after


def held(state: State, torque: Sequence[Any], force: Sequence[Any], arm: Arm, h: float, substeps: int) -> State:
    """Advance arrays or tensors of lanes over one control step; arguments in units of `hold`, each a row of lanes."""
    mean_x, mean_y, change_x, change_y = force
    for substep in range(substeps):
        share = (substep + 0.5) / substeps - 0.5
        force_x, force_y = mean_x + share * change_x, mean_y + share * change_y
        state = step(state, torque[0], torque[1], force_x, force_y, arm, h)
    return state


def hold_numpy(
    state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int
) -> np.ndarray:
    """Plain NumPy twin of `hold`, with the same units: the reference back end of the tests. Return the new states."""
    return np.stack(held(State(*state), tuple(torque), tuple(force), Arm(*arm), h, substeps))


class ForceLine(NamedTuple):
    """A tip force that is linear in time over a control step: its mean and its change over the step [N]."""

    mean: Point
    change: Point


class Hold(NamedTuple):
    """What one arm needs for a control step: its state and constants, the motor torques and the tip force."""

    state: State
    arm: Arm
    torque: PerJoint
    force: ForceLine


_AT = places(Hold)
_read_hold, _write_hold = reader(Hold, in_block), writer(Hold, in_block)
_read_state, _write_state = reader(State, in_block, _AT.state), writer(State, in_block, _AT.state)
_state_of, _store_state = reader(State, in_rows), writer(State, in_rows)
_arm_of, _torque_of, _force_of = reader(Arm, in_rows), reader(PerJoint, in_rows), reader(ForceLine, in_rows)
_SIZE, _FORCE_ROWS = size(Hold), size(ForceLine)
_STATE_ROWS, _TORQUE_ROWS, _ARM_ROWS = size(State), size(PerJoint), size(Arm)


@register_jitable
def hold_block(work: np.ndarray, lanes: int, h: float, substeps: int) -> None:
    """Advance `lanes` <= BLOCK arms by `substeps` sub-steps, in place.

    The loop over lanes is the innermost one and all it touches is one small array whose row length is a constant:
    only then does the compiler see that lanes are independent, and turn the loop into SIMD code.

    Args:
        work: a block that begins with the rows of `Hold`, see `records.in_block`.
        lanes: how many numbers of each row are in use.
        h: sub-step [s].
        substeps: number of sub-steps.
    """
    for substep in range(substeps):
        share = (substep + 0.5) / substeps - 0.5
        for lane in range(lanes):
            now = _read_hold(work, lane)
            force_x = now.force.mean.x + share * now.force.change.x
            force_y = now.force.mean.y + share * now.force.change.y
            after = step(now.state, now.torque.joint1, now.torque.joint2, force_x, force_y, now.arm, h)
            _write_state(work, lane, after)


@kernel
def hold(state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int) -> None:
    """Advance lanes in place over one control step.

    Args:
        state: (8, lanes), the rows of `State`.
        torque: (2, lanes) motor torque [N m], held.
        force: (4, lanes) tip force [N], the rows of `ForceLine`: the mean x and y of the control step, then their
            changes over it; in between the force is linear, each sub-step takes it at its own middle.
        arm: (20, lanes), the rows of `Arm`.
        h: sub-step [s].
        substeps: number of sub-steps.

    Raises:
        ValueError: an array has another shape.
    """
    lanes = state.shape[1]
    if force.shape != (_FORCE_ROWS, lanes):
        raise ValueError("force must have four rows: x, y, change of x, change of y; and a column for each lane")
    if state.shape[0] != _STATE_ROWS or torque.shape != (_TORQUE_ROWS, lanes) or arm.shape != (_ARM_ROWS, lanes):
        raise ValueError("state, torque and arm must have 8, 2 and 20 rows, and a column for each lane")
    work = np.empty(_SIZE * BLOCK)
    for start in range(0, lanes, BLOCK):
        count = min(BLOCK, lanes - start)
        for lane in range(count):
            at = start + lane
            whole = Hold(_state_of(state, at), _arm_of(arm, at), _torque_of(torque, at), _force_of(force, at))
            _write_hold(work, lane, whole)
        hold_block(work, count, h, substeps)
        for lane in range(count):
            _store_state(state, start + lane, _read_state(work, lane))
