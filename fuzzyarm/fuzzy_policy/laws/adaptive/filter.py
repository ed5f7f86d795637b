"""The extended Kalman filter of the adaptive observer: its correction by a sample and its step over a control period.

z = (x, p) with x = (θ, q, θ̇, q̇) of the elastic arm and p of `belief`; P is the covariance of its error. Everything is
recorded and works in place on one lane's arrays; the sizes follow from the arrays.

    correct   for each measured number y with variance r:  ν = y - z_y,  s = max(P_yy + r, ν²/gate),
              z ← z + P_y ν/s,   P ← P - P_y P_yᵀ/s,
    predict   x ← what the arm of p does of x in a control period,   P ← F P Fᵀ + Q.

`gate` makes a sample that nothing explains count less (Huber). The constants of the arm learn only the share

    λ = max(0, 1 - a/ν²)

of a correction, a a multiple of the noise's variance: samples that the sensors' noise alone may explain teach them
nothing. Without this dead zone the estimated stiffness drifts with the noise, because the noise in the estimated
bending correlates with that in the innovation. The covariance of such a partial correction is that of the partial
update of Schmidt's filter: entry (i, j) shrinks by 1 - (1 - λ_i)(1 - λ_j) of a whole correction.

What is computed for one lane has its place in a `Room`, so that nothing is allocated from sample to sample.

What the law of the adaptive observer takes, arranged as arrays and numbers.

How far forces, motors and lateness may stray: forces little while only noise corrects them, motors after jumps.

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

from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, KEPT, LONGEST_LATENESS, Memory
from fuzzyarm.numbers.functions import array, each, maximum, minimum, only, select

__all__ = [
    "INSIGNIFICANT", "Lanes", "Room", "Settings", "confine", "correct", "doubt_lateness", "doubt_scale",
    "fill_lanes", "lanes_of", "note_moves", "numbers_at", "read_noise", "room_for", "significant", "spread_out",
    "step", "tables_of", "walk_share", "with_tables",
]  # fmt: skip


class Settings(NamedTuple):
    """What the law takes, as arrays and numbers.

    Attributes:
        feedback: K, see `FeedbackTable`; in the law, its shape alone counts.
        feedback_rows: K, a row for each payload and point (payloads · points, n · 4 n).
        first_gain: see `AdaptiveWeights`.
        soft_samples: control periods in `AdaptiveWeights.soft_start`.
        kept: joints over whose angles it is tabulated.
        cosine: whether at even cosines rather than angles.
        points: of each angle.
        base: a_0 of `affine_numbers`.
        slopes: S of `affine_numbers`.
        guess: p_0.
        spread: standard deviations of z when an episode begins.
        shared: what numbers of z share when an episode begins, times its standard deviation.
        low: lowest p.
        high: highest p.
        noise: diagonal of Q.
        doubt: deviation of a motor velocity per square of a jump of its commanded torque [rad/s / (N m)²], (n,).
        scale_doubt: see `AdaptiveWeights`.
        calm_walk: see `AdaptiveWeights`.
        reopening: variance of the forces after `AdaptiveWeights.reopening` seconds of walk [N²], (forces,).
        still: square of a correction of the forces that counts as none [N²].
        steps: of the differences that make F.
        variances: of the measured numbers.
        cautious: which numbers of z learn only beyond the dead zone.
        gate: see `AdaptiveWeights`.
        dead_zone: see `AdaptiveWeights`.
        first_share: largest share of a sample in the noise that is read.
        insignificant: c² of `trust.significant`.
        largest_swing: see `AdaptiveWeights`.
        limit: torque limits [N m].
        mass: of all links [kg].
        substep: h [s].
        substeps: in a control period.
    """

    feedback: Any
    feedback_rows: Any
    first_gain: Any
    soft_samples: Any
    kept: Any
    cosine: Any
    points: Any
    base: Any
    slopes: Any
    guess: Any
    spread: Any
    shared: Any
    low: Any
    high: Any
    noise: Any
    doubt: Any
    scale_doubt: Any
    calm_walk: Any
    reopening: Any
    still: Any
    steps: Any
    variances: Any
    cautious: Any
    gate: Any
    dead_zone: Any
    first_share: Any
    insignificant: Any
    largest_swing: Any
    limit: Any
    mass: Any
    substep: Any
    substeps: Any


_TABLES = (
    "feedback_rows", "base", "slopes", "guess", "spread", "shared", "low", "high", "noise", "doubt", "reopening",
    "steps", "variances", "cautious", "limit",
)  # fmt: skip


def tables_of(settings: Settings) -> tuple[np.ndarray, ...]:
    """Return the arrays (any shape) that the law looks up by index, in a fixed order and double precision."""
    return tuple(np.array(getattr(settings, name), dtype=np.float64, order="C") for name in _TABLES)


def with_tables(settings: Settings, tables: Any) -> Settings:
    """Return the settings with other arrays in place of those of `tables_of`."""
    return settings._replace(**dict(zip(_TABLES, tables, strict=True)))


TINY = 1e-300
CHANGE = 6.0  # variance of e - e_last in `read_noise`, in variances of the angles' noise


class Lanes(NamedTuple):
    """Room for copies of the arm that differ in one number each, whose differences are the columns of F.

    Attributes:
        state: (4 n, copies).
        torque: (n, copies).
        force: (rows of a force line, copies).
        numbers: of the arm, (numbers, copies).
        jacobian: F, the rows of x, (4 n, numbers of z).
        product: likewise.
        wide: (n,) steps of the motor velocities.
    """

    state: Any
    torque: Any
    force: Any
    numbers: Any
    jacobian: Any
    product: Any
    wide: Any


def lanes_of(joints: int, size: int, numbers: int, rows: int) -> Lanes:
    """Return room for an arm of n joints and so many numbers, `size` numbers of z and force lines of so many rows."""
    copies = 1 + size + joints
    return Lanes(
        array(4 * joints, copies),
        array(joints, copies),
        array(rows, copies),
        array(numbers, copies),
        array(4 * joints, size),
        array(4 * joints, size),
        array(joints),
    )


def numbers_at(p: Any, first: Any, base: Any, slopes: Any, numbers: Any) -> None:
    """Fill the numbers of the arm of p, a = a_0 + S (p - p_0)."""
    for i in each(len(base)):
        numbers[i] = base[i]
        for j in each(len(p)):
            numbers[i] += slopes[i, j] * (p[j] - first[j])


def read_noise(measured: Any, read: Any, noise: Any, share: float, period: float) -> None:
    """Let `noise` (n,) follow the variance of the measured angles, from what velocities do not explain of their steps.

        e = θ - θ_last - T (θ̇ + θ̇_last)/2,    σ² ← σ² + share ((e - e_last)²/6 - σ²).

    e is 0 for a torque that is constant between two samples, and so is its change, nearly, where the loop vibrates:
    a vibration at ω that the commands cause is read as about (ωT)³/12 of its amplitude or less.

    Args:
        measured: θ and θ̇ of this sample, (2 n,).
        read: θ, θ̇ and e of the last sample (3, n), which become those of this one.
        noise: σ² [rad²].
        share: of this sample, in σ².
        period: T [s].
    """
    joints = len(noise)
    for j in each(joints):
        rest = measured[j] - read[0, j] - 0.5 * period * (measured[joints + j] + read[1, j])
        change = rest - read[2, j]
        noise[j] += share * (change * change / CHANGE - noise[j])
        read[0, j], read[1, j], read[2, j] = measured[j], measured[joints + j], rest


def correct(
    z: Any,
    P: Any,
    measured: Any,
    variances: Any,
    silent: Any,
    cautious: Any,
    gate: float,
    column: Any,
) -> Any:
    """Correct z and P by motor angles and velocities; return the mean of ν²/(P_yy + r).

    `silent` (2 n,) are the a of the module's docstring; `cautious` says which numbers of z learn only a share.
    """
    size, joints, surprise = len(z), len(measured) // 2, array(1)
    surprise[0] = 0.0
    for half in range(2):
        for joint in each(joints):
            k, at = half * joints + joint, 2 * half * joints + joint  # θ and θ̇ in x
            innovation = measured[k] - z[at]
            square, spread = innovation * innovation, P[at, at] + variances[k]
            surprise[0] += square / spread
            spread = maximum(spread, square / gate)
            learned = maximum(0.0, 1.0 - silent[k] / (square + TINY))
            kept = 1.0 - (1.0 - learned) * (1.0 - learned)
            for i in each(size):
                column[i] = P[at, i]
            for i in each(size):
                factor, shy = column[i] / spread, cautious[i] > 0.0
                z[i] += factor * innovation * select(shy, learned, 1.0)
                share = select(shy, kept, 1.0)
                for j in each(size):
                    P[i, j] -= factor * column[j] * select(cautious[j] > 0.0, share, 1.0)
    return surprise[0] / (2.0 * joints)


def confine(z: Any, P: Any, low: Any, high: Any) -> None:
    """Bring p into its range; what else is in z moves with it as P says."""
    first = len(z) - len(low)
    for j in each(len(low)):
        at = first + j
        found = z[at]
        inside = minimum(maximum(found, low[j]), high[j])
        for _ in only(inside != found):
            share = (inside - found) / maximum(P[at, at], TINY)
            for i in each(len(z)):
                z[i] += P[i, at] * share
            z[at] = inside
    for j in each(len(low)):
        z[first + j] = minimum(maximum(z[first + j], low[j]), high[j])


def fill_lanes(
    z: Any,
    P: Any,
    torque: Any,
    torque_slope: Any,
    line: Any,
    directions: Any,
    numbers: Any,
    slopes: Any,
    steps: Any,
    lanes: Lanes,
) -> None:
    """Fill the lanes: 0 the estimate, 1 + j with number j of z a step ahead, then motor velocities a step behind.

    Motor velocities take a standard deviation as their step: a joint that sticks has a slope of zero nearby.

    Args:
        z: x and p, with the lateness last.
        P: covariance of its error.
        torque: what the motors apply [N m], (n,).
        torque_slope: its derivative in the lateness.
        line: the force line of what is known of the tip force, (rows,).
        directions: that of each unit force, (rows, forces).
        numbers: of the arm of p.
        slopes: S.
        steps: of the differences, one for each number of z but the lateness.
        lanes: room, see `lanes_of`.
    """
    joints, states, size, forces = len(torque), len(lanes.state), len(z), directions.shape[1]
    offset = size - 1 - joints
    for lane in each(lanes.state.shape[1]):
        for i in each(states):
            lanes.state[i, lane] = z[i]
        for j in each(joints):
            lanes.torque[j, lane] = torque[j] + z[offset + j]
        for i in each(len(numbers)):
            lanes.numbers[i, lane] = numbers[i]
        for i in each(len(lanes.force)):
            lanes.force[i, lane] = line[i]
            for j in each(forces):
                lanes.force[i, lane] += directions[i, j] * z[states + j]
    for j in each(states):
        lanes.state[j, 1 + j] += steps[j]
    for j in each(joints):
        at = 2 * joints + j
        lanes.wide[j] = maximum(root(maximum(P[at, at], 0.0)), steps[at])
        lanes.state[at, 1 + at] = z[at] + lanes.wide[j]
        lanes.state[at, 1 + size + j] = z[at] - lanes.wide[j]
    for j in each(forces):
        for i in each(len(lanes.force)):
            lanes.force[i, 1 + states + j] += directions[i, j] * steps[states + j]
    for other in each(size - states - 1 - forces):
        j = forces + other
        for i in each(len(numbers)):
            lanes.numbers[i, 1 + states + j] += slopes[i, j] * steps[states + j]
    for j in each(joints):
        lanes.torque[j, size] += torque_slope[j]
        lanes.torque[j, 1 + offset + j] += steps[offset + j]


def step(z: Any, P: Any, steps: Any, noise: Any, lanes: Lanes) -> None:
    """Fill F from what became of the lanes in a control period, and step z and P; `noise` is the diagonal of Q."""
    state, F, G = lanes.state, lanes.jacobian, lanes.product
    joints, states, size, total = len(lanes.wide), len(state), len(z), array(1)
    for i in each(states):
        for j in each(size - 1):
            F[i, j] = (state[i, 1 + j] - state[i, 0]) / steps[j]
        F[i, size - 1] = state[i, size] - state[i, 0]
        for j in each(joints):
            F[i, 2 * joints + j] = (state[i, 1 + 2 * joints + j] - state[i, 1 + size + j]) / (2.0 * lanes.wide[j])
    for i in each(states):
        z[i] = state[i, 0]
        for j in each(size):
            G[i, j] = 0.0
        for k in each(size):
            slope = F[i, k]
            for j in each(size):
                G[i, j] += slope * P[k, j]
    for i in each(states):
        for j in each(i + 1):
            total[0] = 0.0
            for k in each(size):
                total[0] += G[i, k] * F[j, k]
            P[i, j] = P[j, i] = total[0]
        for other in each(size - states):
            j = states + other
            P[i, j] = P[j, i] = G[i, j]
    for i in each(size):
        P[i, i] += noise[i]


class Room(NamedTuple):
    """Room for what is computed for one lane; n joints, and a tip in a space of some axes.

    A force line has a row for each axis of the mean force, then for each axis of its change.
    """

    lanes: Lanes
    one: Any  # a state, torques, a force line and numbers of the arm, each (rows, 1)
    numbers: Any  # of the arm
    column: Any  # as many as z has
    measured: Any  # (2 n,), θ and θ̇
    variances: Any  # of the measured numbers (2 n,)
    silent: Any  # (2 n,)
    moved: Any  # forces before a correction (forces,)
    acted: Any  # z on which the law acts (N,), see `trust.significant`
    deviation: Any  # P_ll⁻¹ (l - l_0) there (loads,)
    factor: Any  # of P_ll (loads, loads)
    link_torque: Any  # τ_d of each kept reference (KEPT, n)
    travel: Any  # direction of travel of each, then the next one (KEPT + 1, axes)
    directions: Any  # force line of each unit force (rows, forces)
    line: Any  # force line of the known force (rows,)
    joints: Any  # (4, n), for short use
    error: Any  # (4 n,)
    gain: Any  # K (n, 4 n)


def room_for(s: Settings) -> Room:
    """Return room for one lane."""
    joints, size, numbers, forces = len(s.limit), len(s.spread), len(s.base), len(s.reopening)
    axes = forces - 1
    one = array(4 * joints, 1), array(joints, 1), array(2 * axes, 1), array(numbers, 1)
    directions = array(2 * axes, forces)
    line = array(2 * axes)
    for i in each(2 * axes):
        line[i] = 0.0
        for force in each(forces):
            directions[i, force] = 0.0
    for i in each(axes):
        directions[i, 1 + i] = 1.0
    return Room(
        lanes_of(joints, size, numbers, 2 * axes), one, array(numbers), array(size), array(2 * joints),
        array(2 * joints), array(2 * joints), array(forces), array(size), array(forces + 1),
        array(forces + 1, forces + 1), array(KEPT, joints), array(KEPT + 1, axes), directions,
        line, array(4, joints), array(4 * joints), array(joints, 4 * joints),
    )  # fmt: skip


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
