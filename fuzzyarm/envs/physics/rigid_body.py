"""Kinematics and dynamics of the links of a `Robot`, in NumPy: M(q) q̈ + C(q, q̇) q̇ + g(q) = τ + J(q)ᵀ F.

The recursive algorithms of Featherstone (Rigid Body Dynamics Algorithms, 2008) in coordinates of the base, where a
sum along the chain needs no change of frame. A velocity is the pair (ω, v): angular velocity, and velocity of the
body's point at the base's origin; an acceleration is its derivative. A force is the pair (n, f): moment about that
origin, and force.

    s_i = (z_i, p_i × z_i)                                   axis of joint i, z_i its direction, p_i its origin
    v_i = Σ_{j<=i} s_j q̇_j
    a_i = Σ_{j<=i} (s_j q̈_j + v_j × s_j q̇_j) - (0, g)         the base accelerates upwards instead of gravity
    f_i = I_i a_i + v_i ×* I_i v_i                           Newton and Euler; I_i about the base's origin
    τ_i = s_iᵀ Σ_{k>=i} f_k                                  recursive Newton-Euler
    M_ij = s_iᵀ (Σ_{k>=max(i,j)} I_k) s_j                    composite rigid bodies

All functions take angles q [rad] of shape (..., n) and return arrays with the same leading axes. `_serial` has
the same equations for every kind of number.
"""

from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.joint import DIMENSIONS
from fuzzyarm.envs.physics.robot import Robot

__all__ = ["Frames", "frames", "gravity", "inverse_dynamics", "mass_matrix", "tip_jacobian"]

_ANGULAR, _LINEAR = slice(0, DIMENSIONS), slice(DIMENSIONS, 2 * DIMENSIONS)


class Frames(NamedTuple):
    """The links, the joint axes and the tip of a robot, in the base frame."""

    rotation: np.ndarray  # R_i of each link's frame (..., n, 3, 3)
    origin: np.ndarray  # p_i of each link's frame (..., n, 3) [m]
    axes: np.ndarray  # z_i = R_i u_i, unit vectors (..., n, 3)
    tip: np.ndarray  # p_n + R_n tip (..., 3) [m]


def frames(robot: Robot, q: Any) -> Frames:
    """Return the frames at angles q (..., n) [rad]: R_i = R_{i-1} A_i exp([u_i]× q_i), p_i = p_{i-1} + R_{i-1} d_i."""
    angles, now = _motion(robot, q), robot.arrays
    rotation, origin, across = np.eye(DIMENSIONS), np.zeros(DIMENSIONS), _skew(now.axis)
    sine, cosine = (function(angles)[..., np.newaxis, np.newaxis] for function in (np.sin, np.cos))
    turns = rotation + sine * across + (1.0 - cosine) * (across @ across)  # Rodrigues
    rotations, origins = [], []
    for i in range(len(robot)):
        origin = origin + rotation @ now.position[i]
        rotation = rotation @ now.rotation[i] @ turns[..., i, :, :]
        rotations.append(rotation)
        origins.append(np.broadcast_to(origin, (*angles.shape[:-1], DIMENSIONS)))
    turned, placed = np.stack(rotations, axis=-3), np.stack(origins, axis=-2)
    axes, tip = np.einsum("...kij,kj->...ki", turned, now.axis), placed[..., -1, :] + turned[..., -1, :, :] @ now.tip
    return Frames(turned, placed, axes, tip)


def mass_matrix(robot: Robot, q: Any) -> np.ndarray:
    """Return the mass matrix M(q) of the links [kg m²], shape (..., n, n), without the inertia of the rotors."""
    links = frames(robot, q)
    axes, inertia = _axes(links), _inertias(robot, links)
    composite = np.flip(np.cumsum(np.flip(inertia, axis=-3), axis=-3), axis=-3)
    upper = np.triu(axes @ np.swapaxes(_times(composite, axes), -1, -2))
    return np.asarray(upper + np.swapaxes(np.triu(upper, 1), -1, -2))


