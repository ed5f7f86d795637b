"""Where the tip of a robot is and how its last link is turned, and how both change with the joints.

With the axis z_i and the origin p_i of joint i, and the tip p, in the base frame:

    J = [z_i × (p - p_i); z_i],      (v, ω) = J q̇,      (v̇, ω̇) = J q̈ + J̇ q̇

J̇ q̇ is found by passing velocities and accelerations from link to link with q̈ = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.physics.robot import Robot

__all__ = [
    "ANGULAR", "LINEAR", "Chain", "angle_ranges", "chain", "drift", "jacobian", "link_lengths", "reach",
    "rotation_vector", "velocity_limits",
]  # fmt: skip

LINEAR, ANGULAR = slice(0, 3), slice(3, 6)  # rows of the Jacobian: velocity of the tip, angular velocity


class Chain(NamedTuple):
    """The joints and the tip of a robot, in the base frame.

    Attributes:
        axes: z_i, unit vectors (..., n, 3).
        origins: p_i (..., n, 3) [m].
        tip: p (..., 3) [m].
        rotation: of the last link (..., 3, 3), columns are its axes.
    """

    axes: np.ndarray
    origins: np.ndarray
    tip: np.ndarray
    rotation: np.ndarray


def chain(robot: Robot, q: np.ndarray) -> Chain:
    """Return joints and tip at joint angles q (..., n) [rad]."""
    links = frames(robot, q)
    axes = np.einsum("...kij,kj->...ki", links.rotation, robot.arrays.axis)
    last = links.rotation[..., -1, :, :]
    return Chain(axes, links.origin, links.origin[..., -1, :] + last @ robot.arrays.tip, last)


def jacobian(now: Chain) -> np.ndarray:
    """Return J (..., 6, n): rows of the tip's velocity [m], then of the angular velocity of the last link."""
    linear = np.cross(now.axes, now.tip[..., np.newaxis, :] - now.origins)
    return np.swapaxes(np.concatenate([linear, now.axes], axis=-1), -1, -2)


def drift(now: Chain, dq: np.ndarray) -> np.ndarray:
    """Return J̇ q̇ (..., 6), [m/s²] and [rad/s²], at joint velocities dq (..., n) [rad/s]."""
    zero = np.zeros_like(now.tip)
    turning, angular, linear = zero, zero, zero  # ω, ω̇ and the acceleration of the place reached so far
    places = [*np.moveaxis(now.origins, -2, 0), now.tip]
    for number, axis in enumerate(np.moveaxis(now.axes, -2, 0)):
        swing = axis * dq[..., number, np.newaxis]
        angular = angular + np.cross(turning, swing)
        turning = turning + swing
        lever = places[number + 1] - places[number]
        linear = linear + np.cross(angular, lever) + np.cross(turning, np.cross(turning, lever))
    return np.concatenate([linear, angular], axis=-1)


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Return axis times angle (..., 3) [rad] of rotations (..., 3, 3), angles of at most π."""
    twice_sine = np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )
    sine = 0.5 * np.linalg.norm(twice_sine, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0))
    factor = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)
    return np.asarray(0.5 * factor[..., np.newaxis] * twice_sine)


def reach(robot: Robot) -> float:
    """Return how far the tip can be from the first joint at most [m]: the summed distances from joint to joint."""
    return float(np.sum(link_lengths(robot)))


def link_lengths(robot: Robot) -> np.ndarray:
    """Return the distances from joint to joint, the last one to the tip, (n,) [m]."""
    return np.asarray(np.linalg.norm([*robot.arrays.position[1:], robot.arrays.tip], axis=-1))


def angle_ranges(robot: Robot) -> np.ndarray:
    """Return (2, n), lowest and highest joint angles [rad]."""
    return np.array([joint.angle_range for joint in robot.joints]).T


def velocity_limits(robot: Robot) -> np.ndarray:
    """Return the largest joint velocities (n,) [rad/s]."""
    return np.array([joint.velocity_limit for joint in robot.joints])
