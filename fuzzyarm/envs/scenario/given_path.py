"""A tip path given by points in a file: the cubic spline through them, for any arm."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_bytes, read_toml, record
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.default_reference import LONGEST, flattened, timed
from fuzzyarm.envs.scenario.kinematics import link_lengths
from fuzzyarm.envs.scenario.paths import MOST_WAYPOINTS, Placed, Spline, any_point
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, Reference, joint_angles
from fuzzyarm.envs.scenario.robot_reference import TipReference

__all__ = ["ENDINGS", "GivenPath"]

ENDINGS = (".csv", ".toml")  # suffixes of files with points
_PLANE = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # of the two-joint arm: origin and axes
_HEADINGS = ("x,y", "x,y,z")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_LARGEST_FILE = 4 * 1024 * 1024


@dataclasses.dataclass(frozen=True)
class GivenPath:
    """Points through which the tip passes, from rest to rest.

    Attributes:
        points: (x, y) [m] of the two-joint arm, x down and y to the right, or (x, y, z) [m] in a robot's base frame.
        closed: whether the path returns to the first point.
        duration: duration of the motion [s]; None: by the rule in `default_reference`.
    """

    points: tuple[tuple[float, ...], ...]
    closed: bool = False
    duration: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", self._curve.waypoints)
        if self.duration is not None:
            object.__setattr__(self, "duration", checks.real("duration", self.duration, "s", low=1e-3, high=1e3))

    @classmethod
    def read(cls, path: Path) -> GivenPath:
        """Read a CSV or TOML file.

        A CSV file has one point per line, with or without the heading ``x,y`` or ``x,y,z``; if the last point equals
        the first, the path is closed. A TOML file has ``points = [[x, y], ...]`` and optionally ``closed`` and
        ``duration``.

        Raises:
            ValueError: the file has another format, or its numbers do not define a path; the message names the file.
            OSError: the file cannot be read.
        """
        try:
            return record(read_toml(path), cls) if path.suffix == ".toml" else cls._of_csv(path)
        except (TypeError, ValueError, csv.Error) as error:
            text = str(error)
            raise ValueError(text if text.startswith(str(path)) else f"{path}: {text}") from None

    @classmethod
    def _of_csv(cls, path: Path) -> GivenPath:
        text = read_bytes(path, largest=_LARGEST_FILE).decode("utf-8-sig")
        points: list[Any] = []
        for row in (reader := csv.reader(io.StringIO(text))):
            cells = [cell.strip() for cell in row]
            if not any(cells) or (not points and ",".join(cells).lower() in _HEADINGS):
                continue
            wrong = [place for place, cell in enumerate(cells, start=1) if not _NUMBER.fullmatch(cell)]
            if wrong:
                raise ValueError(
                    f"entry {wrong[0]} of line {reader.line_num} is {checks.shown(row[wrong[0] - 1])}, which is not a "
                    f"number; each line must be x,y or x,y,z in metres, after an optional heading "
                    f"{' or '.join(_HEADINGS)}"
                )
            points.append(tuple(map(float, cells)))
        if len(points) > MOST_WAYPOINTS:
            raise ValueError(f"the file has {len(points)} points; allowed: at most {MOST_WAYPOINTS}")
        checked = [any_point(f"point {number}", point) for number, point in enumerate(points, start=1)]
        closed = len(checked) > 2 and checked[0] == checked[-1]
        return cls(tuple(checked[:-1] if closed else checked), closed)

    def reference(self, arm: Robot | ArmParameters) -> Reference:
        """Return the motion of an arm along the path; the two-joint arm bends its elbow to q2 > 0 if it can.

        Raises:
            ValueError: the points have the wrong number of coordinates, or the arm cannot follow them.
        """
        try:
            return self._followed_by(arm)
        except ValueError as error:
            raise ValueError(f"--path: {error}") from None

    def _followed_by(self, arm: Robot | ArmParameters) -> Reference:
        size = 2 if isinstance(arm, ArmParameters) else 3
        if len(self.points[0]) != size:
            wanted = "x, y for the two-joint arm" if size == 2 else f"x, y, z for {getattr(arm, 'name', 'a robot')}"
            raise ValueError(f"the points have {len(self.points[0])} coordinates; needed: {wanted}")
        curve, robot = self._curve, robot_of(arm)
        _check_reach(curve, robot)
        if isinstance(arm, Robot):
            return self._timed(TipReference(curve, self.duration or LONGEST, arm))
        reason: ValueError | None = None
        for elbow in (1, -1):
            posture = joint_angles(curve.points(0.0)[0], arm.length, elbow)
            try:
                path = Placed(curve, *_PLANE)
                slow = TipReference(path, self.duration or LONGEST, robot, tuple(posture.tolist()))
                return flattened(self._timed(slow), arm)
            except ValueError as error:
                reason = reason or error
        assert reason is not None
        raise reason

    @property
    def _curve(self) -> Spline:
        return Spline(self.points, self.closed)  # type: ignore[arg-type]

    def _timed(self, reference: TipReference) -> TipReference:
        return timed(reference) if self.duration is None else reference


def _check_reach(curve: Spline, robot: Robot) -> None:
    """Raise ValueError if a point is farther from the base than the arm's length, or nearer than the arm can fold."""
    points = curve.points(np.linspace(0.0, 1.0, CHECKED_INSTANTS))[0]
    base, links = robot.arrays.position[0][: points.shape[-1]], link_lengths(robot)
    high, low = float(links.sum()), max(0.0, float(2.0 * links.max() - links.sum()))
    distance = np.linalg.norm(points - base, axis=-1)
    outside = np.maximum(distance - high, low - distance)
    k = int(np.argmax(outside))
    if outside[k] > 0.0:
        where = ", ".join(f"{number:.4g}" for number in points[k].tolist())
        raise ValueError(
            f"point ({where}) m is {distance[k]:.4g} m from the base, but the arm reaches {low:.4g} to {high:.4g} m; "
            f"move the points by {outside[k]:.2g} m or more, or choose a named path, which fits every arm"
        )
