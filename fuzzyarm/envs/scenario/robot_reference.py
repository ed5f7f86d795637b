"""References of any robot: along a path of its tip in space, or along a spline of its joint angles.

Along a path of the tip, by inverse kinematics, with f, A and the projection P of `kinematics`,

    f(q, p(s(t))) = 0,      A q̇ = (P ṗ, 0, 0),      A q̈ = (P p̈, 0, 0) - Ȧ q̇

The branch is followed once, in steps of s; then Newton's method corrects an interpolation to the last digit, so that
every value depends only on its t. Along a twice continuously differentiable spline c through given postures,

    q(t) = c(s(t)),  q̇ = c' ṡ,  q̈ = c'' ṡ² + c' s̈
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.rigid_body import Frames, frames
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import (
    LINEAR,
    TipTask,
    angle_ranges,
    freedom,
    home_posture,
    jacobian,
    reach,
    solved,
    start_posture,
    upwards,
    velocity_limits,
)
from fuzzyarm.envs.scenario.paths import MOST_WAYPOINTS, Placed, TipPath, chord_spline
from fuzzyarm.envs.scenario.reference import (
    CHECKED_INSTANTS,
    LONGEST,
    SHORTEST,
    PathReference,
    Reference,
    ReferenceSample,
    TipSample,
    along,
    check_limits,
    corner_times,
    quintic_time_law,
    time_at,
)

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

__all__ = ["EXACT", "SplineReference", "TipReference"]


def _checked_angles(name: str, values: object, robot: Robot) -> tuple[float, ...]:
    """Return angles [rad], one for each joint; ValueError if one is outside its joint's range."""
    angles = checks.reals(name, values, len(robot), "rad")
    for angle, joint in zip(angles, robot.joints, strict=True):
        low, high = joint.angle_range
        if not low <= angle <= high:
            raise ValueError(
                f"{name}: {joint.name} = {angle:.6g} rad is out of range; allowed: [{low:.6g}, {high:.6g}] rad"
            )
    return angles


def _check_limits(robot: Robot, t: np.ndarray, motion: ReferenceSample, advice: str) -> None:
    low, high = angle_ranges(robot)
    check_limits([joint.name for joint in robot.joints], (low, high, velocity_limits(robot)), t, motion, advice)


_STEPS = np.linspace(0.0, 1.0, 81)  # values of s; the branch is followed from each to the next
_NODES = np.linspace(0.0, 1.0, 321)  # values of s between which the posture is interpolated and then corrected
_ROUNDS = 2  # of Newton's method between nodes
_TRIES = 8  # rounds from one step to the next, before the path counts as lost
EXACT = 1e-10  # m or rad, largest error of an inverse
_LONGEST_STEP = 0.5  # rad that a joint may move in a step

_SHARPEST = 0.01
"""Smallest singular value allowed for A along a path, with lengths in reaches.

For two equal links the value is 0.04 to 0.08 sin q2, for a wrist of three axes about 0.7 times the middle angle.
"""


