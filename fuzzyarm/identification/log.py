"""A log of the motors: angles, velocities and torques at evenly spaced instants, from a CSV file.

Row k has the measurements at t_k and the torque that the motors held from t_k to t_{k+1}:

    time, q_motor1, q_motor2, dq_motor1, dq_motor2, torque1, torque2      [s, rad, rad/s, N m]

Angles and velocities of the motors refer to the joint's side of the gear. The two velocity columns are optional. The
columns may be in any order, and other columns are ignored.

`Log.smoothed` returns angles, velocities and accelerations without a shift in time: a Butterworth filter of order 4
runs forwards and backwards over the measurements, and derivatives are central differences of its output. The torque
passes the same filter; the torque at instant k is the mean of the torques held before and after it.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_bytes
from fuzzyarm.common.files import csv_text
from fuzzyarm.envs.physics.parameters import LARGEST
from fuzzyarm.envs.physics.robot import MOST_JOINTS

__all__ = ["Log", "Motion", "joint_table", "read_log"]

_PARTS = {"q_motor": "rad", "dq_motor": "rad/s", "torque": "N m"}
_COLUMNS = ("time", *(f"{part}{joint}" for part in _PARTS for joint in (1, 2)))
"""Headings of a log."""
_VELOCITIES = tuple(name for name in _COLUMNS if name.startswith("dq_"))  # which may be missing
_FEWEST_SAMPLES, _MOST_SAMPLES = 100, 200_000  # with the most, the fit takes some gigabytes
_LARGEST_FILE = 64 * 2**20
_EVEN = 0.01  # share of a period by which a step in time may differ from the median step
_SHORTEST, _LONGEST = 1e-5, 0.05  # s, of a sampling period
_JOINTS = re.compile(r"q_motor(\d+)|dq_motor(\d+)|torque(\d+)")


_CUTOFF = 10.0  # Hz: above the motion of the motors, and below the vibration of elastic joints
_ORDER = 4
_SETTLING = 3.0  # periods of the cut-off frequency
_HIGHEST = 0.4  # cut-off frequency as a share of the sampling rate's half, at most


class Motion(NamedTuple):
    """Smooth angles [rad], velocities [rad/s], accelerations [rad/s²] and torques [N m], each of shape (N, n).

    The ends of the log do not affect the instants `settled`; `independent` is the number of independent samples among
    them.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    torque: np.ndarray
    settled: slice
    independent: float


