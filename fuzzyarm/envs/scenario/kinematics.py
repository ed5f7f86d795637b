"""Kinematics of a robot: position of the tip, rotation of the last link, their derivatives, and the inverse.

With the axis z_i and the origin p_i of joint i, and the tip p, in the base frame:

    J = [z_i × (p - p_i); z_i],      (v, ω) = J q̇,      (v̇, ω̇) = J q̈ + J̇ q̇

The posture that puts the tip on a point p solves one square system of equations:

    f(q, p) = (P (x(q) - p), O log(R(q) R_0ᵀ), Nᵀ (q - q_0)) = 0,        A = ∂f/∂q = (P J_v, O J_ω, Nᵀ)

x and R are the position of the tip and the rotation of the last link. P projects onto the directions in which the tip
can move (two for a planar robot, else three), O onto the axes about which the last link can turn (one or three).

- Orientation: if there are enough joints, the last link keeps its initial rotation R_0; otherwise, or if it may turn
  freely, O has no rows.
- Redundancy: the columns of N span the joint motions that change neither of the first two parts of f at the first
  posture q_0. These motions stay zero, so that a closed path brings all joints back.
- Branch: q follows the solution continuously from q_0; along the way, A must not come close to a singular matrix.

The default first posture is dexterous (Yoshikawa, 1985, with lengths divided by the robot's reach), needs little
torque, and is far from the joint limits:

    home = argmax of  log √det(J Jᵀ) - |g(q)/Γ_max|² - mean(((q - middle)/half range)²),   half ranges at most π

The best posture found is rounded to `_ROUNDED` decimals, and thus the same on every machine.
"""

import functools
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.physics.rigid_body import Frames, frames, gravity
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.numbers import linear

__all__ = [
    "LINEAR", "TipTask", "angle_ranges", "freedom", "home_posture", "jacobian", "link_lengths", "reach", "solved",
    "start_posture", "upwards", "velocity_limits",
]  # fmt: skip

LINEAR, _ANGULAR = slice(0, 3), slice(3, 6)  # rows of the Jacobian: velocity of the tip, angular velocity


def jacobian(now: Frames) -> np.ndarray:
    """Return J (..., 6, n) for frames `now`: three rows [m] for the tip's velocity, three [1] for the angular one."""
    linear = np.cross(now.axes, now.tip[..., np.newaxis, :] - now.origin)
    return np.swapaxes(np.concatenate([linear, now.axes], axis=-1), -1, -2)


def _drift(now: Frames, dq: np.ndarray) -> np.ndarray:
    """Return J̇ q̇ (..., 6), accelerations of tip [m/s²] and last link [rad/s²] at q̈ = 0, for dq (..., n) [rad/s]."""
    zero = np.zeros_like(now.tip)
    turning, angular, linear = zero, zero, zero  # ω, ω̇ and the acceleration of the point reached so far
    places = [*np.moveaxis(now.origin, -2, 0), now.tip]
    for number, axis in enumerate(np.moveaxis(now.axes, -2, 0)):
        swing = axis * dq[..., number, np.newaxis]
        angular = angular + np.cross(turning, swing)
        turning = turning + swing
        lever = places[number + 1] - places[number]
        linear = linear + np.cross(angular, lever) + np.cross(turning, np.cross(turning, lever))
    return np.concatenate([linear, angular], axis=-1)


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Return axis times angle (..., 3) [rad] of rotations (..., 3, 3), angles of at most π."""
    rows, columns = [2, 0, 1], [1, 2, 0]
    twice_sine = rotation[..., rows, columns] - rotation[..., columns, rows]
    sine = 0.5 * np.linalg.norm(twice_sine, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0))
    factor = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)
    return np.asarray(0.5 * factor[..., np.newaxis] * twice_sine)


def reach(robot: Robot) -> float:
    """Return the sum [m] of `link_lengths`, an upper bound on the tip's distance from the first joint."""
    return float(np.sum(link_lengths(robot)))


def link_lengths(robot: Robot) -> np.ndarray:
    """Return the distances (n,) [m] from each joint to the next, and from the last joint to the tip."""
    return np.asarray(np.linalg.norm([*robot.arrays.position[1:], robot.arrays.tip], axis=-1))


def upwards(robot: Robot) -> np.ndarray:
    """Return the unit vector (3,) against gravity, or along z without gravity."""
    gravity = robot.arrays.gravity
    return -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])


def angle_ranges(robot: Robot) -> np.ndarray:
    """Return the lowest and the highest joint angles [rad] as rows, shape (2, n)."""
    return np.array([joint.angle_range for joint in robot.joints]).T


def velocity_limits(robot: Robot) -> np.ndarray:
    """Return the largest joint velocities (n,) [rad/s]."""
    return np.array([joint.velocity_limit for joint in robot.joints])


