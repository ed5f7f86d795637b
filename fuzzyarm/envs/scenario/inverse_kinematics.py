"""Inverse kinematics of any robot: the posture that puts the tip on a point, as one square system of equations.

    f(q, p) = (P (x(q) - p), O log(R(q) R_0ᵀ), Nᵀ (q - q_0)) = 0,        A = ∂f/∂q = (P J_v, O J_ω, Nᵀ)

x and R are position of the tip and rotation of the last link. P projects on what the tip can do (a plane for a planar
robot, else space), O on the directions about which the last link can turn (one for a planar robot, else three).

- Orientation: where there are joints enough, the last link keeps the rotation R_0 of the start; otherwise, or where it
  is told to be free, O has no rows.
- Redundancy: the columns of N span the motions that change neither at the start posture q_0. Those stay zero, so that a
  closed path brings all joints back.
- Branch: q follows the solution continuously from q_0; on its way A stays away from singular matrices.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import (
    ANGULAR,
    LINEAR,
    Chain,
    angle_ranges,
    chain,
    drift,
    jacobian,
    reach,
    rotation_vector,
)

__all__ = ["Freedom", "TipTask", "freedom", "solved", "start_posture"]

SPAN_POSTURES, SPAN_SEED = 8, 2022  # postures at which it is seen what the tip can do
NEGLIGIBLE = 1e-9  # share of the largest singular value that counts as zero
NEAR = 1e-4  # [m, rad], what least squares may miss where Newton's steps go on


@dataclasses.dataclass(frozen=True)
class Freedom:
    """What the last link of a robot can do: orthonormal directions of motion of the tip, and of turning."""

    motion: np.ndarray  # P (2 or 3, 3)
    turning: np.ndarray  # (1 or 3, 3)


@functools.lru_cache(maxsize=64)
def freedom(robot: Robot) -> Freedom:
    """Return along which directions the tip of a robot can move, and about which its last link can turn."""
    low, high = angle_ranges(robot)
    q = np.random.default_rng(SPAN_SEED).uniform(low, high, (SPAN_POSTURES, len(robot)))
    rows = jacobian(chain(robot, q))
    return Freedom(_span(rows[:, LINEAR]), _span(rows[:, ANGULAR]))


@dataclasses.dataclass(frozen=True)
class TipTask:
    """The system f(q, p) = 0 of the module, for a robot and a start.

    Attributes:
        robot: the robot.
        start: q_0 (n,) [rad].
        keeps_orientation: whether the last link keeps its rotation.
    """

    robot: Robot
    start: np.ndarray
    keeps_orientation: bool

    @functools.cached_property
    def motion(self) -> np.ndarray:
        """P (2 or 3, 3)."""
        return freedom(self.robot).motion

    @functools.cached_property
    def turning(self) -> np.ndarray:
        """O (0, 1 or 3, 3)."""
        turning = freedom(self.robot).turning
        return turning if self.keeps_orientation else turning[:0]

    @functools.cached_property
    def rotation(self) -> np.ndarray:
        """R_0 (3, 3), of the last link at the start."""
        return chain(self.robot, self.start).rotation

    @functools.cached_property
    def frozen(self) -> np.ndarray:
        """Nᵀ (n - rows of P and O, n)."""
        rows = self._moving(chain(self.robot, self.start))
        return np.linalg.svd(rows)[2][len(rows) :]

    def residual(self, q: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Return f (..., n), in m and rad, at angles (..., n) for points (..., 3) [m]."""
        return self._residual(chain(self.robot, q), q, point)

    def matrix(self, now: Chain) -> np.ndarray:
        """Return A (..., n, n)."""
        rows = self._moving(now)
        frozen = np.broadcast_to(self.frozen, (*rows.shape[:-2], *self.frozen.shape))
        return np.concatenate([rows, frozen], axis=-2)

    def refined(self, q: np.ndarray, point: np.ndarray, rounds: int) -> np.ndarray:
        """Return angles (..., n) [rad] after Newton steps q - A⁻¹ f."""
        for _ in range(rounds):
            now = chain(self.robot, q)
            q = q - solved(self.matrix(now), self._residual(now, q, point))
        return q

    def moved(self, linear: np.ndarray) -> np.ndarray:
        """Return the right-hand side (..., n) of A q̇ for tip velocities (..., 3) [m/s], the rest zero."""
        wanted = linear @ self.motion.T
        rest = len(self.start) - wanted.shape[-1]
        return np.concatenate([wanted, np.zeros((*wanted.shape[:-1], rest))], axis=-1)

    def drifting(self, now: Chain, dq: np.ndarray) -> np.ndarray:
        """Return Ȧ q̇ (..., n) at joint velocities (..., n) [rad/s]."""
        rate = drift(now, dq)
        parts = [rate[..., LINEAR] @ self.motion.T, rate[..., ANGULAR] @ self.turning.T]
        return np.concatenate([*parts, np.zeros((*rate.shape[:-1], len(self.frozen)))], axis=-1)

    def sharpness(self, now: Chain) -> np.ndarray:
        """Return the smallest singular value (...) of A, lengths in reaches of the robot; 0 where it is singular."""
        matrix = self.matrix(now)
        matrix[..., : len(self.motion), :] /= reach(self.robot)
        return np.asarray(np.linalg.svd(matrix, compute_uv=False)[..., -1])

    def _moving(self, now: Chain) -> np.ndarray:
        """Return the rows (..., P J_v and O J_ω, n)."""
        rows = jacobian(now)
        return np.concatenate([self.motion @ rows[..., LINEAR, :], self.turning @ rows[..., ANGULAR, :]], axis=-2)

    def _residual(self, now: Chain, q: np.ndarray, point: np.ndarray) -> np.ndarray:
        turned = rotation_vector(now.rotation @ self.rotation.T) @ self.turning.T
        return np.concatenate([(now.tip - point) @ self.motion.T, turned, (q - self.start) @ self.frozen.T], axis=-1)


