"""One control step of the tracking task, for one arm or a batch: advance the plant, then measure and reward.

The single environment and a batch run this same kernel, one lane or many.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable
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


@register_jitable
def _tip_and_deviation(q1: float, q2: float, arm: Arm, target: np.ndarray) -> tuple[float, float, float]:
    """Return the tip (x, y) [m] at joint angles [rad] and its signed distance from the curve [m], see `measure`."""
    x = arm.length1 * np.cos(q1) + arm.length2 * np.cos(q1 + q2)
    y = arm.length1 * np.sin(q1) + arm.length2 * np.sin(q1 + q2)
    if target[6] > 0.0:
        return x, y, np.hypot(x - target[4], y - target[5]) - target[6]
    return x, y, (x - target[0]) * target[2] + (y - target[1]) * target[3]


@register_jitable
def _inside(state: State, limits: np.ndarray) -> bool:
    """Return whether motors and links are within the box (25); a NaN is outside."""
    within = abs(state.motor1) <= limits[0] and abs(state.link1) <= limits[0]
    within = within and abs(state.motor2) <= limits[1] and abs(state.link2) <= limits[1]
    within = within and abs(state.motor_velocity1) <= limits[2] and abs(state.link_velocity1) <= limits[2]
    return bool(within and abs(state.motor_velocity2) <= limits[3] and abs(state.link_velocity2) <= limits[3])


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
        row[0], row[1], row[19] = _tip_and_deviation(now.link1, now.link2, constants, target[:, lane])
        _, _, row[20] = _tip_and_deviation(now.motor1, now.motor2, constants, target[:, lane])
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
        row[21] = 1.0 if _inside(now, limits[:, lane]) else 0.0
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
