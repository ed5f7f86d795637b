"""The defects of the centre in the arm's equations of motion, as signals over one period.

Along the centre y(t), with φ = θ - q, the held torque u, and K, B, I_a, f_v and the links' torque R of the arm in the
middle of the set,

    N = u - K φ - B φ̇ - f_v θ̇,       P = N - I_a θ̈,       d = K φ + B φ̇ - R(q, q̇, q̈, F).

A motor with the net torque N follows the centre if its friction torque is -P, and the links do with an additional
torque -d. The angles, N and P are polynomials in s in [-1, 1]; d is a power series about s = 0 with
Lagrange's remainder: its last coefficient is a ball that encloses those about all points of [-1, 1]. Each function
is a `Signal`.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from fuzzyarm.envs.physics.dynamics import motors
from fuzzyarm.envs.physics.friction import STRIBECK
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.proof.tip.centre import DEGREE
from fuzzyarm.proof.tip.enclosures import SLACK, between, largest, low_high, middle_of, radius_of

__all__ = ["Forces", "PeriodMotion", "Signal", "TipForces", "dry_friction", "link_torque"]

_ORDER = DEGREE + 1  # coefficients of a power series, without that of the remainder


def _bernstein_table(degree: int) -> Any:
    """Return the matrix that converts a polynomial's coefficients to those in the Bernstein basis on [-1, 1]."""

    def entry(i: int, j: int) -> arb:
        # The i-th coefficient of s^j = (x - (1 - x))^j, s = 2 x - 1.
        terms = range(max(0, j - degree + i), min(i, j) + 1)
        total = sum(math.comb(j, k) * math.comb(degree - j, i - k) * (-1) ** (j - k) for k in terms)
        return arb(total) / math.comb(degree, i)

    return arb_mat([[entry(i, j) for j in range(degree + 1)] for i in range(degree + 1)])


def _shift_table() -> Any:
    """Return a matrix that maps a polynomial's coefficients about 0 to balls of those about all points of [-1, 1]."""
    powers = [arb(1), *[between(-1.0, 1.0)] * DEGREE]  # of s, which all lie in [-1, 1]
    return arb_mat([
        [arb(math.comb(j, i)) * powers[j - i] if j >= i else arb(0) for j in range(DEGREE + 1)]
        for i in range(DEGREE + 1)
    ])  # fmt: skip


_BERNSTEIN, _SHIFT = _bernstein_table(DEGREE + 1), _shift_table()


class Signal:
    """A function of time, Σ a_i s^i with balls a_i, over a period in which s goes from -1 to 1."""

    __slots__ = ("coefficients",)

    def __init__(self, coefficients: Iterable[Any]) -> None:
        self.coefficients = [*coefficients]

    def __getitem__(self, i: int) -> Any:
        """Return a_i, zero beyond the last coefficient."""
        return self.coefficients[i] if i < len(self.coefficients) else arb(0)

    def __add__(self, other: Signal) -> Signal:
        pairs = itertools.zip_longest(self.coefficients, other.coefficients, fillvalue=arb(0))
        return Signal(a + b for a, b in pairs)

    def __rmul__(self, factor: Any) -> Signal:
        return Signal(factor * a for a in self.coefficients)

    def __sub__(self, other: Signal) -> Signal:
        return self + -1 * other

    def derivative(self, rate: arb) -> Signal:
        """Return the derivative with respect to time; `rate` is ds/dt [1/s]."""
        return Signal(rate * i * a for i, a in enumerate(self.coefficients[1:], 1))

    def at(self, s: Any) -> Any:
        """Return the value at s = -1 or s = 1; for a ball s, a ball that encloses the values at all of its points."""
        return sum((a * s**i for i, a in enumerate(self.coefficients)), arb(0))

    def range(self) -> Any:
        """Return the ball a_0 + [-1, 1] Σ |a_i|, which encloses the signal during the period."""
        return self[0] + sum((largest(a) for a in self.coefficients[1:]), 0.0) * between(-1.0, 1.0)

    def size(self) -> float:
        """Return a bound on |signal| during the period."""
        return largest(self.range())

    def bent(self) -> float:
        """Return a bound on the distance of the signal from the line a_0 + a_1 s."""
        return sum(largest(a) for a in self.coefficients[2:]) * (1.0 + 2.0**-40)

    def ends(self) -> tuple[float, float]:
        """Return the lowest and highest Bernstein coefficient, which enclose the range, closely if monotone."""
        ends = [low_high(x) for x in (_BERNSTEIN * self._column(DEGREE + 2)).entries()]
        return min(low for low, _ in ends), max(high for _, high in ends)

    def about_all(self) -> list[Any]:
        """Return the Taylor coefficients about all points of [-1, 1], in balls, which give Lagrange's remainder."""
        return (_SHIFT * self._column(DEGREE + 1)).entries()  # type: ignore[no-any-return]

    def _column(self, rows: int) -> Any:
        return arb_mat([[self[i]] for i in range(rows)])


def _through(function: Callable[..., tuple[Any, ...]], *signals: Signal) -> list[Signal]:
    """Return each result of `function` on the signals as a power series in s about 0 whose last term is a remainder."""
    ctx.cap = _ORDER + 1
    near = function(*(arb_series(signal.coefficients) for signal in signals))
    far = function(*(arb_series(signal.about_all()) for signal in signals))
    return [Signal([*(p[i] for i in range(_ORDER)), q[_ORDER]]) for p, q in zip(near, far, strict=True)]


Forces = Sequence[Signal]
"""A tip force as a signal along each axis: its mean, and half its change with s; empty for no force."""


