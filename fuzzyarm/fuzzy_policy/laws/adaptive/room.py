"""Room for what the adaptive observer computes for one lane, so that nothing is allocated from sample to sample."""

from __future__ import annotations

from typing import Any, NamedTuple

from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Lanes, lanes_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import KEPT
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.numbers.functions import array, each

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


def room_for(s: Settings) -> Room:
    """Return room for one lane."""
    joints, size, numbers, forces = len(s.limit), len(s.spread), len(s.base), len(s.reopening)
    axes = forces - 1
    one = array(4 * joints, 1), array(joints, 1), array(2 * axes, 1), array(numbers, 1)
    directions = array(2 * axes, forces)
    line = array(2 * axes)
    for i in each(2 * axes):
        line[i] = 0.0
        for force in each(forces):
            directions[i, force] = 0.0
    for i in each(axes):
        directions[i, 1 + i] = 1.0
    return Room(
        lanes_of(joints, size, numbers, 2 * axes), one, array(numbers), array(size), array(2 * joints),
        array(2 * joints), array(2 * joints), array(forces), array(size), array(forces + 1),
        array(forces + 1, forces + 1), array(KEPT, joints), array(KEPT + 1, axes), directions,
        line, array(4, joints), array(4 * joints), array(joints, 4 * joints),
    )  # fmt: skip
