"""The load on which the adaptive observer acts: what of its estimate the noise of the encoders does not explain.

l are the forces and the payload, the first numbers of p, l_0 their first guess, and x the state:

    d² = (l - l_0)ᵀ P_ll⁻¹ (l - l_0),   s = max(0, 1 - c² calm ρ/d²),
    l_a = l_0 + s (l - l_0),            x_a = x - (1 - s) P_xl P_ll⁻¹ (l - l_0).

ρ is the share that the noise that is read has in the variance that the filter expects of a measured angle, the largest
of all joints. A load within c standard deviations by that noise moves nothing, one far beyond is hardly smaller than it
is believed (the positive part of the estimator of James and Stein). Without noise ρ is 0, where corrections have a
direction calm is 0, see `forces`, and in both cases s is 1. x_a is the state that fits l_a: the mean of x, given l_a.
The filter itself goes on with x and l.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings

__all__ = ["INSIGNIFICANT", "significant"]

INSIGNIFICANT = 1.25  # c of an arm whose noise is a mean over all samples
TINY = 1e-300
ROUNDING = 1e-9  # least share of a variance that the other loads leave unexplained


@register_jitable
def significant(m: Memory, s: Settings, room: Room) -> None:
    """Fill `acted` of the room with z, and x_a and l_a in place of x and l."""
    joints, loads, acted = len(m.noise), len(room.deviation), room.acted
    states, ratio, square = 4 * joints, 0.0, TINY
    for i in range(len(acted)):
        acted[i] = m.z[i]
    for j in range(joints):
        ratio = max(ratio, m.noise[j] / room.variances[j])
    for i in range(loads):
        acted[states + i] -= s.guess[i]
    _factorise(m.P[states : states + loads, states : states + loads], room.factor)
    _solve(room.factor, acted[states : states + loads], room.deviation)
    for i in range(loads):
        square += acted[states + i] * room.deviation[i]
    kept = max(0.0, 1.0 - s.insignificant * m.flags[FLAG.calm] * ratio / max(square, TINY))
    for i in range(states):
        for k in range(loads):
            acted[i] -= (1.0 - kept) * m.P[i, states + k] * room.deviation[k]
    for i in range(loads):
        acted[states + i] = s.guess[i] + kept * acted[states + i]


@register_jitable
def _factorise(A: np.ndarray, L: np.ndarray) -> None:
    """Fill the lower triangle L of A = L Lᵀ."""
    for i in range(len(A)):
        for j in range(i):
            rest = A[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            L[i, j] = rest / L[j, j]
        rest = A[i, i]
        for k in range(i):
            rest -= L[i, k] * L[i, k]
        L[i, i] = np.sqrt(max(max(rest, ROUNDING * A[i, i]), TINY))


@register_jitable
def _solve(L: np.ndarray, b: np.ndarray, y: np.ndarray) -> None:
    """Fill y with the solution of L Lᵀ y = b."""
    for i in range(len(L)):
        y[i] = b[i]
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for i in range(len(L) - 1, -1, -1):
        for k in range(i + 1, len(L)):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]
