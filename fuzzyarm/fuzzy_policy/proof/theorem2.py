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

import numpy as np

from fuzzyarm.fuzzy_policy.proof.block_matrix import Block, identity, symmetric, zeros
from fuzzyarm.fuzzy_policy.proof.theorem1 import xi
from fuzzyarm.fuzzy_policy.proof.vertices import TrackingVertices, UncertainTerm
from fuzzyarm.fuzzy_policy.states import PLANT, PLANT_STATES

__all__ = ["psi", "uncertain_row"]


def psi(
    data: TrackingVertices,
    i: int,
    k: int,
    *,
    alpha: Any,
    gamma2: Any,
    P: Any,
    M: Any,
    L: Any,
    Q: Any,
    X: Any,
    tau: Any,
    block: Block = np.block,
) -> Any:
    """Return Ψ_ijk, symmetric and affine in P, M, L, Q, X, τ and γ².

    The arguments are those of `theorem1.xi`, and `tau`: the multipliers of the pair (i, j) and k, one for each
    entry of `data.uncertainties`. Without uncertainty Ψ_ijk = Ξ_ijk.
    """
    Psi_1 = xi(data, i, k, alpha=alpha, gamma2=gamma2, P=P, M=M, L=L, Q=Q, X=X, block=block)
    size, before = Psi_1.shape[0], data.n_e + PLANT_STATES  # columns of Ξ, and those before ė
    below: list[list[Any]] = []
    for scale, term in zip(tau, data.uncertainties, strict=True):
        rows = len(term.W)
        H_bar = np.hstack([zeros(rows, before), term.H, zeros(rows, size - before - PLANT_STATES)])
        Psi_1 = Psi_1 + scale * (H_bar.T @ H_bar)
        Psi_2 = block([uncertain_row(data, term, P=P, Q=Q, X=X)])
        below.append([Psi_2, *[0] * len(below), -scale * identity(rows)])
    return symmetric([[Psi_1], *below], block)


def uncertain_row(data: TrackingVertices, term: UncertainTerm, *, P: Any, Q: Any, X: Any) -> list[Any]:
    """Return the row [T_11 T_12 0 ...] or [T_31 T_32 T_33 T_34 0 T_36 0] of Ψ_2; W reads the plant's rows, not x_I."""
    n_e, W, rows = data.n_e, term.W, len(term.W)
    P_11, P_22 = P[PLANT, :n_e], P[n_e:, n_e:]
    Q_11, Q_12 = Q[PLANT, :n_e], Q[PLANT, n_e:]
    X_11, X_12 = X[PLANT, :n_e], X[PLANT, n_e:]
    O_d, O_r, O_z = (zeros(rows, columns) for columns in (data.B.shape[1], data.B_r.shape[1], PLANT_STATES))
    if term.on == "A":
        return [W @ P_11, W @ P_22, zeros(rows, n_e), zeros(rows, PLANT_STATES), O_d, O_r, O_z]
    return [-W @ Q_11, -W @ (data.A_r @ P_22 + Q_12), -W @ X_11, -W @ X_12, O_d, -W @ data.B_r, O_z]