@dataclasses.dataclass(frozen=True)
class TipReference(PathReference):
    """Joint motion that moves the tip of a robot along a path in space, from rest to rest.

    Attributes:
        path: tip curve with points (..., 3) [m] in the base frame: `Line` and `Spline` of triples, or `Placed`.
        duration: T [s], 1e-6 to 1e6.
        robot: the robot.
        posture: joint angles [rad] near which the first posture is sought; they determine the branch, such as elbow up
            or down, and the rotation of the last link. None: `kinematics.home_posture`.
        orientation: ``"constant"``, the last link keeps its rotation if the robot has enough joints (six in space,
            three in a plane); or ``"free"``.

    Raises:
        ValueError: a value is out of range; or the path cannot be followed: it is not entirely within reach,
            comes too close to a singular posture (`_SHARPEST`), or exceeds an angle or velocity limit of a joint. The
            message states when, where, at which joint, by how much, and what to change.
    """

    path: TipPath
    duration: float
    robot: Robot
    posture: tuple[float, ...] | None = None
    orientation: Literal["constant", "free"] = "constant"

    def __post_init__(self) -> None:
        checks.instance("robot", self.robot, Robot)
        checks.choice("orientation", self.orientation, ("constant", "free"))
        posture = home_posture(self.robot) if self.posture is None else self.posture
        checks.keep(self, "posture", _checked_angles("posture", posture, self.robot))
        t = self.checked_instants(3)
        self._check_plane(t, self.tip(t).position)
        motion = self.sample(t)
        self._check_sharpness(t, motion.q)
        _check_limits(self.robot, t, motion, "Move or shrink the path, or start from another `posture`")

    @property
    def keeps_orientation(self) -> bool:
        """Whether the last link keeps its rotation along the path."""
        can = freedom(self.robot)
        return self.orientation == "constant" and len(self.robot) >= len(can.motion) + len(can.turning)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return q, q̇ = A⁻¹ (P ṗ, 0, 0) and q̈, shapes (..., n), at times t [s] (...,); A and P as in `kinematics`."""
        position, velocity, acceleration = along(self.path, t, self.duration)
        task, s = self._task, quintic_time_law(t, self.duration)[0]
        q = task.refined(self._followed(s), position, _ROUNDS)
        now = frames(self.robot, q)
        matrix = task.matrix(now)
        dq = solved(matrix, task.moved(velocity))
        return ReferenceSample(q, dq, solved(matrix, task.moved(acceleration) - task.drifting(now, dq)))

    def normals(self, t: ArrayLike) -> np.ndarray:
        """Return unit normals (..., 3): the left ones of a plane curve that is `Placed`, else `_upward_normals`."""
        s = quintic_time_law(t, self.duration)[0]
        if isinstance(self.path, Placed):
            return self.path.normals(s)
        return _upward_normals(self.path.points(s)[1], self.robot)

    @functools.cached_property
    def _task(self) -> TipTask:
        """The equations for a posture on the path; q_0 of `TipTask` has the tip at the start of the path."""
        point = self.path.points(0.0)[0]
        near = np.array(self.posture)
        q, missed = start_posture(self.robot, near, point, self.keeps_orientation)
        if not np.abs(missed).max() <= EXACT:
            shortest = float(np.linalg.norm(point - self.robot.arrays.position[0]))
            raise ValueError(
                f"the path starts out of reach: point {_shown(point)} m is {shortest:.6g} m from the first joint of "
                f"{self.robot.name}, whose links are {reach(self.robot):.6g} m long in total; from posture = "
                f"{_shown(near)} rad the tip comes within {np.linalg.norm(frames(self.robot, q).tip - point):.3g} m of "
                f"it{' with the orientation kept' if self.keeps_orientation else ''}. Move the path, or start from "
                f"another `posture`{self._or_free}"
            )
        return TipTask(self.robot, q, self.keeps_orientation)

    @functools.cached_property
    def _followed(self) -> CubicHermiteSpline:
        """A spline in s of the joint angles [rad], found at `_STEPS` one after the other, then refined at `_NODES`."""
        from scipy.interpolate import CubicHermiteSpline  # SciPy is only needed here

        points, tangents, _ = self.path.points(_STEPS)
        postures, slopes = [self._task.start], [self._slope(self._task.start, tangents[0])]
        for k in range(1, len(_STEPS)):
            step = (_STEPS[k] - _STEPS[k - 1]) * slopes[-1]
            if not np.abs(step).max() <= _LONGEST_STEP:
                turn = f"would turn by {np.abs(step).max():.3g} rad in a step; allowed: {_LONGEST_STEP:g} rad"
                raise self._lost(k - 1, postures[-1], f"{self._joint(step)} {turn}")
            postures.append(self._corrected(k, postures[-1], step, points[k]))
            slopes.append(self._slope(postures[-1], tangents[k]))
        coarse = CubicHermiteSpline(_STEPS, np.array(postures), np.array(slopes))
        points, tangents, _ = self.path.points(_NODES)
        nodes = self._task.refined(coarse(_NODES), points, _ROUNDS)
        return CubicHermiteSpline(_NODES, nodes, self._slope(nodes, tangents))

    def _slope(self, q: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        """Return dq/ds (..., n) at postures (..., n) where dp/ds is the tangent (..., 3)."""
        return solved(self._task.matrix(frames(self.robot, q)), self._task.moved(tangent))

    def _corrected(self, k: int, before: np.ndarray, step: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Return posture k (n,), with the tip at `point` (3,) [m]; ValueError if Newton's method finds none.

        The search starts at the previous posture `before` plus `step`.
        """
        q = before + step
        for _ in range(_TRIES):
            with np.errstate(all="ignore"):
                try:
                    after = self._task.refined(q, point, 1)
                except np.linalg.LinAlgError:
                    break
            if not np.abs(after - before).max() <= 2.0 * _LONGEST_STEP:
                break
            if np.abs(after - q).max() <= EXACT:
                return after
            q = after
        tip = _shown(frames(self.robot, before).tip)
        raise self._lost(k, before, f"the search that starts with the tip at {tip} m found no posture for this point")

    def _lost(self, k: int, q: np.ndarray, reason: str) -> ValueError:
        """Return the error for a path that cannot be followed to or beyond step k from the posture q (n,)."""
        time, point = float(time_at(_STEPS[k], self.duration)), self.path.points(_STEPS[k])[0]
        sharp = float(self._task.sharpness(frames(self.robot, q)))
        return ValueError(
            f"the path cannot be followed at t = {time:.4g} s, point {_shown(point)} m: {reason} (the smallest "
            f"singular value of the scaled extended Jacobian is {sharp:.2g}). Move or shrink the path, or start from "
            f"another `posture`{self._or_free}"
        )

    @property
    def _or_free(self) -> str:
        """The end of an error message: the advice to leave the orientation free; empty if it is free."""
        return ", or leave the orientation free (orientation='free')" if self.keeps_orientation else ""

    def _check_plane(self, t: np.ndarray, position: np.ndarray) -> None:
        """Raise ValueError if the path leaves the plane in which the tip of a planar robot moves."""
        across = np.eye(3) - self._task.motion.T @ self._task.motion
        beside = np.linalg.norm((position - frames(self.robot, self._task.start).tip) @ across, axis=-1)
        k = int(np.argmax(beside))
        if beside[k] > EXACT:
            raise ValueError(
                f"{self.robot.name} is planar: its tip cannot reach point {_shown(position[k])} m at t = {t[k]:.4g} s, "
                f"which is {beside[k]:.3g} m off its plane. Move or turn the path into the plane"
            )

    def _check_sharpness(self, t: np.ndarray, q: np.ndarray) -> None:
        now = frames(self.robot, q)
        sharp = self._task.sharpness(now)
        k = int(np.argmin(sharp))
        if not sharp[k] >= _SHARPEST:
            _, _, directions = np.linalg.svd(self._task.matrix(Frames(*(part[k] for part in now))))
            raise ValueError(
                f"the path comes too close to a singular posture at t = {t[k]:.4g} s, point {_shown(now.tip[k])} m: "
                f"the smallest singular value of the scaled extended Jacobian is {sharp[k]:.2g}; allowed: {_SHARPEST} "
                f"or more. There {self._joint(directions[-1])} can turn most while the tip stays. Move or shrink the "
                f"path, or start from another `posture`{self._or_free}"
            )

    def _joint(self, motion: np.ndarray) -> str:
        """Return the name of the joint that a motion (n,) turns most."""
        return self.robot.joints[int(np.argmax(np.abs(motion)))].name


