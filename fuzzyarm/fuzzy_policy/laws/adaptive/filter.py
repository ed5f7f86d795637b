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
"""

from __future__ import annotations

from typing import Any, NamedTuple

from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import KEPT
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.numbers.functions import array, each, maximum, minimum, only, select

__all__ = [
    "Lanes", "Room", "confine", "correct", "fill_lanes", "lanes_of", "numbers_at", "read_noise", "room_for", "step",
]  # fmt: skip


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
