"""The arrays that the kernels work on, as records: the data of a lane, and the results of a step.

values (blocks, entries of `Lane`, WIDE)  data of the lanes during their episodes; a block is contiguous in memory
clock (entries of `Clock`, lanes)         current rows of the lanes in their schedules, and their random streams
table (rows, entries of a row)            stacked schedules of all episodes, see `schedule`
starts (schedules, entries of `Start`)    rows of each schedule, and initial data of its episode
out                                       observations and `StepResults` of a step in one array, see `Layout.split`

A `Layout` has the parts that depend on the numbers of joints and axes.
"""

import functools
import itertools
import sys
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.observation import PARTS
from fuzzyarm.envs.physics.records import Physics, places, record_type
from fuzzyarm.numbers.machine import WIDE

__all__ = [
    "CLOCK", "INFO", "SCALARS", "START", "VECTORS", "Clock", "Layout", "Noise", "ResultsMemory", "Start", "StepResults",
    "StepRoom", "StepScalars", "StepVectors", "by_rows", "in_blocks", "layout_of",
]  # fmt: skip


def by_rows(values: np.ndarray, lanes: int) -> np.ndarray:
    """Return a copy of values (blocks, rows, `WIDE`) as (rows, lanes), in the same units."""
    return np.ascontiguousarray(np.swapaxes(values, 0, 1).reshape(values.shape[1], -1)[:, :lanes])


