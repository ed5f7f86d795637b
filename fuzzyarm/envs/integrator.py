"""The plant's time step: half drift, kick with exact stick, half drift; second order.

Over a sub-step h the positions move half-way, the accelerations are taken there, and the velocities jump:

    x_m = x + h/2 v,    v_m = v + h/2 a(x_m, v),    v' = v + h a(x_m, v_m),    x' = x_m + h/2 v'.

The configuration-dependent terms (sines, mass matrix, gravity, tip force) are computed once a sub-step, at x_m;
only the velocity-dependent ones are computed twice. The motors' velocities are advanced by `stick_slip`, so
stick is exact. The torque is held over the control step; the tip force is linear in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable
from numba.np.unsafe.ndarray import to_fixed_tuple

from fuzzyarm.envs.compiled import kernel
from fuzzyarm.envs.dynamics import (
    Arm,
    State,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    solve_mass_matrix,
    tip_force_torque,
)
from fuzzyarm.envs.friction import stick_slip, stribeck_magnitude


@register_jitable
def step(state: State, torque1: Any, torque2: Any, force_x: Any, force_y: Any, arm: Arm, h: Any) -> State:
    """Advance the elastic arm by one sub-step h [s] under motor torques [N m] and a tip force [N]."""
    half = 0.5 * h
    motor1 = state.motor1 + half * state.motor_velocity1
    motor2 = state.motor2 + half * state.motor_velocity2
    link1 = state.link1 + half * state.link_velocity1
    link2 = state.link2 + half * state.link_velocity2
    sin1, cos1 = np.sin(link1), np.cos(link1)
    sin12, cos12 = np.sin(link1 + link2), np.cos(link1 + link2)
    sin2, cos2 = sin12 * cos1 - cos12 * sin1, cos12 * cos1 + sin12 * sin1
    force1, force2 = tip_force_torque(sin1, cos1, sin12, cos12, force_x, force_y, arm)
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)

    # Two evaluations at the mid positions: with the old velocities over h/2, then with those over h.
    velocities = (state.motor_velocity1, state.motor_velocity2, state.link_velocity1, state.link_velocity2)
    travelled1, travelled2 = motor1, motor2
    for stage in range(2):
        duration = half if stage == 0 else h
        middle = State(motor1, motor2, link1, link2, velocities[0], velocities[1], velocities[2], velocities[3])
        joint1, joint2 = joint_torque(middle, arm)
        coriolis1, coriolis2 = coriolis_torque(sin2, middle.link_velocity1, middle.link_velocity2, arm)
        acceleration1, acceleration2 = solve_mass_matrix(
            cos2, joint1 + force1 - gravity1 - coriolis1, joint2 + force2 - gravity2 - coriolis2, arm
        )
        motor_velocity1, travelled1 = stick_slip(
            state.motor_velocity1,
            (torque1 - joint1 - arm.viscous1 * middle.motor_velocity1) / arm.motor_inertia1,
            stribeck_magnitude(middle.motor_velocity1, arm.coulomb1, arm.static1, arm.stribeck_velocity)
            / arm.motor_inertia1,
            duration,
        )
        motor_velocity2, travelled2 = stick_slip(
            state.motor_velocity2,
            (torque2 - joint2 - arm.viscous2 * middle.motor_velocity2) / arm.motor_inertia2,
            stribeck_magnitude(middle.motor_velocity2, arm.coulomb2, arm.static2, arm.stribeck_velocity)
            / arm.motor_inertia2,
            duration,
        )
        velocities = (
            motor_velocity1,
            motor_velocity2,
            state.link_velocity1 + duration * acceleration1,
            state.link_velocity2 + duration * acceleration2,
        )
    return State(
        state.motor1 + travelled1,
        state.motor2 + travelled2,
        link1 + half * velocities[2],
        link2 + half * velocities[3],
        velocities[0],
        velocities[1],
        velocities[2],
        velocities[3],
    )


def hold_numpy(
    state: np.ndarray, torque: np.ndarray, force: np.ndarray, arm: np.ndarray, h: float, substeps: int
) -> np.ndarray:
    """Plain NumPy twin of `hold`, the reference back end of the tests: returns the new states."""
    lanes, constants = State(*state), Arm(*arm)
    for substep in range(substeps):
        share = (substep + 0.5) / substeps - 0.5
        force_x, force_y = force[0] + share * force[2], force[1] + share * force[3]
        lanes = step(lanes, torque[0], torque[1], force_x, force_y, constants, h)
    return np.stack(lanes)


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
    for lane in range(state.shape[1]):
        constants = Arm(*to_fixed_tuple(arm[:, lane], 20))
        now = State(*to_fixed_tuple(state[:, lane], 8))
        for substep in range(substeps):
            share = (substep + 0.5) / substeps - 0.5
            force_x = force[0, lane] + share * force[2, lane]
            force_y = force[1, lane] + share * force[3, lane]
            now = step(now, torque[0, lane], torque[1, lane], force_x, force_y, constants, h)
        for entry in range(8):
            state[entry, lane] = now[entry]