@dataclasses.dataclass(frozen=True, eq=False)
class Log:
    """Measurements of the motors of an arm of n joints at N instants; arrays are read-only copies.

    Attributes:
        period: time between two samples [s].
        angle: q_a [rad], shape (N, n).
        torque: Γ [N m], shape (N, n); row k is held from instant k to instant k + 1.
        velocity: q̇_a [rad/s], shape (N, n), or None.
        name: of the file that it was read from, in messages.
        remarks: what was done to the file's numbers to get these, a sentence each.

    Raises:
        TypeError: an entry is not a real number.
        ValueError: shapes differ, there are too few or too many samples, or a number is not finite or out of range.
    """

    period: float
    angle: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray | None = None
    name: str = "log"
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        period = checks.real("period", self.period, "s", low=_SHORTEST, high=_LONGEST)
        samples = checks.whole("the number of samples", len(self.angle), low=_FEWEST_SAMPLES, high=_MOST_SAMPLES)
        object.__setattr__(self, "period", period)
        joints = checks.whole("the number of joints", np.shape(self.angle)[-1], low=1, high=MOST_JOINTS)
        for name, unit in zip(("angle", "velocity", "torque"), _PARTS.values(), strict=True):
            if getattr(self, name) is not None:
                array = checks.finite_array(name, getattr(self, name), (samples, joints), unit, largest=LARGEST)
                array.flags.writeable = False
                object.__setattr__(self, name, array)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return (len(self.angle) - 1) * self.period

    @property
    def measured(self) -> np.ndarray:
        """Angles [rad] and, if there are any, velocities [rad/s], shape (N, n or 2 n)."""
        return self.angle if self.velocity is None else np.concatenate([self.angle, self.velocity], axis=1)

    def smoothed(self) -> Motion:
        """Return the motion behind the filter that the docstring of this module describes."""
        rate = 1.0 / self.period
        cutoff = min(_CUTOFF, 0.5 * _HIGHEST * rate)
        filter_ = butter(_ORDER, cutoff, fs=rate, output="sos")

        def smooth(values: np.ndarray) -> np.ndarray:
            return np.asarray(sosfiltfilt(filter_, values, axis=0))

        q = smooth(self.angle)
        dq = np.gradient(q, self.period, axis=0) if self.velocity is None else smooth(self.velocity)
        held = self.torque.copy()
        held[1:] = 0.5 * (self.torque[1:] + self.torque[:-1])
        edge = min(round(_SETTLING * rate / cutoff), len(q) // 4)
        settled = slice(edge, len(q) - edge)
        independent = (settled.stop - settled.start) * self.period * 2.0 * cutoff
        return Motion(q, dq, np.gradient(dq, self.period, axis=0), smooth(held), settled, independent)

    def to_csv(self) -> str:
        """Return the text of a CSV file that `read_log` reads back to an equal log."""
        velocity = {} if self.velocity is None else {"dq_motor": self.velocity}
        time = np.arange(len(self.angle)) * self.period
        return joint_table(time, {"q_motor": self.angle, **velocity, "torque": self.torque})


def read_log(path: Path) -> Log:
    """Return the log in a CSV file with a heading.

    Raises:
        ValueError: a column is missing or belongs to another number of joints, a cell is not a finite number, or the
            instants are not evenly spaced; the message names the file, the line or the column, and what is needed.
        OSError: the file cannot be read.
    """
    path = checks.path_of("path", path)
    try:
        return _parsed(read_bytes(path, largest=_LARGEST_FILE).decode("utf-8-sig"))
    except (TypeError, ValueError, csv.Error) as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def joint_table(time: np.ndarray, parts: dict[str, np.ndarray]) -> str:
    """Return instants (N,) [s] and quantities of n joints (N, n) as CSV, with n columns for each quantity."""
    joints = {f"{part}{j + 1}": column for part, values in parts.items() for j, column in enumerate(values.T)}
    columns = {"time": time} | joints
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return csv_text([dict(zip(columns, row, strict=True)) for row in rows])


def _parsed(text: str) -> Log:
    rows = [row for row in csv.reader(io.StringIO(text)) if any(cell.strip() for cell in row)]
    if not rows:
        raise ValueError(f"it is empty; needed: a heading {','.join(_COLUMNS)} and a line for each instant")
    heading = [cell.strip() for cell in rows[0]]
    _check_heading(heading)
    count = checks.whole("the number of samples", len(rows) - 1, low=_FEWEST_SAMPLES, high=_MOST_SAMPLES)
    columns = {name: heading.index(name) for name in _COLUMNS if name in heading}
    values = np.empty((count, len(columns)))
    for line, row in enumerate(rows[1:], start=2):
        if any(cell.strip() for cell in row[len(heading) :]):
            raise ValueError(
                f"line {line} has {len(row)} cells, the heading {len(heading)}; numbers need a decimal point"
            )
        for place, (name, column) in enumerate(columns.items()):
            values[line - 2, place] = _number(row, line, name, column)
    velocity = values[:, 3:5] if len(columns) == len(_COLUMNS) else None
    return Log(_period(values[:, 0]), values[:, 1:3], values[:, -2:], velocity)


def _check_heading(heading: list[str]) -> None:
    """Raise ValueError unless the heading names every needed column once, for joints 1 and 2 alone."""
    joints = {int(next(filter(None, found.groups()))) for found in map(_JOINTS.fullmatch, heading) if found}
    if joints - {1, 2}:
        wanted = ",".join(_COLUMNS)
        raise ValueError(f"it is the log of {max(joints)} joints; allowed: two-joint arms, columns {wanted}")
    missing = [name for name in _COLUMNS if name not in heading]
    if missing and (set(missing) != set(_VELOCITIES)):
        raise ValueError(
            f"its heading {checks.shown(','.join(heading))} lacks {', '.join(missing)}; needed: {','.join(_COLUMNS)}, "
            f"where {' and '.join(_VELOCITIES)} may both be missing"
        )
    twice = [name for name in _COLUMNS if heading.count(name) > 1]
    if twice:
        raise ValueError(f"its heading has {twice[0]} twice; leave out one")


def _number(row: list[str], line: int, name: str, column: int) -> float:
    cell = row[column].strip() if column < len(row) else ""
    try:
        number = float(cell)
    except ValueError:
        number = float("nan")
    if not abs(number) <= LARGEST:
        raise ValueError(f"line {line} has {name} = {checks.shown(cell)}; needed: a finite number up to {LARGEST:g}")
    return number


def _period(time: np.ndarray) -> float:
    """Return the time between two instants [s]; ValueError with the first place where it differs."""
    steps = np.diff(time)
    period = float(np.median(steps))
    wrong = np.flatnonzero(~(np.abs(steps - period) <= _EVEN * period))
    if wrong.size:
        k = int(wrong[0])
        raise ValueError(
            f"the step in time from line {k + 2} to line {k + 3} is {steps[k]:.6g} s, the others {period:.6g} s; "
            "needed: evenly spaced instants. Cut the log at the gap, or resample it"
        )
    return float(np.mean(steps))
