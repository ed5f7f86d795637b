"""A pinhole camera that looks at a robot, for perspective views in pictures and reports.

With the eye e, unit vectors r (right), d (down) and a (ahead), a point p is seen at

    (right, down) = center + focal (rᵀ (p - e), dᵀ (p - e)) / depth,    depth = aᵀ (p - e).

Gravity points down the picture, and the robot reaches to the right. The camera looks slightly downwards, and as
squarely as possible at the plane of the path and at the vertical plane through the base and the middle of the path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.physics.rigid_body import frames
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import reach, upwards

__all__ = ["Camera", "Poses", "across", "floor_of", "in_space", "looking_at", "poses_of"]

_ELEVATION = 0.35  # tangent of the angle at which the camera looks down if both planes are vertical
_DISTANCE = 4.0  # distance of the eye from the middle of the view, in reaches of the robot
_LEVEL = 1e-6  # relative length below which a vector counts as zero


class Poses(NamedTuple):
    """A robot in the base frame: `points` (..., n + 2, 3) [m] of base, joints and tip, `axes` (..., n, 3) of joints."""

    points: np.ndarray
    axes: np.ndarray


class Camera(NamedTuple):
    """The position, the axes and the scale of a camera, see the module."""

    eye: np.ndarray  # e (3,) [m]
    axes: np.ndarray  # the rows r, d, a (3, 3)
    focal: float = 1.0  # scale of the picture at depth 1 m [px]
    center: np.ndarray = np.zeros(2)  # picture position of the point straight ahead (2,) [px]

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Return how far (...) [m] points (..., 3) [m] are ahead of the camera."""
        return np.asarray((points - self.eye) @ self.axes[-1])

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return the picture positions (right, down) (..., 2) [px] of points (..., 3) [m]."""
        seen = (points - self.eye) @ self.axes.T
        return np.asarray(self.center + self.focal * seen[..., :-1] / seen[..., -1:])

    def fitted(self, points: np.ndarray, low: np.ndarray, high: np.ndarray) -> Camera:
        """Return the camera that shows points (n, 3) [m] as large as possible between corners (2,) [px], centered."""
        seen = self._replace(focal=1.0, center=np.zeros(2)).pixels(points)
        least, most = seen.min(axis=0), seen.max(axis=0)
        focal = float(np.min((high - low) / np.maximum(most - least, 1e-9)))
        return self._replace(focal=focal, center=0.5 * (low + high) - 0.5 * focal * (least + most))


class _Floor(NamedTuple):
    """A horizontal plane at the height of a robot's base or of its lowest point, whichever is lower."""

    up: np.ndarray  # unit normal (3,)
    height: float  # of the plane above the base [m]
    square: float  # width of the squares [m]
    grid: np.ndarray  # ends of the lines between the squares (lines, 2, 3) [m]

    def below(self, points: np.ndarray) -> np.ndarray:
        """Return the shadows (..., 3) [m] of points (..., 3) [m] on the floor."""
        return np.asarray(points - (points @ self.up - self.height)[..., np.newaxis] * self.up)


def floor_of(robot: Robot, points: np.ndarray) -> _Floor:
    """Return the floor of a robot below points (..., 3) [m], with a grid of squares 10^k m wide, k an integer."""
    up, length = upwards(robot), reach(robot)
    height = min(0.0, float((points @ up).min()))
    square = 10.0 ** np.floor(np.log10(0.3 * length))
    first = across(up)
    second = np.cross(up, first)
    flat = np.stack([points.reshape(-1, len(up)) @ first, points.reshape(-1, len(up)) @ second])
    low, high = np.floor(flat.min(axis=1) / square) - 1.0, np.ceil(flat.max(axis=1) / square) + 1.0
    lines = [
        [square * (end * along + place * beside) + height * up for end in (low[a], high[a])]
        for along, beside, a, b in ((first, second, 0, 1), (second, first, 1, 0))
        for place in np.arange(low[b], high[b] + 1.0)
    ]
    return _Floor(up, height, float(square), np.array(lines))


def poses_of(robot: Robot, q: np.ndarray) -> Poses:
    """Return base, joints, tip and axes of a robot at joint angles q (..., n) [rad]."""
    now = frames(robot, q)
    base = np.zeros_like(now.tip)[..., np.newaxis, :]
    return Poses(np.concatenate([base, now.origin, now.tip[..., np.newaxis, :]], axis=-2), now.axes)


def across(axis: np.ndarray) -> np.ndarray:
    """Return a unit vector (3,) at a right angle to an axis (3,)."""
    return _unit(np.cross(axis, np.eye(len(axis))[np.argmin(np.abs(axis))]))


def in_space(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 2 or 3) as (..., 3): two coordinates become points with z = 0."""
    return np.concatenate([vectors, np.zeros((*vectors.shape[:-1], 3 - vectors.shape[-1]))], axis=-1)


def looking_at(robot: Robot, path: np.ndarray) -> Camera:
    """Return a camera for a robot whose tip follows a path (n, 3) [m]; the caller scales it by `Camera.fitted`."""
    up, middle = upwards(robot), path.mean(axis=0)
    forwards = _unit(middle - (middle @ up) * up)
    if not forwards.any():  # the path is above or below the base
        forwards = across(up)
    side = np.cross(forwards, up)
    normal = _normal(path, reach(robot))
    normal = normal * np.sign(normal @ (forwards + 2.0 * side + 3.0 * up))
    normal = normal - min(float(normal @ up), 0.0) * up  # never from below
    towards = _unit(_unit(side + normal) + _ELEVATION * up)
    right = _unit(np.cross(up, towards))
    down = np.cross(-towards, right)
    eye = 0.5 * middle + _DISTANCE * reach(robot) * towards
    return Camera(eye, np.stack([right, down, -towards]))


def _normal(path: np.ndarray, length: float) -> np.ndarray:
    """Return the unit normal (3,) of the plane of a path, zero for a straight path or one that is not planar."""
    _, sizes, rows = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)
    if len(sizes) < 3 or sizes[1] < _LEVEL * np.sqrt(len(path)) * length or sizes[2] > 0.5 * sizes[1]:
        return np.zeros(3)
    return np.asarray(rows[-1])


def _unit(vector: np.ndarray) -> np.ndarray:
    """Return a vector (3,) scaled to length 1; zero for a vector that is zero up to rounding."""
    length = np.linalg.norm(vector)
    return np.asarray(vector / length if length > _LEVEL else np.zeros_like(vector))
