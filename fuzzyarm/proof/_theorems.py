"""The matrix inequalities of a controller, for floats, exact rationals and cvxpy expressions (`block_matrix`).

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

Theorem 2: the matrix Ψ_ijk (`tracking_psi`), Theorem 1 for a model with norm-bounded uncertainty.

    Ψ_ijk = | Ξ_ijk + H̄ᵀ τ H̄   ⋆       |        Ψ_2 = | T_11  T_12  0     0     0  0     0 |   ΔA = H_aᵀ Δ_a W_a
            | Ψ_2              -τ I    |              | T_31  T_32  T_33  T_34  0  T_36  0 |   ΔE = H_eᵀ Δ_e W_e

with H̄ = [0 0 H 0 0 0 0] in the columns of Ξ, so that the third diagonal block of Ξ becomes
S_33* = S_33 + τ_a H_aᵀH_a + τ_e H_eᵀH_e, and

    T_11 = W_a P_11         T_12 = W_a P_22
    T_31 = -W_e Q_11        T_32 = -W_e (A_r P_22 + Q_12)
    T_33 = -W_e X_11        T_34 = -W_e X_12        T_36 = -W_e B_r

If Ψ_iik < 0 and Ψ_ijk + Ψ_jik < 0 for i < j and all k, then the dissipation inequality of Theorem 1 holds for all
Δ with ΔᵀΔ <= I. With y = P*⁻¹ x*, Ψ_2 maps (y, w, ·) to W_a x_p and -W_e ẋ_p: the two signals the uncertainty acts on.

The paper prints T_32 with -Q_12; both terms of S_32 that contain E_k have a minus sign, and so has ΔE here. The rows
T_21 and T_26 of ΔB are left out, because B_p is constant. With the integral, H and W act on e but not on x_I.
`data.uncertainties` has one term for A and one for E as printed, or one term for each dropped premise; each term is a
row of Ψ_2 with its own multiplier.

Consistent-reference form: the matrix Ψ_ijk of Theorem 2 without the reference model (`error_psi`).

With x_r ≡ (q_d, q̇_d) and the feedforward L of `controller`, (9) becomes, for ē = (e, x_I), ẋ_I = C_p e,

    Ē_v ē' = (Ā_h + ΔĀ) ē + B̄ K̄ ē + B̄ d,      Ē_v = diag(E_pv + ΔE, I),    Ā_h = [[A_ph, 0], [C_p, 0]],

and V = ēᵀ P⁻¹ ē obeys V' + zᵀz - γ² dᵀd + 2αV < 0, z = C ē the position error, if P > 0 and for all i, j, k (paper
(15) and Theorem 2 without the x_r blocks) Ψ_iik < 0 and Ψ_ijk + Ψ_jik < 0 for i < j, where

            | He(Q_ij + αP)                      ⋆                               ⋆      ⋆    ⋆     |   ē
            | A_i P + B M_jk - E_k Q_ij + X_ijᵀ  -He(E_k X_ij) + Σ τ_l H_lᵀH_l   ⋆      ⋆    ⋆     |   ē'
    Ψ_ijk = | 0                                  Bᵀ                              -γ²I   ⋆    ⋆     |   d
            | C P                                0                               0      -I   ⋆     |   z
            | W_l P  or  -W_l Q_ij               0  or  -W_l X_ij                0      0    -τ_l I|

with one row block and one multiplier τ_l for each dropped premise (on A, or on E). K_jk = M_jk P⁻¹. Without the
integral ē = e. The paper's multipliers, one for A and one for E, are more conservative. Ψ is written without bars.

*Fastest pole.* Backwards in time, the error obeys Ē dē/d(-t) = -(Ā + B̄ K̄) ē. So V falls no faster than exp(-2βt), that
is V' + 2βV > 0 for d = 0, if the inequality for a decay rate of -β holds for -A and -B, with the same P and M_jk and
separate slack variables (`error_phi`): Φ_iik < 0 and Φ_ijk + Φ_jik < 0 for i < j, where

            | He(Q_ij - βP)                        ⋆                               ⋆    |   ē
    Φ_ijk = | -A_i P - B M_jk - E_k Q_ij + X_ijᵀ  -He(E_k X_ij) + Σ τ_l H_lᵀH_l   ⋆    |   ē' backwards
            | W_l P  or  -W_l Q_ij                 0  or  -W_l X_ij               -τ_l I|

At a frozen state, -2βV < V' < -2αV implies that the real part of every pole lies between -β and -α.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.ts_model import PLANT, POSITION, Uncertainty
from fuzzyarm.proof.block_matrix import Assembly, he, identity, symmetric, times, transposed
from fuzzyarm.proof.vertices import Index, TrackingVertices, Vertices

__all__ = ["error_phi", "error_psi", "tracking_psi"]


def tracking_psi(
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
    """Return Ψ_ijk of Theorem 2, affine in P, M, L, Q, X, τ and γ²; without uncertainty it is Ξ_ijk of Theorem 1.

    n_e = 4 or, with the integral, 6; n = n_e + 4. Vertices i of A and k of E count from 0; α is in 1/s; `output` is a
    factor of z. P = diag(P_11, P_22) is (n, n), and only its diagonal blocks are used; M_jk is (2, n_e), L_jk (2, 6),
    Q_ij and X_ij (n, n), and τ (..., m) has an entry for each of `data.uncertainties`. `put` assembles a matrix from
    block rows. For arrays of i and k the result is a stack; M, L, Q, X and τ must then be stacks, and P one matrix.
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

    def uncertain(term: Uncertainty) -> list[Any]:
        W = term.W  # reads the plant's rows, not x_I
        if term.on == "A":
            return [W @ P_11[PLANT], W @ P_22, 0, 0, 0, 0, 0]
        W_Q_11, W_X_11, W_X_12 = (-W @ block[..., PLANT, :] for block in (Q_11, X_11, X_12))
        return [W_Q_11, -W @ (data.A_r @ P_22 + Q_12[..., PLANT, :]), W_X_11, W_X_12, 0, -W @ B_r, 0]

    S_33, below = _with_uncertainty(data, tau, S_33, uncertain)
    rows: list[list[Any]] = [
        [S_11],
        [S_21, S_22],
        [S_31, S_32, S_33],
        [S_41, S_42, S_43, S_44],
        [0, 0, B.T, 0, -gamma2 * identity(B.shape[1])],
        [0, 0, S_63, B_r.T, 0, -gamma2 * identity(B_r.shape[1])],
        [output * P_11[PLANT], 0, 0, 0, 0, 0, -data.Q_inverse],
    ]
    return put([*rows, *below])


