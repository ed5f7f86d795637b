"""The centre of the tube: polynomial motions in floats, which need not be exact.

On a segment the angles are polynomials of degree 7 in s in [-1, 1], found by collocation: the accelerations are those
of the arm at the Gauss points of s, and the angles their integrals. The defects of the polynomials in the equations
are bounded afterwards (`defects`), and the centre's friction is the one that its motor's motion requires. A motor slips
or rests; the period is divided where that changes.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import polynomial

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.envs.physics.friction import STRIBECK

__all__ = ["DEGREE", "Centre", "Mode", "Segment"]

DEGREE = 7  # of the polynomials of the angles
_NODES = DEGREE - 1
_ITERATIONS = 14  # of the collocation; each gains a digit or two
_SAMPLES = 33  # of a segment, at which changes of mode are looked for
_MOST_SEGMENTS = 8  # in a period
_SHORTEST = 1e-6  # share of the rest of a period, below which a change of mode is passed over

_MOTOR_VELOCITY = 2 * JOINTS  # where the velocities of the motors begin in a state (θ, q, θ̇, q̇)


class Mode(enum.IntEnum):
    """The friction of one of the centre's motors in one segment."""

    BACKWARD = -1  # F(v), for a negative velocity
    FREE = 0  # a constant torque
    FORWARD = 1  # -F(v), for a positive velocity
    REST = 2  # what holds the motor at rest


class Segment(NamedTuple):
    """The centre in a period, or in a part of one."""

    angles: np.ndarray  # coefficients of θ_1, θ_2, q_1, q_2 [rad] in s in [-1, 1], (4, DEGREE + 1), the constant first
    modes: tuple[Mode, ...]  # of both motors
    duration: float  # [s]
    end: np.ndarray  # state (8,) at the end, in the order θ, q, θ̇, q̇


