"""Room for what the adaptive observer computes for one lane, so that nothing is allocated from sample to sample."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.fuzzy_policy.laws.adaptive.arm import FORCE_ROWS
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FORCES, SPACE
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Lanes, lanes_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import KEPT

__all__ = ["Room", "room_for"]


class Room(NamedTuple):
    """Room for what is computed for one lane; n joints."""

    lanes: Lanes
    one: Any  # a state, torques, a force line and constants, each (rows, 1)
    constants: Any
    column: Any
    measured: Any  # (2 n,), θ and θ̇
    silent: Any  # (2 n,)
    moved: Any  # forces before a correction (FORCES,)
    link_torque: Any  # τ_d of each kept reference (KEPT, n)
    travel: Any  # direction of travel of each, then the next one (KEPT + 1, space)
    directions: Any  # force line of each unit force (FORCE_ROWS, FORCES)
    line: Any  # force line of the known force (FORCE_ROWS,)
    joints: Any  # (4, n), for short use
    error: Any  # (4 n,)
    gain: Any  # K (n, 4 n)


@register_jitable
def room_for(joints: int, size: int, constants: int) -> Room:
    """Return room for one lane of an arm of n joints, `size` numbers of z and as many constants."""
    one = np.empty((4 * joints, 1)), np.empty((joints, 1)), np.empty((FORCE_ROWS, 1)), np.empty((constants, 1))
    directions = np.zeros((FORCE_ROWS, FORCES))
    for i in range(SPACE):
        directions[i, 1 + i] = 1.0
    return Room(
        lanes_of(joints, size, constants),
        one,
        np.empty(constants),
        np.empty(size),
        np.empty(2 * joints),
        np.empty(2 * joints),
        np.empty(FORCES),
        np.empty((KEPT, joints)),
        np.empty((KEPT + 1, SPACE)),
        directions,
        np.zeros(FORCE_ROWS),
        np.empty((4, joints)),
        np.empty(4 * joints),
        np.empty((joints, 4 * joints)),
    )