def start_posture(
    robot: Robot, near: np.ndarray, point: np.ndarray, keeps_orientation: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return a posture (n,) [rad] within the joints' ranges and what it misses (m,) [m, rad]: zero if it is a start.

    It is found by bounded least squares from `near` (n,), whose rotation of the last link it has if it keeps the
    orientation; the tip is to be at `point` (3,) [m].
    """
    from scipy.optimize import least_squares  # SciPy is only needed here

    task = TipTask(robot, near, keeps_orientation)
    moving = len(task.motion) + len(task.turning)
    low, high = angle_ranges(robot)

    def missed(q: np.ndarray) -> np.ndarray:
        return task.residual(q, point)[:moving]

    def slope(q: np.ndarray) -> np.ndarray:
        return task.matrix(chain(robot, q))[:moving]

    found = least_squares(missed, near, slope, bounds=(low, high), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=1.0)
    q = np.array(found.x)
    if np.abs(missed(q)).max() > NEAR:
        return q, missed(q)  # out of reach: Newton's steps would leave the closest posture
    for _ in range(3):  # to the last digit
        q = q - np.linalg.lstsq(slope(q), missed(q), rcond=None)[0]
    return q, missed(q)


def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return A⁻¹ b, shapes (..., n, n) and (..., n)."""
    return np.asarray(np.linalg.solve(matrix, right[..., np.newaxis])[..., 0])


def _span(columns: np.ndarray) -> np.ndarray:
    """Return orthonormal rows (d, 3) that span all columns of matrices (k, 3, n)."""
    left, sizes, _ = np.linalg.svd(np.concatenate(list(columns), axis=-1))
    kept = left.T[: int(np.sum(sizes > NEGLIGIBLE * sizes[0]))]
    # The axes themselves where they span the same, so that planar robots compute with zeros and ones.
    axes = np.eye(3)[np.abs(kept.T @ kept @ np.eye(3) - np.eye(3)).max(axis=0) < NEGLIGIBLE]
    return axes if len(axes) == len(kept) else kept