def in_blocks(values: np.ndarray) -> np.ndarray:
    """Return values (rows, lanes) as (blocks, rows, `WIDE`) in the same units; nan where there is no lane."""
    rows, lanes = values.shape
    padded = np.full((rows, -(-lanes // WIDE) * WIDE), np.nan)
    padded[:, :lanes] = values
    return np.ascontiguousarray(np.swapaxes(padded.reshape(rows, -1, WIDE), 0, 1))


class Noise(NamedTuple):
    """Standard deviations of the encoder noise in angles [rad] and velocities [rad/s]."""

    angle: Any
    velocity: Any


class Clock(NamedTuple):
    """Integers of a lane: current, first and last row of its episode in the table; key of its random numbers."""

    row: Any
    first: Any
    last: Any
    key: Any


class Start(NamedTuple):
    """Initial data of an episode."""

    first: Any  # first row of its schedule in the table
    last: Any  # last row
    payload: Any  # mass that the disturbance adds [kg]
    noise: Noise  # of the encoders
    family: Any  # 1 if the schedule is the first one of a family from which each episode draws; else 0


VECTORS = (
    *("tip", "tip_reference", "q_motor", "dq_motor", "q_link", "dq_link"),
    *("torque", "friction_torque", "external_force"),
)
"""Vector results, one entry per joint or per axis of the tip's space; named as in the environment's `info`."""

SCALARS = (
    *("time", "tip_error", "circularity_error", "circularity_error_motor", "reward_tracking", "reward_effort"),
    *("reward", "torque_clipped", "truncated", "reason"),
)
"""Scalar results; flags are 0.0 or 1.0, the reason is a `Termination`."""

StepVectors: Any = record_type("StepVectors", **dict.fromkeys(VECTORS, Any))
StepScalars: Any = record_type("StepScalars", **dict.fromkeys(SCALARS, Any))


class StepResults(NamedTuple):
    """Results of a control step in addition to the observation."""

    vectors: Any  # `StepVectors`
    scalars: Any  # `StepScalars`


CLOCK, START = places(Clock), places(Start)  # index of each entry of the records `Clock` and `Start` in its array

INFO = (*VECTORS, *SCALARS[: SCALARS.index("reward")], "in_domain", "torque_clipped")
"""The keys of `info`; the last two are flags. Reward, truncated and reason are reported separately."""

_POINTS = ("tip", "tip_reference", "external_force")  # the fields of `StepVectors` with one entry per axis


class Layout:
    """Record types for the equations of an arm, and the index of each entry in its array.

    Attributes:
        Lane: data of a lane during its episode: state, constants, limits, factor on the tip force, `Noise`.
        LANE: index of each entry of `Lane`.
        observed: length of an observation; `longest`: of the longest of `StepVectors`; `reported`: of `StepResults`.
        parts: slice of each of the `StepVectors` in their concatenation.
    """

    def __init__(self, physics: Physics) -> None:
        state, arm, limits = physics.State, physics.Arm, physics.Limits
        self.physics = physics
        self.Lane = record_type("Lane", state=state, arm=arm, limits=limits, force_factor=Any, noise=Noise)
        self.LANE = places(self.Lane)
        self.observed, self.longest = PARTS * physics.joints, max(physics.joints, physics.axes)
        lengths = [physics.axes if name in _POINTS else physics.joints for name in VECTORS]
        stops = list(itertools.accumulate(lengths))
        self.parts = StepVectors(*(slice(stop - length, stop) for stop, length in zip(stops, lengths, strict=True)))
        self.reported = stops[-1] + len(SCALARS)

    def __reduce__(self) -> tuple[Any, tuple[Physics]]:
        """Pickle only the equations; the records are rebuilt from them."""
        return layout_of, (self.physics,)

    def size(self, lanes: int) -> int:
        """Return the number of entries of the array `out`, see the module's docstring, for this number of lanes."""
        return -(-self.observed * lanes // _LINE) * _LINE + self.reported * _apart(lanes)

    def arrays(self, out: np.ndarray, lanes: int) -> tuple[np.ndarray, np.ndarray]:
        """Return observations (lanes, `observed`) and `StepResults` (`reported`, lanes), both views of `out`."""
        observed, apart = self.observed * lanes, _apart(lanes)
        numbers = out[-self.reported * apart :].reshape(self.reported, apart)
        return out[:observed].reshape(lanes, self.observed), numbers[:, :lanes]

    def split(self, out: np.ndarray, lanes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return views of one array `out` (`size`,): observations (lanes, `observed`), vectors and scalars (10, lanes).

        Vectors (entries, lanes) have a row for each entry, see `each`; scalars are those of `SCALARS`.
        """
        observations, numbers = self.arrays(out, lanes)
        return observations, numbers[:-_SCALAR_COUNT], numbers[-_SCALAR_COUNT:]

    def each(self, vectors: np.ndarray) -> list[np.ndarray]:
        """Return each vector (lanes, length of the vector), in order, from the rows returned by `split`."""
        return [vectors[part].T for part in self.parts]


_SCALAR_COUNT = len(SCALARS)
_LINE = 8  # numbers in a cache line


def _apart(lanes: int) -> int:
    """Return how many numbers apart the rows of `StepResults` begin.

    An odd number of cache lines keeps rows from evicting each other from the cache.
    """
    return lanes if lanes == 1 else _LINE * (-(-lanes // _LINE) | 1)


@functools.cache
def layout_of(physics: Physics) -> Layout:
    """Return the layout for arms with these equations."""
    return Layout(physics)


_KEPT = 3  # rooms: a loop still holds the results of the last step while the next step is made
_OWN = 2  # references to a free array: the one in its room, and the argument of `getrefcount`


class StepRoom:
    """Memory for the results of one step; its user may store data in `kept`."""

    __slots__ = ("_array", "_first", "_stop", "kept")

    def __init__(self, size: int) -> None:
        """Allocate memory for `size` numbers that starts at a cache line."""
        self._array = np.empty(size + _LINE)
        self._first = -(self._array.ctypes.data // self._array.itemsize) % _LINE
        self._stop = self._first + size
        self.kept: Any = None

    def array(self) -> np.ndarray:
        """Return a view (size,) of the memory; its numbers are arbitrary until they are written."""
        return self._array[self._first : self._stop]


class ResultsMemory:
    """A pool of `StepRoom` objects of one size.

    The system zeroes new memory page by page at its first use, which takes a third of a large batch's step time. Every
    view of an array holds a reference to it, so an array without further references can be reused.
    """

    def __init__(self, size: int) -> None:
        self._size, self._rooms = size, list[StepRoom]()

    def room(self) -> StepRoom:
        """Return a `StepRoom` whose memory no result uses, or a new one."""
        for room in self._rooms:
            if sys.getrefcount(room._array) == _OWN:
                return room
        room = StepRoom(self._size)
        if len(self._rooms) < _KEPT:
            self._rooms.append(room)
        return room

    def __getstate__(self) -> dict[str, object]:
        return {"_size": self._size, "_rooms": []}
