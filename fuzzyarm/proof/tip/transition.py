"""The linear equation of the deviation in one period, its solution and its bounds, in floats with an allowance.

    ξ = (δθ, δq, δθ̇, δq̇, δu),      ξ̇ = A ξ + Σ b_c w_c(t),      δu constant,      observed: S ξ + D w.

Every matrix X is a float matrix with |X - X_exact| <= SLACK |X|', where X' is the same expression with the absolute
value of each factor: |A|' for A, E = exp(|A|' T) for exp(A t), t <= T, and so on (`enclosures`). The series of the
exponential is cut after `_TERMS` terms; |A| T is below one in the units that balance it, so the rest is below 1e-24 E.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.proof.tip.enclosures import SLACK

__all__ = ["CHANNELS", "CHANNEL_COUNT", "OBSERVED", "ROWS", "ROW_COUNT", "STATES", "Linear", "Transition"]

_TERMS = 24
_PARTS = 2  # of a period, in each of which the first two moments of a disturbance are kept


def _slices(names: str) -> SimpleNamespace:
    """Return slices by name, each of `JOINTS` numbers, one after the other."""
    return SimpleNamespace(**{name: slice(i * JOINTS, (i + 1) * JOINTS) for i, name in enumerate(names.split())})


CHANNELS = _slices("motor link joint tip")
"""The places of disturbing torques: the motors, the links, within the joints, and the tip along x and y."""
ROWS = _slices("theta link d_theta d_link bending bending_rate net motor_acceleration link_acceleration")
"""The observed rows of the deviation: δθ, δq, δθ̇, δq̇ as in ξ, then φ, φ̇, the net torque N, θ̈ and q̈."""
CHANNEL_COUNT = JOINTS * len(vars(CHANNELS))  # numbers of all channels
ROW_COUNT = JOINTS * len(vars(ROWS))  # numbers of these rows
STATES = ROWS.d_link.stop  # numbers of δθ, δq, δθ̇, δq̇
_SIZE = STATES + JOINTS  # of ξ
_ACCELERATIONS = (ROWS.motor_acceleration, ROWS.d_theta), (ROWS.link_acceleration, ROWS.d_link)
OBSERVED = np.r_[ROWS.link_acceleration, ROWS.link, ROWS.d_link]
"""Rows of δq̈, δq and δq̇; further rows, which follow the 18 others, are combinations of them."""


class Transition(NamedTuple):
    """The solution over one period."""

    phi: np.ndarray  # exp(A T), (10, 10)
    growth: np.ndarray  # E = exp(|A|' T), (10, 10), rounded up
    # held, ramp: ∫ e^{A (T - t)} b dt and the same with s(t) as a factor, (10, 8)
    held: np.ndarray
    ramp: np.ndarray
    moments: np.ndarray  # directions (_PARTS, 2, 10, 8) of the first two moments of a disturbance of size one
    beyond: np.ndarray  # bound (10, 8) of what the two moments leave of it
    push_state: np.ndarray  # bound (10, 8) of all of it
    # bound (18 + n, 8) of what a disturbance of size one can add to the observed numbers within the period
    push: np.ndarray
    # S_A, S_A_A: products (18 + n, 10)
    S_A: np.ndarray
    S_A_A: np.ndarray


class Linear(NamedTuple):
    """The linear equation of a period, for n further observed rows beside the 18 of `ROWS`."""

    A: np.ndarray  # (10, 10)
    size: np.ndarray  # |A|', (10, 10)
    b: np.ndarray  # (10, 8)
    S: np.ndarray  # (18 + n, 10)
    size_of_rows: np.ndarray  # |S|', (18 + n, 10)
    D: np.ndarray  # (18 + n, 8)

    @classmethod
    def of(
        cls,
        arm: Arm,
        links: tuple[np.ndarray, np.ndarray, np.ndarray],
        lever: np.ndarray,
        slip: np.ndarray,
        still: list[bool],
        given: list[bool],
        products: np.ndarray,
    ) -> Linear:
        """Return the linear equation of a period.

        Args:
            arm: constants in floats.
            links: M_k [kg m²], G_k = ∂R/∂q [N m/rad] and D_k = ∂R/∂q̇ [N m s/rad] at the middle of the period, (2, 2).
            lever: Jᵀ (2, 2), from tip forces [N] to torques [N m].
            slip: derivative of the friction torque by velocity (2,) [N m s/rad].
            still: whether friction holds a motor still; its rows are zero.
            given: whether the velocity of a motor is bounded separately. Then it is not a state, and the motor's
                channel represents it, in rad/s.
            products: further rows (n, 6) over δq̈, δq and δq̇ that are observed.
        """
        mass, stiff, damp = links
        K, B = np.diag([arm.stiffness1, arm.stiffness2]), np.diag([arm.damping1, arm.damping2])
        inertia, viscous = np.array([arm.motor_inertia1, arm.motor_inertia2]), np.array([arm.viscous1, arm.viscous2])
        inverse = np.linalg.inv(mass)
        free = np.where(still, 0.0, 1.0 / inertia)
        A, b = np.zeros((_SIZE, _SIZE)), np.zeros((_SIZE, CHANNEL_COUNT))
        A[ROWS.theta, ROWS.d_theta] = np.diag(np.where(still, 0.0, 1.0))
        A[ROWS.link, ROWS.d_link] = np.eye(JOINTS)
        size = A.copy()
        joint = np.hstack([-K, K, -B, B, np.eye(JOINTS)])  # δu - K φ - B φ̇
        motor = joint.copy()
        motor[:, ROWS.d_theta] += np.diag(slip - viscous)
        A[ROWS.d_theta], size[ROWS.d_theta] = free[:, np.newaxis] * motor, free[:, np.newaxis] * np.abs(motor)
        link = np.hstack([K, -K - stiff, B, -B - damp, np.zeros((JOINTS, JOINTS))])
        A[ROWS.d_link], size[ROWS.d_link] = inverse @ link, np.abs(inverse) @ np.abs(link)
        b[ROWS.d_theta, CHANNELS.motor] = np.diag(free)
        b[ROWS.d_link, CHANNELS.link] = inverse
        b[ROWS.d_theta, CHANNELS.joint], b[ROWS.d_link, CHANNELS.joint] = -np.diag(free), inverse
        b[ROWS.d_link, CHANNELS.tip] = inverse @ lever
        S, D = np.zeros((ROW_COUNT, _SIZE)), np.zeros((ROW_COUNT, CHANNEL_COUNT))
        S[:STATES, :STATES] = np.eye(STATES)
        S[ROWS.bending] = np.eye(JOINTS, _SIZE) - np.eye(JOINTS, _SIZE, JOINTS)
        S[ROWS.bending_rate] = np.eye(JOINTS, _SIZE, 2 * JOINTS) - np.eye(JOINTS, _SIZE, 3 * JOINTS)
        S[ROWS.net] = joint
        S[ROWS.net, ROWS.d_theta] -= np.diag(viscous)
        for rows, rates in _ACCELERATIONS:
            S[rows], D[rows] = A[rates], b[rates]
        for j in np.flatnonzero(given).tolist():  # the motor's channel stands for its velocity
            velocity, channel, row = ROWS.d_theta.start + j, CHANNELS.motor.start + j, ROWS.motor_acceleration.start + j
            A[velocity], size[velocity], b[velocity], S[row], D[row] = 0.0, 0.0, 0.0, 0.0, 0.0
            b[:, channel], D[:, channel] = A[:, velocity], S[:, velocity]
            A[:, velocity], size[:, velocity], S[:, velocity] = 0.0, 0.0, 0.0
        size_of_rows = np.abs(S)
        for rows, rates in _ACCELERATIONS:
            size_of_rows[rows] = size[rates]
        S, D = np.vstack([S, products @ S[OBSERVED]]), np.vstack([D, products @ D[OBSERVED]])
        size_of_rows = np.vstack([size_of_rows, np.abs(products) @ size_of_rows[OBSERVED]])
        return cls(A, size, b, S, size_of_rows, D)

    def over(self, period: float) -> Transition:
        """Return the solution over T [s]."""
        A, size, b, S, _, D = self
        powers, bounds = [np.eye(_SIZE)], np.eye(_SIZE)
        growth = np.eye(_SIZE)
        for i in range(1, _TERMS):
            powers.append(powers[-1] @ A / i)
            bounds = bounds @ size * (period / i)
            growth += bounds
        growth = growth * (1.0 + 1e-9)
        stack = np.array(powers)  # A^i / i!
        order = np.arange(_TERMS)
        h = period / _PARTS
        left = period - h * (np.arange(_PARTS) + 0.5)  # from the middle of each part to the end
        at = np.tensordot(np.power(np.array([*left, period])[:, np.newaxis], order), stack, axes=1)
        phi, directions = at[-1], at[:-1] @ b
        held = np.tensordot(period ** (order + 1.0) / (order + 1.0), stack, axes=1) @ b
        later = np.tensordot(period ** (order + 2.0) / (order + 2.0), stack, axes=1) @ b  # ∫ e^{A t} t dt
        moments = np.stack([h * directions, 0.25 * h * h * (at[:-1] @ (A @ b))], axis=1)
        beyond = _PARTS * h**3 / 24.0 * growth @ (size @ (size @ np.abs(b))) + SLACK * period * growth @ np.abs(b)
        S_A = S @ A
        reach = np.abs(S) @ size
        push = period * (
            np.abs(S @ b) + 0.5 * period * np.abs(S_A @ b) + period**2 / 6.0 * reach @ size @ growth @ np.abs(b)
        )
        return Transition(
            phi, growth, held, held - 2.0 / period * later, moments, beyond * 1.001,
            period * growth @ np.abs(b), push * 1.001 + np.abs(D),
            S_A, S_A @ A,
        )  # fmt: skip
