"""A log of the motors: angles, velocities and torques at evenly spaced instants.

Row k has the measurements at t_k and the torque that the motors held from t_k to t_{k+1}. Angles, velocities and
torques refer to the joint's side of the gear. `reading` reads logs from files.

`Log.smoothed` returns angles, velocities and accelerations without a shift in time: a Butterworth filter of order 4
runs forwards and backwards over the measurements, and derivatives are central differences of the filter's output. The
torque at instant k is the mean of the torques held before and after k; the same filter smooths it.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fuzzyarm.common import checks
from fuzzyarm.common.files import csv_text
from fuzzyarm.envs.physics.parameters import LARGEST
from fuzzyarm.envs.physics.robot import MOST_JOINTS

__all__ = ["FEWEST_SAMPLES", "Log", "Motion", "joint_table"]

_PARTS = {"q_motor": "rad", "dq_motor": "rad/s", "torque": "N m"}
FEWEST_SAMPLES = 100
"""Smallest number of samples in a log."""
_MOST_SAMPLES = 200_000
_SHORTEST, _LONGEST = 1e-5, 0.05  # s, limits of the sampling period

_CUTOFF = 10.0  # Hz: above the motion of the motors, and below the vibration of elastic joints
_ORDER = 4
_SETTLING = 3.0  # periods of the cut-off frequency
_HIGHEST = 0.4  # largest cut-off frequency, as a share of half the sampling rate


class Motion(NamedTuple):
    """Smooth angles [rad], velocities [rad/s], accelerations [rad/s²] and torques [N m], each of shape (N, n).

    The values at the instants of the slice `settled` hardly depend on how the filter treats the ends of the log;
    `independent` is the number of independent samples among these instants.
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
        name: the log's name in messages; for a log from a file, the name of the file.
        remarks: the changes made to the data of the file, one sentence each.

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
        samples = checks.whole("the number of samples", len(self.angle), low=FEWEST_SAMPLES, high=_MOST_SAMPLES)
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
        """Return the filtered motion of the log; the docstring of this module describes the filter."""
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
        """Return the text of a CSV file that `reading.read_log` reads back to an equal log."""
        velocity = {} if self.velocity is None else {"dq_motor": self.velocity}
        time = np.arange(len(self.angle)) * self.period
        return joint_table(time, {"q_motor": self.angle, **velocity, "torque": self.torque})


def joint_table(time: np.ndarray, parts: dict[str, np.ndarray]) -> str:
    """Return CSV text: a column of instants `time` (N,) [s], then n columns for each quantity (N, n) in `parts`."""
    joints = {f"{part}{j + 1}": column for part, values in parts.items() for j, column in enumerate(values.T)}
    columns = {"time": time} | joints
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return csv_text([dict(zip(columns, row, strict=True)) for row in rows])
