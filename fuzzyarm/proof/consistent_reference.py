"""The consistent-reference form: Theorem 2 without the reference model, which the feedforward cancels.

With x_r ≡ (q_d, q̇_d) and the feedforward L of `controller`, what remains of (9) is, for ē = (e, x_I), ẋ_I = C_p e,

    Ē_v ē' = (Ā_h + ΔĀ) ē + B̄ K̄ ē + B̄ d,      Ē_v = diag(E_pv + ΔE, I),    Ā_h = [[A_ph, 0], [C_p, 0]],

and V = ēᵀ P⁻¹ ē obeys V' + zᵀz - γ² dᵀd + 2αV < 0, z = C ē the position error, if P > 0 and for all i, j, k (paper
(15) and Theorem 2 without the x_r blocks) Ψ_iik < 0 and Ψ_ijk + Ψ_jik < 0 for i < j, where

            | He(Q_ij + αP)                      ⋆                               ⋆      ⋆    ⋆     |   ē
            | A_i P + B M_jk - E_k Q_ij + X_ijᵀ  -He(E_k X_ij) + Σ τ_l H_lᵀH_l   ⋆      ⋆    ⋆     |   ē'
    Ψ_ijk = | 0                                  Bᵀ                              -γ²I   ⋆    ⋆     |   d
            | C P                                0                               0      -I   ⋆     |   z
            | W_l P  or  -W_l Q_ij               0  or  -W_l X_ij                0      0    -τ_l I|

with one row block and one multiplier τ_l for each dropped premise (on A, or on E). K_jk = M_jk P⁻¹. Without
the integral ē = e. The paper has one multiplier for all uncertainties of A and one for E; one each is less
conservative. Bars are left out in Ψ.

*Fastest pole.* Run backwards the error obeys Ē dē/d(-t) = -(Ā + B̄ K̄) ē, so V falls no faster than exp(-2βt),
V' + 2βV > 0 where d = 0, if the inequality of a decay rate of -β holds for -A and -B, with the same P and M_jk and
slack of its own: Φ_iik < 0 and Φ_ijk + Φ_jik < 0 for i < j, where

            | He(Q_ij - βP)                        ⋆                               ⋆    |   ē
    Φ_ijk = | -A_i P - B M_jk - E_k Q_ij + X_ijᵀ  -He(E_k X_ij) + Σ τ_l H_lᵀH_l   ⋆    |   ē' backwards
            | W_l P  or  -W_l Q_ij                 0  or  -W_l X_ij               -τ_l I|

At a frozen state -2βV < V' < -2αV puts the real part of every pole between -β and -α.
"""

from __future__ import annotations

from typing import Any

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.fuzzy_policy.states import PLANT, POSITION
from fuzzyarm.proof.block_matrix import Assembly, he, identity, symmetric, times, transposed, zeros
from fuzzyarm.proof.vertices import Index, Vertices

__all__ = ["phi", "psi"]


def psi(
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
    """Return Ψ_ijk, symmetric and affine in P, M, Q, X, τ and γ².

    Vertices i of A and k of E count from 0; α is in 1/s, γ² in rad²/(N m)², z has the factor `output`. P, Q_ij and X_ij
    are (n, n), n = 4 or, with the integral, 6; M_jk is (2, n), τ (..., m) has an entry for each of
    `data.uncertainties`, and `put` makes a matrix of the block rows. With arrays of i and k the result is a stack: M,
    Q, X and τ are stacks then, and P is one matrix.
    """
    E, A, B = data.error_E(k), data.error_A(i), data.error_rows(data.B)
    corner, below = _uncertainty(data, P, Q, X, tau, between=2)
    return put(
        [
            [he(Q + alpha * P)],
            [A @ P + B @ M - E @ Q + transposed(X), corner - he(E @ X)],
            [0, B.T, -gamma2 * identity(JOINTS)],
            [output * P[POSITION], 0, 0, -identity(JOINTS)],
            *below,
        ]
    )


def phi(
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
    """Return Φ_ijk, symmetric and affine in P, M, Q, X and τ, for the bound β [1/s] of the decay rate from above.

    P (n, n) and M are those of Ψ; Q, X and τ are not. The other arguments are as for `psi`.
    """
    E, A, B = data.error_E(k), data.error_A(i), data.error_rows(data.B)
    corner, below = _uncertainty(data, P, Q, X, tau, between=0)
    return put([[he(Q - fastest_pole * P)], [transposed(X) - A @ P - B @ M - E @ Q, corner - he(E @ X)], *below])


def _uncertainty(data: Vertices, P: Any, Q: Any, X: Any, tau: Any, between: int) -> tuple[Any, list[list[Any]]]:
    """Return Σ τ_l H_lᵀH_l and the row of each dropped premise, with so many columns after ē and ē'."""
    total, rows = zeros(data.n_e, data.n_e), list[list[Any]]()
    for scale, term in zip(data.multipliers(tau), data.uncertainties, strict=True):
        H = data.error_rows(term.H.T).T
        total = total + times(scale, H.T @ H)
        W_P, W_Q, W_X = (term.W @ matrix[..., PLANT, :] for matrix in (P, Q, X))
        left = [W_P, 0] if term.on == "A" else [-W_Q, -W_X]
        rows.append([*left, *[0] * (between + len(rows)), -times(scale, identity(len(H)))])
    return total, rows
