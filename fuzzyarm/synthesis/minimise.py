"""Solve a design problem with Clarabel; whether an answer counts is decided by its recomputed margin alone."""

from __future__ import annotations

import dataclasses
import math
import time

import clarabel  # type: ignore[import-untyped]
import numpy as np
from scipy import sparse

from fuzzyarm.common.bisection import last_that_works
from fuzzyarm.synthesis.conic import Problem, Program, program
from fuzzyarm.synthesis.error_model import ErrorModel, reversed_time
from fuzzyarm.synthesis.reduced import ReducedModel, Variables, blended, expand

__all__ = ["TOLERANCE", "Infeasible", "Solution", "solve", "solve_for_largest_alpha"]

TOLERANCE = 0.01  # of the solver, as a share of the margin, so that its error stays far below the margin
INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")


class Infeasible(ValueError):
    """No strictly feasible point was found.

    Attributes:
        problem: the requirements.
        program: its cone program.
        status: as the solver reports it.
        margin: of the point the solver ended at, not positive; -inf if the solver claims that no point exists.
        ray: z (n_rows,) in the cones with Aᵀz = 0 and bᵀz < 0, if the solver claims infeasibility, else None.
    """

    def __init__(self, problem: Problem, cone: Program, status: str, margin: float, ray: np.ndarray | None) -> None:
        self.problem, self.program, self.status, self.margin, self.ray = problem, cone, status, margin, ray
        found = "a proof that there is none" if ray is not None else f"a point with margin {margin:.2g}"
        super().__init__(
            f"no strictly feasible point for {problem}: the solver ended with {status} and {found}; "
            "lower alpha or the floor, raise gamma, gain_bound or fastest_pole"
        )


@dataclasses.dataclass(frozen=True)
class Solution:
    """A strictly feasible point of the full inequality, in the units of the error model.

    Attributes:
        problem: the requirements.
        P: (n, n).
        M: (N, N_e, 2, n_e).
        L: (N, N_e, 2, n_r).
        Q: (pairs, n, n), slack of the full inequality.
        X: (pairs, n, n), likewise.
        tau: (pairs, N_e, m).
        gamma: bound of the L2 gain, given or found.
        largest_gain: largest |K_jk|, recomputed from M and P.
        margin: recomputed; the reduced inequalities are <= -margin I.
        objective: as the solver reports it: g for a bound of K, the bound for M, γ² |weight|, or 0.
        status: as the solver reports it.
        iterations: of the solver.
        build_time: seconds.
        solve_time: seconds.
        variables: their number.
        rows: of the cones, upper triangles.
        pole_slack: Q, X (pairs, n, n) and τ (pairs, N_e, m) of the full inequality of `fastest_pole`; None without it.
    """

    problem: Problem
    P: np.ndarray
    M: np.ndarray
    L: np.ndarray
    Q: np.ndarray
    X: np.ndarray
    tau: np.ndarray
    gamma: float
    largest_gain: float
    margin: float
    objective: float
    status: str
    iterations: int
    build_time: float
    solve_time: float
    variables: int
    rows: int
    pole_slack: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None


def solve(system: ErrorModel, problem: Problem) -> Solution:
    """Return the best point found for a (scaled) error model.

    Raises:
        Infeasible: none is strictly feasible when recomputed from the error model.
    """
    start = time.perf_counter()
    model = ReducedModel.of(system)
    cone = program(model, problem)
    built = time.perf_counter()
    answer = _clarabel(cone, TOLERANCE * problem.margin)
    status = str(answer.status)
    if status in INFEASIBLE:
        raise Infeasible(problem, cone, status, -math.inf, np.array(answer.z))
    v = cone.values(np.array(answer.x))
    inequalities = [(model, v, blended(model, problem.alpha, v))]
    if problem.fastest_pole is not None:
        reverse, own = ReducedModel.of(reversed_time(system)), cone.values(np.array(answer.x), cone.pole_layout)
        inequalities.append((reverse, own, blended(reverse, -problem.fastest_pole, own)))
    margin = min(_margin(R, v) for _, v, R in inequalities)
    if not margin > 0.0:
        raise Infeasible(problem, cone, status, margin, None)
    (Q, X, tau), *pole_slack = [(*expand(*one), one[1].tau) for one in inequalities]
    gains = v.M @ np.linalg.inv(v.P[: v.M.shape[-1], : v.M.shape[-1]])
    return Solution(
        problem=problem, P=v.P, M=v.M, L=v.L, Q=Q, X=X, tau=tau,
        gamma=math.sqrt(v.gamma2 / model.weight_norm),
        largest_gain=float(np.linalg.norm(gains, ord=2, axis=(-2, -1)).max()),
        margin=margin, objective=float(answer.obj_val), status=status, iterations=answer.iterations,
        build_time=built - start, solve_time=time.perf_counter() - built, variables=len(cone.q), rows=len(cone.b),
        pole_slack=pole_slack[0] if pole_slack else None,
    )  # fmt: skip


def solve_for_largest_alpha(system: ErrorModel, problem: Problem, resolution: float = 0.01) -> Solution:
    """Return the solution with the largest decay rate, by bisection from `problem.alpha` up.

    α multiplies P, so it cannot be a variable of the cone program.

    Args:
        system: error model.
        problem: gamma and gain_bound are given, nothing is minimised; alpha is where to start.
        resolution: relative width of the last interval.

    Raises:
        Infeasible: already at `problem.alpha`.
        ValueError: no bound of the gains is given, without which the decay rate has none either.
    """
    if problem.gain_bound is None:
        raise ValueError("gain_bound is missing: without a bound of the gains the decay rate has none")
    best = solve(system, problem)

    def works(alpha: float) -> bool:
        nonlocal best
        try:
            best = solve(system, dataclasses.replace(problem, alpha=alpha))
        except Infeasible:
            return False
        return True

    if problem.fastest_pole is None:
        last_that_works(works, problem.alpha, 2.0 * problem.alpha, resolution=resolution, limit=math.inf)
    else:  # no pole is faster than that: it bounds α, too
        last_that_works(works, problem.alpha, problem.fastest_pole, resolution=resolution)
    return best


def _margin(R: np.ndarray, v: Variables) -> float:
    """Return the smallest eigenvalue of all -R and of P, -inf if there is no point at all."""
    if not (np.isfinite(R).all() and np.isfinite(v.P).all()):
        return -math.inf
    return min(-float(np.linalg.eigvalsh(R).max()), float(np.linalg.eigvalsh(v.P).min()))


def _clarabel(cone: Program, tolerance: float) -> clarabel.DefaultSolution:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    # More threads are slower; the decomposition that keeps overlapping cliques apart has 40 % of the fill of the
    # compact one (32 rules).
    settings.direct_solve_method, settings.max_threads = "faer", 1
    settings.chordal_decomposition_compact = False
    no_quadratic = sparse.csc_matrix((len(cone.q), len(cone.q)))
    cones = [clarabel.PSDTriangleConeT(order) for order in cone.orders]
    return clarabel.DefaultSolver(no_quadratic, cone.q, cone.A, cone.b, cones, settings).solve()
