"""What the centre misses of the equations of the arm in one period, and the torques of each uncertain constant there.

Along the centre y(t), with K, B, I_a, f_v and the links' torque R of the middle of the set,

    N = u - K φ - B φ̇ - f_v θ̇,       P = N - I_a θ̈,       d = K φ + B φ̇ - R(q, q̇, q̈, F).

P is the friction that the centre's motor has, with its sign changed; d is what its links miss. The angles are
polynomials in s in [-1, 1], so N and P are, too; d is a power series about s = 0, whose remainder is its last
coefficient about a ball, s in [-1, 1] (Lagrange). A signal is a list of coefficients a_i: on the whole period it lies
in a_0 + [-1, 1] Σ |a_i|.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import STRIBECK
from fuzzyarm.proof.tip.centre import DEGREE
from fuzzyarm.proof.tip.enclosures import between, largest, low_high

__all__ = [
    "Forces", "LinkMotion", "PeriodMotion", "Signal", "TipForces", "dry_friction", "link_torque", "rest_size",
    "signal_ends", "signal_range", "signal_size",
]  # fmt: skip

_ORDER = DEGREE + 1  # coefficients of a power series, without the one of its remainder
Signal = list[Any]  # coefficients in s in [-1, 1]


def signal_range(signal: Signal) -> Any:
    """Return a ball that holds a signal during the whole period."""
    return signal[0] + sum((largest(a) for a in signal[1:]), 0.0) * between(-1.0, 1.0)


def _bernstein_table(degree: int) -> Any:
    """Return the matrix from coefficients in s in [-1, 1] to those in Bernstein's basis, one row each."""

    def entry(i: int, j: int) -> arb:
        # The i-th coefficient of s^j = (x - (1 - x))^j, s = 2 x - 1.
        terms = range(max(0, j - degree + i), min(i, j) + 1)
        total = sum(math.comb(j, k) * math.comb(degree - j, i - k) * (-1) ** (j - k) for k in terms)
        return arb(total) / math.comb(degree, i)

    return arb_mat([[entry(i, j) for j in range(degree + 1)] for i in range(degree + 1)])


_BERNSTEIN = _bernstein_table(DEGREE + 1)


def _column(signal: Signal, rows: int) -> Any:
    """Return a signal as a column of so many coefficients."""
    return arb_mat([[a] for a in [*signal, *[arb(0)] * (rows - len(signal))]])


def signal_ends(signal: Signal) -> tuple[float, float]:
    """Return the lowest and highest coefficient of a signal in Bernstein's basis, which enclose its range.

    For a monotone signal they are its values at both ends, or near them.
    """
    ends = [low_high(x) for x in (_BERNSTEIN * _column(signal, DEGREE + 2)).entries()]
    return min(low for low, _ in ends), max(high for _, high in ends)


def signal_size(signal: Signal) -> float:
    """Return a bound of |a(s)|."""
    return largest(signal_range(signal))


def rest_size(signal: Signal) -> float:
    """Return a bound of |a(s) - a_0 - a_1 s|."""
    return sum(largest(a) for a in signal[2:]) * (1.0 + 2.0**-40)


class Forces(NamedTuple):
    """A tip force as signals along x and y: its mean, and half its change with s."""

    x: Signal
    y: Signal


class TipForces(NamedTuple):
    """What may act at the tip during a segment."""

    middle: Forces  # the force in the middle of the set
    radii: tuple[float, float]  # how far the force along x and y can be from it [N]
    direction: tuple[float, float]  # a unit vector (x, y)
    courses: tuple[float, float]  # largest part of any course along the direction and across it [N]


def _shift_table() -> Any:
    """Return the matrix that takes coefficients about 0 to those about the ball [-1, 1], one row each."""
    powers = [arb(1), *[between(-1.0, 1.0)] * DEGREE]  # of s, which all lie in [-1, 1]
    return arb_mat([
        [arb(math.comb(j, i)) * powers[j - i] if j >= i else arb(0) for j in range(DEGREE + 1)]
        for i in range(DEGREE + 1)
    ])  # fmt: skip


