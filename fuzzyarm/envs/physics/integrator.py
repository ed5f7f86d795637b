"""The plant's time step: half drift, kick with exact stick, half drift; second order.

Over a sub-step h the positions move half-way, the accelerations are taken there, and the velocities jump:

    x_m = x + h/2 v,    v_m = v + h/2 a(x_m, v),    v' = v + h a(x_m, v_m),    x' = x_m + h/2 v'.

The configuration-dependent terms (sines, mass matrix, gravity, tip force) are computed once a sub-step, at x_m;
only the velocity-dependent ones are computed twice. The motors' velocities are advanced by `stick_slip`, so
stick is exact. The torque is held over the control step; the tip force is linear in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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

BLOCK = 32  # lanes that are advanced together: their numbers stay in the fastest cache
ARM, TORQUE, FORCE = 8, 28, 30  # where the rows of `hold_block`'s array begin; the state's are the first eight


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
        velocities[0],
        velocities[1],
        velocities[2],
        velocities[3],
    )
    velocities, travelled = kick(start, middle, torque1, torque2, outer1, outer2, sin2, cos2, arm, h)
    return State(
        start.motor1 + travelled[0],
        start.motor2 + travelled[1],
        middle.link1 + half * velocities[2],
        middle.link2 + half * velocities[3],
        velocities[0],
        velocities[1],
        velocities[2],
        velocities[3],
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
    middle = State(motor1, motor2, link1, link2, state[4], state[5], state[6], state[7])
    after: State = kick_twice(state, middle, torque1, torque2, outer1, outer2, sin2, cos2, arm, h)
    return after


def held(state: State, torque: Sequence[Any], force: Sequence[Any], arm: Arm, h: float, substeps: int) -> State:
    """Advance arrays or tensors of lanes over one control step; arguments as in `hold`, each a row of lanes."""
    for substep in range(substeps):
        share = (substep + 0.5) / substeps - 0.5
        force_x, force_y = force[0] + share * force[2], force[1] + share * force[3]
        state = step(state, torque[0], torque[1], force_x, force_y, arm, h)
    return state


def hold_numpy(
    state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int
) -> np.ndarray:
    """Plain NumPy twin of `hold`, the reference back end of the tests: returns the new states."""
    return np.stack(held(State(*state), tuple(torque), tuple(force), Arm(*arm), h, substeps))


@register_jitable(forceinline=True)
def state_at(work: np.ndarray, lane: int) -> State:
    """Read a column of `hold_block`'s array."""
    return State(
        work[lane],
        work[BLOCK + lane],
        work[2 * BLOCK + lane],
        work[3 * BLOCK + lane],
        work[4 * BLOCK + lane],
        work[5 * BLOCK + lane],
        work[6 * BLOCK + lane],
        work[7 * BLOCK + lane],
    )


@register_jitable(forceinline=True)
def arm_at(work: np.ndarray, lane: int) -> Arm:
    """Read a column of `hold_block`'s array."""
    return Arm(
        work[8 * BLOCK + lane],
        work[9 * BLOCK + lane],
        work[10 * BLOCK + lane],
        work[11 * BLOCK + lane],
        work[12 * BLOCK + lane],
        work[13 * BLOCK + lane],
        work[14 * BLOCK + lane],
        work[15 * BLOCK + lane],
        work[16 * BLOCK + lane],
        work[17 * BLOCK + lane],
        work[18 * BLOCK + lane],
        work[19 * BLOCK + lane],
        work[20 * BLOCK + lane],
        work[21 * BLOCK + lane],
        work[22 * BLOCK + lane],
        work[23 * BLOCK + lane],
        work[24 * BLOCK + lane],
        work[25 * BLOCK + lane],
        work[26 * BLOCK + lane],
        work[27 * BLOCK + lane],
    )


@register_jitable
def hold_block(work: np.ndarray, lanes: int, h: float, substeps: int) -> None:
    """Advance `lanes` <= BLOCK arms by `substeps` sub-steps, in place.

    The loop over lanes is the innermost one and all it touches is one small array whose row length is a constant:
    only then does the compiler see that lanes are independent, and turn the loop into SIMD code.

    Args:
        work: rows of BLOCK numbers below each other, 34 or more: those of `State` and of `Arm`, two of torque, four
            of force, see `hold`.
        lanes: how many numbers of each row are in use.
        h: sub-step [s].
        substeps: number of sub-steps.
    """
    for substep in range(substeps):
        share = (substep + 0.5) / substeps - 0.5
        for lane in range(lanes):
            force_x = work[FORCE * BLOCK + lane] + share * work[(FORCE + 2) * BLOCK + lane]
            force_y = work[(FORCE + 1) * BLOCK + lane] + share * work[(FORCE + 3) * BLOCK + lane]
            torque1, torque2 = work[TORQUE * BLOCK + lane], work[(TORQUE + 1) * BLOCK + lane]
            now = step(state_at(work, lane), torque1, torque2, force_x, force_y, arm_at(work, lane), h)
            for row in range(8):
                work[row * BLOCK + lane] = now[row]


@kernel
def hold(state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int) -> None:
    """Advance lanes in place over one control step.

    Args:
        state: (8, lanes), the rows of `State`.
        torque: (2, lanes) motor torque [N m], held.
        force: (4, lanes) tip force [N]: the mean x and y of the control step, then their changes over it; in between
            the force is linear, each sub-step takes it at its own middle.
        arm: (20, lanes), the rows of `Arm`.
        h: sub-step [s].
        substeps: number of sub-steps.

    Raises:
        ValueError: `force` has not four rows (the other shapes are not checked).
    """
    if force.shape[0] != 4:
        raise ValueError("force must have four rows: x, y, change of x, change of y")
    work = np.empty((FORCE + 4) * BLOCK)
    for start in range(0, state.shape[1], BLOCK):
        lanes = min(BLOCK, state.shape[1] - start)
        for lane in range(lanes):
            for row in range(8):
                work[row * BLOCK + lane] = state[row, start + lane]
            for row in range(20):
                work[(ARM + row) * BLOCK + lane] = arm[row, start + lane]
            for row in range(2):
                work[(TORQUE + row) * BLOCK + lane] = torque[row, start + lane]
            for row in range(4):
                work[(FORCE + row) * BLOCK + lane] = force[row, start + lane]
        hold_block(work, lanes, h, substeps)
        for row in range(8):
            for lane in range(lanes):
                state[row, start + lane] = work[row * BLOCK + lane]
