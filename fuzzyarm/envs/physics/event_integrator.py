"""Reference solution of the elastic arm: a hybrid automaton, integrated event by event.

Equations (1) to (3), with the signs of (5), motor inertias M_a, viscous friction N_a, dry friction Γ_f, tip force F:

    M_a q̈_a + N_a q̇_a = Γ - Γ_t + Γ_f,    Γ_t = K_t (q_a - q_b) + B_t (q̇_a - q̇_b),
    M_b(q_b) q̈_b + N_b(q_b, q̇_b) q̇_b + g(q_b) = Γ_t + J(q_b)ᵀ F(t).

Each motor is in one of three modes. It slips forwards or backwards, where Γ_f = -S(|q̇_a|) sign q̇_a, S the Stribeck
curve, until its velocity falls to zero; or it sticks until |Γ - Γ_t| exceeds the static friction Γ_fs. Between two
such events the equations are smooth, so DOP853 solves them to the requested tolerance.

This module shares only `ArmParameters` and `Payload` with `dynamics`, `friction` and `integrator`: its right-hand
side is written independently, and its steps never cross a sign change of a velocity. It measures the errors of
`integrator.hold_of`, including that of the force approximated over a control step, and is too slow for other uses.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.friction import dry_friction_of, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters

__all__ = ["integrate"]

_TipForce = Callable[[float], Sequence[float]]  # force on the tip (F_x, F_y) [N] at a time [s]

_MOTOR, _LINK, _MOTOR_VELOCITY, _LINK_VELOCITY = range(0, 8, 2)
"""The index at which each pair of entries begins in a state: angles of motors and links, then their velocities."""

_MAX_EVENTS = 1000
"""Events allowed in one call; a motor that sticks and slips at the joints' 331 rad/s has about four in 19 ms."""

_MAX_STEP = 2.5e-4
"""Longest step [s], 0.08 rad of Table 1's fastest vibration: two events that cancel within one step are not seen.

With Table 1, it limits the step before the default tolerances do; halving it changes the result by less than 1e-14.
"""

_BREAK_AWAY_MARGIN = 1e-12
"""Relative excess over Γ_fs at which stick ends, so that a motor under a net torque of exactly Γ_fs always sticks."""


def integrate(
    state: np.ndarray,
    torque: np.ndarray,
    force: _TipForce,
    parameters: ArmParameters,
    payload: Payload,
    start: float,
    stop: float,
    *,
    rtol: float = 1e-11,
    atol: float = 1e-13,
) -> np.ndarray:
    """Return the state (8,) at `stop` under held motor torques (2,) [N m] and a tip force F(t) [N], continuous in time.

    `state` has the entries of `records.State` [rad, rad/s] at the time `start` [s]; a velocity of exactly 0 may mean
    stick. `rtol` and `atol` are the tolerances of DOP853.

    Raises:
        RuntimeError: the solver failed or found more than `_MAX_EVENTS` events; the message names time and state.
    """
    y = np.array(state, dtype=float)
    plant = _ModePlant(parameters, payload, torque, force)
    time, events, modes = start, 0, [plant.mode(joint, y) for joint in range(2)]
    while time < stop:
        if events > _MAX_EVENTS:
            raise RuntimeError(
                f"the motors stopped or broke loose more than {_MAX_EVENTS} times before t = {time!r} s, in state "
                f"{y.tolist()}. Choose an earlier `stop` or a smoother `force`"
            )
        solution = solve_ivp(
            functools.partial(plant.derivative, tuple(modes)),
            (time, stop),
            y,
            method="DOP853",
            rtol=rtol,
            atol=atol,
            first_step=min(_MAX_STEP, stop - time),
            max_step=_MAX_STEP,
            events=[plant.end_of_mode(joint, modes[joint], time) for joint in range(2)],
        )
        time, y = float(solution.t[-1]), solution.y[:, -1]
        if not solution.success:
            raise RuntimeError(f"the integration failed at t = {time!r} s, in state {y.tolist()}: {solution.message}")
        for joint, times in enumerate(solution.t_events or ()):
            if times.size:
                events += 1
                modes[joint] = plant.next_mode(joint, modes[joint], y)
    return y


