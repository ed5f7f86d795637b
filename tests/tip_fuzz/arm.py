"""The elastic arm under a held torque, by equations (1) to (3) of the paper: RK4 with located stick and slip events.

    I_a θ̈ = u - Γ_t - f_v θ̇ + Γ_f,                Γ_t = K (θ - q) + B (θ̇ - q̇),
    M(q) q̈ = Γ_t - C(q, q̇) q̇ - g(q) + J(q)ᵀ F,

with the signs of the descriptor form (5), which are those that conserve energy. A motor that slips has the friction
-F(|v|) sgn v; one that sticks rests as long as |N| <= F(0), N = u - Γ_t. Within a mode the equations are smooth. Where
a velocity passes zero or a net torque exceeds F(0), the step is cut there, to the last digits, and the modes change.

Nothing of the package is used: plain Python floats, one plant after the other.
"""

import functools
import math
from typing import NamedTuple

from scipy.optimize import brentq

MOST_EVENTS = 400  # in a hold

Vector = tuple[float, ...]
Pair = tuple[float, float]


class Body(NamedTuple):
    """A rigid body on a link: mass [kg], distance of its centre from the link's joint [m], inertia about it [kg m²]."""

    mass: float
    radius: float
    inertia: float = 0.0


class ElasticArm(NamedTuple):
    """A plant; per joint where there are two numbers."""

    length: Pair  # L_1, L_2 [m]
    first: Body  # link 1, about joint 1
    second: tuple[Body, ...]  # link 2 and all that it carries, about joint 2
    gravity: float  # g [m/s²]
    motor_inertia: Pair  # I_a [kg m²]
    viscous: Pair  # f_v [N m s/rad]
    stiffness: Pair  # K [N m/rad]
    damping: Pair  # B [N m s/rad]
    static: Pair  # F(0) [N m]
    coulomb: Pair  # F(∞) [N m]
    stribeck: float  # v_s [rad/s]
    any_friction: bool = False  # whether friction is a torque that is given, rather than that of the law

    def tip(self, q1, q2):
        """Return the tip [m]; x points down, along gravity."""
        (l1, l2), q12 = self.length, q1 + q2
        return l1 * math.cos(q1) + l2 * math.cos(q12), l1 * math.sin(q1) + l2 * math.sin(q12)

    def slip_friction(self, j, velocity):
        """Return F(|v|) [N m]."""
        return self.coulomb[j] + (self.static[j] - self.coulomb[j]) * math.exp(-((velocity / self.stribeck) ** 2))

    def energy(self, x):
        """Return kinetic energy, energy of the bent joints and potential energy [J]."""
        th1, th2, q1, q2, v1, v2, w1, w2 = x
        (l1, _), g = self.length, self.gravity
        total = 0.5 * (self.motor_inertia[0] * v1**2 + self.motor_inertia[1] * v2**2)
        total += 0.5 * (self.stiffness[0] * (th1 - q1) ** 2 + self.stiffness[1] * (th2 - q2) ** 2)
        m, r, inertia = self.first
        total += 0.5 * (m * r**2 + inertia) * w1**2 - m * g * r * math.cos(q1)
        for m, r, inertia in self.second:
            w12 = w1 + w2
            square = (l1 * w1) ** 2 + (r * w12) ** 2 + 2.0 * l1 * r * w1 * w12 * math.cos(q2)
            total += 0.5 * (m * square + inertia * w12**2) - m * g * (l1 * math.cos(q1) + r * math.cos(q1 + q2))
        return total


class Node(NamedTuple):
    """A moment of a motion: time since the hold began [s], state θ, q, θ̇, q̇ (8,), and its rates (8,)."""

    time: float
    state: Vector
    rates: Vector


def hold(arm, state, torque, force, stops, refined=1, given=(0.0, 0.0)):
    """Yield the motion under a held torque [N m], from the start, at each of `stops` (rising times [s] since then).

    The force is x, y at the beginning [N] and their rates [N/s]. There are `refined` steps of RK4 between two stops,
    without those that end at an event. `given` are the friction torques [N m] of an arm with any friction.
    """
    field = _field(arm, torque, force, given)
    modes = tuple(_mode(arm, field, 0.0, state, j) for j in range(2))
    yield Node(0.0, state, field(0.0, state, modes))
    now, events = 0.0, 0
    for last, stop in zip([0.0, *stops], stops, strict=False):
        for i in range(1, refined + 1):
            target = stop if i == refined else last + (stop - last) * i / refined
            while now < target:
                after = _rk4(field, now, state, modes, target - now)
                part, who = _first_event(arm, field, now, state, modes, target - now, after)
                if who is None:
                    now, state = target, after
                    break
                now, state = now + part, _rk4(field, now, state, modes, part)
                if modes[who]:
                    state = (*state[: 4 + who], 0.0, *state[5 + who :])
                    mode = _mode(arm, field, now, state, who)
                else:  # a motor that breaks away has |N| = F(0) but for the last digits
                    mode = 1 if _net(arm, field, now, state, who) > 0.0 else -1
                modes = (mode, modes[1]) if who == 0 else (modes[0], mode)
                events += 1
                if events > MOST_EVENTS:
                    raise RuntimeError(f"more than {MOST_EVENTS} events in {stop} s; the motors chatter")
        yield Node(stop, state, field(stop, state, modes))


