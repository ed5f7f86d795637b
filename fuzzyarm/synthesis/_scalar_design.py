"""Feedback k of a scheduled controller from the inequalities of its certificate, with 1/(α + μ) as unit of time.

There is a solution for every bound β > (3κ - 2)(α + μ) on the fastest pole; as β approaches this limit, the bound γ on
the L2 gain tends to infinity. The symbols are those of `ScheduledController`.
"""

import dataclasses
import functools
import math
import threading
import warnings

import cvxpy as cp
import numpy as np

from fuzzyarm.common.arithmetic import last_that_works
from fuzzyarm.fuzzy_policy.ts_model import SCALAR_STATES
from fuzzyarm.proof.scheduled_certificate import decay, fastest
from fuzzyarm.synthesis._expressions import half, negative, positive

__all__ = ["Feedback", "best_feedback", "feedback_for_gamma", "smallest_pole"]

_GAMMA_SLACK = 1.001  # factor on the solver's γ, so that the inequalities hold strictly
_STRICT = 2e-4  # relative margin of the rates, for the same reason
_MOST = 50.0  # largest fastest pole in the search for a given γ, relative to the smallest possible one
_CLARABEL = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-7) | {"max_threads": 1}


@dataclasses.dataclass(frozen=True)
class Feedback:
    """A feedback k of the scalar loop, its Lyapunov matrix X, and its bounds γ on the L2 gain and β on the poles."""

    k: np.ndarray  # (k_p [1/s²], k_d [1/s], k_i [1/s³])
    X: np.ndarray  # (3, 3)
    gamma: float  # γ [s²]
    fastest_pole: float  # β [1/s]


@functools.lru_cache(maxsize=8)
def _compiled(thread: int) -> cp.Problem:
    """Return the problem of a thread: minimise γ² over P (3, 3) and m (1, 3); the parameters are 1/κ and β/(α + μ).

    Each thread has its own problem, since it sets the parameters and reads the variables.
    """
    P = cp.Variable((SCALAR_STATES, SCALAR_STATES), symmetric=True, name="P")
    m, gamma2 = cp.Variable((1, SCALAR_STATES), name="m"), cp.Variable(name="gamma2")
    least, pole = cp.Parameter(nonneg=True, name="share"), cp.Parameter(nonneg=True, name="pole")
    values, constraints = {"P": P, "m": m, "put": half}, [P >> 0]
    for share in (least, 1.0):
        constraints.append(negative(decay(share, rate=1.0 + _STRICT, gamma2=gamma2, **values)))
        constraints.append(positive(fastest(share, pole=pole, **values)))
    return cp.Problem(cp.Minimize(gamma2), constraints)


def smallest_pole(kappa: float, rate: float) -> float:
    """Return (3κ - 2) a [1/s], the lower limit of the fastest-pole bound, for a = `rate` [1/s]."""
    return (3.0 * kappa - 2.0) * rate


def best_feedback(kappa: float, rate: float, fastest_pole: float) -> Feedback | None:
    """Return the feedback with the smallest γ for κ, α + μ = `rate` and β = `fastest_pole` [1/s]; None if not found."""
    problem = _compiled(threading.get_ident())
    asked, found = problem.param_dict, problem.var_dict
    asked["share"].value, asked["pole"].value = 1.0 / kappa, (1.0 - _STRICT) * fastest_pole / rate
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # cvxpy's warning of an inaccurate point: the inequalities decide
        try:
            problem.solve(solver=cp.CLARABEL, canon_backend="SCIPY", **_CLARABEL)
        except cp.SolverError:
            return None
    P = found["P"].value
    if P is None or not np.linalg.eigvalsh(P)[0] > 0.0:
        return None
    # Back from the time unit 1/a: x = T x̃ with T = diag(1, a, 1/a), and V = Ṽ/a.
    T_inverse = np.diag([1.0, 1.0 / rate, rate])
    X = T_inverse @ np.linalg.inv(P) @ T_inverse / rate
    k = rate**2 * np.linalg.solve(P, found["m"].value[0]) @ T_inverse
    gamma = _GAMMA_SLACK * math.sqrt(max(float(found["gamma2"].value), 0.0)) / rate**2
    feedback = Feedback(k, 0.5 * (X + X.T), gamma, fastest_pole)
    return feedback if _holds(feedback, kappa, rate) else None


def feedback_for_gamma(kappa: float, rate: float, gamma: float) -> Feedback | None:
    """Return the feedback with the smallest β for κ, α + μ = `rate` [1/s], γ <= `gamma` [s²]; None if not found."""
    lowest, best = smallest_pole(kappa, rate), None

    def fails(pole: float) -> bool:
        nonlocal best
        found = best_feedback(kappa, rate, pole)
        if found is None or found.gamma > gamma:
            return True
        best = found
        return False

    if not fails(_MOST * lowest):
        last_that_works(fails, 1.001 * lowest, _MOST * lowest, resolution=0.005)
    return best


def _holds(found: Feedback, kappa: float, rate: float) -> bool:
    """Return whether a feedback meets all inequalities for κ and α + μ = `rate` [1/s], as computed in floats."""
    P, matrices = np.linalg.inv(found.X), [found.X]
    m = found.k[np.newaxis] @ P
    for share in (1.0 / kappa, 1.0):
        matrices.append(-decay(share, rate=rate, gamma2=found.gamma**2, P=P, m=m))
        matrices.append(fastest(share, pole=found.fastest_pole, P=P, m=m))
    diagonals = [np.diag(matrix) for matrix in matrices]
    return all((diagonal > 0.0).all() for diagonal in diagonals) and all(
        np.linalg.eigvalsh(matrix / np.sqrt(np.outer(diagonal, diagonal)))[0] > 0.0
        for matrix, diagonal in zip(matrices, diagonals, strict=True)
    )
