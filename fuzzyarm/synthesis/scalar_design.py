"""Feedback k of a scheduled controller by linear matrix inequalities of size three, see `proof.scalar_loop`.

With P = X⁻¹ and m = k P, in the time unit 1/a, a = α + μ, the inequalities are linear in P, m and γ²:

    | He(A P - λ b m) + 2P   λb    P cᵀ |             | (β/a) P       ⋆       |
    | ⋆                      -γ²   0    | < 0,        | A P - λ b m   (β/a) P | > 0,        λ = 1/κ and 1.
    | ⋆                      ⋆     -1   |

There is a solution for every β above (3κ - 2) a, where γ grows without bound; twice that brings γ down twentyfold.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from fuzzyarm.common.bisection import last_that_works
from fuzzyarm.common.slices import consecutive
from fuzzyarm.fuzzy_policy.proof.scalar_loop import decay, fastest, loop
from fuzzyarm.fuzzy_policy.states import SCALAR_STATES
from fuzzyarm.synthesis.semidefinite_program import Family, minimise, symmetric_units

__all__ = ["Feedback", "best_feedback", "feedback_for_gamma", "smallest_pole"]

GAMMA_SLACK = 1.001  # of γ over the solver's, so that the inequalities hold strictly
STRICT = 2e-4  # of the rates, likewise
MOST = 50.0  # fastest pole over the smallest one, where the search for a given γ gives up

# Places among the unknowns: P by its upper triangle, m = k P, and γ².
_P, _M = consecutive(SCALAR_STATES * (SCALAR_STATES + 1) // 2, SCALAR_STATES)
_P_AND_M, _GAMMA = slice(_M.stop), _M.stop
_UNKNOWNS = _GAMMA + 1
# Rows of the inequality of γ: state, disturbance, output; and of that of the fastest pole: two blocks of the state.
_X, _W, _Z = consecutive(SCALAR_STATES, 1, 1)
_UPPER, _LOWER = consecutive(SCALAR_STATES, SCALAR_STATES)


@dataclasses.dataclass(frozen=True)
class Feedback:
    """A feedback of the scalar loop.

    Attributes:
        k: (k_p [1/s²], k_d [1/s], k_i [1/s³]).
        X: (3, 3).
        gamma: γ [s²].
        fastest_pole: β [1/s].
    """

    k: np.ndarray
    X: np.ndarray
    gamma: float
    fastest_pole: float


def smallest_pole(kappa: float, rate: float) -> float:
    """Return (3κ - 2) a [1/s], the bound of the fastest pole that no feedback falls below, for a = `rate` [1/s]."""
    return (3.0 * kappa - 2.0) * rate


def best_feedback(kappa: float, rate: float, fastest_pole: float) -> Feedback | None:
    """Return the feedback with the smallest γ; None if none was found whose inequalities hold.

    Args:
        kappa: κ.
        rate: a = α + μ [1/s].
        fastest_pole: β [1/s].
    """
    x, _ = minimise(np.eye(_UNKNOWNS)[_GAMMA], _families(kappa, fastest_pole / rate))
    if not np.isfinite(x).all():
        return None
    P = np.tensordot(x[_P], symmetric_units(SCALAR_STATES), axes=1)
    if not np.linalg.eigvalsh(P)[0] > 0.0:
        return None
    # Back from the time unit 1/a: x = T x̃ with T = diag(1, a, 1/a), and V = Ṽ/a.
    T_inverse = np.diag([1.0, 1.0 / rate, rate])
    X = T_inverse @ np.linalg.inv(P) @ T_inverse / rate
    k = rate**2 * np.linalg.solve(P, x[_M]) @ T_inverse
    gamma = GAMMA_SLACK * math.sqrt(max(x[_GAMMA], 0.0)) / rate**2
    found = Feedback(k, 0.5 * (X + X.T), gamma, fastest_pole)
    return found if _holds(found, kappa, rate) else None


def feedback_for_gamma(kappa: float, rate: float, gamma: float) -> Feedback | None:
    """Return the feedback with the smallest bound of the fastest pole whose γ [s²] is at most `gamma`; None if none."""
    lowest, best = smallest_pole(kappa, rate), None

    def fails(pole: float) -> bool:
        nonlocal best
        found = best_feedback(kappa, rate, pole)
        if found is None or found.gamma > gamma:
            return True
        best = found
        return False

    if not fails(MOST * lowest):
        last_that_works(fails, 1.001 * lowest, MOST * lowest, resolution=0.005)
    return best


def _families(kappa: float, pole: float) -> list[Family]:
    """Return the inequalities in the variables P (6), m (3) and γ², in the time unit 1/a."""
    A, b, c = loop()
    P, rows = symmetric_units(SCALAR_STATES), np.eye(SCALAR_STATES)[:, np.newaxis]
    families = []
    for share in (1.0 / kappa, 1.0):
        moved = np.concatenate([A @ P, -share * (b @ rows)])
        state = moved + np.swapaxes(moved, 1, 2)
        alone = np.concatenate([P, np.zeros_like(P[:SCALAR_STATES])])
        whole, constant = np.zeros((1, _UNKNOWNS, _Z.stop, _Z.stop)), np.zeros((1, _Z.stop, _Z.stop))
        whole[0, _P_AND_M, _X, _X] = -state - 2.0 * (1.0 + STRICT) * alone
        whole[0, _P, _X, _Z], whole[0, _P, _Z, _X] = -P @ c.T, -c @ P
        whole[0, _GAMMA, _W, _W] = 1.0
        constant[0, _X, _W], constant[0, _W, _X], constant[0, _Z, _Z] = -share * b, -share * b.T, 1.0
        slow = np.zeros((1, _UNKNOWNS, _LOWER.stop, _LOWER.stop))
        slow[0, _P_AND_M, _UPPER, _UPPER] = slow[0, _P_AND_M, _LOWER, _LOWER] = pole * (1.0 - STRICT) * alone
        slow[0, _P_AND_M, _LOWER, _UPPER], slow[0, _P_AND_M, _UPPER, _LOWER] = moved, np.swapaxes(moved, 1, 2)
        families += [Family(constant, whole), Family(np.zeros((1, _LOWER.stop, _LOWER.stop)), slow)]
    positive = np.zeros((1, _UNKNOWNS, SCALAR_STATES, SCALAR_STATES))
    positive[0, _P] = P
    return [*families, Family(np.zeros((1, SCALAR_STATES, SCALAR_STATES)), positive)]


def _holds(found: Feedback, kappa: float, rate: float) -> bool:
    """Return whether all inequalities hold in floating point; the proof is in `scheduled_certificate`."""
    k, matrices = found.k[np.newaxis], [found.X]
    for share in (1.0 / kappa, 1.0):
        matrices.append(-decay(share, rate=rate, gamma2=found.gamma**2, X=found.X, k=k))
        matrices.append(fastest(share, pole=found.fastest_pole, X=found.X, k=k))
    for matrix in matrices:
        diagonal = np.diag(matrix)
        if not (diagonal > 0.0).all():
            return False
        if not np.linalg.eigvalsh(matrix / np.sqrt(np.outer(diagonal, diagonal)))[0] > 0.0:
            return False
    return True
