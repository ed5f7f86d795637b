"""The fuzzy policy: parallel distributed compensation (12) of a controller file.

    u = K_hv e + H_hv x_I + L_hv r,   r = (q_d, q̇_d, q̈_d),   e = (q_a - q_d, q̇_a - q̇_d).

For a twice differentiable reference the reference model (8) is the identity, x_r = (q_d, q̇_d). In the consistent form
L_ik r = -A_pi[3:4, :] (q_d, q̇_d) + E_pk[3:4, 3:4] q̈_d, which cancels A_ph x_r - E_pv ẋ_r exactly for the kept premises.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.proof.statement import PolicyCertificate, controller_certificate


class FuzzyPolicy(Policy):
    """The controller of a file as a policy; see the module for the law."""

    def __init__(self, controller: Controller, control_period: float = 1e-3) -> None:
        """Lay the controller out for the compiled law."""
        super().__init__(controller.model.parameters, control_period)
        self.controller = controller
        model, arm = controller.model, arm_constants(controller.model.parameters)
        # Without the integral its gain is zero: one law for both.
        gains = np.zeros((*controller.gains.shape[:3], 6))
        gains[..., : controller.gains.shape[3]] = controller.gains
        self._arguments = (
            gains,
            np.ascontiguousarray(controller.feedforward_gains),
            np.array(model.kept_in_A, dtype=np.int64),
            model.bounds,
            np.array([arm.c2, arm.c4, arm.c5]),
            control_period,
        )

    def certificate(self, reference: JointReference) -> PolicyCertificate:
        """Return what is proven of the controller, which is the same for every reference."""
        return controller_certificate(self.controller)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate (12), see `Policy`."""
        _fuzzy_law(observation, memory, torque, *self._arguments)


@kernel
def _fuzzy_law(
    observation: np.ndarray,
    integral: np.ndarray,
    torque: np.ndarray,
    gains: np.ndarray,
    feedforward: np.ndarray,
    kept_in_A: np.ndarray,
    bounds: np.ndarray,
    constants: np.ndarray,
    period: float,
) -> None:
    """Evaluate the law for every lane; see `FuzzyPolicy` for the arrays' meaning."""
    omega, error = np.empty(5), np.empty(6)
    for lane in range(len(observation)):
        o = observation[lane]
        # Premises (6) at the measured motor angles, and ω_i1, the weight of the max vertex.
        sinc12 = _sinc(o[0] + o[1])
        sin2 = np.sin(o[1])
        omega[0] = np.cos(o[1])
        omega[1] = -constants[1] * _sinc(o[0]) - constants[2] * sinc12
        omega[2] = -constants[2] * sinc12
        omega[3] = constants[0] * o[3] * sin2
        omega[4] = -constants[0] * o[2] * sin2
        for index in range(5):
            span = bounds[index, 1] - bounds[index, 0]
            omega[index] = min(max((omega[index] - bounds[index, 0]) / span, 0.0), 1.0)
        for joint in range(4):
            error[joint] = o[joint] - o[4 + joint]
        error[4], error[5] = integral[lane, 0], integral[lane, 1]
        torque1, torque2 = 0.0, 0.0
        for i in range(gains.shape[0]):
            h = 1.0
            for position in range(len(kept_in_A)):
                weight = omega[kept_in_A[position]]
                h *= weight if (i >> position) & 1 else 1.0 - weight
            for k in range(gains.shape[1]):
                v = 1.0 if gains.shape[1] == 1 else (omega[0] if k == 1 else 1.0 - omega[0])
                for entry in range(6):
                    feedback, forward = error[entry], o[4 + entry]
                    torque1 += h * v * (gains[i, k, 0, entry] * feedback + feedforward[i, k, 0, entry] * forward)
                    torque2 += h * v * (gains[i, k, 1, entry] * feedback + feedforward[i, k, 1, entry] * forward)
        torque[lane, 0], torque[lane, 1] = torque1, torque2
        integral[lane, 0] += period * error[0]
        integral[lane, 1] += period * error[1]


@kernel
def _sinc(angle: float) -> float:
    """Return sin(x)/x, 1 at x = 0."""
    return 1.0 if angle == 0.0 else np.sin(angle) / angle
