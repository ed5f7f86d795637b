"""The defects of the centre in the arm's equations of motion, as signals over one period.

Along the centre y(t), with K, B, I_a, f_v and the links' torque R of the middle of the set,

    N = u - K φ - B φ̇ - f_v θ̇,       P = N - I_a θ̈,       d = K φ + B φ̇ - R(q, q̇, q̈, F).

P is the negative friction of the centre's motor, and d the defect of its links' torque. The angles are polynomials in s
in [-1, 1], and so are N and P; d is a power series about s = 0, whose remainder is its last coefficient about the ball
s in [-1, 1] (Lagrange). All of them are a `Signal`.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, arb_series, ctx

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import STRIBECK
from fuzzyarm.proof.tip.centre import DEGREE
from fuzzyarm.proof.tip.enclosures import SLACK, between, largest, low_high, middle_of, radius_of

__all__ = ["Forces", "PeriodMotion", "Signal", "TipForces", "dry_friction", "link_torque"]

_ORDER = DEGREE + 1  # coefficients of a power series, without the one of its remainder


def _bernstein_table(degree: int) -> Any:
    """Return the matrix from coefficients in s in [-1, 1] to those in Bernstein's basis, one row each."""

    def entry(i: int, j: int) -> arb:
        # The i-th coefficient of s^j = (x - (1 - x))^j, s = 2 x - 1.
        terms = range(max(0, j - degree + i), min(i, j) + 1)
        total = sum(math.comb(j, k) * math.comb(degree - j, i - k) * (-1) ** (j - k) for k in terms)
        return arb(total) / math.comb(degree, i)

    return arb_mat([[entry(i, j) for j in range(degree + 1)] for i in range(degree + 1)])


def _shift_table() -> Any:
    """Return the matrix that takes coefficients about 0 to those about the ball [-1, 1], one row each."""
    powers = [arb(1), *[between(-1.0, 1.0)] * DEGREE]  # of s, which all lie in [-1, 1]
    return arb_mat([
        [arb(math.comb(j, i)) * powers[j - i] if j >= i else arb(0) for j in range(DEGREE + 1)]
        for i in range(DEGREE + 1)
    ])  # fmt: skip


_BERNSTEIN, _SHIFT = _bernstein_table(DEGREE + 1), _shift_table()


class Signal:
    """A course in time, Σ a_i s^i with balls a_i, over a period in which s goes from -1 to 1."""

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
        """Return the derivative by time; `rate` is ds/dt [1/s]."""
        return Signal(rate * i * a for i, a in enumerate(self.coefficients[1:], 1))

    def at(self, s: Any) -> Any:
        """Return the value at s = -1 or s = 1, or values that hold it on a ball of s."""
        return sum((a * s**i for i, a in enumerate(self.coefficients)), arb(0))

    def range(self) -> Any:
        """Return the ball a_0 + [-1, 1] Σ |a_i|, which holds the signal during the whole period."""
        return self[0] + sum((largest(a) for a in self.coefficients[1:]), 0.0) * between(-1.0, 1.0)

    def size(self) -> float:
        """Return a bound of |a(s)|."""
        return largest(self.range())

    def bent(self) -> float:
        """Return a bound of |a(s) - a_0 - a_1 s|."""
        return sum(largest(a) for a in self.coefficients[2:]) * (1.0 + 2.0**-40)

    def ends(self) -> tuple[float, float]:
        """Return the lowest and highest coefficient in Bernstein's basis, which enclose the range.

        For a monotone signal they are its values at both ends, or near them.
        """
        ends = [low_high(x) for x in (_BERNSTEIN * self._column(DEGREE + 2)).entries()]
        return min(low for low, _ in ends), max(high for _, high in ends)

    def about_all(self) -> list[Any]:
        """Return the coefficients about the ball s in [-1, 1], which give Lagrange's remainder."""
        return (_SHIFT * self._column(DEGREE + 1)).entries()  # type: ignore[no-any-return]

    def _column(self, rows: int) -> Any:
        return arb_mat([[self[i]] for i in range(rows)])


def _through(function: Callable[..., tuple[Any, ...]], *signals: Signal) -> list[Signal]:
    """Return functions of signals as power series about s = 0, each with its remainder as the last coefficient."""
    ctx.cap = _ORDER + 1
    near = function(*(arb_series(signal.coefficients) for signal in signals))
    far = function(*(arb_series(signal.about_all()) for signal in signals))
    return [Signal([*(p[i] for i in range(_ORDER)), q[_ORDER]]) for p, q in zip(near, far, strict=True)]


class Forces(NamedTuple):
    """A tip force as signals along x and y: its mean, and half its change with s."""

    x: Signal
    y: Signal


class TipForces(NamedTuple):
    """The forces that may act at the tip during a segment."""

    middle: Forces  # force in the middle of the set
    radii: tuple[float, float]  # how far the force along x and y can be from it [N]
    direction: tuple[float, float]  # a unit vector (x, y)
    courses: tuple[float, float]  # largest part of any course along the direction and across it [N]


