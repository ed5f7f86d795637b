"""Theorem 2: the matrix Ψ_ijk, Theorem 1 for a model with norm-bounded uncertainty.

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

from fuzzyarm.fuzzy_policy.proof.block_matrix import Assembly, identity, symmetric, times
from fuzzyarm.fuzzy_policy.proof.theorem1 import xi
from fuzzyarm.fuzzy_policy.proof.vertices import Index, TrackingVertices, UncertainTerm
from fuzzyarm.fuzzy_policy.states import PLANT

__all__ = ["psi", "uncertain_row"]


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
    """Return Ψ_ijk, symmetric and affine in P, M, L, Q, X, τ and γ².

    The arguments are those of `theorem1.xi`, and `tau`: the multipliers of the pair (i, j) and k, (..., m), one for
    each entry of `data.uncertainties`. Without uncertainty Ψ_ijk = Ξ_ijk.
    """
    rows = xi(data, i, k, alpha=alpha, gamma2=gamma2, output=output, P=P, M=M, L=L, Q=Q, X=X, put=list)
    for scale, term in zip(data.multipliers(tau), data.uncertainties, strict=True):
        H = data.error_rows(term.H.T).T
        rows[2][2] = rows[2][2] + times(scale, H.T @ H)
        before = [0] * (len(rows) - 7)  # columns of the terms so far, behind the seven of Ξ
        rows.append([*uncertain_row(data, term, P=P, Q=Q, X=X), *before, -times(scale, identity(len(term.W)))])
    return put(rows)


def uncertain_row(data: TrackingVertices, term: UncertainTerm, *, P: Any, Q: Any, X: Any) -> list[Any]:
    """Return the row [T_11 T_12 0 ...] or [T_31 T_32 T_33 T_34 0 T_36 0] of Ψ_2; W reads the plant's rows, not x_I."""
    W, e, r = term.W, slice(data.n_e), slice(data.n_e, None)
    P_11, P_22 = P[PLANT, e], P[r, r]
    Q_11, Q_12 = Q[..., PLANT, e], Q[..., PLANT, r]
    X_11, X_12 = X[..., PLANT, e], X[..., PLANT, r]
    if term.on == "A":
        return [W @ P_11, W @ P_22, 0, 0, 0, 0, 0]
    return [-W @ Q_11, -W @ (data.A_r @ P_22 + Q_12), -W @ X_11, -W @ X_12, 0, -W @ data.B_r, 0]
