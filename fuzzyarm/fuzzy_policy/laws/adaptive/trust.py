"""How far forces, motors and lateness may stray: forces little while only noise corrects them, motors after jumps.

c_k are the corrections of the forces by the samples, in N, and means are over the last `SHARE`⁻¹ samples or so:

    s = |mean c|² / (mean |c|² + floor),    calm → 1 for s up to `NOISE`, falling to 0 for s from `DIRECTED` on.

Corrections by noise point anywhere, so that s is about `SHARE`/2; those by a force that moves have one direction, and s
goes to 1, however small they are. The ratio needs no variance of any sensor. Calm comes slowly and goes at once. The
forces walk (1 - calm) + `calm_walk` calm times as fast as they do when they move; where calm goes, their variance also
grows by that of `reopening` seconds of walk, which it would have had without calm.

A motor's torque may be wrong by the share w (Δu/u_max)² of its limit u_max, w = `torque_doubt` and Δu the largest jump
of the commands that are on their way. A wrong torque constant or lateness acts through such jumps, and what it does to
the motors would be taken for a load that is answered by a larger jump.

A filter may become sure of a wrong lateness. Where the innovations are larger than it expects, the lateness is doubted:
a sample whose ν²/s is on average 1 + a adds `LATENESS_DOUBT` a to its variance, up to the first one. So is a factor
that all of the arm's constants share, as a wrong torque constant gives them: the sample adds

    P_ik ← P_ik + min(`scale_doubt` a, max(0, `LARGEST_SCALE` - min P_jj))

to the covariance of any two of these factors, j being any of them.

The load on which the adaptive observer acts: what of its estimate the noise of the encoders does not explain.

l are the forces and the payload, the first numbers of p, l_0 their first guess, and x the state:

    d² = (l - l_0)ᵀ P_ll⁻¹ (l - l_0),   s = max(0, 1 - c² calm ρ/d²),
    l_a = l_0 + s (l - l_0),            x_a = x - (1 - s) P_xl P_ll⁻¹ (l - l_0).

ρ is the share that the noise that is read has in the variance that the filter expects of a measured angle, the largest
of all joints. A load within c standard deviations by that noise moves nothing, one far beyond is hardly smaller than it
is believed (the positive part of the estimator of James and Stein). Without noise ρ is 0, where corrections have a
direction calm is 0, and in both cases s is 1. x_a is the state that fits l_a: the mean of x, given l_a.
The filter itself goes on with x and l.
"""

from __future__ import annotations

from typing import Any

from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, LONGEST_LATENESS, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Room
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.numbers.functions import array, each, maximum, minimum, only, select

__all__ = ["INSIGNIFICANT", "doubt_lateness", "doubt_scale", "note_moves", "significant", "spread_out", "walk_share"]


SHARE = 0.1  # of a sample, in the means
NOISE, DIRECTED = 0.08, 0.3  # s up to which corrections count as noise, and from which on as a motion
CALMING, STIRRING = 0.02, 0.7  # share of the way to more and to less calm that a sample makes
LATENESS_DOUBT = 0.01  # variance of the lateness per surprise [control periods²]
LARGEST_SCALE = 0.1  # variance of the surest factor above which the shared one is not doubted


def note_moves(m: Memory, s: Settings, before: Any) -> None:
    """Bring `calm` and the variances of the forces up to date, after a correction of the forces `before` (forces,)."""
    first, forces, square, mean = len(m.z) - len(s.guess), len(before), array(1), array(1)
    square[0], mean[0] = 0.0, 0.0
    for i in each(forces):
        change = m.z[first + i] - before[i]
        square[0] += change * change
        m.moves[i] += SHARE * (change - m.moves[i])
        mean[0] += m.moves[i] * m.moves[i]
    m.moves[forces] += SHARE * (square[0] - m.moves[forces])
    directed = mean[0] / (m.moves[forces] + s.still)
    calm = 1.0 - minimum(maximum((directed - NOISE) / (DIRECTED - NOISE), 0.0), 1.0)
    change = calm - m.flags[FLAG.calm]
    stirred = change * STIRRING
    for _ in only(change < 0.0):
        for i in each(forces):
            m.P[first + i, first + i] -= stirred * s.reopening[i]
    m.flags[FLAG.calm] += select(change < 0.0, stirred, change * CALMING)


def doubt_lateness(m: Memory, s: Settings, surprise: float) -> None:
    """Let a sample with this mean ν²/s add to the variance of the lateness."""
    last = len(m.z) - 1
    wider = m.P[last, last] + LATENESS_DOUBT * maximum(0.0, surprise - 1.0)
    m.P[last, last] = minimum(wider, s.spread[last] * s.spread[last])


def doubt_scale(m: Memory, s: Settings, surprise: float) -> None:
    """Let a sample with this mean ν²/s add to the variance of the factor that the arm's constants share."""
    first, beliefs, least = len(m.z) - len(s.guess), len(s.guess), array(1)
    least[0] = LARGEST_SCALE
    for belief in each(beliefs):
        i = first + belief
        least[0] = select(s.shared[i] > 0.0, minimum(least[0], m.P[i, i]), least[0])
    more = minimum(s.scale_doubt * maximum(0.0, surprise - 1.0), LARGEST_SCALE - least[0])
    for belief in each(beliefs):
        i = first + belief
        for other in each(beliefs):
            k = first + other
            both = (s.shared[i] > 0.0) & (s.shared[k] > 0.0)
            m.P[i, k] = select(both, m.P[i, k] + more, m.P[i, k])


def walk_share(calm: float, calm_walk: float) -> float:
    """Return how fast the forces walk, as a share of their fastest walk."""
    return 1.0 - (1.0 - calm_walk) * calm


def spread_out(m: Memory, s: Settings) -> None:
    """Change what `predict` has added to P: less where forces are calm, more for motors after a jump of the torque."""
    joints, states = len(m.noise), 4 * len(m.noise)
    share = walk_share(m.flags[FLAG.calm], s.calm_walk)
    for force in each(len(s.reopening)):
        i = states + force
        m.P[i, i] -= (1.0 - share * share) * s.noise[i]
    for j in each(joints):
        jump: Any = 0.0
        for k in range(LONGEST_LATENESS + 1):
            jump = maximum(jump, abs(m.commands[k, j] - m.commands[k + 1, j]))
        wrong = s.doubt[j] * jump * jump
        m.P[2 * joints + j, 2 * joints + j] += wrong * wrong


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