class PeriodMotion:
    """The centre of a period, or of a part of one, in balls: its angles and their derivatives as signals [rad, s]."""

    def __init__(self, angles: np.ndarray, period: float) -> None:
        """Take the coefficients (4, DEGREE + 1) of the angles [rad] and T [s]."""
        rate, self.duration = 2 / arb(period), period
        self.angle = [Signal(map(arb, row)) for row in angles.tolist()]
        self.velocity = [signal.derivative(rate) for signal in self.angle]
        self.acceleration = [signal.derivative(rate) for signal in self.velocity]
        self.links = [kind[JOINTS:] for kind in (self.angle, self.velocity, self.acceleration)]

    @functools.cached_property
    def link_ranges(self) -> list[list[Any]]:
        """Balls that hold the angles, velocities and accelerations of both links during the whole period."""
        return [[signal.range() for signal in kind] for kind in self.links]

    def at(self, s: int) -> list[Any]:
        """Return the eight numbers of the state at s = -1 or s = 1."""
        return [signal.at(s) for signal in (*self.angle, *self.velocity)]

    def bending(self, joint: int) -> Signal:
        """Return φ of a joint [rad]."""
        return self.angle[joint] - self.angle[JOINTS + joint]

    def bending_rate(self, joint: int) -> Signal:
        """Return φ̇ of a joint [rad/s]."""
        return self.velocity[joint] - self.velocity[JOINTS + joint]

    def net_torque(self, joint: int, torque: float, arm: Arm) -> tuple[Signal, Signal]:
        """Return N and P of a motor under a held torque [N m], with the constants of `arm`."""
        stiffness, damping = (arm.stiffness1, arm.stiffness2)[joint], (arm.damping1, arm.damping2)[joint]
        viscous, inertia = (arm.viscous1, arm.viscous2)[joint], (arm.motor_inertia1, arm.motor_inertia2)[joint]
        joint_torque = stiffness * self.bending(joint), damping * self.bending_rate(joint)
        net = Signal([arb(torque)]) - joint_torque[0] - joint_torque[1] - viscous * self.velocity[joint]
        return net, net - inertia * self.acceleration[joint]

    def link_torques(self, force: Forces, arm: Arm) -> list[Signal]:
        """Return R of both links."""

        def torques(*links: Any) -> tuple[Any, Any]:
            return link_torque(links[0:2], links[2:4], links[4:6], links[6:8], arm)

        return _through(torques, *itertools.chain(*self.links), *force)

    def link_defects(self, torques: list[Signal], arm: Arm) -> list[Signal]:
        """Return d of both links."""
        stiffness, damping = (arm.stiffness1, arm.stiffness2), (arm.damping1, arm.damping2)
        return [stiffness[j] * self.bending(j) + damping[j] * self.bending_rate(j) - torques[j] for j in range(JOINTS)]

    def lever_arms(self, direction: tuple[float, float], arm: Arm) -> tuple[np.ndarray, np.ndarray]:
        """Return Jᵀ d and Jᵀ d⊥ (2, 2) [m] at the middle of the period, and their largest change within it."""
        lever, spread = np.zeros((JOINTS, 2)), np.zeros((JOINTS, 2))

        def arms(angles: list[arb], unit: tuple[float, float]) -> tuple[arb, arb]:
            q1, q12 = angles[0], angles[0] + angles[1]
            return dynamics.tip_force_torque(q1.sin(), q1.cos(), q12.sin(), q12.cos(), *unit, arm)

        for axis, unit in enumerate((direction, (-direction[1], direction[0]))):
            middle, whole = arms([signal[0] for signal in self.links[0]], unit), arms(self.link_ranges[0], unit)
            for joint, (near, wide) in enumerate(zip(middle, whole, strict=True)):
                lever[joint, axis] = middle_of(near)
                spread[joint, axis] = radius_of(wide, lever[joint, axis])
        return lever, spread + SLACK * np.abs(lever).sum()

    def slip(self, joint: int, side: int, arm: Arm) -> Signal:
        """Return F(v) [N m] of a motor that moves in one direction."""
        return _through(lambda speed: (dry_friction(speed, joint, arm),), side * self.velocity[joint])[0]


def dry_friction(speed: Any, joint: int, arm: Arm) -> Any:
    """Return F(v) [N m] of a motor as the environment computes it, for speeds [rad/s] of any number type."""
    return STRIBECK.magnitude(speed, dynamics.dry_frictions(arm)[joint])


def link_torque(angle: Any, velocity: Any, acceleration: Any, force: Any, arm: Arm) -> tuple[Any, Any]:
    """Return R = M(q) q̈ + C(q, q̇) q̇ + g(q) - J(q)ᵀ F [N m] of both links.

    Angles [rad], velocities [rad/s], accelerations [rad/s²] and the tip force (x, y) [N] are pairs of numbers of any
    type: balls, jets or power series. The equations are those of the environment, linear in q̈ and in the constants of
    the arm.
    """
    (q1, q2), (dq1, dq2), (ddq1, ddq2) = angle, velocity, acceleration
    (sin1, cos1), (sin2, cos2), (sin12, cos12) = sine_cosine(q1), sine_cosine(q2), sine_cosine(q1 + q2)
    m11, m12, m22 = dynamics.mass_matrix(cos2, arm)
    coriolis1, coriolis2 = dynamics.coriolis_torque(sin2, dq1, dq2, arm)
    gravity1, gravity2 = dynamics.gravity_torque(sin1, sin12, arm)
    force1, force2 = dynamics.tip_force_torque(sin1, cos1, sin12, cos12, force[0], force[1], arm)
    return (
        m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1 - force1,
        m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2 - force2,
    )