_SPAN_POSTURES, _SPAN_SEED = 8, 2022  # postures from which the possible motions of the tip are found
_NEGLIGIBLE = 1e-9  # share of the largest singular value that counts as zero
_NEAR = 1e-4  # [m, rad], residual of least squares up to which Newton's steps follow


class _Freedom(NamedTuple):
    """Orthonormal directions in which the tip of a robot can move, and axes about which its last link can turn."""

    motion: np.ndarray  # P (2 or 3, 3)
    turning: np.ndarray  # (1 or 3, 3)


@functools.lru_cache(maxsize=64)
def freedom(robot: Robot) -> _Freedom:
    """Return the directions in which the tip of a robot can move, and the axes about which its last link can turn."""
    low, high = angle_ranges(robot)
    q = np.random.default_rng(_SPAN_SEED).uniform(low, high, (_SPAN_POSTURES, len(robot)))
    rows = jacobian(frames(robot, q))
    return _Freedom(_span(rows[:, LINEAR]), _span(rows[:, _ANGULAR]))


class TipTask:
    """The system f(q, p) = 0 of the module, for a robot and a first posture q_0 (n,) [rad].

    Attributes:
        motion: P (2 or 3, 3), directions in which the tip can move.
        turning: O (0, 1 or 3, 3), axes about which the last link can turn; no rows if the orientation is free.
        rotation: R_0 (3, 3), rotation of the last link at q_0.
        frozen: Nᵀ (n - rows of P and O, n), the joint motions that stay zero.
    """

    def __init__(self, robot: Robot, start: np.ndarray, keeps_orientation: bool) -> None:
        self.robot, self.start, can, now = robot, start, freedom(robot), frames(robot, start)
        self.motion, self.turning = can.motion, can.turning if keeps_orientation else can.turning[:0]
        self.rotation, rows = now.rotation[-1], self._moving(now)
        self.frozen: np.ndarray = np.linalg.svd(rows)[2][len(rows) :]

    def residual(self, now: Frames, q: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Return the residual f(q, p) (..., n) [m, rad] at q (..., n), with frames `now` and points p (..., 3) [m]."""
        turned = _rotation_vector(now.rotation[..., -1, :, :] @ self.rotation.T) @ self.turning.T
        return np.concatenate([(now.tip - point) @ self.motion.T, turned, (q - self.start) @ self.frozen.T], axis=-1)

    def matrix(self, now: Frames) -> np.ndarray:
        """Return the matrix A = ∂f/∂q (..., n, n) of the module's docstring in a posture with the frames `now`."""
        rows = self._moving(now)
        frozen = np.broadcast_to(self.frozen, (*rows.shape[:-2], *self.frozen.shape))
        return np.concatenate([rows, frozen], axis=-2)

    def refined(self, q: np.ndarray, point: np.ndarray, rounds: int) -> np.ndarray:
        """Return angles (..., n) [rad]: `q` after `rounds` Newton steps for f(q, p) = 0, with points p (..., 3) [m]."""
        for _ in range(rounds):
            now = frames(self.robot, q)
            q = q - solved(self.matrix(now), self.residual(now, q, point))
        return q

    def moved(self, linear: np.ndarray) -> np.ndarray:
        """Return (P v, 0, 0), shape (..., n), which A q̇ must equal for tip velocities v (..., 3) [m/s]."""
        wanted = linear @ self.motion.T
        rest = len(self.start) - wanted.shape[-1]
        return np.concatenate([wanted, np.zeros((*wanted.shape[:-1], rest))], axis=-1)

    def drifting(self, now: Frames, dq: np.ndarray) -> np.ndarray:
        """Return Ȧ q̇ (..., n), with A of the module, at joint velocities q̇ (..., n) [rad/s]."""
        rate = _drift(now, dq)
        parts = [rate[..., LINEAR] @ self.motion.T, rate[..., _ANGULAR] @ self.turning.T]
        return np.concatenate([*parts, np.zeros((*rate.shape[:-1], len(self.frozen)))], axis=-1)

    def sharpness(self, now: Frames) -> np.ndarray:
        """Return A's smallest singular value (...), with lengths divided by the robot's reach; 0 if A is singular."""
        matrix = self.matrix(now)
        matrix[..., : len(self.motion), :] /= reach(self.robot)
        return np.asarray(np.linalg.svd(matrix, compute_uv=False)[..., -1])

    def _moving(self, now: Frames) -> np.ndarray:
        """Return the rows P J_v and O J_ω of A, (..., rows, n)."""
        rows = jacobian(now)
        return np.concatenate([self.motion @ rows[..., LINEAR, :], self.turning @ rows[..., _ANGULAR, :]], axis=-2)


def start_posture(
    robot: Robot, near: np.ndarray, point: np.ndarray, keeps_orientation: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return a first posture (n,) [rad] within the joints' ranges, and its residual (m,) [m, rad], zero if it is valid.

    It is found by bounded least squares from `near` (n,), with the tip at `point` (3,) [m]; if the orientation is kept,
    the last link keeps its rotation at `near`.
    """
    from scipy.optimize import least_squares  # SciPy is only needed here

    task = TipTask(robot, near, keeps_orientation)
    moving = len(task.motion) + len(task.turning)
    low, high = angle_ranges(robot)

    def missed(q: np.ndarray) -> np.ndarray:
        return task.residual(frames(robot, q), q, point)[:moving]

    def slope(q: np.ndarray) -> np.ndarray:
        return task.matrix(frames(robot, q))[:moving]

    found = least_squares(missed, near, slope, bounds=(low, high), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=1.0)
    q = np.array(found.x)
    if np.abs(missed(q)).max() > _NEAR:
        return q, missed(q)  # out of reach: Newton's steps would leave the closest posture
    for _ in range(3):  # to the last digit
        q = q - np.linalg.lstsq(slope(q), missed(q), rcond=None)[0]
    return q, missed(q)


def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return A⁻¹ b (..., n) for matrices A (..., n, n) and b (..., n); numpy.linalg.LinAlgError if A is singular."""
    found = linear.solved(matrix, right[..., np.newaxis])[..., 0]
    if not np.isfinite(found).all():
        raise np.linalg.LinAlgError("a posture of the arm is singular: its Jacobian has no inverse; move the path")
    return found


def _span(columns: np.ndarray) -> np.ndarray:
    """Return orthonormal rows (d, 3) that span all columns of matrices (k, 3, n)."""
    left, sizes, _ = np.linalg.svd(np.concatenate(list(columns), axis=-1))
    kept = left.T[: int(np.sum(sizes > _NEGLIGIBLE * sizes[0]))]
    # Coordinate axes, if they span the same space, so that planar robots compute with zeros and ones.
    axes = np.eye(3)[np.abs(kept.T @ kept @ np.eye(3) - np.eye(3)).max(axis=0) < _NEGLIGIBLE]
    return axes if len(axes) == len(kept) else kept


_POSTURES, _IMPROVED, _SEED = 2000, 5, 2022
_INSIDE = 0.9  # share of the half ranges that is searched
_DIFFERENCE = 1e-6  # step of the central differences, as a share
_ROUNDED = 2  # decimals
_SINGULAR = 1e-300  # stands for a determinant of zero


@functools.lru_cache(maxsize=64)
def home_posture(robot: Robot) -> tuple[float, ...]:
    """Return a robot's default initial posture (n,) [rad], by the rule in the module's docstring."""
    from scipy.optimize import minimize  # SciPy is only needed here

    low, high = angle_ranges(robot)
    middle, half = 0.5 * (low + high), np.minimum(0.5 * (high - low), np.pi)
    limit, can, length = robot.drive("torque_limit"), freedom(robot), reach(robot)
    turns = len(robot) >= len(can.motion) + len(can.turning)

    def cost(shares: np.ndarray) -> np.ndarray:
        """Return the cost (...) to be minimised, at angles middle + shares × half range, shares (..., n)."""
        q = middle + half * shares
        rows = jacobian(frames(robot, q))
        parts = [can.motion @ rows[..., LINEAR, :] / length, *([can.turning @ rows[..., _ANGULAR, :]] if turns else [])]
        moving = np.concatenate(parts, axis=-2)
        sizes = np.linalg.det(moving @ np.swapaxes(moving, -1, -2))
        dexterity = 0.5 * np.log(np.maximum(sizes, _SINGULAR))
        strain = np.sum((gravity(robot, q) / limit) ** 2, axis=-1)
        return np.asarray(strain + np.mean(shares**2, axis=-1) - dexterity)

    def slope(shares: np.ndarray) -> np.ndarray:
        """Return the derivative (n,) of the cost at shares (n,), by central differences."""
        steps = _DIFFERENCE * np.eye(len(shares))
        return np.asarray((cost(shares + steps) - cost(shares - steps)) / (2.0 * _DIFFERENCE))

    tried = np.random.default_rng(_SEED).uniform(-_INSIDE, _INSIDE, (_POSTURES, len(robot)))
    bounds = [(-_INSIDE, _INSIDE)] * len(robot)
    best = [
        minimize(cost, tried[number], jac=slope, method="L-BFGS-B", bounds=bounds)
        for number in np.argsort(cost(tried))[:_IMPROVED]
    ]
    shares = min(best, key=lambda found: float(found.fun)).x
    return tuple((np.round(middle + half * shares, _ROUNDED) + 0.0).tolist())
