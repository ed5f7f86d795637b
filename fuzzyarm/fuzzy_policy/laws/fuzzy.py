"""The fuzzy policy: parallel distributed compensation (12) of a controller file.

    u = K_hv e + H_hv x_I + L_hv r,   r = (q_d, q̇_d, q̈_d),   e = (q_a - q_d, q̇_a - q̇_d).

For a twice differentiable reference the reference model (8) is the identity, x_r = (q_d, q̇_d). In the consistent form
L_ik r = -A_pi[3:4, :] (q_d, q̇_d) + E_pk[3:4, 3:4] q̈_d, which cancels A_ph x_r - E_pv ẋ_r exactly for the kept premises.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import JOINTS, REFERENCE, observed
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw, spread_of
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.fuzzy_policy.proof.policy_certificate import PolicyCertificate, controller_certificate
from fuzzyarm.fuzzy_policy.states import ERROR_STATES, INTEGRAL, POSITION, VELOCITY
from fuzzyarm.fuzzy_policy.ts_model import PREMISES

__all__ = ["FuzzyPolicy"]


class FuzzyPolicy(Policy):
    """The law of a controller file as a policy; it is in the module's docstring.

    Attributes:
        controller: the content of the file.
    """

    integral_at: int | None = 0

    def __init__(self, controller: Controller, control_period: float = 1e-3) -> None:
        """Lay the controller out for the compiled law, at a control period T [s]."""
        super().__init__(controller.model.parameters, control_period)
        self.controller = controller
        model, n_e = controller.model, controller.gains.shape[-1]
        arm = arm_constants(model.parameters)
        # Without the integral its gain is zero, so that one law serves both.
        gains = np.zeros((*controller.gains.shape[:-1], ERROR_STATES))
        gains[..., :n_e] = controller.gains
        self._arguments = (
            gains,
            np.ascontiguousarray(controller.feedforward_gains),
            np.array(model.kept_in_A, dtype=np.int64),
            model.bounds,
            *(arm.c2, arm.c4, arm.c5),  # not the whole record, which takes as long to hand over as the law itself
            self.control_period,
        )

    def certificate(self, reference: Reference) -> PolicyCertificate:
        """Return what is proven of the controller, which is the same for every reference."""
        return controller_certificate(self.controller)

    def compiled(self) -> CompiledLaw:
        """Return the law for compiled loops."""
        return CompiledLaw("fuzzy", _ACT, self._arguments)

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
    c2: float,
    c4: float,
    c5: float,
    period: float,
) -> None:
    """Evaluate the law for every lane and advance its integral.

    Args:
        observation: (lanes, 10).
        integral: x_I (lanes, 2) [rad s].
        torque: (lanes, 2), becomes u [N m].
        gains: K̄ = [K H], (N, N_e, 2, 6).
        feedforward: L, (N, N_e, 2, 6).
        kept_in_A: indices of the premises that blend A.
        bounds: of the premises, (5, 2).
        c2: inertia of (3) [kg m²].
        c4: gravity torque of (3) [N m].
        c5: likewise.
        period: T [s].
    """
    o, reference = observed(observation), observation[:, REFERENCE]
    omega, error = np.empty(len(PREMISES)), np.empty(ERROR_STATES)
    e, de, x_I = error[POSITION], error[VELOCITY], error[INTEGRAL]
    for lane in range(len(observation)):
        q1, q2, dq1, dq2 = o.q_motor[lane, 0], o.q_motor[lane, 1], o.dq_motor[lane, 0], o.dq_motor[lane, 1]
        # The premises (6) at the measured motor angles, as `premises` has them.
        sinc12, (sin2, cos2) = _sinc(q1 + q2), sine_cosine(q2)
        z = (cos2, -c4 * _sinc(q1) - c5 * sinc12, -c5 * sinc12, c2 * dq2 * sin2, -c2 * dq1 * sin2)
        for index in range(len(omega)):  # the weight of the vertex at the premise's maximum
            low, high = bounds[index, 0], bounds[index, 1]
            omega[index] = min(max((z[index] - low) / (high - low), 0.0), 1.0)
        for joint in range(JOINTS):
            e[joint] = o.q_motor[lane, joint] - o.q_reference[lane, joint]
            de[joint] = o.dq_motor[lane, joint] - o.dq_reference[lane, joint]
            x_I[joint] = integral[lane, joint]
        torque1, torque2 = 0.0, 0.0
        for i in range(gains.shape[0]):
            h = 1.0
            for position in range(len(kept_in_A)):
                h *= _weight(omega[kept_in_A[position]], (i >> position) & 1)
            for k in range(gains.shape[1]):
                hv = h if gains.shape[1] == 1 else h * _weight(omega[0], k)  # z1 alone blends E
                for entry in range(ERROR_STATES):
                    back, forward = error[entry], reference[lane, entry]
                    torque1 += hv * (gains[i, k, 0, entry] * back + feedforward[i, k, 0, entry] * forward)
                    torque2 += hv * (gains[i, k, 1, entry] * back + feedforward[i, k, 1, entry] * forward)
        torque[lane, 0], torque[lane, 1] = torque1, torque2
        for joint in range(JOINTS):
            integral[lane, joint] += period * e[joint]


_ACT = spread_of(_fuzzy_law)


@register_jitable
def _weight(omega: float, at_maximum: int) -> float:
    """Return ω for a vertex at the premise's maximum, 1 - ω for one at its minimum."""
    return omega if at_maximum else 1.0 - omega


@register_jitable
def _sinc(angle: float) -> float:
    """Return sin(x)/x, 1 at x = 0."""
    return 1.0 if angle == 0.0 else sine_cosine(angle)[0] / angle