def _upward_normals(tangents: np.ndarray, robot: Robot) -> np.ndarray:
    """Return unit normals (..., 3) of a curve with these tangents (..., 3), upwards against the robot's gravity.

    Where the curve is vertical, they are sideways, along x or y.
    """
    up = upwards(robot)
    aside = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    along_curve = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
    normals = []
    for wanted in (up, aside):
        across = wanted - np.sum(along_curve * wanted, axis=-1, keepdims=True) * along_curve
        normals.append((across, np.linalg.norm(across, axis=-1, keepdims=True)))
    (upward, size), (sideways, other) = normals
    return np.asarray(np.where(size > 1e-6, upward / np.maximum(size, 1e-6), sideways / np.maximum(other, 1e-6)))


def _shown(values: Any) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"


_MINIMUM_TURN = 1e-6  # rad by which neighbouring postures must differ


@dataclasses.dataclass(frozen=True)
class SplineReference(Reference):
    """Joint motion through given postures, from rest at the first to rest at the last.

    Attributes:
        waypoints: two or more postures of n angles [rad] each (any sequence or array of shape (k, n)); two give a
            straight line in joint space. At each posture, the path parameter s is proportional to the distance so far.
        duration: T [s], 1e-6 to 1e6.
        robot: the robot.

    Raises:
        ValueError: a value is out of range, neighbours coincide, or the motion exceeds an angle or velocity limit of a
            joint. The message states when, at which joint, by how much, and what to change.
    """

    waypoints: tuple[tuple[float, ...], ...]
    duration: float
    robot: Robot

    def __post_init__(self) -> None:
        checks.instance("robot", self.robot, Robot)
        checks.keep(self, "duration", checks.real("duration", self.duration, "s", low=SHORTEST, high=LONGEST))
        if not isinstance(self.waypoints, Sequence | np.ndarray) or isinstance(self.waypoints, str):
            raise TypeError(f"waypoints = {checks.shown(self.waypoints)} must be a sequence of postures [rad]")
        if not 2 <= len(self.waypoints) <= MOST_WAYPOINTS:
            raise ValueError(f"the number of waypoints is {len(self.waypoints)}; allowed: 2 to {MOST_WAYPOINTS}")
        postures = tuple(_checked_angles(f"waypoints[{k}]", q, self.robot) for k, q in enumerate(self.waypoints))
        checks.keep(self, "waypoints", postures)
        for k, turn in enumerate(np.linalg.norm(np.diff(postures, axis=0), axis=1)):
            if turn < _MINIMUM_TURN:
                raise ValueError(
                    f"waypoints[{k}] and waypoints[{k + 1}] are {turn:.3g} rad apart; allowed: {_MINIMUM_TURN:g} rad "
                    "or more. Leave one of them out"
                )
        t = np.linspace(0.0, self.duration, CHECKED_INSTANTS)
        advice = "Add waypoints where the spline swings too far, or move them inwards"
        _check_limits(self.robot, t, self.sample(t), advice)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return q, q̇ and q̈, shapes (..., n), at times t [s] of shape (...,)."""
        return ReferenceSample(*along(self, t, self.duration))

    def tip(self, t: ArrayLike) -> TipSample:
        """Return position x(q) [m] and velocity J q̇ [m/s] of the tip, shapes (..., 3), at times t [s] (...)."""
        q, dq, _ = self.sample(t)
        now = frames(self.robot, q)
        return TipSample(now.tip, _tip_rate(jacobian(now), dq))

    def normals(self, t: ArrayLike) -> np.ndarray:
        """Return upward unit normals (..., 3) of the tip's curve at times t [s] (...,), see `_upward_normals`."""
        q, dq, _ = self.points(quintic_time_law(t, self.duration)[0])
        return _upward_normals(_tip_rate(jacobian(frames(self.robot, q)), dq), self.robot)

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
    """Return the tip's velocity (..., 3) [m/s] from the Jacobian `rows` (..., 6, n) and joint velocities (..., n)."""
    return np.asarray(np.einsum("...ij,...j->...i", rows[..., LINEAR, :], dq))
