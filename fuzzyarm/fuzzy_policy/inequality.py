"""The matrix inequality of the consistent-reference form, written once for solver and verifier.

With x_r ≡ (q_d, q̇_d) and the feedforward L of `controller`, what remains of (9) is, for ē = (e, x_I), ẋ_I = C_p e,

    Ē_v ē' = (Ā_h + ΔĀ) ē + B̄ K̄ ē + B̄ d,      Ē_v = diag(E_pv + ΔE, I),    Ā_h = [[A_ph, 0], [C_p, 0]],

and V = ēᵀ P⁻¹ ē obeys V' + zᵀz - γ² dᵀd + 2αV < 0, z = C ē, if for all i, j, k (paper (15) and Theorem 2 without
the x_r blocks) Ψ_iik < 0 and Ψ_ijk + Ψ_jik < 0 for i < j, where

            | He(Q_ij + αP)                        *                               *      *   *     |
            | A_i P + B M_jk - E_k Q_ij + X_ijᵀ    -He(E_k X_ij) + Σ τ_l H_lᵀH_l   *      *   *     |
    Ψ_ijk = | 0                                    Bᵀ                              -γ²I   *   *     |
            | C P                                  0                               0      -I  *     |
            | W_l P  or  -W_l Q_ij                 0  or  -W_l X_ij                0      0   -τ_l I|

with one row block and one multiplier τ_l for each dropped premise (on A, or on E). K_jk = M_jk P⁻¹. Without
the integral ē = e. The paper has one multiplier for all uncertainties of A and one for E; one each is less
conservative.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.ts_model import TSModel


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """The matrices of the error dynamics, n = 6 with the integral and 4 without; in SI units or scaled.

    E (N_e of (n, n)), A (N of (n, n)), B (n, 2), C (2, n), per dropped premise (on, H (r, n), W (r, n)), and the
    weight (2, 2) of dᵀd, the identity in SI units.
    """

    E: list[np.ndarray]
    A: list[np.ndarray]
    B: np.ndarray
    C: np.ndarray
    uncertainties: list[tuple[str, np.ndarray, np.ndarray]]
    disturbance_weight: np.ndarray

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The index pairs i <= j of the convex double sum."""
        return [(i, j) for i in range(len(self.A)) for j in range(i, len(self.A))]


def error_model(model: TSModel, integral: bool) -> ErrorModel:
    """Return the error dynamics of a T-S model in SI units; z = C ē is the position error [rad]."""
    extra = 2 if integral else 0
    n = 4 + extra

    def embed(matrix: np.ndarray) -> np.ndarray:
        return np.hstack([matrix, np.zeros((len(matrix), extra))])

    C = embed(np.eye(2, 4))
    E, A = [], []
    for vertex in model.E_vertices:
        E.append(np.eye(n))
        E[-1][:4, :4] = vertex
    for vertex in model.A_vertices:
        A.append(np.zeros((n, n)))
        A[-1][:4, :4] = vertex
        A[-1][4:, :] = C[:extra]
    uncertainties = [(u.on, embed(u.H), embed(u.W)) for u in model.uncertainties]
    return ErrorModel(E, A, np.vstack([model.B, np.zeros((extra, 2))]), C, uncertainties, np.eye(2))


def psi(
    system: ErrorModel,
    i: int,
    k: int,
    *,
    alpha: Any,
    gamma2: Any,
    P: Any,
    M: Any,
    Q: Any,
    X: Any,
    tau: Any,
    block: Callable[[list[list[Any]]], Any] = np.block,
) -> Any:
    """Return Ψ_ijk, symmetric; `M` is M_jk, `Q`, `X`, `tau` those of the pair (i, j) and k.

    Works on arrays with `block = np.block` and on cvxpy expressions with `block = cvxpy.bmat`.
    """
    A, E, B, C = system.A[i], system.E[k], system.B, system.C
    n, n_d, n_z = len(A), B.shape[1], len(C)
    slack = E @ X
    coupling = A @ P + B @ M - E @ Q + X.T
    corner = -(slack + slack.T)
    below: list[tuple[Any, Any, int]] = []
    for scale, (on, H, W) in zip(tau, system.uncertainties, strict=True):
        corner = corner + scale * (H.T @ H)
        below.append((W @ P, np.zeros((len(W), n)), len(W)) if on == "A" else (-W @ Q, -W @ X, len(W)))
    performance = C @ P
    rows = [
        [Q + Q.T + 2.0 * alpha * P, coupling.T, np.zeros((n, n_d)), performance.T, *(left.T for left, _, _ in below)],
        [coupling, corner, B, np.zeros((n, n_z)), *(middle.T for _, middle, _ in below)],
        [
            np.zeros((n_d, n)),
            B.T,
            -gamma2 * system.disturbance_weight,
            np.zeros((n_d, n_z)),
            *(np.zeros((n_d, r)) for *_, r in below),
        ],
        [performance, np.zeros((n_z, n)), np.zeros((n_z, n_d)), -np.eye(n_z), *(np.zeros((n_z, r)) for *_, r in below)],
    ]
    for position, (left, middle, size) in enumerate(below):
        diagonal = [
            -tau[position] * np.eye(size) if other == position else np.zeros((size, width))
            for other, (_, _, width) in enumerate(below)
        ]
        rows.append([left, middle, np.zeros((size, n_d)), np.zeros((size, n_z)), *diagonal])
    return block(rows)
