"""The reference of any robot along a spline of its joint angles.

    q(t) = c(s(t)),  q̇ = c' ṡ,  q̈ = c'' ṡ² + c' s̈

c is the cubic spline through given postures (`paths.Spline` in the space of the joints): twice continuously
differentiable, and s(t) of `time_law` lets it begin and end at rest.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import LINEAR, chain, jacobian
from fuzzyarm.envs.scenario.paths import MOST_WAYPOINTS, chord_spline
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, Reference, ReferenceSample, TipSample
from fuzzyarm.envs.scenario.robot_limits import check_angles, check_velocities, checked_angles
from fuzzyarm.envs.scenario.time_law import LONGEST, SHORTEST, along, corner_times, quintic_time_law
from fuzzyarm.envs.scenario.tip_reference import upward_normals

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["MINIMUM_TURN", "SplineReference"]

MINIMUM_TURN = 1e-6  # rad by which neighbouring postures must differ


@dataclasses.dataclass(frozen=True)
class SplineReference(Reference):
    """Joint motion through given postures, from rest at the first to rest at the last.

    Attributes:
        waypoints: two or more postures of n angles [rad] each (any sequence or array of shape (k, n)); two give a
            straight line in the space of the joints. s is proportional to the summed distances between them.
        duration: T [s], 1e-6 to 1e6.
        robot: the robot.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a value is out of range, neighbours coincide, or the motion passes the range of a joint or the limit
            of its velocity; the message says when, at which joint, by how much, and what to change.
    """

    waypoints: tuple[tuple[float, ...], ...]
    duration: float
    robot: Robot

    def __post_init__(self) -> None:
        """Check the values, then the whole motion at `CHECKED_INSTANTS` instants."""
        checks.instance("robot", self.robot, Robot)
        _keep(self, "duration", checks.real("duration", self.duration, "s", low=SHORTEST, high=LONGEST))
        if not isinstance(self.waypoints, Sequence | np.ndarray) or isinstance(self.waypoints, str):
            raise TypeError(f"waypoints = {checks.shown(self.waypoints)} must be a sequence of postures [rad]")
        if not 2 <= len(self.waypoints) <= MOST_WAYPOINTS:
            raise ValueError(f"waypoints holds {len(self.waypoints)} postures; allowed: 2 to {MOST_WAYPOINTS}")
        postures = tuple(checked_angles(f"waypoints[{k}]", q, self.robot) for k, q in enumerate(self.waypoints))
        _keep(self, "waypoints", postures)
        for k, turn in enumerate(np.linalg.norm(np.diff(postures, axis=0), axis=1)):
            if turn < MINIMUM_TURN:
                raise ValueError(
                    f"waypoints[{k}] and waypoints[{k + 1}] are {turn:.3g} rad apart; allowed: {MINIMUM_TURN:g} rad or "
                    "more. Leave one of them out"
                )
        t = np.linspace(0.0, self.duration, CHECKED_INSTANTS)
        motion = self.sample(t)
        check_angles(self.robot, t, motion.q, "Add waypoints where the spline swings too far, or move them inwards")
        check_velocities(self.robot, t, motion.dq, self.duration)

    @property
    def joints(self) -> int:
        """The joints of the robot."""
        return len(self.robot)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return q, q̇ and q̈, shapes (..., n), at times t [s] of shape (...,)."""
        return ReferenceSample(*along(self, t, self.duration))

    def tip(self, t: ArrayLike) -> TipSample:
        """Return position x(q) [m] and velocity J q̇ [m/s] of the tip, shapes (..., 3), at times t [s] (...)."""
        q, dq, _ = self.sample(t)
        now = chain(self.robot, q)
        return TipSample(now.tip, _tip_rate(jacobian(now), dq))

    def normals(self, t: ArrayLike) -> np.ndarray:
        """Return `upward_normals` (..., 3) of the curve of the tip."""
        q, dq, _ = self.points(quintic_time_law(t, self.duration)[0])
        return upward_normals(_tip_rate(jacobian(chain(self.robot, q)), dq), self.robot)

    def points(self, s: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return c, dc/ds and d²c/ds² [rad], each of shape (..., n), for s of shape (...,) in [0, 1]."""
        s, spline = np.asarray(s, dtype=float), self._spline
        return spline(s), spline(s, 1), spline(s, 2)

    def corners(self) -> np.ndarray:
        """Return the times [s] at which q̈ has a corner, ascending: the ends and the inner postures."""
        return corner_times(self._spline.x[1:-1], self.duration)

    @functools.cached_property
    def _spline(self) -> CubicSpline:
        return chord_spline(np.array(self.waypoints))


def _tip_rate(rows: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Return J_v q̇ (..., 3)."""
    return np.asarray(np.einsum("...ij,...j->...i", rows[..., LINEAR, :], dq))


def _keep(reference: object, name: str, value: Any) -> None:
    object.__setattr__(reference, name, value)
