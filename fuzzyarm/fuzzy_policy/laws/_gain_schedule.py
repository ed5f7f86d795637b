"""Tabulation of the elastic observer's gains: angles, points and interpolation.

The mass matrix of the two-joint arm depends on cos q2 alone: its gains are tabulated at nine values of cos q2 and
interpolated linearly. A robot's gains are tabulated over the two angles on which its mass matrix depends most: those
with the largest normalised |E[M | q_j] - E[M]|², where E[M | q_j] is the mean over the other angles. Each angle has
eight points around the circle. The gains at a point are designed for the mean of M over the others, and are
interpolated linearly in each angle.
"""

import functools
import itertools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants
from fuzzyarm.envs.physics.dynamics import mass_matrix as two_joint_mass_matrix
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.numbers.functions import RECORDERS, floor, maximum, minimum, row, select

__all__ = [
    "GainSchedule", "corners_of", "loaded_inertia", "nearest_inertia", "on_table", "random_angles", "schedule_of",
]  # fmt: skip

_GRID = np.linspace(-1.0, 1.0, 9)  # cos q2 of the two-joint arm's tables
_POINTS = 8  # points per angle of a robot, 45° apart
_MOST_KEPT = 2  # angles of a robot over which gains are tabulated
_BITS = 30  # precision of a mean inertia
_SAMPLES, _SEED = 64, 2022  # of the random angles over which M is averaged


class GainSchedule(NamedTuple):
    """The points at which gains are tabulated, and the angles that determine them."""

    kept: tuple[int, ...]  # indices of the k joints over which gains are tabulated
    cosine: bool  # whether the points are evenly spaced in the cosine of the single angle, rather than in the angles
    points: int  # number of points per angle
    places: tuple[str, ...]  # angles or cosine of each of the points^k points as text, for messages
    inertia: np.ndarray  # M at each point, (points^k, n, n) [kg m²]


def schedule_of(arm: AnyArm) -> GainSchedule:
    """Return the points at which gains are tabulated for the two-joint arm or a robot."""
    if isinstance(arm, Robot):
        return _of_robot(arm)
    schedule = GainSchedule((1,), True, len(_GRID), tuple(f"cos q2 = {cos2:g}" for cos2 in _GRID), np.empty(0))
    return schedule._replace(inertia=loaded_inertia(arm, schedule, 0.0))


def loaded_inertia(arm: AnyArm, schedule: GainSchedule, payload: float) -> np.ndarray:
    """Return the mass matrix (points, n, n) [kg m²] at the schedule's points, with a payload [kg] at the tip."""
    if isinstance(arm, Robot):
        return _inertia_at(arm.with_payload(payload), _turned_to(random_angles(arm), list(schedule.kept)))
    constants = arm_constants(arm, Payload(payload))
    entries = [two_joint_mass_matrix(float(cos2), constants) for cos2 in _GRID]
    return np.array([[[m11, m12], [m12, m22]] for m11, m12, m22 in entries])


def _kept_joints(robot: Robot) -> tuple[int, ...]:
    """Return the indices of the joints on which the mass matrix depends most, ascending; never the first joint."""
    count = min(_MOST_KEPT, len(robot) - 1)
    others = random_angles(robot)
    whole = np.mean(mass_matrix(robot, others), axis=0)
    size = np.sqrt(np.diagonal(whole))
    spread = []
    for joint in range(1, len(robot)):
        means = _inertia_at(robot, _turned_to(others, [joint]))
        spread.append(float(np.mean(((means - whole) / np.outer(size, size)) ** 2)))
    return tuple(sorted(1 + int(number) for number in np.argsort(spread)[::-1][:count]))


@functools.lru_cache(maxsize=32)
def _of_robot(robot: Robot) -> GainSchedule:
    kept = list(_kept_joints(robot))
    points = _turned_to(random_angles(robot), kept)
    names = [robot.joints[joint].name for joint in kept]
    places = tuple(
        ", ".join(f"{name} = {q[0, joint]:.3g} rad" for name, joint in zip(names, kept, strict=True)) or "any angles"
        for q in points
    )
    return GainSchedule(tuple(kept), False, _POINTS, places, _inertia_at(robot, points))


