"""Scaling of the design problem: without it every interior-point solver fails on the SI numbers.

With ē = T ẽ, t = t̃/σ, u = U ũ and equations multiplied by R, the error model becomes

    Ẽ = σ R E T,   Ã = R A T,   B̃ = R B U = [0; I; 0],   C̃ = sqrt(c/σ) C T,   weight of dᵀd: c U²/σ,

and with P = c T P̃ T, M = c U M̃ T, Q = cσ T Q̃ T, X = c T X̃ R⁻¹, α = σ α̃ the inequality of `fuzzy_policy.inequality`
is congruent: Ψ = c D Ψ̃ D with a positive diagonal D. The scaling changes no solution, only the solver's luck.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.envs.dynamics import arm_constants
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.inequality import ErrorModel

REFERENCE_POLE = 62.0  # rad/s, the double pole of the paper's reference model: the natural unit of time


@dataclasses.dataclass(frozen=True)
class Scaling:
    """Diagonals of the scaling above.

    Attributes:
        time: σ [rad/s].
        state: T, (n,).
        row: R, (n,).
        torque: U, (2,) [N m].
        lyapunov: c.
        uncertainty: (m,), n_l with H̃ = n_l H R and W̃ = W T / n_l (times σ on E); τ_l = c n_l² τ̃_l / σ.
    """

    time: float
    state: np.ndarray
    row: np.ndarray
    torque: np.ndarray
    lyapunov: float
    uncertainty: np.ndarray

    @classmethod
    def of(cls, system: ErrorModel, parameters: ArmParameters, lyapunov: float) -> Scaling:
        """Choose the units for a robot: the inertia of each joint, geometrically averaged with that of both.

        Inertias alone would ask for equal bandwidths, no inertias for equal stiffness of the two joints; the
        average balances the two and sets what "small gains" means in the design.
        """
        arm = arm_constants(parameters)
        inertia = np.array(parameters.motor_inertia) + np.array([arm.c1, arm.c3])
        angle = 1.0 / np.sqrt(np.sqrt(inertia * inertia.mean()))
        time = REFERENCE_POLE
        state = np.concatenate([angle, angle * time, angle / time])[: len(system.B)]
        row = 1.0 / (state * time)
        row[2:4] = angle / time**2
        balance = np.array(
            [
                np.sqrt(np.linalg.norm(W * state * (time if on == "E" else 1.0)) / np.linalg.norm(H * row))
                for on, H, W in system.uncertainties
            ]
        )
        return cls(time, state, row, 1.0 / row[2:4], lyapunov, balance)

    def apply(self, system: ErrorModel) -> ErrorModel:
        """Return the scaled error model."""
        row, state, sigma, c = self.row[:, np.newaxis], self.state, self.time, self.lyapunov
        return ErrorModel(
            E=[sigma * row * E * state for E in system.E],
            A=[row * A * state for A in system.A],
            B=row * system.B * self.torque,
            C=np.sqrt(c / sigma) * system.C * state,
            uncertainties=[
                (on, n * H * self.row, W * state / n * (sigma if on == "E" else 1.0))
                for n, (on, H, W) in zip(self.uncertainty, system.uncertainties, strict=True)
            ],
            disturbance_weight=c / sigma * np.diag(self.torque) @ system.disturbance_weight @ np.diag(self.torque),
        )

    def congruence(self, system: ErrorModel) -> np.ndarray:
        """Return the diagonal of D in Ψ = c D Ψ̃ D."""
        root, c = np.sqrt(self.time), self.lyapunov
        return np.concatenate(
            [
                self.state * root,
                1.0 / (self.row * root),
                root / (self.torque * c),
                np.full(len(system.C), 1.0 / np.sqrt(c)),
                *(np.full(len(u[2]), n / root) for n, u in zip(self.uncertainty, system.uncertainties, strict=True)),
            ]
        )

    def restore(
        self, P: np.ndarray, M: np.ndarray, Q: np.ndarray, X: np.ndarray, tau: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the decision variables in SI units; leading axes of M, Q, X and tau are kept."""
        state, c = self.state, self.lyapunov
        column = state[:, np.newaxis]
        return (
            c * column * P * state,
            c * self.torque[:, np.newaxis] * M * state,
            c * self.time * column * Q * state,
            c * column * X / self.row,
            c / self.time * self.uncertainty**2 * tau,
        )
