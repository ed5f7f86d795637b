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

from typing import Any

from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.room import Room
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.numbers.functions import array, each, maximum

__all__ = ["INSIGNIFICANT", "significant"]

INSIGNIFICANT = 1.25  # c of an arm whose noise is a mean over all samples
TINY = 1e-300
ROUNDING = 1e-9  # least share of a variance that the other loads leave unexplained


def significant(m: Memory, s: Settings, room: Room) -> None:
    """Fill `acted` of the room with z, and x_a and l_a in place of x and l."""
    joints, loads, acted = len(m.noise), len(room.deviation), room.acted
    states, ratio, square = 4 * joints, array(1), array(1)
    ratio[0], square[0] = 0.0, TINY
    for i in each(len(acted)):
        acted[i] = m.z[i]
    for j in each(joints):
        ratio[0] = maximum(ratio[0], m.noise[j] / room.variances[j])
    for i in each(loads):
        acted[states + i] -= s.guess[i]
    _factorise(m.P[states : states + loads, states : states + loads], room.factor)
    _solve(room.factor, acted[states : states + loads], room.deviation)
    for i in each(loads):
        square[0] += acted[states + i] * room.deviation[i]
    kept = maximum(0.0, 1.0 - s.insignificant * m.flags[FLAG.calm] * ratio[0] / maximum(square[0], TINY))
    for i in each(states):
        for k in each(loads):
            acted[i] -= (1.0 - kept) * m.P[i, states + k] * room.deviation[k]
    for i in each(loads):
        acted[states + i] = s.guess[i] + kept * acted[states + i]


def _factorise(A: Any, L: Any) -> None:
    """Fill the lower triangle L of A = L Lᵀ."""
    for i in each(len(A)):
        for j in each(i):
            L[i, j] = A[i, j]
            for k in each(j):
                L[i, j] -= L[i, k] * L[j, k]
            L[i, j] /= L[j, j]
        L[i, i] = A[i, i]
        for k in each(i):
            L[i, i] -= L[i, k] * L[i, k]
        L[i, i] = root(maximum(maximum(L[i, i], ROUNDING * A[i, i]), TINY))


def _solve(L: Any, b: Any, y: Any) -> None:
    """Fill y with the solution of L Lᵀ y = b."""
    for i in each(len(L)):
        y[i] = b[i]
        for k in each(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for behind in each(len(L)):
        i = len(L) - 1 - behind
        for later in each(behind):
            k = i + 1 + later
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]
