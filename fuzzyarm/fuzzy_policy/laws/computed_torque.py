"""Computed torque on the rigid model, the classical opponent of the fuzzy policy.

    u = M(q) (q̈_d - 3ω ė - 3ω² e - ω³ x_I) + C(q, q̇) q̇ + g(q) + f_v q̇,      e = q_a - q_d,   x_I = ∫ e dt,

M with the motor inertias, motor-side measurement: on the rigid arm a triple pole at -ω. Same information, integral
action and torque limits as the fuzzy policy.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import Arm, arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.policy import Policy

BANDWIDTH = 70.0
"""Default ω [rad/s]."""


class ComputedTorquePolicy(Policy):
    """Computed torque with integral; see the module for the law."""

    def __init__(
        self,
        parameters: ArmParameters | None = None,
        control_period: float = 1e-3,
        bandwidth: float = BANDWIDTH,
    ) -> None:
        """Keep the robot, the control period [s] and ω [rad/s]."""
        super().__init__(parameters or ArmParameters(), control_period)
        if not (math.isfinite(bandwidth) and bandwidth > 0.0):
            raise ValueError(f"bandwidth = {bandwidth!r} rad/s is out of range; allowed: (0, inf) rad/s")
        self.bandwidth = bandwidth
        self._arm = arm_constants(self.parameters)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        _computed_torque(observation, memory, torque, self._arm, self.bandwidth, self.control_period)


@kernel
def _computed_torque(
    observation: np.ndarray,
    integral: np.ndarray,
    torque: np.ndarray,
    arm: Arm,
    bandwidth: float,
    period: float,
) -> None:
    """Evaluate the law for every lane."""
    for lane in range(len(observation)):
        o = observation[lane]
        wanted1 = o[8] - bandwidth * (
            3.0 * (o[2] - o[6]) + bandwidth * (3.0 * (o[0] - o[4]) + bandwidth * integral[lane, 0])
        )
        wanted2 = o[9] - bandwidth * (
            3.0 * (o[3] - o[7]) + bandwidth * (3.0 * (o[1] - o[5]) + bandwidth * integral[lane, 1])
        )
        m11, m12, m22 = mass_matrix(np.cos(o[1]), arm)
        coriolis1, coriolis2 = coriolis_torque(np.sin(o[1]), o[2], o[3], arm)
        gravity1, gravity2 = gravity_torque(np.sin(o[0]), np.sin(o[0] + o[1]), arm)
        torque[lane, 0] = (
            (m11 + arm.motor_inertia1) * wanted1 + m12 * wanted2 + coriolis1 + gravity1 + arm.viscous1 * o[2]
        )
        torque[lane, 1] = (
            m12 * wanted1 + (m22 + arm.motor_inertia2) * wanted2 + coriolis2 + gravity2 + arm.viscous2 * o[3]
        )
        integral[lane, 0] += period * (o[0] - o[4])
        integral[lane, 1] += period * (o[1] - o[5])
