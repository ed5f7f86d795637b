"""The centre of the tube: polynomial motions in floats, which need not be exact.

On a segment the angles are polynomials of degree 7 in s in [-1, 1], found by collocation: the accelerations are those
of the arm at the Gauss points of s, and the angles are their integrals. The defects of the polynomials in the equations
are bounded afterwards (`_defects`), and the centre's friction is the torque that its motor's motion requires. A motor
slips or rests; the period is divided at the changes between the two.
"""

import enum
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import polynomial

from fuzzyarm.envs.physics.dynamics import motors
from fuzzyarm.envs.physics.friction import STRIBECK
from fuzzyarm.envs.physics.records import Physics

__all__ = ["DEGREE", "Centre", "Mode", "Segment"]

DEGREE = 7  # of the polynomials of the angles
_NODES = DEGREE - 1
_ITERATIONS = 14  # of the collocation; each gains a digit or two
_SAMPLES = 33  # of a segment, at which a change of mode is sought
_MOST_SEGMENTS = 8  # in a period
_SHORTEST = 1e-6  # share of the rest of a period, within which a change of mode is ignored


class Mode(enum.IntEnum):
    """The friction of one of the centre's motors in one segment."""

    BACKWARD = -1  # F(v), for a negative velocity
    FREE = 0  # a constant torque
    FORWARD = 1  # -F(v), for a positive velocity
    REST = 2  # the torque that holds the motor at rest


class _Nodes(np.ndarray):
    """Values at the nodes, with NumPy's sine and cosine; their last digits may differ from the environment's."""

    def sin(self) -> np.ndarray:
        """Return the sine of each value."""
        return np.sin(self.view(np.ndarray))

    def cos(self) -> np.ndarray:
        """Return the cosine of each value."""
        return np.cos(self.view(np.ndarray))


class Segment(NamedTuple):
    """The centre in a period, or in a part of one."""

    angles: np.ndarray  # coefficients of θ_1, θ_2, q_1, q_2 [rad] in s in [-1, 1], (4, DEGREE + 1), the constant first
    modes: tuple[Mode, ...]  # of the motors
    duration: float  # [s]
    end: np.ndarray  # state (8,) at the end, in the order θ, q, θ̇, q̇


