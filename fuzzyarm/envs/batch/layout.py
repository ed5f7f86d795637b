"""The arrays that the kernels work on, as records: what a lane carries, what a block holds, what a step leaves behind.

values (blocks, numbers of `Lane`, BLOCK)  lanes through their episodes: a block of them is one piece of memory
clock (numbers of `Clock`, lanes)          where they are in their schedules, and their random streams
table (rows, numbers of a row)             the schedules of all episodes below each other, see `schedule`
starts (schedules, numbers of `Start`)     where each schedule begins, and what its episode starts with
work (numbers of `Layout.Work` x BLOCK)    the block of lanes that is being advanced
out                                        `Results` of a step, in one piece of memory

What depends on the equations, on how many joints and axes there are, is in the `Layout` of a `Physics`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import PARTS
from fuzzyarm.envs.physics.hold import hold_record
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import places, record_type
from fuzzyarm.envs.task import assessment_record, target_record

__all__ = [
    "CLOCK", "INFO", "SCALARS", "START", "VECTORS", "Clock", "Layout", "Noise", "Results", "Scalars", "Start",
    "Vectors", "layout_of",
]  # fmt: skip


class Noise(NamedTuple):
    """Standard deviations of the encoder noise of angles [rad] and of velocities [rad/s]."""

    angle: Any
    velocity: Any


class Clock(NamedTuple):
    """Integers of a lane: rows of the table (of the present instant, first, last), and the key of its episode."""

    row: Any
    first: Any
    last: Any
    key: Any


class Start(NamedTuple):
    """What an episode starts with.

    Attributes:
        first: first row of its schedule in the table.
        last: last row.
        payload: mass that the disturbance adds [kg].
        noise: of the encoders.
        family: 1 if the schedule is the first one of a family, of which each episode draws one; else 0.
    """

    first: Any
    last: Any
    payload: Any
    noise: Noise
    family: Any


class Vectors(NamedTuple):
    """A number for each joint, or for each axis of the tip's space; named as in the environment's `info`."""

    tip: Any
    tip_reference: Any
    q_motor: Any
    dq_motor: Any
    q_link: Any
    dq_link: Any
    torque: Any
    friction_torque: Any
    external_force: Any


class Scalars(NamedTuple):
    """One number each; flags are 0.0 or 1.0, the reason is a `Termination`."""

    time: Any
    tip_error: Any
    circularity_error: Any
    circularity_error_motor: Any
    reward_tracking: Any
    reward_effort: Any
    reward: Any
    torque_clipped: Any
    truncated: Any
    reason: Any


class Results(NamedTuple):
    """What a control step leaves behind in n lanes of arms with so many `joints`.

    Attributes:
        observation: (n, 5 joints), the parts of `observation.Observation`.
        vectors: (9, n, `Layout.longest`), the rows of `Vectors`.
        scalars: (10, n), the rows of `Scalars`.
    """

    observation: np.ndarray
    vectors: np.ndarray
    scalars: np.ndarray


CLOCK, START = places(Clock), places(Start)
"""Where each number of the records `Clock` and `Start` lies in its array."""

VECTORS, SCALARS = Vectors._fields, Scalars._fields
"""Names of the results."""

INFO = (*VECTORS, *SCALARS[: SCALARS.index("reward")], "in_domain", "torque_clipped")
"""The keys of `info`, the last two as flags; reward, truncated and reason have their own places."""

_VECTOR_COUNT, _SCALAR_COUNT = len(VECTORS), len(SCALARS)
_POINTS = ("tip", "tip_reference", "external_force")  # those of `Vectors` that have a number for each axis


@dataclasses.dataclass(frozen=True, eq=False)
class Layout:
    """Records of an arm's equations, and where each number of them lies in its array.

    Attributes:
        physics: the equations.
        Lane: what a lane carries through its episode: state, constants, limits, the factor of its tip force, `Noise`.
        Work: what a block holds of each lane while it is advanced by one control step. `hold` is what the physics
            advances; then the limits, and the target at the end of the step; `command` are the agent's torques [N m],
            then clipped, `bias` those that act beside them; `before` is the state at the start of the step, in case
            that at its end is not finite; then the encoders' noise and what they read, the assessment at the end, and
            two flags: 1.0 where the state there was `finite`, and where torques were beyond the limits, `clipped`.
        LANE: places in `Lane`.
        WORK: places in `Work`.
    """

    physics: Physics
    Lane: Any
    Work: Any
    LANE: Any
    WORK: Any

    def __reduce__(self) -> tuple[Any, tuple[Physics]]:
        """Leave the records behind."""
        return layout_of, (self.physics,)

    @functools.cached_property
    def observed(self) -> int:
        """Numbers in an observation."""
        return PARTS * self.physics.joints

    @functools.cached_property
    def longest(self) -> int:
        """Numbers that each of the vectors has room for."""
        return max(self.physics.joints, self.physics.axes)

    @functools.cached_property
    def width(self) -> int:
        """Numbers in the results of one lane."""
        return self.observed + self.longest * len(VECTORS) + len(SCALARS)

    @functools.cached_property
    def lengths(self) -> tuple[int, ...]:
        """Numbers in each of the vectors."""
        return tuple(self.physics.axes if name in _POINTS else self.physics.joints for name in VECTORS)

    @functools.cached_property
    def vector_places(self) -> tuple[Any, ...]:
        """What picks each of the vectors from an array (9, `longest`); plain numbers where it can be, for speed."""
        if self._full:
            return tuple(range(len(VECTORS)))
        return tuple((k, slice(length)) for k, length in enumerate(self.lengths))

    @functools.cached_property
    def parts(self) -> Any:
        """The compiled ``parts(out)``: the `Results` of n lanes, as flat views of one array (`width` n,)."""
        width, first = self.width, self.observed
        second = first + self.longest * len(VECTORS)

        @register_jitable(forceinline=True)
        def parts(out: np.ndarray) -> Results:
            n = len(out) // width
            return Results(out[: first * n], out[first * n : second * n], out[second * n :])

        return parts

    def split(self, out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the `Results` of n lanes in their shapes, as views of one array (`width` n,).

        A plain tuple: a small batch would notice the time that making a record takes.
        """
        width, observed, before_scalars, longest = self._sizes
        n = len(out) // width
        first, second = observed * n, before_scalars * n
        vectors = out[first:second].reshape(_VECTOR_COUNT, n, longest)
        return out[:first].reshape(n, observed), vectors, out[second:].reshape(_SCALAR_COUNT, n)

    def each(self, vectors: np.ndarray) -> Iterable[np.ndarray]:
        """Return the vectors, in order, each with the numbers that it has: rows of an array (9, ..., `longest`)."""
        if self._full:
            return vectors
        return [v[..., :n] for v, n in zip(vectors, self.lengths, strict=True)]

    @functools.cached_property
    def _full(self) -> bool:
        return min(self.lengths) == self.longest

    @functools.cached_property
    def _sizes(self) -> tuple[int, int, int, int]:
        """Numbers in the results of one lane: all, of the observation, from there to the scalars, of each vector."""
        return self.width, self.observed, self.width - len(SCALARS), self.longest


@functools.cache
def layout_of(physics: Physics) -> Layout:
    """Return the layout for arms with these equations."""
    Hold, PerJoint, State = hold_record(physics), physics.PerJoint, physics.State
    Lane = record_type("Lane", state=State, arm=physics.Arm, limits=physics.Limits, force_factor=Any, noise=Noise)
    Work = record_type(
        "Work",
        hold=Hold,
        limits=physics.Limits,
        target=target_record(physics.axes),
        command=PerJoint,
        bias=PerJoint,
        before=State,
        noise=Noise,
        reading=record_type("Reading", q=PerJoint, dq=PerJoint),
        assessment=assessment_record(physics.joints, physics.axes),
        finite=Any,
        clipped=Any,
    )
    return Layout(physics, Lane, Work, places(Lane), places(Work))
