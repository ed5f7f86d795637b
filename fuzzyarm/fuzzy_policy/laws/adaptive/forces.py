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
"""

from __future__ import annotations

from typing import Any

from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, LONGEST_LATENESS, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.numbers.functions import array, each, maximum, minimum, only, select

__all__ = ["doubt_lateness", "doubt_scale", "note_moves", "spread_out", "walk_share"]

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
