"""The extended Kalman filter of the adaptive observer: its correction by a sample and its step over a control period.

z = (x, p) with x = (θ, q, θ̇, q̇) of the elastic arm and p of `belief`; P is the covariance of its error. Everything is
compiled and works in place on one lane's arrays; the sizes follow from the arrays.

    correct   for each measured number y with variance r:  ν = y - z_y,  s = max(P_yy + r, ν²/gate),
              z ← z + P_y ν/s,   P ← P - P_y P_yᵀ/s,
    predict   x ← what the arm of p does of x in a control period,   P ← F P Fᵀ + Q.

`gate` makes a sample that nothing explains count less (Huber). The constants of the arm learn only the share

    λ = max(0, 1 - a/ν²)

of a correction, a a multiple of the noise's variance: samples that the sensors' noise alone may explain teach them
nothing. Without this dead zone the estimated stiffness drifts with the noise, because the noise in the estimated
bending correlates with that in the innovation. The covariance of such a partial correction is that of the partial
update of Schmidt's filter: entry (i, j) shrinks by 1 - (1 - λ_i)(1 - λ_j) of a whole correction.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

__all__ = ["Lanes", "confine", "correct", "fill_lanes", "lanes_of", "numbers_at", "read_noise", "step"]

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


@register_jitable
def lanes_of(joints: int, size: int, numbers: int, rows: int) -> Lanes:
    """Return room for an arm of n joints and so many numbers, `size` numbers of z and force lines of so many rows."""
    copies = 1 + size + joints
    return Lanes(
        np.empty((4 * joints, copies)),
        np.empty((joints, copies)),
        np.empty((rows, copies)),
        np.empty((numbers, copies)),
        np.empty((4 * joints, size)),
        np.empty((4 * joints, size)),
        np.empty(joints),
    )


@register_jitable
def numbers_at(p: np.ndarray, first: np.ndarray, base: np.ndarray, slopes: np.ndarray, numbers: np.ndarray) -> None:
    """Fill the numbers of the arm of p, a = a_0 + S (p - p_0)."""
    for i in range(len(base)):
        total = base[i]
        for j in range(len(p)):
            total += slopes[i, j] * (p[j] - first[j])
        numbers[i] = total


@register_jitable
def read_noise(measured: np.ndarray, read: np.ndarray, noise: np.ndarray, share: float, period: float) -> None:
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
    for j in range(joints):
        rest = measured[j] - read[0, j] - 0.5 * period * (measured[joints + j] + read[1, j])
        change = rest - read[2, j]
        noise[j] += share * (change * change / CHANGE - noise[j])
        read[0, j], read[1, j], read[2, j] = measured[j], measured[joints + j], rest


@register_jitable
def correct(
    z: np.ndarray,
    P: np.ndarray,
    measured: np.ndarray,
    variances: np.ndarray,
    silent: np.ndarray,
    cautious: np.ndarray,
    gate: float,
    column: np.ndarray,
) -> float:
    """Correct z and P by motor angles and velocities; return the mean of ν²/(P_yy + r).

    `silent` (2 n,) are the a of the module's docstring; `cautious` says which numbers of z learn only a share.
    """
    size, joints, surprise = len(z), len(measured) // 2, 0.0
    for k in range(2 * joints):
        at = k if k < joints else joints + k  # θ and θ̇ in x
        innovation = measured[k] - z[at]
        square, spread = innovation * innovation, P[at, at] + variances[k]
        surprise += square / spread
        spread = max(spread, square / gate)
        learned = max(0.0, 1.0 - silent[k] / (square + TINY))
        kept = 1.0 - (1.0 - learned) * (1.0 - learned)
        for i in range(size):
            column[i] = P[at, i]
        for i in range(size):
            factor = column[i] / spread
            z[i] += factor * innovation * (learned if cautious[i] else 1.0)
            if cautious[i]:
                for j in range(size):
                    P[i, j] -= factor * column[j] * (kept if cautious[j] else 1.0)
            else:
                for j in range(size):
                    P[i, j] -= factor * column[j]
    return surprise / (2 * joints)


@register_jitable
def confine(z: np.ndarray, P: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Bring p into its range; what else is in z moves with it as P says."""
    first = len(z) - len(low)
    for j in range(len(low)):
        at = first + j
        inside = min(max(z[at], low[j]), high[j])
        if inside != z[at]:
            share = (inside - z[at]) / max(P[at, at], TINY)
            for i in range(len(z)):
                z[i] += P[i, at] * share
            z[at] = inside
    for j in range(len(low)):
        z[first + j] = min(max(z[first + j], low[j]), high[j])


@register_jitable
def fill_lanes(
    z: np.ndarray,
    P: np.ndarray,
    torque: np.ndarray,
    torque_slope: np.ndarray,
    line: np.ndarray,
    directions: np.ndarray,
    numbers: np.ndarray,
    slopes: np.ndarray,
    steps: np.ndarray,
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
    for lane in range(lanes.state.shape[1]):
        for i in range(states):
            lanes.state[i, lane] = z[i]
        for j in range(joints):
            lanes.torque[j, lane] = torque[j] + z[offset + j]
        for i in range(len(numbers)):
            lanes.numbers[i, lane] = numbers[i]
        for i in range(len(lanes.force)):
            total = line[i]
            for j in range(forces):
                total += directions[i, j] * z[states + j]
            lanes.force[i, lane] = total
    for j in range(states):
        lanes.state[j, 1 + j] += steps[j]
    for j in range(joints):
        at = 2 * joints + j
        lanes.wide[j] = max(np.sqrt(max(P[at, at], 0.0)), steps[at])
        lanes.state[at, 1 + at] = z[at] + lanes.wide[j]
        lanes.state[at, 1 + size + j] = z[at] - lanes.wide[j]
    for j in range(size - states - 1):
        lane, step = 1 + states + j, steps[states + j]
        if j < forces:
            for i in range(len(lanes.force)):
                lanes.force[i, lane] += directions[i, j] * step
        else:
            for i in range(len(numbers)):
                lanes.numbers[i, lane] += slopes[i, j] * step
    for j in range(joints):
        lanes.torque[j, size] += torque_slope[j]
        lanes.torque[j, 1 + offset + j] += steps[offset + j]


@register_jitable
def step(z: np.ndarray, P: np.ndarray, steps: np.ndarray, noise: np.ndarray, lanes: Lanes) -> None:
    """Fill F from what became of the lanes in a control period, and step z and P; `noise` is the diagonal of Q."""
    state, F, G = lanes.state, lanes.jacobian, lanes.product
    joints, states, size = len(lanes.wide), len(state), len(z)
    for i in range(states):
        for j in range(size - 1):
            F[i, j] = (state[i, 1 + j] - state[i, 0]) / steps[j]
        F[i, size - 1] = state[i, size] - state[i, 0]
        for j in range(joints):
            F[i, 2 * joints + j] = (state[i, 1 + 2 * joints + j] - state[i, 1 + size + j]) / (2.0 * lanes.wide[j])
    for i in range(states):
        z[i] = state[i, 0]
        for j in range(size):
            G[i, j] = 0.0
        for k in range(size):
            slope = F[i, k]
            for j in range(size):
                G[i, j] += slope * P[k, j]
    for i in range(states):
        for j in range(i + 1):
            total = 0.0
            for k in range(size):
                total += G[i, k] * F[j, k]
            P[i, j] = P[j, i] = total
        for j in range(states, size):
            P[i, j] = P[j, i] = G[i, j]
    for i in range(size):
        P[i, i] += noise[i]