class PeriodMotion:
    """The centre of a period, or of a part of one, in balls: its angles and their derivatives as signals [rad, s]."""

    _shift = _shift_table()

    def __init__(self, angles: np.ndarray, period: float) -> None:
        """Take the coefficients (4, DEGREE + 1) of the angles [rad] and T [s]."""
        self._rate, self.duration = 2 / arb(period), period
        self.angle: list[Signal] = [[arb(c) for c in row] for row in angles.tolist()]
        self.velocity = [self._derivative(signal) for signal in self.angle]
        self.acceleration = [self._derivative(signal) for signal in self.velocity]

    def _derivative(self, signal: Signal) -> Signal:
        return [self._rate * i * signal[i] for i in range(1, len(signal))]

    @functools.cached_property
    def links(self) -> list[list[Any]]:
        """Return balls that hold the angles, velocities and accelerations of both links during the whole period."""
        return [[signal_range(s) for s in kind[JOINTS:]] for kind in (self.angle, self.velocity, self.acceleration)]

    def at(self, s: int) -> list[Any]:
        """Return the eight numbers of the state at s = -1 or s = 1."""
        signals = [*self.angle, *self.velocity]
        return [sum((a * s**i for i, a in enumerate(signal)), arb(0)) for signal in signals]

    def net_torque(self, joint: int, torque: float, arm: Arm) -> tuple[Signal, Signal]:
        """Return N and P of a motor under a held torque [N m], with the constants of `arm`."""
        stiffness, damping = (arm.stiffness1, arm.stiffness2)[joint], (arm.damping1, arm.damping2)[joint]
        viscous, inertia = (arm.viscous1, arm.viscous2)[joint], (arm.motor_inertia1, arm.motor_inertia2)[joint]
        parts = [
            (-stiffness, self.bending(joint)),
            (-damping, self.bending_rate(joint)),
            (-viscous, self.velocity[joint]),
        ]
        net = combined([(arb(1), [arb(torque)]), *parts])
        return net, combined([(arb(1), net), (-inertia, self.acceleration[joint])])

    def bending(self, joint: int) -> Signal:
        """Return φ of a joint [rad]."""
        return combined([(arb(1), self.angle[joint]), (arb(-1), self.angle[JOINTS + joint])])

    def bending_rate(self, joint: int) -> Signal:
        """Return φ̇ of a joint [rad/s]."""
        return combined([(arb(1), self.velocity[joint]), (arb(-1), self.velocity[JOINTS + joint])])

    def link_torques(self, force: Forces, arm: Arm) -> list[Signal]:
        """Return R of both links, with the remainder as the last coefficient."""
        near, far = self._series(force, arm, shifted=False), self._series(force, arm, shifted=True)
        return [[*(p[i] for i in range(_ORDER)), q[_ORDER]] for p, q in zip(near, far, strict=True)]

    def link_defects(self, torques: list[Signal], arm: Arm) -> list[Signal]:
        """Return d of both links."""
        stiffness, damping = (arm.stiffness1, arm.stiffness2), (arm.damping1, arm.damping2)
        return [
            combined([
                (stiffness[j], self.bending(j)), (damping[j], self.bending_rate(j)), (arb(-1), torques[j])
            ])
            for j in range(JOINTS)
        ]  # fmt: skip

    def _series(self, force: Forces, arm: Arm, *, shifted: bool) -> tuple[Any, Any]:
        """Return R as power series about s = 0, or about the ball [-1, 1]."""
        ctx.cap = _ORDER + 1

        def series(signal: Signal) -> arb_series:
            return arb_series((self._shift * _column(signal, DEGREE + 1)).entries() if shifted else signal)

        parts = ([series(s) for s in kind[JOINTS:]] for kind in (self.angle, self.velocity, self.acceleration))
        return link_torque(LinkMotion(*parts), (series(force.x), series(force.y)), arm)

    def slip(self, joint: int, side: int, arm: Arm) -> Signal:
        """Return F(v) [N m] of a motor that turns to one side, with its remainder."""
        signal = [side * a for a in self.velocity[joint]]
        ctx.cap = _ORDER + 1
        shifted = (self._shift * _column(signal, DEGREE + 1)).entries()
        near, far = (dry_friction(arb_series(about), joint, arm) for about in (signal, shifted))
        return [*(near[i] for i in range(_ORDER)), far[_ORDER]]


def dry_friction(speed: Any, joint: int, arm: Arm) -> Any:
    """Return F(v) [N m] of a motor for a number type of one's own, as the environment has it."""
    return STRIBECK.magnitude(speed, dynamics.dry_frictions(arm)[joint])


def combined(parts: list[tuple[Any, Signal]]) -> Signal:
    """Return the sum of signals times factors."""
    length = max(len(signal) for _, signal in parts)
    return [sum((factor * signal[i] for factor, signal in parts if i < len(signal)), arb(0)) for i in range(length)]


class LinkMotion(NamedTuple):
    """Angles [rad], velocities [rad/s] and accelerations [rad/s²] of the links, pairs of any number type."""

    angle: Any
    velocity: Any
    acceleration: Any


def link_torque(motion: LinkMotion, force: Any, arm: Arm) -> tuple[Any, Any]:
    """Return R = M(q) q̈ + C(q, q̇) q̇ + g(q) - J(q)ᵀ F [N m] for a motion of the links and a tip force (x, y) [N].

    It is linear in q̈ and in the constants of the arm, and the text of the environment for balls, jets and power series.
    """
    (q1, q2), (dq1, dq2), (ddq1, ddq2) = motion
    (sin1, cos1), (sin2, cos2), (sin12, cos12) = sine_cosine(q1), sine_cosine(q2), sine_cosine(q1 + q2)
    m11, m12, m22 = dynamics.mass_matrix(cos2, arm)
    coriolis1, coriolis2 = dynamics.coriolis_torque(sin2, dq1, dq2, arm)
    gravity1, gravity2 = dynamics.gravity_torque(sin1, sin12, arm)
    force1, force2 = dynamics.tip_force_torque(sin1, cos1, sin12, cos12, force[0], force[1], arm)
    return (
        m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1 - force1,
        m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2 - force2,
    )