class Centre:
    """The solver that computes the centre, period by period."""

    def __init__(self, arm: Arm, period: float) -> None:
        """Prepare the collocation for the constants of an arm and T [s]."""
        self._arm, self._period = arm, period
        self._dry, self._grain = dynamics.dry_frictions(arm), math.ulp(period)
        self._static = tuple(dry.static_friction for dry in self._dry)
        self._stiffness, self._damping = (arm.stiffness1, arm.stiffness2), (arm.damping1, arm.damping2)
        self._viscous, self._inertia = (arm.viscous1, arm.viscous2), (arm.motor_inertia1, arm.motor_inertia2)
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

        The state (8,) is that at the start, the torque (2,) [N m] is held, the force (4,) [N] is x, y at the middle of
        the period and their change over it. `drags` are the constant friction torques of the motors [N m]; None for the
        law's.
        """
        begun = 0.0
        for count in range(_MOST_SEGMENTS):
            modes = self._modes(state, torque, drags)
            torques = torque + [drag or 0.0 for drag in drags]
            left = self._period - begun
            found = self._solved(state, torques, _part(force, begun, left, self._period), modes, left)
            at, who = self._first_change(found, torque) if count < _MOST_SEGMENTS - 1 else (1.0, 0)
            if at <= _SHORTEST and state[_MOTOR_VELOCITY + who]:
                # A velocity that is zero but for rounding, and on the wrong side, is set to zero.
                state = state.copy()
                state[_MOTOR_VELOCITY + who] = 0.0
                continue
            if _SHORTEST < at < 1.0 - _SHORTEST:
                part = round(at * left / self._grain) * self._grain  # so that all durations add up exactly
                found = self._solved(state, torques, _part(force, begun, part, self._period), modes, part)
                for j in range(JOINTS):  # who has come to rest rests exactly
                    before, after = state[_MOTOR_VELOCITY + j], found.end[_MOTOR_VELOCITY + j]
                    if modes[j] in (Mode.FORWARD, Mode.BACKWARD) and abs(after) < 1e-9 and abs(after) < abs(before):
                        found.end[_MOTOR_VELOCITY + j] = 0.0
                begun += part
            else:
                begun = self._period
            yield found
            state = found.end
            if begun == self._period:
                return

    def _modes(self, state: np.ndarray, torque: np.ndarray, drags: Sequence[float | None]) -> tuple[Mode, ...]:
        modes = []
        for j in range(JOINTS):
            motor, link, velocity, link_velocity = state[j::JOINTS]
            net = self._net(motor, link, velocity, link_velocity, torque[j], j)
            moving = velocity or (net if abs(net) > self._static[j] else 0.0)
            own = Mode(int(np.sign(moving))) if moving else Mode.REST
            modes.append(own if drags[j] is None else Mode.FREE)
        return tuple(modes)

    def _net(self, theta: Any, q: Any, dtheta: Any, dq: Any, torque: Any, j: int) -> Any:
        """Return N [N m] of a motor."""
        bent = torque - self._stiffness[j] * (theta - q) - self._damping[j] * (dtheta - dq)
        return bent - self._viscous[j] * dtheta

    def _first_change(self, found: Segment, torque: np.ndarray) -> tuple[float, int]:
        """Return the share of a segment at which a motor first changes its mode, 1 if none does, and that motor."""
        s = np.linspace(-1.0, 1.0, _SAMPLES)
        first = 1.0, 0
        values = polynomial.polyval(s, found.angles.T)
        rates = polynomial.polyval(s, polynomial.polyder(found.angles, axis=1).T) * (2.0 / found.duration)
        for j, mode in enumerate(found.modes):
            if mode == Mode.FREE:
                continue
            if mode == Mode.REST:
                net = self._net(values[j], values[2 + j], 0.0, rates[2 + j], torque[j], j)
                margin = self._static[j] - np.abs(net)
            else:
                margin = int(mode) * rates[j]
            changed = np.flatnonzero(margin[1:] < 0.0)
            if not changed.size or (margin[0] <= 0.0 and changed[0] == 0):
                continue
            k = changed[0]
            # The margin is smooth: a cubic through four samples finds its zero far more closely than they lie.
            near = slice(max(k - 1, 0), max(k - 1, 0) + 4)
            fit = np.polynomial.Polynomial.fit(s[near], margin[near], min(3, len(s[near]) - 1))
            roots = [r.real for r in fit.roots() if abs(r.imag) < 1e-9 and s[k] - 1e-9 <= r.real <= s[k + 1] + 1e-9]
            at = 0.5 * (1.0 + float(roots[0] if roots else s[k + 1]))
            first = min(first, (at, j))
        return first

    def _solved(
        self, state: np.ndarray, torque: np.ndarray, force: np.ndarray, modes: tuple[Mode, ...], duration: float
    ) -> Segment:
        """Return the segment of given modes and duration [s], under a force line over it as in `segments`."""
        half = 0.5 * duration
        angle, velocity = state[:_MOTOR_VELOCITY, np.newaxis], state[_MOTOR_VELOCITY:, np.newaxis]
        start = angle + velocity * (half * (self._nodes + 1.0))
        acceleration = np.zeros((4, _NODES))
        push = [force[i] + force[2 + i] * 0.5 * self._nodes for i in range(2)]
        for _ in range(_ITERATIONS):
            v = velocity + half * acceleration @ self._velocity_at.T
            x = start + half**2 * acceleration @ self._angle_at.T
            before, acceleration = acceleration, self._accelerations(x, v, torque, push, modes)
            if np.abs(acceleration - before).max() < 1e-11:
                break
        speeds = half * acceleration @ self._velocity.T
        speeds[:, 0] += state[_MOTOR_VELOCITY:]
        angles = half**2 * acceleration @ self._angle.T
        angles[:, 0] += state[:_MOTOR_VELOCITY] + half * state[_MOTOR_VELOCITY:]
        angles[:, 1] += half * state[_MOTOR_VELOCITY:]
        for joint in range(JOINTS):
            if modes[joint] == Mode.REST:
                angles[joint], speeds[joint] = 0.0, 0.0
                angles[joint, 0] = state[joint]
        end = np.concatenate([angles.sum(axis=1), speeds.sum(axis=1)])
        return Segment(angles, modes, duration, end)

    def _accelerations(
        self, x: np.ndarray, v: np.ndarray, torque: np.ndarray, force: list[np.ndarray], modes: tuple[Mode, ...]
    ) -> np.ndarray:
        arm, (q1, q2) = self._arm, x[2:]
        sin1, cos1, sin12, cos12 = np.sin(q1), np.cos(q1), np.sin(q1 + q2), np.cos(q1 + q2)
        joint = [self._stiffness[j] * (x[j] - x[2 + j]) + self._damping[j] * (v[j] - v[2 + j]) for j in range(JOINTS)]
        outer = dynamics.tip_force_torque(sin1, cos1, sin12, cos12, force[0], force[1], arm)
        coriolis, gravity = (
            dynamics.coriolis_torque(np.sin(q2), v[2], v[3], arm),
            dynamics.gravity_torque(sin1, sin12, arm),
        )
        first, second = (joint[j] + outer[j] - coriolis[j] - gravity[j] for j in (0, 1))
        links = dynamics.solve_mass_matrix(np.cos(q2), first, second, arm)
        motors = []
        for j, mode in enumerate(modes):
            if mode == Mode.REST:
                motors.append(np.zeros_like(q1))
                continue
            slip = STRIBECK.magnitude(v[j], self._dry[j])
            net = self._net(x[j], x[2 + j], v[j], v[2 + j], torque[j], j)
            motors.append((net - int(mode) * slip) / self._inertia[j])
        return np.stack([*motors, *links])


def _part(force: np.ndarray, begun: float, duration: float, period: float) -> np.ndarray:
    """Return the force line (4,) of a part of a period that begins at `begun` [s]."""
    at = (begun + 0.5 * duration) / period - 0.5
    return np.concatenate([force[:2] + at * force[2:], force[2:] * (duration / period)])