def error_psi(
    data: Vertices,
    i: Index,
    k: Index,
    *,
    alpha: Any,
    gamma2: Any,
    output: Any = 1,
    P: Any,
    M: Any,
    Q: Any,
    X: Any,
    tau: Any,
    put: Assembly = symmetric,
) -> Any:
    """Return the matrix Ψ_ijk of the consistent-reference form, symmetric and affine in P, M, Q, X, τ and γ².

    γ² is in rad²/(N m)², P is (n, n) with n = n_e; the other arguments are as for `tracking_psi`.
    """
    E, A, B = data.error_E(k), data.error_A(i), data.error_rows(data.B)
    corner, below = _error_uncertainty(data, tau, P, Q, X, [0, 0])
    rows: list[list[Any]] = [
        [he(Q + alpha * P)],
        [A @ P + B @ M - E @ Q + transposed(X), corner - he(E @ X)],
        [0, B.T, -gamma2 * identity(JOINTS)],
        [output * P[POSITION], 0, 0, -identity(JOINTS)],
    ]
    return put([*rows, *below])


def error_phi(
    data: Vertices,
    i: Index,
    k: Index,
    *,
    fastest_pole: Any,
    P: Any,
    M: Any,
    Q: Any,
    X: Any,
    tau: Any,
    put: Assembly = symmetric,
) -> Any:
    """Return the matrix Φ_ijk, affine in P, M, Q, X and τ, for a bound β = `fastest_pole` [1/s] on the decay rate.

    P (n, n) and M are the same as in Ψ, but Q, X and τ belong to Φ alone. The other arguments are as for `error_psi`.
    """
    E, A, B = data.error_E(k), data.error_A(i), data.error_rows(data.B)
    corner, below = _error_uncertainty(data, tau, P, Q, X, [])
    return put([[he(Q - fastest_pole * P)], [transposed(X) - A @ P - B @ M - E @ Q, corner - he(E @ X)], *below])


def _error_uncertainty(
    data: Vertices, tau: Any, P: Any, Q: Any, X: Any, between: list[int]
) -> tuple[Any, list[list[Any]]]:
    """Return Σ τ_l H_lᵀH_l, and for each dropped premise a block row: that for ē, for ē', `between`, 0, ..., -τ_l I."""

    def uncertain(term: Uncertainty) -> list[Any]:
        W_P, W_Q, W_X = (term.W @ matrix[..., PLANT, :] for matrix in (P, Q, X))
        return [W_P, 0, *between] if term.on == "A" else [-W_Q, -W_X, *between]

    return _with_uncertainty(data, tau, np.zeros((data.n_e, data.n_e), dtype=int), uncertain)


def _with_uncertainty(
    data: Vertices, tau: Any, corner: Any, uncertain: Callable[[Uncertainty], list[Any]]
) -> tuple[Any, list[list[Any]]]:
    """Return `corner` + Σ τ_l H_lᵀH_l and a block row [*uncertain(l), 0, ..., -τ_l I] for each dropped premise l."""
    rows = list[list[Any]]()
    scales = (tau[..., position] for position in range(tau.shape[-1]))
    for scale, term in zip(scales, data.uncertainties, strict=True):
        H = data.error_rows(term.H.T).T
        corner = corner + times(scale, H.T @ H)
        rows.append([*uncertain(term), *[0] * len(rows), -times(scale, identity(len(H)))])
    return corner, rows
