"""The arrays that the kernels work on, as records: what a lane carries, what a block holds, what a step leaves behind.

values (numbers of `Lane`, lanes)         a lane through its episode
clock (numbers of `Clock`, lanes)         where it is in its schedule, and its random stream
table (rows, numbers of `Row`)            the schedules of all episodes below each other, see `schedule`
starts (schedules, numbers of `Start`)    where each schedule begins, and what its episode starts with
work (numbers of `Work` times BLOCK)      the block of lanes that is being advanced
out                                       `Results` of a step, in one piece of memory
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.observation import SIZE
from fuzzyarm.envs.physics.dynamics import Arm, State
from fuzzyarm.envs.physics.integrator import Hold
from fuzzyarm.envs.physics.records import PerJoint, places
from fuzzyarm.envs.task import Assessment, Limits, Target

__all__ = [
    "CLOCK",
    "INFO",
    "LANE",
    "PLANAR",
    "SCALARS",
    "START",
    "VECTORS",
    "WIDTH",
    "WORK",
    "Clock",
    "Lane",
    "Noise",
    "Results",
    "Scalars",
    "Start",
    "Vectors",
    "Work",
    "parts",
    "split",
]


class Noise(NamedTuple):
    """Standard deviations of the encoder noise of angles [rad] and of velocities [rad/s]."""

    angle: Any
    velocity: Any


class Lane(NamedTuple):
    """What a lane carries through its episode."""

    state: State
    arm: Arm
    limits: Limits
    force_factor: Any
    noise: Noise


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


class Work(NamedTuple):
    """What a block holds of each lane while it is advanced by one control step.

    Attributes:
        hold: what the physics advances.
        limits: of the plant.
        target: at the end of the step.
        command: the agent's torques [N m], then clipped.
        bias: torque that acts beside them [N m].
        before: the state at the start of the step, in case the one at its end is not finite.
        assessment: of the state at the end of the step.
        finite: 1.0 where that state was finite, else 0.0.
        clipped: 1.0 where the torques were beyond the limits, else 0.0.
    """

    hold: Hold
    limits: Limits
    target: Target
    command: PerJoint
    bias: PerJoint
    before: State
    assessment: Assessment
    finite: Any
    clipped: Any


class Vectors(NamedTuple):
    """Two numbers each, named as in the environment's `info`."""

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
    """What a control step leaves behind in n lanes.

    Attributes:
        observation: (n, 10), the parts of `observation.Observation`.
        vectors: (9, n, 2), the rows of `Vectors`.
        scalars: (10, n), the rows of `Scalars`.
    """

    observation: np.ndarray
    vectors: np.ndarray
    scalars: np.ndarray


# Where each number of a record lies in its array, and the names of the results.
LANE, CLOCK, START, WORK = places(Lane), places(Clock), places(Start), places(Work)
PLANAR = 2  # numbers in each of the vectors
VECTORS, SCALARS = Vectors._fields, Scalars._fields
INFO = (*VECTORS, *SCALARS[: SCALARS.index("reward")], "in_domain", "torque_clipped")
"""The keys of `info`, the last two as flags; reward, truncated and reason have their own places."""

_VECTOR_COUNT, _SCALAR_COUNT = len(VECTORS), len(SCALARS)
_BEFORE_SCALARS = SIZE + PLANAR * _VECTOR_COUNT
WIDTH = _BEFORE_SCALARS + _SCALAR_COUNT
"""Numbers in the results of one lane."""


@register_jitable(forceinline=True)
def parts(out: np.ndarray) -> Results:
    """Return the parts of the results of n lanes, as flat views of one array (`WIDTH` n,)."""
    n = len(out) // WIDTH
    return Results(out[: SIZE * n], out[SIZE * n : _BEFORE_SCALARS * n], out[_BEFORE_SCALARS * n :])


def split(out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the `Results` of n lanes in their shapes, as views of one array (`WIDTH` n,).

    A plain tuple: a small batch would notice the time that making a record takes.
    """
    n = len(out) // WIDTH
    first, second = SIZE * n, _BEFORE_SCALARS * n
    vectors = out[first:second].reshape(_VECTOR_COUNT, n, PLANAR)
    return out[:first].reshape(n, SIZE), vectors, out[second:].reshape(_SCALAR_COUNT, n)
