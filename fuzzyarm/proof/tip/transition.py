"""The linear equation of the deviation in one period, its solution and bounds of it, in floats with an allowance.

    ξ = (δθ, δq, δθ̇, δq̇, δu),      ξ̇ = A ξ + Σ b_c w_c(t),      δu constant,      observed: S ξ + D w.

Every matrix X is a float matrix with |X - X_exact| <= SLACK |X|', where X' is the same expression with the absolute
value of each factor: |A|' for A, E = exp(|A|' T) for exp(A t), t <= T, and so on (`enclosures`). The series of the
exponential is cut after `_TERMS` terms; |A| T is below one in the units that balance it, so the rest is below 1e-24 E.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm
from fuzzyarm.proof.tip.enclosures import SLACK

__all__ = [
    "CHANNELS", "OBSERVED", "PARTS", "ROWS", "ROW_COUNT", "STATES", "Linear", "Transition", "linear", "transition",
]  # fmt: skip

STATES = 4 * JOINTS  # numbers of δθ, δq, δθ̇, δq̇
SIZE = STATES + JOINTS  # of ξ
_TERMS = 24
PARTS = 2  # of a period, in each of which the first two moments of a disturbance are kept

THETA, LINK, D_THETA, _D_LINK, HELD = (slice(i * JOINTS, (i + 1) * JOINTS) for i in range(5))


class _Channels(NamedTuple):
    """Where disturbing torques act: on the motors, on the links, within the joints, and at the tip along x and y."""

    motor: slice
    link: slice
    joint: slice
    tip: slice


CHANNELS = _Channels(*(slice(i * JOINTS, (i + 1) * JOINTS) for i in range(4)))  # where the channels lie
COUNT = 4 * JOINTS


class Rows(NamedTuple):
    """What is observed of the deviation: ξ without δu, then φ, φ̇, the net torque N, θ̈ and q̈."""

    theta: slice
    link: slice
    d_theta: slice
    d_link: slice
    bending: slice
    bending_rate: slice
    net: slice
    motor_acceleration: slice
    link_acceleration: slice


ROWS = Rows(*(slice(i * JOINTS, (i + 1) * JOINTS) for i in range(9)))  # where the rows lie
ROW_COUNT = 9 * JOINTS  # numbers of these rows; those that are made of `OBSERVED` follow
OBSERVED = np.r_[ROWS.link_acceleration, ROWS.link, ROWS.d_link]
"""Rows of δq̈, δq and δq̇, of which further rows can be made."""


class Linear(NamedTuple):
    """A (10, 10), its absolute value |A|' (10, 10), b (10, 8), S (18 + n, 10), |S|' (18 + n, 10) and D (18 + n, 8)."""

    A: np.ndarray
    size: np.ndarray
    b: np.ndarray
    S: np.ndarray
    size_of_rows: np.ndarray
    D: np.ndarray


class Transition(NamedTuple):
    """The solution over one period."""

    phi: np.ndarray  # exp(A T), (10, 10)
    growth: np.ndarray  # E = exp(|A|' T), (10, 10), rounded up
    # held, ramp: ∫ e^{A (T - t)} b dt and the same with s(t) as a factor, (10, 8)
    held: np.ndarray
    ramp: np.ndarray
    moments: np.ndarray  # directions (PARTS, 2, 10, 8) of the first two moments of a disturbance of size one
    beyond: np.ndarray  # bound (10, 8) of what the two moments leave of it
    push_state: np.ndarray  # bound (10, 8) of all of it
    # bound (18 + n, 8) of what a disturbance of size one can add to the observed numbers within the period
    push: np.ndarray
    # S_A, S_A_A: products (18 + n, 10)
    S_A: np.ndarray
    S_A_A: np.ndarray


def linear(
    arm: Arm,
    mass: np.ndarray,
    stiff: np.ndarray,
    damp: np.ndarray,
    lever: np.ndarray,
    slip: np.ndarray,
    still: list[bool],
    given: list[bool],
    products: np.ndarray,
) -> Linear:
    """Return the linear equation of a period.

    Constants of the arm are floats; at the middle M_k (2, 2) [kg m²] is the `mass` of the links, `stiff` G_k = ∂R/∂q [N
    m/rad], `damp` D_k = ∂R/∂q̇ [N m s/rad], `lever` Jᵀ (2, 2), from tip forces [N] to torques [N m]. `slip` (2,) [N m
    s/rad] is the change of the friction torque with the velocity. The rows of motors that friction holds `still` are
    zero; the velocity of a `given` motor is bounded otherwise, so that it is no state, and the motor's channel stands
    for it, in rad/s. `products` (n, 6) are further rows over δq̈, δq and δq̇ that are observed.
    """
    K, B = np.diag([arm.stiffness1, arm.stiffness2]), np.diag([arm.damping1, arm.damping2])
    inertia, viscous = np.array([arm.motor_inertia1, arm.motor_inertia2]), np.array([arm.viscous1, arm.viscous2])
    inverse = np.linalg.inv(mass)
    free = np.where(still, 0.0, 1.0 / inertia)
    A, b = np.zeros((SIZE, SIZE)), np.zeros((SIZE, COUNT))
    A[THETA, D_THETA] = np.diag(np.where(still, 0.0, 1.0))
    A[LINK, _D_LINK] = np.eye(JOINTS)
    size = A.copy()
    joint = np.hstack([-K, K, -B, B, np.eye(JOINTS)])  # δu - K φ - B φ̇
    motor = joint.copy()
    motor[:, D_THETA] += np.diag(slip - viscous)
    A[D_THETA], size[D_THETA] = free[:, np.newaxis] * motor, free[:, np.newaxis] * np.abs(motor)
    link = np.hstack([K, -K - stiff, B, -B - damp, np.zeros((JOINTS, JOINTS))])
    A[_D_LINK], size[_D_LINK] = inverse @ link, np.abs(inverse) @ np.abs(link)
    b[D_THETA, CHANNELS.motor] = np.diag(free)
    b[_D_LINK, CHANNELS.link] = inverse
    b[D_THETA, CHANNELS.joint], b[_D_LINK, CHANNELS.joint] = -np.diag(free), inverse
    b[_D_LINK, CHANNELS.tip] = inverse @ lever
    S, D = np.zeros((ROW_COUNT, SIZE)), np.zeros((ROW_COUNT, COUNT))
    S[:STATES, :STATES] = np.eye(STATES)
    one = np.eye(JOINTS)
    S[ROWS.bending, THETA], S[ROWS.bending, LINK] = one, -one
    S[ROWS.bending_rate, D_THETA], S[ROWS.bending_rate, _D_LINK] = one, -one
    S[ROWS.net] = joint
    S[ROWS.net, D_THETA] -= np.diag(viscous)
    S[ROWS.motor_acceleration], S[ROWS.link_acceleration] = A[D_THETA], A[_D_LINK]
    D[ROWS.motor_acceleration], D[ROWS.link_acceleration] = b[D_THETA], b[_D_LINK]
    for j in np.flatnonzero(given):
        _velocity_as_channel(int(j), A, size, b, S, D)
    size_of_rows = np.abs(S)
    size_of_rows[ROWS.motor_acceleration], size_of_rows[ROWS.link_acceleration] = size[D_THETA], size[_D_LINK]
    S, D = np.vstack([S, products @ S[OBSERVED]]), np.vstack([D, products @ D[OBSERVED]])
    size_of_rows = np.vstack([size_of_rows, np.abs(products) @ size_of_rows[OBSERVED]])
    return Linear(A, size, b, S, size_of_rows, D)


def _velocity_as_channel(j: int, A: np.ndarray, size: np.ndarray, b: np.ndarray, S: np.ndarray, D: np.ndarray) -> None:
    """Let the channel of motor j stand for its velocity in all matrices of `Linear`, in place."""
    velocity, channel = STATES // 2 + j, CHANNELS.motor.start + j
    A[velocity], size[velocity], b[velocity] = 0.0, 0.0, 0.0
    S[ROWS.motor_acceleration.start + j], D[ROWS.motor_acceleration.start + j] = 0.0, 0.0
    b[:, channel], D[:, channel] = A[:, velocity], S[:, velocity]
    A[:, velocity], size[:, velocity], S[:, velocity] = 0.0, 0.0, 0.0


def transition(system: Linear, period: float) -> Transition:
    """Return the solution of a linear equation over T [s]."""
    A, size, b, S = system.A, system.size, system.b, system.S
    powers, bounds = [np.eye(SIZE)], np.eye(SIZE)
    growth = np.eye(SIZE)
    for i in range(1, _TERMS):
        powers.append(powers[-1] @ A / i)
        bounds = bounds @ size * (period / i)
        growth += bounds
    growth = growth * (1.0 + 1e-9)
    stack = np.array(powers)  # A^i / i!
    order = np.arange(_TERMS)
    h = period / PARTS
    left = period - h * (np.arange(PARTS) + 0.5)  # from the middle of each part to the end
    at = np.tensordot(np.power(np.array([*left, period])[:, np.newaxis], order), stack, axes=1)
    phi, directions = at[-1], at[:-1] @ b
    held = np.tensordot(period ** (order + 1.0) / (order + 1.0), stack, axes=1) @ b
    later = np.tensordot(period ** (order + 2.0) / (order + 2.0), stack, axes=1) @ b  # ∫ e^{A t} t dt
    moments = np.stack([h * directions, 0.25 * h * h * (at[:-1] @ (A @ b))], axis=1)
    beyond = PARTS * h**3 / 24.0 * growth @ (size @ (size @ np.abs(b))) + SLACK * period * growth @ np.abs(b)
    S_A = S @ A
    reach = np.abs(S) @ size
    push = period * (
        np.abs(S @ b) + 0.5 * period * np.abs(S_A @ b) + period**2 / 6.0 * reach @ size @ growth @ np.abs(b)
    )
    return Transition(
        phi, growth, held, held - 2.0 / period * later, moments, beyond * 1.001,
        period * growth @ np.abs(b), push * 1.001 + np.abs(system.D),
        S_A, S_A @ A,
    )  # fmt: skip
