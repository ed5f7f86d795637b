"""One control step of the tracking task, for one arm or a batch: advance the plant, then measure and reward.

The single environment and a batch run this same kernel, one lane or many.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from fuzzyarm.envs.compiled import kernel
from fuzzyarm.envs.dynamics import Arm, State, joint_torque
from fuzzyarm.envs.friction import friction_torque
from fuzzyarm.envs.integrator import hold

TRACKING_LENGTH = 0.005  # m; the tip error at which the tracking reward is one half [a choice, no source]
EFFORT_WEIGHT = 0.1  # share of the reward that full torque takes away [a choice, no source]


class Slots(NamedTuple):
    """Where each measured quantity stands in a row of `measure`'s output."""

    tip: slice = slice(0, 2)
    tip_reference: slice = slice(2, 4)
    motor: slice = slice(4, 8)  # q_a (2), dq_a (2), noise-free
    link: slice = slice(8, 12)  # q_b (2), dq_b (2)
    torque: slice = slice(12, 14)
    friction_torque: slice = slice(14, 16)
    external_force: slice = slice(16, 18)
    tip_error: int = 18
    circularity_error: int = 19
    circularity_error_motor: int = 20
    in_domain: int = 21
    reward_tracking: int = 22
    reward_effort: int = 23
    reward: int = 24


SLOTS = Slots()
WIDTH = 25


@kernel
def measure(
    state: np.ndarray,
    torque: np.ndarray,
    bias: np.ndarray,
    force: np.ndarray,
    arm: np.ndarray,
    limits: np.ndarray,
    target: np.ndarray,
    out: np.ndarray,
) -> None:
    """Measure every lane after its step and reward it, into the rows of `out`.

    reward = tracking (1 - 0.1 effort), tracking = 1 / (1 + |tip - reference| / 5 mm),
    effort = ((Γ_1/Γ_1max)² + (Γ_2/Γ_2max)²) / 2.

    Args:
        state: (8, lanes), the rows of `State`, after the step.
        torque: (2, lanes) motor torque of the controller, clipped [N m].
        bias: (2, lanes) torque bias [N m].
        force: (4, lanes) mean tip force of the step and its change over it [N], see `hold`.
        arm: (20, lanes), the rows of `Arm`.
        limits: (6, lanes), joint [rad], velocity [rad/s] and torque [N m] limits.
        target: (7, lanes): reference tip (x, y) [m]; unit normal (x, y) of the curve; circle center (x, y) and
            radius [m], radius 0 for a curve that is no circle.
        out: (lanes, 25), laid out as `Slots`.
    """
    for lane in range(state.shape[1]):
        constants = Arm(*to_fixed_tuple(arm[:, lane], 20))
        now = State(*to_fixed_tuple(state[:, lane], 8))
        row = out[lane]
        for side in range(2):
            q1, q2 = (now.link1, now.link2) if side == 0 else (now.motor1, now.motor2)
            x = constants.length1 * np.cos(q1) + constants.length2 * np.cos(q1 + q2)
            y = constants.length1 * np.sin(q1) + constants.length2 * np.sin(q1 + q2)
            if target[6, lane] > 0.0:
                row[19 + side] = np.hypot(x - target[4, lane], y - target[5, lane]) - target[6, lane]
            else:
                row[19 + side] = (x - target[0, lane]) * target[2, lane] + (y - target[1, lane]) * target[3, lane]
            if side == 0:
                row[0], row[1] = x, y
        row[2], row[3] = target[0, lane], target[1, lane]
        row[4], row[5], row[6], row[7] = now.motor1, now.motor2, now.motor_velocity1, now.motor_velocity2
        row[8], row[9], row[10], row[11] = now.link1, now.link2, now.link_velocity1, now.link_velocity2
        row[12], row[13] = torque[0, lane], torque[1, lane]
        joint1, joint2 = joint_torque(now, constants)
        row[14] = friction_torque(
            now.motor_velocity1,
            torque[0, lane] + bias[0, lane] - joint1,
            constants.coulomb1,
            constants.static1,
            constants.stribeck_velocity,
        )
        row[15] = friction_torque(
            now.motor_velocity2,
            torque[1, lane] + bias[1, lane] - joint2,
            constants.coulomb2,
            constants.static2,
            constants.stribeck_velocity,
        )
        row[16], row[17] = force[0, lane], force[1, lane]
        row[18] = np.hypot(row[0] - row[2], row[1] - row[3])
        inside = True
        for entry in range(2):
            # Written so that a NaN counts as outside.
            for value in (state[entry, lane], state[2 + entry, lane]):
                inside = inside and np.abs(value) <= limits[entry, lane]
            for value in (state[4 + entry, lane], state[6 + entry, lane]):
                inside = inside and np.abs(value) <= limits[2 + entry, lane]
        row[21] = 1.0 if inside else 0.0
        effort1, effort2 = torque[0, lane] / limits[4, lane], torque[1, lane] / limits[5, lane]
        row[22] = 1.0 / (1.0 + row[18] / TRACKING_LENGTH)
        row[23] = 0.5 * (effort1 * effort1 + effort2 * effort2)
        row[24] = row[22] * (1.0 - EFFORT_WEIGHT * row[23])


@kernel
def control_step(
    state: np.ndarray,
    torque: np.ndarray,
    bias: np.ndarray,
    force: np.ndarray,
    arm: np.ndarray,
    limits: np.ndarray,
    target: np.ndarray,
    h: float,
    substeps: int,
    out: np.ndarray,
) -> None:
    """Advance every lane in place under torque + bias, then `measure` it; arguments as there and in `hold`."""
    hold(state, torque + bias, force, arm, h, substeps)
    measure(state, torque, bias, force, arm, limits, target, out)
