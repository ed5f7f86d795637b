"""Computed torque on the rigid model, the classical alternative to the fuzzy policy.

    u = M(q) (q̈_d - 3ω ė - 3ω² e - ω³ x_I) + C(q, q̇) q̇ + g(q) + f_v q̇,      e = q_a - q_d,   x_I = ∫ e dt,

M with the motor inertias, measured on the motor side: on the rigid arm a triple pole at -ω. The law has the same
information, integral action and torque limits as the fuzzy policy.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import arm_constants, arm_in, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["BANDWIDTH", "ComputedTorquePolicy"]

BANDWIDTH = 70.0
"""Default ω [rad/s]."""


class ComputedTorquePolicy(Policy):
    """Computed torque with integral action; the law is in the module's docstring."""

    def __init__(
        self,
        parameters: ArmParameters | None = None,
        control_period: float = 1e-3,
        bandwidth: float = BANDWIDTH,
    ) -> None:
        """Prepare the law.

        Args:
            parameters: the arm, as the controller knows it; default Table 1.
            control_period: T, time between two calls [s].
            bandwidth: ω [rad/s].

        Raises:
            TypeError: a number is none.
            ValueError: the control period or the bandwidth is not positive.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        self.bandwidth = real("bandwidth", bandwidth, "rad/s", above=0.0)
        self._arm = np.array(arm_constants(self.parameters))

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        _computed_torque(observation, memory, torque, self._arm, self.bandwidth, self.control_period)


@kernel
def _computed_torque(
    observation: np.ndarray,
    integral: np.ndarray,
    torque: np.ndarray,
    constants: np.ndarray,
    bandwidth: float,
    period: float,
) -> None:
    """Evaluate the law for every lane and advance its integral."""
    arm = arm_in(constants, 0)
    o, viscous = observed(observation), (arm.viscous1, arm.viscous2)
    for lane in range(len(observation)):
        for joint in range(JOINTS):
            error = o.q_motor[lane, joint] - o.q_reference[lane, joint]
            error_rate = o.dq_motor[lane, joint] - o.dq_reference[lane, joint]
            feedback = 3.0 * error_rate + bandwidth * (3.0 * error + bandwidth * integral[lane, joint])
            # The acceleration that is asked for stands where the torque will be.
            torque[lane, joint] = o.ddq_reference[lane, joint] - bandwidth * feedback
            integral[lane, joint] += period * error
        wanted1, wanted2 = torque[lane, 0], torque[lane, 1]
        q1, q2, dq1, dq2 = o.q_motor[lane, 0], o.q_motor[lane, 1], o.dq_motor[lane, 0], o.dq_motor[lane, 1]
        m11, m12, m22 = mass_matrix(np.cos(q2), arm)
        rigid = (
            (m11 + arm.motor_inertia1) * wanted1 + m12 * wanted2,
            m12 * wanted1 + (m22 + arm.motor_inertia2) * wanted2,
        )
        coriolis = coriolis_torque(np.sin(q2), dq1, dq2, arm)
        gravity = gravity_torque(np.sin(q1), np.sin(q1 + q2), arm)
        for joint in range(JOINTS):
            smooth = rigid[joint] + coriolis[joint] + gravity[joint]
            torque[lane, joint] = smooth + viscous[joint] * o.dq_motor[lane, joint]