def inverse_dynamics(robot: Robot, q: Any, dq: Any, ddq: Any) -> np.ndarray:
    """Return M(q) q̈ + C(q, q̇) q̇ + g(q) [N m] for q [rad], q̇ [rad/s] and q̈ [rad/s²]; all of shape (..., n)."""
    links, rate, change = frames(robot, q), _motion(robot, dq), _motion(robot, ddq)
    axes, inertia = _axes(links), _inertias(robot, links)
    turning = axes * rate[..., np.newaxis]
    velocity = np.cumsum(turning, axis=-2)
    acceleration = np.cumsum(axes * change[..., np.newaxis] + _cross_motion(velocity, turning), axis=-2)
    acceleration[..., _LINEAR] -= robot.arrays.gravity
    force = _times(inertia, acceleration) + _cross_force(velocity, _times(inertia, velocity))
    outer = np.flip(np.cumsum(np.flip(force, axis=-2), axis=-2), axis=-2)
    return np.asarray(np.sum(axes * outer, axis=-1))


def gravity(robot: Robot, q: Any) -> np.ndarray:
    """Return the gravity torques g(q) [N m], shape (..., n), at joint angles q [rad]."""
    still = np.zeros(len(robot))
    return inverse_dynamics(robot, q, still, still)


def tip_jacobian(robot: Robot, q: Any) -> np.ndarray:
    """Return the tip's Jacobian J = ∂tip/∂q [m], shape (..., 3, n): column i is z_i × (tip - p_i)."""
    links = frames(robot, q)
    columns = _cross(links.axes, links.tip[..., np.newaxis, :] - links.origin)
    return np.swapaxes(columns, -1, -2)


def _motion(robot: Robot, values: Any) -> np.ndarray:
    """Return angles, velocities or accelerations as an array (..., n) of floats; ValueError for another shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != len(robot):
        raise ValueError(
            f"angles, velocities and accelerations of {checks.shown(robot.name)} must have shape (..., {len(robot)}); "
            f"one of them has shape {array.shape}"
        )
    return array


def _skew(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices [a]×, shape (..., 3, 3), of vectors a (..., 3), with [a]× b = a × b."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, DIMENSIONS, DIMENSIONS)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return _times(_skew(first), second)


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.asarray((matrices @ vectors[..., np.newaxis])[..., 0])


def _axes(links: Frames) -> np.ndarray:
    """Return the joint axes s_i = (z_i, p_i × z_i), shape (..., n, 6): direction, then moment about the origin."""
    return np.concatenate([links.axes, _cross(links.origin, links.axes)], axis=-1)


def _inertias(robot: Robot, links: Frames) -> np.ndarray:
    """Return the spatial inertias I_i (..., n, 6, 6) of the links about the base's origin.

    I_i = [[R I Rᵀ + m [c]×ᵀ [c]×, m [c]×], [m [c]×ᵀ, m 1]], c the mass center, 1 the identity matrix.
    """
    now, turn = robot.arrays, links.rotation
    mass = now.mass[:, np.newaxis, np.newaxis]
    across = _skew(links.origin + np.einsum("...kij,kj->...ki", turn, now.center))
    transposed = np.swapaxes(across, -1, -2)
    whole = np.zeros((*across.shape[:-2], 2 * DIMENSIONS, 2 * DIMENSIONS))
    whole[..., _ANGULAR, _ANGULAR] = turn @ now.inertia @ np.swapaxes(turn, -1, -2) + mass * (transposed @ across)
    whole[..., _ANGULAR, _LINEAR] = mass * across
    whole[..., _LINEAR, _ANGULAR] = mass * transposed
    whole[..., _LINEAR, _LINEAR] = mass * np.eye(DIMENSIONS)
    return whole


def _cross_motion(velocity: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return v × s = (ω × s_ω, ω × s_v + v × s_ω) for `velocity` = (ω, v) and `motion` = (s_ω, s_v), (..., 6)."""
    turn = velocity[..., _ANGULAR]
    angular = _cross(turn, motion[..., _ANGULAR])
    linear = _cross(turn, motion[..., _LINEAR]) + _cross(velocity[..., _LINEAR], motion[..., _ANGULAR])
    return np.concatenate([angular, linear], axis=-1)


def _cross_force(velocity: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return V ×* (n, f) = (ω × n + v × f, ω × f) for `velocity` V = (ω, v) and `force` = (n, f), (..., 6)."""
    turn = velocity[..., _ANGULAR]
    moment = _cross(turn, force[..., _ANGULAR]) + _cross(velocity[..., _LINEAR], force[..., _LINEAR])
    return np.concatenate([moment, _cross(turn, force[..., _LINEAR])], axis=-1)
