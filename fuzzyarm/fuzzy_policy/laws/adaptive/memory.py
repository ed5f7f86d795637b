"""What the adaptive observer remembers of one lane from one sample to the next, in a fixed number of numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.slices import consecutive
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import Belief, forces_in
from fuzzyarm.numbers.functions import Cells

__all__ = ["ENOUGH", "FLAG", "KEPT", "LONGEST_LATENESS", "ORDERS", "Flags", "Memory", "layout", "places", "remembered"]

LONGEST_LATENESS = 3
"""Longest time from a command to the motors that the filter considers [control periods]."""
KEPT = 5
"""References kept, the present one included: the derivatives of the joint torque are differences of four of them, and
the feedforward's change takes one more."""
ORDERS = 3
"""Of a reference: q_d, q̇_d and q̈_d."""
ENOUGH = 1e6
"""Samples that are counted."""
READ = 3  # numbers of a joint kept of the last sample, see `read_noise`


class Flags(NamedTuple):
    """Single numbers of a memory, or where they stand among them.

    Attributes:
        samples: how many there have been, up to `ENOUGH`.
        surprise: ν²/s of the last samples, on average; about 1 where the filter is right.
        lost: 1 once the filter has diverged or the torques swing, else 0.
        calm: 1 where the corrections of the forces look like noise, 0 where they have a direction.
        taught: 1 if the memory that an episode begins with holds what an earlier pass has taught, else 0.
        swing: mean of the commands' jumps of the last samples, see `law.note_swing`.
    """

    samples: Any
    surprise: Any
    lost: Any
    calm: Any
    taught: Any
    swing: Any


FLAG = Flags(*range(len(Flags._fields)))
"""Where they stand."""
_FLAGS = len(FLAG)


class Memory(NamedTuple):
    """The parts of one lane's memory as arrays; zeros when an episode begins. n joints, N numbers of z.

    Attributes:
        flags: see `Flags`.
        z: prediction of (x, p) for this sample, (N,).
        P: its covariance, (N, N).
        commands: torques commanded [N m], newest first, (`LONGEST_LATENESS` + 2, n).
        references: q_d, q̇_d, q̈_d, newest first, (`KEPT`, `ORDERS`, n).
        read: what `read_noise` keeps of the last sample, (3, n).
        moves: mean of the corrections of each force [N], then that of their square [N²], (forces + 1,).
        noise: variance of the noise of the measured angles [rad²], (n,).
    """

    flags: Any
    z: Any
    P: Any
    commands: Any
    references: Any
    read: Any
    moves: Any
    noise: Any


def places(joints: int, belief: Belief) -> Memory:
    """Return the parts as places of arrays in a law's memory."""
    size = 4 * joints + belief.lateness.stop
    shapes = (
        (_FLAGS,), (size,), (size, size), (LONGEST_LATENESS + 2, joints), (KEPT, ORDERS, joints), (READ, joints),
        (forces_in(belief) + 1,), (joints,),
    )  # fmt: skip
    return Memory(*map(Cells, shapes))


def layout(joints: int, belief: Belief) -> Memory:
    """Return where the parts lie, as slices; `belief` says where the parts of p do."""
    size = 4 * joints + belief.lateness.stop
    return Memory(
        *consecutive(
            _FLAGS,
            size,
            size * size,
            (LONGEST_LATENESS + 2) * joints,
            KEPT * ORDERS * joints,
            READ * joints,
            forces_in(belief) + 1,
            joints,
        )
    )


def remembered(memory: np.ndarray, joints: int, beliefs: int, forces: int) -> Memory:
    """Return the parts of one lane's memory as views of it, each in its shape.

    Args:
        memory: of the lane.
        joints: n.
        beliefs: how many numbers p has.
        forces: how many of them are forces.
    """
    size = 4 * joints + beliefs
    z = _FLAGS
    covariance = z + size
    commands = covariance + size * size
    references = commands + (LONGEST_LATENESS + 2) * joints
    read = references + KEPT * ORDERS * joints
    moves = read + READ * joints
    noise = moves + forces + 1
    return Memory(
        memory[:z],
        memory[z:covariance],
        memory[covariance:commands].reshape((size, size)),
        memory[commands:references].reshape((LONGEST_LATENESS + 2, joints)),
        memory[references:read].reshape((KEPT, ORDERS, joints)),
        memory[read:moves].reshape((READ, joints)),
        memory[moves:noise],
        memory[noise : noise + joints],
    )
