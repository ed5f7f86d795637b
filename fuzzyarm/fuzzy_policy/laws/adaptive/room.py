"""Room for what the adaptive observer computes for one lane, so that nothing is allocated from sample to sample."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Lanes, lanes_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import KEPT
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings

__all__ = ["Room", "room_for"]


class Room(NamedTuple):
    """Room for what is computed for one lane; n joints, and a tip in a space of some axes.

    A force line has a row for each axis of the mean force, then for each axis of its change.
    """

    lanes: Lanes
    one: Any  # a state, torques, a force line and numbers of the arm, each (rows, 1)
    numbers: Any  # of the arm
    column: Any  # as many as z has
    measured: Any  # (2 n,), θ and θ̇
    variances: Any  # of the measured numbers (2 n,)
    silent: Any  # (2 n,)
    moved: Any  # forces before a correction (forces,)
    acted: Any  # z on which the law acts (N,), see `significance`
    deviation: Any  # P_ll⁻¹ (l - l_0) there (loads,)
    factor: Any  # of P_ll (loads, loads)
    link_torque: Any  # τ_d of each kept reference (KEPT, n)
    travel: Any  # direction of travel of each, then the next one (KEPT + 1, axes)
    directions: Any  # force line of each unit force (rows, forces)
    line: Any  # force line of the known force (rows,)
    joints: Any  # (4, n), for short use
    error: Any  # (4 n,)
    gain: Any  # K (n, 4 n)
    index: Any  # (corners,), of the table of K
    weight: Any  # (corners,)


@register_jitable
def room_for(s: Settings) -> Room:
    """Return room for one lane."""
    joints, size, numbers, forces = len(s.limit), len(s.spread), len(s.base), len(s.reopening)
    axes, corners = forces - 1, 1 << len(s.kept)
    one = np.empty((4 * joints, 1)), np.empty((joints, 1)), np.empty((2 * axes, 1)), np.empty((numbers, 1))
    directions = np.zeros((2 * axes, forces))
    for i in range(axes):
        directions[i, 1 + i] = 1.0
    return Room(
        lanes_of(joints, size, numbers, 2 * axes), one, np.empty(numbers), np.empty(size), np.empty(2 * joints),
        np.empty(2 * joints), np.empty(2 * joints), np.empty(forces), np.empty(size), np.empty(forces + 1),
        np.empty((forces + 1, forces + 1)), np.empty((KEPT, joints)), np.empty((KEPT + 1, axes)), directions,
        np.zeros(2 * axes), np.empty((4, joints)), np.empty(4 * joints), np.empty((joints, 4 * joints)),
        np.empty(corners, dtype=np.int64), np.empty(corners),
    )  # fmt: skip