class Centre:
    """The solver that computes the centre, period by period."""

    def __init__(self, arm: Any, period: float, physics: Physics) -> None:
        """Prepare the collocation for an arm's constants, the control period [s], and the arm's equations."""
        self._arm, self._period, self._physics, self._grain = arm, period, physics, math.ulp(period)
        self._joints = physics.joints
        self._drives = motors(arm, range(self._joints))
        self._speeds = 2 * self._joints  # index of the first motor's velocity in a state (θ, q, θ̇, q̇)
        nodes, _ = np.polynomial.legendre.leggauss(_NODES)
        vandermonde = np.linalg.inv(np.vander(nodes, _NODES, increasing=True))
        once, twice = np.zeros((_NODES + 1, _NODES)), np.zeros((DEGREE + 1, _NODES))
        for i in range(_NODES):
            once[i + 1, i], once[0, i] = 1.0 / (i + 1), (-1.0) ** i / (i + 1)  # ∫ from s = -1
        for i in range(_NODES + 1):
            twice[i + 1] += once[i] / (i + 1)
            twice[0] -= once[i] * (-1.0) ** (i + 1) / (i + 1)
        self._nodes = nodes
        self._velocity, self._angle = once @ vandermonde, twice @ vandermonde  # accelerations to coefficients
        self._velocity_at = np.vander(nodes, _NODES + 1, increasing=True) @ self._velocity
        self._angle_at = np.vander(nodes, DEGREE + 1, increasing=True) @ self._angle

    def segments(
        self, state: np.ndarray, torque: np.ndarray, force: np.ndarray, drags: Sequence[float | None]
    ) -> Iterator[Segment]:
        """Yield the centre of a period, in segments on which no motor changes its mode.

        `state` (8,) is the initial θ, q, θ̇, q̇, and `torque` (2,) [N m] is held. `force` (4,) [N] has the tip force
        along x and y at the middle of the period, then its change along x and y over the period. `drags` are constant
        friction torques of the motors [N m]; None: friction by the law.
        """
        begun = 0.0
        for count in range(_MOST_SEGMENTS):
            modes = self._modes(state, torque, drags)
            torques = torque + [drag or 0.0 for drag in drags]
            left = self._period - begun
            found = self._solved(state, torques, _part(force, begun, left, self._period), modes, left)
            at, who = self._first_change(found, torque) if count < _MOST_SEGMENTS - 1 else (1.0, 0)
            if at <= _SHORTEST and state[self._speeds + who]:
                # A velocity that is zero up to rounding, but has the wrong sign, is set to zero.
                state = state.copy()
                state[self._speeds + who] = 0.0
                continue
            if _SHORTEST < at < 1.0 - _SHORTEST:
                part = round(at * left / self._grain) * self._grain  # so that all durations add up exactly
                found = self._solved(state, torques, _part(force, begun, part, self._period), modes, part)
                for j in range(self._joints):  # a motor that has come to rest rests exactly
                    before, after = state[self._speeds + j], found.end[self._speeds + j]
                    if modes[j] in (Mode.FORWARD, Mode.BACKWARD) and abs(after) < 1e-9 and abs(after) < abs(before):
                        found.end[self._speeds + j] = 0.0
                begun += part
            else:
                begun = self._period
            yield found
            state = found.end
            if begun == self._period:
                return

    def _modes(self, state: np.ndarray, torque: np.ndarray, drags: Sequence[float | None]) -> tuple[Mode, ...]:
        modes = []
        for j, drive in enumerate(self._drives):
            motor, link, velocity, link_velocity = state[j :: self._joints]
            net = self._net(motor, link, velocity, link_velocity, torque[j], j)
            moving = velocity or (net if abs(net) > drive.dry_friction.static_friction else 0.0)
            own = Mode(int(np.sign(moving))) if moving else Mode.REST
            modes.append(own if drags[j] is None else Mode.FREE)
        return tuple(modes)

    def _net(self, theta: Any, q: Any, dtheta: Any, dq: Any, torque: Any, j: int) -> Any:
        """Return the net torque N [N m] of motor j: the held torque less elastic, damping and viscous torques."""
        own = self._drives[j]
        return torque - own.stiffness * (theta - q) - own.damping * (dtheta - dq) - own.viscous * dtheta

    def _first_change(self, found: Segment, torque: np.ndarray) -> tuple[float, int]:
        """Return the fraction of a segment before a motor first changes its mode, and the motor; (1, 0) if none does.

        `torque` (2,) [N m] is held.
        """
        s = np.linspace(-1.0, 1.0, _SAMPLES)
        first = 1.0, 0
        values = polynomial.polyval(s, found.angles.T)
        rates = polynomial.polyval(s, polynomial.polyder(found.angles, axis=1).T) * (2.0 / found.duration)
        for j, mode in enumerate(found.modes):
            if mode == Mode.FREE:
                continue
            if mode == Mode.REST:
                link = self._joints + j
                net = self._net(values[j], values[link], 0.0, rates[link], torque[j], j)
                margin = self._drives[j].dry_friction.static_friction - np.abs(net)
            else:
                margin = int(mode) * rates[j]
            changed = np.flatnonzero(margin[1:] < 0.0)
            if not changed.size or (margin[0] <= 0.0 and changed[0] == 0):
                continue
            k = changed[0]
            # The margin is smooth: a cubic through four samples locates its zero far more finely than their spacing.
            near = slice(max(k - 1, 0), max(k - 1, 0) + 4)
            fit = np.polynomial.Polynomial.fit(s[near], margin[near], min(3, len(s[near]) - 1))
            roots = [r.real for r in fit.roots() if abs(r.imag) < 1e-9 and s[k] - 1e-9 <= r.real <= s[k + 1] + 1e-9]
            at = 0.5 * (1.0 + float(roots[0] if roots else s[k + 1]))
            first = min(first, (at, j))
        return first

    def _solved(
        self, state: np.ndarray, torque: np.ndarray, force: np.ndarray, modes: tuple[Mode, ...], duration: float
    ) -> Segment:
        """Return the segment with given modes and duration [s]; its linear `force` (4,) is as in `segments`."""
        half = 0.5 * duration
        angle, velocity = state[: self._speeds, np.newaxis], state[self._speeds :, np.newaxis]
        start = angle + velocity * (half * (self._nodes + 1.0))
        acceleration = np.zeros((self._speeds, _NODES))
        axes = self._physics.axes
        push = [force[i] + force[axes + i] * 0.5 * self._nodes for i in range(axes)]
        for _ in range(_ITERATIONS):
            v = velocity + half * acceleration @ self._velocity_at.T
            x = start + half**2 * acceleration @ self._angle_at.T
            before, acceleration = acceleration, self._accelerations(x, v, torque, push, modes)
            if np.abs(acceleration - before).max() < 1e-11:
                break
        speeds = half * acceleration @ self._velocity.T
        speeds[:, 0] += state[self._speeds :]
        angles = half**2 * acceleration @ self._angle.T
        angles[:, 0] += state[: self._speeds] + half * state[self._speeds :]
        angles[:, 1] += half * state[self._speeds :]
        for joint in range(self._joints):
            if modes[joint] == Mode.REST:
                angles[joint], speeds[joint] = 0.0, 0.0
                angles[joint, 0] = state[joint]
        end = np.concatenate([angles.sum(axis=1), speeds.sum(axis=1)])
        return Segment(angles, modes, duration, end)

    def _accelerations(
        self, x: np.ndarray, v: np.ndarray, torque: np.ndarray, force: list[np.ndarray], modes: tuple[Mode, ...]
    ) -> np.ndarray:
        of, (motor, link), (motor_rate, link_rate) = self._physics, np.split(x, 2), np.split(v, 2)
        angles, rates, still = (
            of.PerJoint(*link.view(_Nodes)),
            of.PerJoint(*link_rate),
            of.PerJoint(*np.zeros_like(link)),
        )
        outer = of.tip_load(angles, of.Point(*force), self._arm) if np.any(force) else still
        inner = of.inverse_dynamics(angles, rates, still, self._arm)
        joint, own_accelerations = [], []
        for j, (own, mode) in enumerate(zip(self._drives, modes, strict=True)):
            joint.append(own.stiffness * (motor[j] - link[j]) + own.damping * (motor_rate[j] - link_rate[j]))
            if mode == Mode.REST:
                own_accelerations.append(np.zeros_like(link[j]))
                continue
            slip = STRIBECK.magnitude(motor_rate[j], own.dry_friction)
            net = self._net(motor[j], link[j], motor_rate[j], link_rate[j], torque[j], j)
            own_accelerations.append((net - int(mode) * slip) / own.motor_inertia)
        mass = np.moveaxis(np.array(of.mass_matrix(angles, self._arm)), -1, 0)
        driven = np.array(joint) + np.array(outer) - np.array(inner)
        return np.concatenate([own_accelerations, np.linalg.solve(mass, driven.T[..., np.newaxis])[..., 0].T])


def _part(force: np.ndarray, begun: float, duration: float, period: float) -> np.ndarray:
    """Return the tip force (4,) in a part of a period, from that in the whole period, both as in `segments`.

    The part lasts `duration` [s] and begins at `begun` [s] of the `period` [s].
    """
    at = (begun + 0.5 * duration) / period - 0.5
    mean, change = np.split(force, 2)
    return np.concatenate([mean + at * change, change * (duration / period)])