def _inertia_at(robot: Robot, angles: list[np.ndarray]) -> np.ndarray:
    """Return M (points, n, n) [kg m²], averaged over the angles (samples, n) [rad] of each point, to about nine digits.

    Processors sum the products in M in different orders. M_ij is rounded to a multiple of 2^-30 of a power of two near
    √(M_ii M_jj), so that M is the same on all processors.
    """
    mean = np.array([np.mean(mass_matrix(robot, q), axis=0) for q in angles])
    size = np.frexp(np.diagonal(mean[0]))[1]
    unit = np.ldexp(1.0, (size + size[:, np.newaxis]) // 2 - _BITS)
    return np.asarray(np.rint(mean / unit) * unit)


def random_angles(robot: Robot) -> np.ndarray:
    """Return random angles (`_SAMPLES`, n) [rad] within the joints' ranges, the same at every call."""
    low, high = np.array([joint.angle_range for joint in robot.joints]).T
    return np.random.default_rng(_SEED).uniform(
        np.maximum(low, -np.pi), np.minimum(high, np.pi), (_SAMPLES, len(robot))
    )


def nearest_inertia(schedule: GainSchedule, q: np.ndarray) -> np.ndarray:
    """Return the mass matrix (n, n) [kg m²] at the schedule's point with the largest weight for angles q (n,) [rad]."""
    corners = corners_of(q.tolist(), *schedule[:3])
    nearest, _ = max(corners, key=lambda corner: corner[1])
    inertia: np.ndarray = schedule.inertia[int(nearest)]
    return inertia


def _turned_to(angles: np.ndarray, kept: list[int]) -> list[np.ndarray]:
    """Return copies of `angles` (samples, n) [rad], with joints `kept` at all combinations of `_POINTS` angles.

    The last joint's angle varies fastest.
    """
    turned = []
    for place in itertools.product(2.0 * np.pi * np.arange(_POINTS) / _POINTS, repeat=len(kept)):
        q = angles.copy()
        q[:, kept] = place
        turned.append(q)
    return turned


def corners_of(q: Any, kept: tuple[int, ...], cosine: bool, points: int) -> list[tuple[Any, Any]]:
    """Return (table row, weight) of the 2^k points around angles q (n,) [rad]; arguments as in `GainSchedule`."""
    corners: list[tuple[Any, Any]] = [(0.0, 1.0)] * (1 << len(kept))
    for number, joint in enumerate(kept):
        if cosine:
            place = 0.5 * (sine_cosine(q[joint])[1] + 1.0) * (points - 1.0)
            left = minimum(points - 2.0, maximum(0.0, floor(place)))  # nan gives a row of the table, too
            share, right = place - left, left + 1.0
        else:
            place = q[joint] * (points / (2.0 * np.pi))
            whole = floor(place)
            share, left = place - whole, whole - points * floor(whole / points)
            right = select(left + 1.0 == points, 0.0, left + 1.0)
        for corner, (index, weight) in enumerate(corners):
            upper = (corner >> number) & 1
            corners[corner] = index * points + (right if upper else left), weight * (share if upper else 1.0 - share)
    return corners


def on_table(table: Any, corners: list[tuple[Any, Any]], sign: float, x: list[Any], y: list[Any]) -> list[Any]:
    """Return y + sign G x; G (len(y), len(x)) is a weighted sum of table rows, (row, weight) in `corners`."""
    if RECORDERS and hasattr(RECORDERS[-1], "interpolated"):
        return RECORDERS[-1].interpolated(table, corners, sign, x, y)  # type: ignore[no-any-return]
    for place, weight in corners:
        gains, share, grown = row(table, place), sign * weight, []
        for i, before in enumerate(y):
            product: Any = 0.0
            for k, value in enumerate(x):
                product = product + gains[i * len(x) + k] * value
            grown.append(before + share * product)
        y = grown
    return y
