"""Theorems 1 and 2 of the paper, for floats, exact rationals and the expressions of cvxpy (`block_matrix`).

Theorem 1: the matrix Ξ_ijk of (15), for the tracking error and the reference model together.

            | S_11   ⋆      ⋆      ⋆      ⋆      ⋆      ⋆   |   e, with the integral (e, x_I)
            | S_21   S_22   ⋆      ⋆      ⋆      ⋆      ⋆   |   x_r
            | S_31   S_32   S_33   ⋆      ⋆      ⋆      ⋆   |   ė
    Ξ_ijk = | S_41   S_42   S_43   S_44   ⋆      ⋆      ⋆   |   ẋ_r
            | 0      0      B_dᵀ   0      -γ²I   ⋆      ⋆   |   d
            | 0      0      S_63   B_rᵀ   0      -γ²I   ⋆   |   r
            | P_11   0      0      0      0      0      -Q⁻¹|   z

    S_11 = He(Q_11 + αP_11)                  S_21 = Q_21 + Q_12ᵀ          S_22 = He(Q_22 + αP_22)
    S_31 = A_i P_11 + B M_jk - E_k Q_11 + X_11ᵀ          S_32 = (A_i - E_k A_r) P_22 - E_k Q_12 + X_21ᵀ
    S_41 = -Q_21 + X_12ᵀ                                 S_42 = A_r P_22 - Q_22 + X_22ᵀ
    S_33 = -He(E_k X_11)      S_43 = -X_21 - X_12ᵀ E_kᵀ      S_44 = -He(X_22)
    S_63 = (B L_jk)ᵀ - (E_k B_r)ᵀ

The blocks of Q and X are those of the pair (i, j). If Ξ_iik < 0 and Ξ_ijk + Ξ_jik < 0 for i < j and all k, with
P_11, P_22 > 0, then V = ēᵀ P_11⁻¹ ē + x_rᵀ P_22⁻¹ x_r obeys, along (10) with u = M_hv P_11⁻¹ ē + L_hv r,

    V̇ + eᵀQe - γ² wᵀw + 2αV < 0,     w = (d, r).

The paper prints an eighth column of ⋆ in (15), Ξ_ik for Ξ_iik in (14), and a D_v in (11) whose lower row lacks the
[0 B_r] that (8) has and (15) uses. With the integral (Remark 2), E_k is diag(E_pk, I), A_i is [[A_pi, 0], [C_p, 0]],
A_i - E_k A_r is [A_pi - E_pk A_r; 0] (printed there with B_r for A_r), E_k B_r is [E_pk B_r; 0], and the last
row is [I 0] P_11: z weights e only.

Theorem 2: the matrix Ψ_ijk, Theorem 1 for a model with norm-bounded uncertainty.

    Ψ_ijk = | Ξ_ijk + H̄ᵀ τ H̄   ⋆       |        Ψ_2 = | T_11  T_12  0     0     0  0     0 |   ΔA = H_aᵀ Δ_a W_a
            | Ψ_2              -τ I    |              | T_31  T_32  T_33  T_34  0  T_36  0 |   ΔE = H_eᵀ Δ_e W_e

with H̄ = [0 0 H 0 0 0 0] in the columns of Ξ, so that the third diagonal block of Ξ becomes
S_33* = S_33 + τ_a H_aᵀH_a + τ_e H_eᵀH_e, and

    T_11 = W_a P_11         T_12 = W_a P_22
    T_31 = -W_e Q_11        T_32 = -W_e (A_r P_22 + Q_12)
    T_33 = -W_e X_11        T_34 = -W_e X_12        T_36 = -W_e B_r

If Ψ_iik < 0 and Ψ_ijk + Ψ_jik < 0 for i < j and all k, then the dissipation inequality of Theorem 1 holds for all
Δ with ΔᵀΔ <= I. With y = P*⁻¹ x*, Ψ_2 maps (y, w, ·) to W_a x_p and -W_e ẋ_p: the two signals the uncertainty acts on.

The paper prints T_32 with -Q_12; both terms of S_32 that carry E_k have a minus sign, and so does ΔE here. The rows
T_21 and T_26 of ΔB are left out: the torques of this arm enter with certainty, B_p is constant. With the
integral H and W act on e and leave x_I alone. `data.uncertainties` has one term for A and one for E as printed, or
one term for each dropped premise: every term is a row of Ψ_2 with its own multiplier.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.states import PLANT
from fuzzyarm.fuzzy_policy.ts_model import Uncertainty
from fuzzyarm.proof.block_matrix import Assembly, he, identity, symmetric, times, transposed
from fuzzyarm.proof.vertices import Index, TrackingVertices

__all__ = ["psi"]


def psi(
    data: TrackingVertices,
    i: Index,
    k: Index,
    *,
    alpha: Any,
    gamma2: Any,
    output: Any = 1,
    P: Any,
    M: Any,
    L: Any,
    Q: Any,
    X: Any,
    tau: Any,
    put: Assembly = symmetric,
) -> Any:
    """Return Ψ_ijk, symmetric and affine in P, M, L, Q, X, τ and γ²; Ξ_ijk of a model without uncertainty.

    n_e = 4 or, with the integral, 6; n = n_e + 4. Vertices i of A and k of E count from 0; α is in 1/s, z has the
    factor `output`. P = diag(P_11, P_22) is (n, n), of which the two diagonal blocks are read, M_jk (2, n_e), L_jk (2,
    6), Q_ij and X_ij (n, n), τ (..., m) has an entry for each of `data.uncertainties`, and `put` makes a matrix of the
    block rows. With arrays of i and k the result is a stack: M, L, Q, X and τ are stacks then, and P is one matrix.
    """
    E, A, B, A_r, B_r = data.error_E(k), data.error_A(i), data.error_rows(data.B), data.A_r, data.B_r
    A_minus_E_A_r = data.error_rows(np.asarray(data.A)[i] - np.asarray(data.E)[k] @ A_r)
    E_B_r = data.error_rows(np.asarray(data.E)[k] @ B_r)
    e, r = slice(data.n_e), slice(data.n_e, None)
    P_11, P_22 = P[e, e], P[r, r]
    Q_11, Q_12, Q_21, Q_22 = Q[..., e, e], Q[..., e, r], Q[..., r, e], Q[..., r, r]
    X_11, X_12, X_21, X_22 = X[..., e, e], X[..., e, r], X[..., r, e], X[..., r, r]

    S_11 = he(Q_11 + alpha * P_11)
    S_21 = Q_21 + transposed(Q_12)
    S_31 = A @ P_11 + B @ M - E @ Q_11 + transposed(X_11)
    S_41 = -Q_21 + transposed(X_12)
    S_22 = he(Q_22 + alpha * P_22)
    S_32 = A_minus_E_A_r @ P_22 - E @ Q_12 + transposed(X_21)
    S_42 = A_r @ P_22 - Q_22 + transposed(X_22)
    S_33 = -he(E @ X_11)
    S_43 = -X_21 - transposed(X_12) @ transposed(E)
    S_44 = -he(X_22)
    S_63 = transposed(B @ L) - transposed(E_B_r)
    rows: list[list[Any]] = [
        [S_11],
        [S_21, S_22],
        [S_31, S_32, S_33],
        [S_41, S_42, S_43, S_44],
        [0, 0, B.T, 0, -gamma2 * identity(B.shape[1])],
        [0, 0, S_63, B_r.T, 0, -gamma2 * identity(B_r.shape[1])],
        [output * P_11[PLANT], 0, 0, 0, 0, 0, -data.Q_inverse],
    ]
    for scale, term in zip(data.multipliers(tau), data.uncertainties, strict=True):
        H = data.error_rows(term.H.T).T
        rows[2][2] = rows[2][2] + times(scale, H.T @ H)
        before = [0] * (len(rows) - 7)  # columns of the terms so far, behind the seven of Ξ
        rows.append([*_uncertain_row(data, term, P=P, Q=Q, X=X), *before, -times(scale, identity(len(term.W)))])
    return put(rows)


def _uncertain_row(data: TrackingVertices, term: Uncertainty, *, P: Any, Q: Any, X: Any) -> list[Any]:
    """Return the row [T_11 T_12 0 ...] or [T_31 T_32 T_33 T_34 0 T_36 0] of Ψ_2; W reads the plant's rows, not x_I."""
    W, e, r = term.W, slice(data.n_e), slice(data.n_e, None)
    P_11, P_22 = P[PLANT, e], P[r, r]
    Q_11, Q_12 = Q[..., PLANT, e], Q[..., PLANT, r]
    X_11, X_12 = X[..., PLANT, e], X[..., PLANT, r]
    if term.on == "A":
        return [W @ P_11, W @ P_22, 0, 0, 0, 0, 0]
    return [-W @ Q_11, -W @ (data.A_r @ P_22 + Q_12), -W @ X_11, -W @ X_12, 0, -W @ data.B_r, 0]