class TipForces(NamedTuple):
    """The forces that may act at the tip during a segment."""

    middle: Forces  # force in the middle of the set
    radii: Sequence[float]  # largest difference from `middle` along each axis [N]
    directions: np.ndarray  # orthogonal unit vectors, one per row
    courses: np.ndarray  # largest force of arbitrary course in time along each direction [N]


class PeriodMotion:
    """The tube's centre in a period or a part of one, in balls: angles and their derivatives as signals [rad, s]."""

    def __init__(self, angles: np.ndarray, period: float, physics: Physics) -> None:
        """Take the coefficients (4, DEGREE + 1) of the angles [rad], the duration [s], and the equations of the arm."""
        rate, self.duration, self._physics, self._joints = 2 / arb(period), period, physics, physics.joints
        self.angle = [Signal(map(arb, row)) for row in angles.tolist()]
        self.velocity = [signal.derivative(rate) for signal in self.angle]
        self.acceleration = [signal.derivative(rate) for signal in self.velocity]
        self.links = [kind[self._joints :] for kind in (self.angle, self.velocity, self.acceleration)]

    @functools.cached_property
    def link_ranges(self) -> list[list[Any]]:
        """Balls that enclose the angles, velocities and accelerations of all links during the period."""
        return [[signal.range() for signal in kind] for kind in self.links]

    def at(self, s: int) -> list[Any]:
        """Return the state θ, q, θ̇, q̇ (8 balls) at the start, s = -1, or at the end, s = 1."""
        return [signal.at(s) for signal in (*self.angle, *self.velocity)]

    def bending(self, joint: int) -> Signal:
        """Return the bending φ of a joint [rad]."""
        return self.angle[joint] - self.angle[self._joints + joint]

    def bending_rate(self, joint: int) -> Signal:
        """Return the bending velocity φ̇ of a joint [rad/s]."""
        return self.velocity[joint] - self.velocity[self._joints + joint]

    def net_torque(self, joint: int, torque: float, arm: Any) -> tuple[Signal, Signal]:
        """Return a motor's net torque N and P = N - I_a θ̈ [N m] under a held torque, with the constants of `arm`."""
        own = motors(arm, self.links[0])[joint]
        net = Signal([arb(torque)]) - own.stiffness * self.bending(joint) - own.damping * self.bending_rate(joint)
        net -= own.viscous * self.velocity[joint]
        return net, net - own.motor_inertia * self.acceleration[joint]

    def link_torques(self, force: Forces, arm: Any) -> list[Signal]:
        """Return the torques R [N m] of all links as signals, under a tip force and with the constants of `arm`."""
        n = self._joints

        def torques(*links: Any) -> Any:
            return link_torque(self._physics, (links[:n], links[n : 2 * n], links[2 * n : 3 * n]), links[3 * n :], arm)

        return _through(torques, *itertools.chain(*self.links), *force)

    def link_defects(self, torques: list[Signal], arm: Any) -> list[Signal]:
        """Return the defects d = K φ + B φ̇ - R [N m] of all links, for their torques R, with the constants of `arm`."""
        drives = enumerate(motors(arm, torques))
        return [own.stiffness * self.bending(j) + own.damping * self.bending_rate(j) - torques[j] for j, own in drives]

    def lever_arms(self, directions: np.ndarray, arm: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return Jᵀ d (2, 2) [m] at mid-period: one column for each unit force d, a row of `directions`.

        The second result bounds the change of Jᵀ d (2, 2) [m] in the period.
        """
        lever, spread = np.zeros((self._joints, len(directions))), np.zeros((self._joints, len(directions)))
        middles, force = [signal[0] for signal in self.links[0]], self._physics.Point
        for axis, unit in enumerate(directions.tolist()):
            loads = (
                self._physics.tip_load(self._physics.PerJoint(*q), force(*unit), arm)
                for q in (middles, self.link_ranges[0])
            )
            for joint, (near, wide) in enumerate(zip(*loads, strict=True)):
                lever[joint, axis] = middle_of(near)
                spread[joint, axis] = radius_of(wide, lever[joint, axis])
        return lever, spread + SLACK * np.abs(lever).sum()

    def slip(self, joint: int, side: int, arm: Any) -> Signal:
        """Return the dry friction F(v) [N m], a signal, of a motor that moves in the direction `side`, 1 or -1."""
        return _through(lambda speed: (dry_friction(speed, joint, arm),), side * self.velocity[joint])[0]


def dry_friction(speed: Any, joint: int, arm: Any) -> Any:
    """Return a motor's dry friction F(v) [N m] as the environment computes it, for speeds [rad/s] of any type."""
    return STRIBECK.magnitude(speed, getattr(arm, f"dry_friction{joint + 1}"))


def link_torque(physics: Physics, motion: Sequence[Sequence[Any]], force: Sequence[Any], arm: Any) -> Any:
    """Return R = M(q) q̈ + C(q, q̇) q̇ + g(q) - J(q)ᵀ F [N m] of all links.

    `motion` has angles [rad], velocities [rad/s] and accelerations [rad/s²], one for each joint. The motion and the tip
    `force` [N], one for each axis or empty, are of any number type: balls, jets or power series. The equations are
    the environment's, linear in q̈ and in the arm's constants.
    """
    angles, rates, accelerations = (physics.PerJoint(*part) for part in motion)
    torques = physics.inverse_dynamics(angles, rates, accelerations, arm)
    if not force:
        return torques
    loads = physics.tip_load(angles, physics.Point(*force), arm)
    return tuple(torque - load for torque, load in zip(torques, loads, strict=True))