def _field(arm, torque, force, given):
    """Return the right-hand side (t, state, modes) -> rates; modes: 1 and -1 slip, 0 sticks."""
    (l1, l2), g = arm.length, arm.gravity
    (ia1, ia2), (f1, f2), (k1, k2), (b1, b2) = arm.motor_inertia, arm.viscous, arm.stiffness, arm.damping
    (s1, s2), (c1, c2), vs = arm.static, arm.coulomb, arm.stribeck
    m, r, inertia = arm.first
    fixed = m * r * r + inertia + sum(b.mass for b in arm.second) * l1 * l1
    coupling = sum(b.mass * l1 * b.radius for b in arm.second)
    turning = sum(b.mass * b.radius**2 + b.inertia for b in arm.second)
    weight1 = (m * r + sum(b.mass for b in arm.second) * l1) * g
    weight2 = sum(b.mass * b.radius for b in arm.second) * g
    (u1, u2), (fx, fy, dfx, dfy), loose = torque, force, arm.any_friction
    if loose:
        u1, u2 = u1 + given[0], u2 + given[1]

    def rates(t, x, modes):
        th1, th2, q1, q2, v1, v2, w1, w2 = x
        joint1 = k1 * (th1 - q1) + b1 * (v1 - w1)
        joint2 = k2 * (th2 - q2) + b2 * (v2 - w2)
        m1, m2 = modes
        a1, a2 = (u1 - joint1 - f1 * v1) / ia1, (u2 - joint2 - f2 * v2) / ia2
        if not loose:
            a1 = m1 and a1 - m1 * (c1 + (s1 - c1) * math.exp(-((v1 / vs) ** 2))) / ia1
            a2 = m2 and a2 - m2 * (c2 + (s2 - c2) * math.exp(-((v2 / vs) ** 2))) / ia2
        q12 = q1 + q2
        sin2, cos2, sin12, cos12 = math.sin(q2), math.cos(q2), math.sin(q12), math.cos(q12)
        sin1, cos1 = math.sin(q1), math.cos(q1)
        x_force, y_force = fx + t * dfx, fy + t * dfy
        tip2 = l2 * (cos12 * y_force - sin12 * x_force)
        tip1 = l1 * (cos1 * y_force - sin1 * x_force) + tip2
        turn = coupling * sin2
        tau1 = joint1 + tip1 + turn * w2 * (2.0 * w1 + w2) - weight1 * sin1 - weight2 * sin12
        tau2 = joint2 + tip2 - turn * w1 * w1 - weight2 * sin12
        m12 = turning + coupling * cos2
        m11 = fixed + turning + 2.0 * coupling * cos2
        det = m11 * turning - m12 * m12
        return v1, v2, w1, w2, a1, a2, (turning * tau1 - m12 * tau2) / det, (m11 * tau2 - m12 * tau1) / det

    return rates


def _rk4(field, t, x, modes, h):
    half = 0.5 * h
    a = field(t, x, modes)
    b = field(t + half, tuple([p + half * d for p, d in zip(x, a, strict=True)]), modes)
    c = field(t + half, tuple([p + half * d for p, d in zip(x, b, strict=True)]), modes)
    d = field(t + h, tuple([p + h * d for p, d in zip(x, c, strict=True)]), modes)
    sixth = h / 6.0
    return tuple([p + sixth * (i + 2.0 * (j + k) + m) for p, i, j, k, m in zip(x, a, b, c, d, strict=True)])


def _net(arm, field, t, x, j):
    """Return N [N m] of a motor at rest: its acceleration with the friction of one side, without that friction."""
    modes = (1, 0) if j == 0 else (0, 1)
    return field(t, x, modes)[4 + j] * arm.motor_inertia[j] + arm.slip_friction(j, x[4 + j])


def _mode(arm, field, t, x, j):
    """Return the mode of a motor, that begins at a state or goes on from it."""
    if arm.any_friction:
        return 0
    if x[4 + j]:
        return 1 if x[4 + j] > 0.0 else -1
    net = _net(arm, field, t, x, j)
    return 0 if abs(net) <= arm.static[j] else (1 if net > 0.0 else -1)


def _first_event(arm, field, t, x, modes, h, after):
    """Return when within a step a mode ends first [s], and whose; None if all last."""

    def margin(part, j):
        """Return how far a motor is from an event: a positive number as long as its mode lasts."""
        at = after if part == h else _rk4(field, t, x, modes, part)
        return modes[j] * at[4 + j] if modes[j] else arm.static[j] - abs(_net(arm, field, t + part, at, j))

    ending = [j for j in range(2) if not arm.any_friction and margin(h, j) < 0.0]
    return min(((_root(functools.partial(margin, j=j), h), j) for j in ending), default=(h, None))


def _root(margin, h):
    """Return the first part of a step at which a margin, negative at its end, is zero.

    A step may begin at an event: with its velocity or its margin zero but for rounding.
    """
    shares = (0.0, 1e-9, 1e-6, 1e-3, 1e-1)
    begins = next((share * h for share in shares if margin(share * h) > 0.0), None)
    return 1e-9 * h if begins is None else brentq(margin, begins, h, xtol=1e-15 * h, rtol=1e-15)
