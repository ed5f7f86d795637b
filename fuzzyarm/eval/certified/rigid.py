"""The rigid arm in continuous time under a controller of the consistent form: the loop its certificate describes.

    (M_b(q) + I_a) q̈ + C(q, q̇) q̇ + f_v q̇ + g(q) = u + d,      u = K_hv e + H_hv x_I + L_hv r,      ẋ_I = q - q_d,

with continuous feedback and no torque limit. d holds all other torques on the joints: dry friction, tip forces, a
payload. Equation (5) and the feedforward make of this, for ē = (e, x_I) and without any approximation,

    Ē(z) ē' = (Ā(z) + B̄ K̄_hv) ē + B̄ w,      w = d + ρ,      ρ = [A(z) x_r - E(z) ẋ_r]_3:4 + L_hv r,

x_r = (q_d, q̇_d). ρ is the feedforward residual of the dropped premises, zero if none is. The certificate states for
this w

    V' + zᵀz - γ² wᵀw + 2αV < 0,      V = ēᵀ P⁻¹ ē,      z = q - q_d,      while q and q̇ stay in the box (25).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.scenario.reference import ReferenceSample
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.states import PLANT, POSITION, VELOCITY
from fuzzyarm.fuzzy_policy.ts_model import descriptor_terms, premises

__all__ = ["RigidLoop"]


@dataclasses.dataclass(frozen=True)
class RigidLoop:
    """The closed loop of the module's docstring, for states in lanes; the controller's law in plain NumPy.

    Attributes:
        controller: a controller of the consistent form.

    Raises:
        ValueError: the controller is of the paper's form.
    """

    controller: Controller

    def __post_init__(self) -> None:
        """Raise for the paper's form, whose V and residual differ."""
        if self.controller.form != "consistent":
            raise ValueError(f"a controller of the {self.controller.form} form; needed: the consistent form")

    @cached_property
    def arm(self) -> Arm:
        """The constants of (3)."""
        return arm_constants(self.controller.model.parameters)

    @property
    def states(self) -> int:
        """Size n_e of ē: 6 with the integral, 4 without."""
        return int(self.controller.gains.shape[-1])

    def law(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return K̄_hv (lanes, 2, n_e) and L_hv (lanes, 2, 6), the convex sums at premises z (lanes, 5)."""
        model = self.controller.model
        low, high = model.bounds.T
        omega = np.clip((z - low) / (high - low), 0.0, 1.0)
        weights = np.ones((len(z), 1))
        for index in [*model.kept_in_E, *model.kept_in_A]:  # the first one changes fastest, as in `TSModel`
            ratio = omega[:, index : index + 1]
            weights = np.concatenate([weights * (1.0 - ratio), weights * ratio], axis=1)
        blended = (weights @ self._vertices).reshape(len(z), JOINTS, -1)
        return blended[..., : self.states], blended[..., self.states :]

    @cached_property
    def _vertices(self) -> np.ndarray:
        """[K̄_ik L_ik] as rows, i slow and k fast."""
        both = np.concatenate([self.controller.gains, self.controller.feedforward_gains], axis=-1)
        return both.reshape(-1, JOINTS * both.shape[-1])

    def descriptor(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return E(z) and A(z) of (5), (lanes, 4, 4) each, at premises z (lanes, 5)."""
        (E, E_slopes), (A, A_slopes) = self._terms["E"], self._terms["A"]
        return np.asarray(E + np.tensordot(z, E_slopes, axes=1)), np.asarray(A + np.tensordot(z, A_slopes, axes=1))

    @cached_property
    def _terms(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        return descriptor_terms(self.controller.model.parameters)

    def acceleration(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return q̈ = (M_b + I_a)⁻¹ (τ - C q̇ - f_v q̇ - g) [rad/s²] for torques τ = u + d [N m], (lanes, 2) each."""
        arm, (dq1, dq2) = self.arm, dq.T
        m11, m12, m22 = mass_matrix(np.cos(q[:, 1]), arm)
        m11, m22 = m11 + arm.motor_inertia1, m22 + arm.motor_inertia2
        c1, c2 = coriolis_torque(np.sin(q[:, 1]), dq1, dq2, arm)
        g1, g2 = gravity_torque(np.sin(q[:, 0]), np.sin(q[:, 0] + q[:, 1]), arm)
        t1 = torque[:, 0] - c1 - arm.viscous1 * dq1 - g1
        t2 = torque[:, 1] - c2 - arm.viscous2 * dq2 - g2
        return np.asarray(np.stack([m22 * t1 - m12 * t2, m11 * t2 - m12 * t1] / (m11 * m22 - m12 * m12), axis=1))

    def error_rate(
        self, error: np.ndarray, target: ReferenceSample, torque: np.ndarray, *, total: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ē' (lanes, n_e) and w [N m] (lanes, 2) for errors (lanes, n_e) from a target.

        Args:
            error: ē = (q - q_d, q̇ - q̇_d, x_I).
            target: q_d, q̇_d, q̈_d, (2,) or (lanes, 2).
            torque: w itself if `total`, so that d = w - ρ acts on the arm; otherwise d, and w = d + ρ.
            total: which of the two `torque` is.
        """
        q, dq = target.q + error[:, POSITION], target.dq + error[:, VELOCITY]
        z = premises(q, dq, self.controller.model.parameters)
        gain, feedforward = self.law(z)
        r = np.concatenate([np.broadcast_to(part, q.shape) for part in target], axis=1)
        forward = (feedforward @ r[..., np.newaxis])[..., 0]
        E, A = self.descriptor(z)
        x_r, ddq_d = r[:, PLANT, np.newaxis], r[:, PLANT.stop :, np.newaxis]
        rho = (A[:, VELOCITY] @ x_r - E[:, VELOCITY, VELOCITY] @ ddq_d)[..., 0] + forward
        d, w = (torque - rho, np.broadcast_to(torque, q.shape)) if total else (torque, torque + rho)
        u = (gain @ error[..., np.newaxis])[..., 0] + forward
        rates = [error[:, VELOCITY], self.acceleration(q, dq, u + d) - target.ddq, error[:, POSITION]]
        return np.concatenate(rates[: self.states // JOINTS], axis=1), w

    def lyapunov(self, error: np.ndarray) -> np.ndarray:
        """Return V = ēᵀ P⁻¹ ē for errors (..., n_e)."""
        return np.asarray(np.sum((error @ self._root) ** 2, axis=-1))

    @cached_property
    def _root(self) -> np.ndarray:
        """S with S Sᵀ = P⁻¹."""
        return np.linalg.inv(np.linalg.cholesky(self.controller.P)).T
