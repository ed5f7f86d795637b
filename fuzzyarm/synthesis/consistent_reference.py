"""The design problem of the consistent-reference form: smallest feedback gains at a given α and γ.

Minimise ε² subject to Ψ_iik <= -μ I, Ψ_ijk + Ψ_jik <= -2μ I (i < j, all k), P >= I and, for every j, k,

    | ε² I   M_jk |
    | M_jkᵀ  P    |  >= 0,     which is   K_jk P K_jkᵀ <= ε² I   and so   |K_jk| <= ε.

This is Remark 3 of the paper with P bounded from below too: |M| alone does not bound K = M P⁻¹.
"""

from __future__ import annotations

import dataclasses
import itertools

import cvxpy as cp
import numpy as np

from fuzzyarm.fuzzy_policy.inequality import ErrorModel, psi

Pair = tuple[int, int]


@dataclasses.dataclass(frozen=True)
class DesignProblem:
    """A cvxpy problem with its decision variables; Q, X by pair (i, j), M by (j, k), tau by (pair, k)."""

    problem: cp.Problem
    gain_bound: cp.Variable
    P: cp.Variable
    M: dict[Pair, cp.Variable]
    Q: dict[Pair, cp.Variable]
    X: dict[Pair, cp.Variable]
    tau: dict[tuple[Pair, int], cp.Variable]


def build(system: ErrorModel, *, alpha: float, gamma: float, margin: float) -> DesignProblem:
    """Return the problem for a (scaled) error model; nothing is solved.

    Args:
        system: error model, from `Scaling.apply`.
        alpha: decay rate, in the units of `system`.
        gamma: bound of the L2 gain [rad/(N m)].
        margin: μ, strictness of the inequalities in the units of `system`.
    """
    n = len(system.B)
    vertices = list(itertools.product(range(len(system.A)), range(len(system.E))))
    P = cp.Variable((n, n), symmetric=True)
    M = {(j, k): cp.Variable((2, n)) for j, k in vertices}
    Q = {pair: cp.Variable((n, n)) for pair in system.pairs}
    X = {pair: cp.Variable((n, n)) for pair in system.pairs}
    blocks = [(pair, k) for pair in system.pairs for k in range(len(system.E))]
    tau = {key: cp.Variable(len(system.uncertainties)) for key in blocks}
    gain_bound = cp.Variable()

    def inequality(i: int, j: int, pair: Pair, k: int) -> cp.Expression:
        return psi(
            system,
            i,
            k,
            alpha=alpha,
            gamma2=gamma**2,
            P=P,
            M=M[j, k],
            Q=Q[pair],
            X=X[pair],
            tau=tau[pair, k],
            block=cp.bmat,
        )

    constraints = [np.eye(n) << P]
    for pair, k in blocks:
        i, j = pair
        total = inequality(i, j, pair, k) if i == j else 0.5 * (inequality(i, j, pair, k) + inequality(j, i, pair, k))
        constraints.append(total << -margin * np.eye(total.shape[0]))
    constraints += [cp.bmat([[gain_bound * np.eye(2), m], [m.T, P]]) >> 0 for m in M.values()]
    return DesignProblem(cp.Problem(cp.Minimize(gain_bound), constraints), gain_bound, P, M, Q, X, tau)