class _ModePlant:
    """The right-hand side of the arm's equations, with a mode for each motor, while the torques are held.

    A mode is the sign of the motor's velocity, 0 for stick.
    """

    def __init__(self, parameters: ArmParameters, payload: Payload, torque: np.ndarray, force: _TipForce) -> None:
        (m1, m2), (r1, r2), (i1, i2) = parameters.mass, parameters.mass_center, parameters.inertia
        l1, l2 = parameters.length
        carried = (payload.mass, payload.radius(parameters))
        beyond = ((m2, r2), carried)  # point masses on link 2: mass [kg], distance from joint 2 [m]
        m, mr, mrr = (sum(mass * r**power for mass, r in beyond) for power in range(3))
        self.length = l1, l2
        self.c3 = i2 + mrr
        self.c2 = l1 * mr
        self.c1 = m1 * r1**2 + i1 + l1**2 * m + self.c3
        self.c4, self.c5 = parameters.gravity * (m1 * r1 + l1 * m), parameters.gravity * mr
        self.torque = float(torque[0]), float(torque[1])
        self.force, self.parameters = force, parameters

    def joint_torque(self, joint: int, y: Sequence[float] | np.ndarray) -> float:
        """Return Γ_t [N m], equation (2), of `joint` 0 or 1 in the state y (8,)."""
        p = self.parameters
        bending, rate = y[_MOTOR + joint] - y[_LINK + joint], y[_MOTOR_VELOCITY + joint] - y[_LINK_VELOCITY + joint]
        return p.stiffness[joint] * bending + p.damping[joint] * rate

    def mode(self, joint: int, y: np.ndarray) -> int:
        """Return the mode: the sign of the velocity; at rest, the sign of the net torque if it exceeds Γ_fs, else 0."""
        if y[_MOTOR_VELOCITY + joint] != 0.0:
            return int(np.sign(y[_MOTOR_VELOCITY + joint]))
        net = self.torque[joint] - self.joint_torque(joint, y)
        return int(np.sign(net)) if abs(net) > self.parameters.static_friction[joint] else 0

    def next_mode(self, joint: int, mode: int, y: np.ndarray) -> int:
        """Return the mode after the event that ended `mode`; after a slip, set the velocity in `y` to exactly 0."""
        # The joint has broken away; testing |net| > Γ_fs again would depend on rounding of the event's time
        if mode == 0:
            return int(np.sign(self.torque[joint] - self.joint_torque(joint, y)))
        y[_MOTOR_VELOCITY + joint] = 0.0
        return self.mode(joint, y)

    def end_of_mode(self, joint: int, mode: int, start: float) -> Any:
        """Return the event of `solve_ivp` that ends this mode: a speed [rad/s] or, in stick, a torque [N m] becomes 0.

        The quantity is treated as positive at `start`. Otherwise a slip that has just left v = 0 would end immediately,
        and a simultaneous event of the other joint could hide this one.
        """
        static = self.parameters.static_friction[joint]

        def event(time: float, y: np.ndarray) -> float:
            if time == start or static == 0.0:  # without friction all modes have the same equations
                return 1.0
            if mode != 0:
                return float(mode * y[_MOTOR_VELOCITY + joint])
            return (1.0 + _BREAK_AWAY_MARGIN) * static - abs(self.torque[joint] - self.joint_torque(joint, y))

        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        return event

    def derivative(self, modes: tuple[int, ...], time: float, state: np.ndarray) -> list[float]:
        """Return the time derivative of the state, with each motor in its mode, as floats for speed."""
        y = state.tolist()
        joint_torque = self.joint_torque(0, y), self.joint_torque(1, y)
        _, _, q1, q2, *velocities = y
        _, _, dq1, dq2 = velocities
        motor1, motor2 = (self.motor_acceleration(j, modes[j], joint_torque[j], velocities[j]) for j in range(2))
        link1, link2 = self.link_acceleration(q1, q2, dq1, dq2, joint_torque, self.force(time))
        return [*velocities, motor1, motor2, link1, link2]

    def motor_acceleration(self, joint: int, mode: int, joint_torque: float, velocity: float) -> float:
        """Return the acceleration q̈_a [rad/s²] of one motor in a mode, from equation (1)."""
        p = self.parameters
        if mode == 0 and p.static_friction[joint] > 0.0:
            return 0.0
        friction = -mode * stribeck_magnitude(velocity, dry_friction_of(p, joint))
        net = self.torque[joint] - joint_torque + friction - p.viscous_friction[joint] * velocity
        return float(net / p.motor_inertia[joint])

    def link_acceleration(
        self, q1: float, q2: float, dq1: float, dq2: float, joint_torque: Sequence[float], force: Sequence[float]
    ) -> tuple[float, float]:
        """Return q̈_b [rad/s²] from equation (3), M_b q̈_b = Γ_t + Jᵀ F - N_b q̇_b - g, solved by Cramer's rule."""
        l1, l2 = self.length
        x1, y1 = l1 * math.cos(q1), l1 * math.sin(q1)  # joint 2 from joint 1 [m], x down
        x2, y2 = l2 * math.cos(q1 + q2), l2 * math.sin(q1 + q2)  # the tip from joint 2 [m]
        m11, m12, m22 = self.c1 + 2.0 * self.c2 * math.cos(q2), self.c3 + self.c2 * math.cos(q2), self.c3
        s = self.c2 * math.sin(q2)
        (n11, n12), (n21, n22) = (-2.0 * s * dq2, -s * dq2), (s * dq1, 0.0)
        g2 = self.c5 * math.sin(q1 + q2)
        g1 = self.c4 * math.sin(q1) + g2
        fx, fy = float(force[0]), float(force[1])
        right1 = joint_torque[0] - (y1 + y2) * fx + (x1 + x2) * fy - n11 * dq1 - n12 * dq2 - g1
        right2 = joint_torque[1] - y2 * fx + x2 * fy - n21 * dq1 - n22 * dq2 - g2
        determinant = m11 * m22 - m12 * m12
        return (m22 * right1 - m12 * right2) / determinant, (m11 * right2 - m12 * right1) / determinant
