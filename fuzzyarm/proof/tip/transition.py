"""The linear equation of the deviation in one period, its solution and bounds, in floats with a rounding allowance.

    ξ = (δθ, δq, δθ̇, δq̇, δu),      ξ̇ = A ξ + Σ b_c w_c(t),      δu constant,      observed: S ξ + D w.

Every matrix X is a float matrix with |X - X_exact| <= SLACK |X|', where |X|' is the same expression with the absolute
value of each factor: |A|' for A, E = exp(|A|' T) for exp(A t), t <= T, and so on (`enclosures`). The series of the
exponential is cut after `_TERMS` terms. `over` checks that the remainder, at most L E with the last term L, is small.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import motors
from fuzzyarm.proof.tip.enclosures import SLACK, NoBound

__all__ = ["Linear", "StateLayout", "Transition", "layout"]

_TERMS = 24
_PARTS = 2  # of a period; in each, the first two moments of a disturbance are kept


class StateLayout:
    """The index ranges `rows` in S ξ and `channels` in w; array sizes in this module are for 2 joints and 2 axes."""

    def __init__(self, joints: int, axes: int) -> None:
        def slices(names: str) -> SimpleNamespace:
            return SimpleNamespace(**{k: slice(i * joints, (i + 1) * joints) for i, k in enumerate(names.split())})

        self.joints, self.axes = joints, axes
        # rows of the deviation: δθ, δq, δθ̇, δq̇ as in ξ, then φ, φ̇, the net torque N, θ̈ and q̈
        self.rows = slices("theta link d_theta d_link bending bending_rate net motor_acceleration link_acceleration")
        # channels of disturbing torques: the motors, the links, within the joints, and the tip along its axes
        self.channels = slices("motor link joint")
        self.channels.tip = slice(self.channels.joint.stop, self.channels.joint.stop + axes)
        self.states = self.rows.d_link.stop  # length of (δθ, δq, δθ̇, δq̇)
        self.row_count, self.channel_count = self.rows.link_acceleration.stop, self.channels.tip.stop
        # rows of δq̈, δq and δq̇; further rows, which follow the 18 others, are combinations of them
        self.observed = np.r_[self.rows.link_acceleration, self.rows.link, self.rows.d_link]


@functools.cache
def layout(joints: int, axes: int) -> StateLayout:
    """Return the `StateLayout` of an arm; the same object on every call."""
    return StateLayout(joints, axes)


class Transition(NamedTuple):
    """The solution of ξ̇ = A ξ + b w over one period T."""

    phi: np.ndarray  # exp(A T), (10, 10)
    growth: np.ndarray  # E = exp(|A|' T), (10, 10), rounded up
    # held, ramp: ∫ e^{A (T - t)} b dt and the same with s(t) as a factor, (10, 8)
    held: np.ndarray
    ramp: np.ndarray
    moments: np.ndarray  # directions (_PARTS, 2, 10, 8) of the first two moments of a disturbance of size one
    beyond: np.ndarray  # bound (10, 8) on the effect of this disturbance beyond the two moments
    push_state: np.ndarray  # bound (10, 8) on the whole effect of this disturbance
    # bound (18 + n, 8) on what a disturbance of size one can add to the observed rows within the period
    push: np.ndarray
    # S_A, S_A_A: the products S A and S A² (18 + n, 10)
    S_A: np.ndarray
    S_A_A: np.ndarray


class Linear(NamedTuple):
    """The linear equation of a period, with n observed rows in addition to the 18 of `StateLayout.rows`."""

    A: np.ndarray  # (10, 10)
    size: np.ndarray  # |A|', (10, 10)
    b: np.ndarray  # (10, 8)
    S: np.ndarray  # (18 + n, 10)
    size_of_rows: np.ndarray  # |S|', (18 + n, 10)
    D: np.ndarray  # (18 + n, 8)

    @classmethod
    def of(
        cls,
        arm: Any,
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
            links: M_k [kg m²], G_k = ∂R/∂q [N m/rad] and D_k = ∂R/∂q̇ [N m s/rad] at mid-period, (2, 2) each.
            lever: Jᵀ (2, 2), from tip forces [N] to torques [N m].
            slip: change of each motor's friction torque with its velocity (2,) [N m s/rad].
            still: whether friction holds each motor; if so, the motor's rows are zero.
            given: whether each motor's velocity is bounded separately; if so, w in the motor's channel is δθ̇ [rad/s]
                instead of a torque, and δθ̇ in ξ is zero.
            products: coefficients (n, 6) of δq̈, δq and δq̇ in n further observed rows.
        """
        mass, stiff, damp = links
        at = layout(*lever.shape)
        n, rows, channels, size_of_xi = at.joints, at.rows, at.channels, at.states + at.joints
        drives = motors(arm, slip)
        K, B = np.diag([own.stiffness for own in drives]), np.diag([own.damping for own in drives])
        inertia, viscous = (np.array([getattr(own, name) for own in drives]) for name in ("motor_inertia", "viscous"))
        inverse = np.linalg.inv(mass)
        free = np.where(still, 0.0, 1.0 / inertia)
        A, b = np.zeros((size_of_xi, size_of_xi)), np.zeros((size_of_xi, at.channel_count))
        A[rows.theta, rows.d_theta] = np.diag(np.where(still, 0.0, 1.0))
        A[rows.link, rows.d_link] = np.eye(n)
        size = A.copy()
        joint = np.hstack([-K, K, -B, B, np.eye(n)])  # δu - K φ - B φ̇
        motor = joint.copy()
        motor[:, rows.d_theta] += np.diag(slip - viscous)
        A[rows.d_theta], size[rows.d_theta] = free[:, np.newaxis] * motor, free[:, np.newaxis] * np.abs(motor)
        link = np.hstack([K, -K - stiff, B, -B - damp, np.zeros((n, n))])
        A[rows.d_link], size[rows.d_link] = inverse @ link, np.abs(inverse) @ np.abs(link)
        b[rows.d_theta, channels.motor] = np.diag(free)
        b[rows.d_link, channels.link] = inverse
        b[rows.d_theta, channels.joint], b[rows.d_link, channels.joint] = -np.diag(free), inverse
        b[rows.d_link, channels.tip] = inverse @ lever
        S, D = np.zeros((at.row_count, size_of_xi)), np.zeros((at.row_count, at.channel_count))
        S[: at.states, : at.states] = np.eye(at.states)
        S[rows.bending] = np.eye(n, size_of_xi) - np.eye(n, size_of_xi, n)
        S[rows.bending_rate] = np.eye(n, size_of_xi, 2 * n) - np.eye(n, size_of_xi, 3 * n)
        S[rows.net] = joint
        S[rows.net, rows.d_theta] -= np.diag(viscous)
        accelerations = (rows.motor_acceleration, rows.d_theta), (rows.link_acceleration, rows.d_link)
        for those, rates in accelerations:
            S[those], D[those] = A[rates], b[rates]
        for j in np.flatnonzero(given).tolist():  # the motor's channel stands for its velocity
            velocity, channel, row = rows.d_theta.start + j, channels.motor.start + j, rows.motor_acceleration.start + j
            A[velocity], size[velocity], b[velocity], S[row], D[row] = 0.0, 0.0, 0.0, 0.0, 0.0
            b[:, channel], D[:, channel] = A[:, velocity], S[:, velocity]
            A[:, velocity], size[:, velocity], S[:, velocity] = 0.0, 0.0, 0.0
        size_of_rows = np.abs(S)
        for those, rates in accelerations:
            size_of_rows[those] = size[rates]
        S, D = np.vstack([S, products @ S[at.observed]]), np.vstack([D, products @ D[at.observed]])
        size_of_rows = np.vstack([size_of_rows, np.abs(products) @ size_of_rows[at.observed]])
        return cls(A, size, b, S, size_of_rows, D)

    def over(self, period: float) -> Transition:
        """Return the solution of the linear equation over a period T [s]."""
        A, size, b, S, _, D = self
        powers, bounds = [np.eye(len(A))], np.eye(len(A))
        growth = np.eye(len(A))
        for i in range(1, _TERMS):
            powers.append(powers[-1] @ A / i)
            bounds = bounds @ size * (period / i)
            growth += bounds
        growth = growth * (1.0 + 1e-9)
        if not (bounds @ growth <= 1e-3 * SLACK * growth).all():
            raise NoBound(f"the motion in {period:g} s cannot be bounded: the arm is too stiff or damped too strongly")
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
