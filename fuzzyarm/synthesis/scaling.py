"""Scaling of the design problem: in SI units every interior-point solver fails.

With x = T x̃, t = t̃/σ, u = U ũ, w = V w̃ and equations multiplied by R, the error model becomes

    Ẽ = σ R E T,   Ã = R A T,   B̃ = R B U,   D̃ = R D V,   C̃ = sqrt(c/σ) C T,   weight of wᵀw: c V²/σ,

and with P = c T P̃ T, M = c U M̃ T, L = U L̃ V⁻¹, Q = cσ T Q̃ T, X = c T X̃ R⁻¹, α = σ α̃ the inequality is congruent:
Ψ = c D Ψ̃ D with a positive diagonal D. The scaling changes no solution.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.envs.physics.dynamics import arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.proof.vertices import REFERENCE_POLE
from fuzzyarm.fuzzy_policy.states import PLANT, VELOCITY
from fuzzyarm.synthesis.error_model import ErrorModel, UncertainBlock

__all__ = ["Scaling"]


@dataclasses.dataclass(frozen=True)
class Scaling:
    """Diagonals of the scaling above.

    Attributes:
        time: σ [rad/s], the pole of the paper's reference model.
        state: T, (n,).
        row: R, (n,).
        torque: U, (2,) [N m].
        disturbance: V, (n_w,).
        lyapunov: c.
        uncertainty: (m,), n_l with H̃ = n_l H R and W̃x = Wx T / n_l, W̃d = σ Wd T / n_l, W̃w = Ww V / n_l;
            τ_l = c n_l² τ̃_l / σ.
    """

    time: float
    state: np.ndarray
    row: np.ndarray
    torque: np.ndarray
    disturbance: np.ndarray
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
        error = np.concatenate([angle, angle * time, angle / time])[: system.blocks[0]]
        state = np.concatenate([error, error[PLANT]])[: len(system.B)]
        row = 1.0 / (state * time)
        row[VELOCITY] = angle / time**2
        torque = 1.0 / row[VELOCITY]
        disturbance = np.concatenate([torque, angle, angle * time, angle * time**2])[: system.D[0].shape[1]]
        balance = np.array(
            [
                np.sqrt(
                    max(np.linalg.norm(b.Wx * state), np.linalg.norm(b.Wd * state) * time) / np.linalg.norm(b.H * row)
                )
                for b in system.uncertainties
            ]
        )
        return cls(time, state, row, torque, disturbance, lyapunov, balance)

    def apply(self, system: ErrorModel) -> ErrorModel:
        """Return the scaled error model."""
        row, state, sigma, c = self.row[:, np.newaxis], self.state, self.time, self.lyapunov
        V = np.diag(self.disturbance)
        return dataclasses.replace(
            system,
            E=[sigma * row * E * state for E in system.E],
            A=[[row * A * state for A in per_k] for per_k in system.A],
            B=row * system.B * self.torque,
            D=[row * D * self.disturbance for D in system.D],
            C=np.sqrt(c / sigma) * system.C * state,
            uncertainties=[
                UncertainBlock(
                    b.premises,
                    n * b.H * self.row,
                    b.Wx * state / n,
                    sigma * b.Wd * state / n,
                    b.Ww * self.disturbance / n,
                )
                for n, b in zip(self.uncertainty, system.uncertainties, strict=True)
            ],
            disturbance_weight=c / sigma * V @ system.disturbance_weight @ V,
            given_L=None if system.given_L is None else self._scaled_L(system.given_L),
        )

    def _scaled_L(self, L: np.ndarray) -> np.ndarray:
        scaled: np.ndarray = L * self.disturbance[len(self.disturbance) - L.shape[-1] :] / self.torque[:, np.newaxis]
        return scaled

    def congruence(self, system: ErrorModel) -> np.ndarray:
        """Return the diagonal of D in Ψ = c D Ψ̃ D; rows ordered x, ẋ, w, z, uncertainties."""
        root, c = np.sqrt(self.time), self.lyapunov
        return np.concatenate(
            [
                self.state * root,
                1.0 / (self.row * root),
                root / (self.disturbance * c),
                np.full(len(system.C), 1.0 / np.sqrt(c)),
                *(np.full(len(b.H), n / root) for n, b in zip(self.uncertainty, system.uncertainties, strict=True)),
            ]
        )

    def restore(
        self, P: np.ndarray, M: np.ndarray, L: np.ndarray, Q: np.ndarray, X: np.ndarray, tau: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the decision variables in SI units; leading axes of M, L, Q, X and tau are kept.

        M (..., 2, n_e) belongs to the first block of P; L (..., 2, n_r) to the last n_r entries of w.
        """
        state, c, torque = self.state, self.lyapunov, self.torque[:, np.newaxis]
        column = state[:, np.newaxis]
        return (
            c * column * P * state,
            c * torque * M * state[: M.shape[-1]],
            torque * L / self.disturbance[len(self.disturbance) - L.shape[-1] :],
            c * self.time * column * Q * state,
            c * column * X / self.row,
            c / self.time * self.uncertainty**2 * tau,
        )
