"""What two robots have in common whose equations of motion are the same lines of source, and the rest as symbols.

The structure of a robot is its rotations, its axes, and which of its other numbers are zero. Those numbers, lengths,
masses, inertias, drives, are inputs of the generated functions: they differ from lane to lane.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.joint import DIMENSIONS, DRIVE_UNITS, as_rows
from fuzzyarm.envs.physics.recursion import Body, Chain, Inertia, joined, moved, rotated, rotated_inertia
from fuzzyarm.envs.physics.robot import Robot

__all__ = ["DRIVE", "Structure", "bodies_of", "chain_of", "gravity_of", "numbers_of", "structure_of"]

Rows = tuple[tuple[float, ...], ...]

DRIVE = tuple(name for name, _, _ in DRIVE_UNITS)
"""The quantities of a drive, each a number per joint."""

LIMITS = ("angle_low", "angle_high", "velocity_limit")
AXES = "xyz"
ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
PLANAR_JOINTS = 2  # of the arm whose tip has two coordinates, the paper's
UNTURNED = as_rows(np.eye(DIMENSIONS))
ROUNDING = 1e-15  # of products of rotations


class Structure(NamedTuple):
    """The structure of a robot, see the module.

    Attributes:
        rotations: of each joint frame in the one before, once each frame is turned so that its axis is z.
        frames: that turn, for each joint: the columns are the new axes in the old frame.
        planar: whether it is an arm of two joints in a plane, whose tip has two coordinates.
        numbers: names of the numbers that are inputs, in the order of a `Plant`.
    """

    rotations: tuple[Rows, ...]
    frames: tuple[Rows, ...]
    planar: bool
    numbers: tuple[str, ...]

    @property
    def joints(self) -> range:
        """The joints, counted from 1 as in the names of numbers."""
        return range(1, len(self.rotations) + 1)


def structure_of(robot: Robot) -> Structure:
    """Return the structure of a robot; hashable, equal for robots with the same equations."""
    now = robot.arrays
    frames = [_frame(axis) for axis in now.axis]
    before = [np.eye(DIMENSIONS), *frames[:-1]]
    rotations = [a.T @ r @ b for a, r, b in zip(before, now.rotation, frames, strict=True)]
    numbers = numbers_of(robot)
    heights = np.concatenate([now.position[:, -1], now.tip[-1:], now.gravity[-1:]])
    upright = bool((now.axis[:, -1] == 1.0).all() and (now.rotation[:, -1, -1] == 1.0).all())
    planar = len(robot) == PLANAR_JOINTS and upright and not heights.any()
    per_joint = (*DRIVE, *LIMITS, "mass")
    names = [name for name, value in numbers.items() if value != 0.0 or name.rstrip("0123456789") in per_joint]
    return Structure(tuple(map(_exact, rotations)), tuple(map(_exact, frames)), planar, tuple(names))


def numbers_of(robot: Robot) -> dict[str, float]:
    """Return every number of a robot by name: mass1, center1x, inertia1xy, stiffness1, ..., tipx, gravityz."""
    return dict(_numbers(robot))


def _numbers(robot: Robot) -> Iterator[tuple[str, float]]:
    for k, joint in enumerate(robot.joints, start=1):
        yield f"mass{k}", joint.link.mass
        yield from zip((f"center{k}{axis}" for axis in AXES), joint.link.center, strict=True)
        upper = np.array(joint.link.inertia)[np.triu_indices(DIMENSIONS)].tolist()
        yield from zip((f"inertia{k}{entry}" for entry in ENTRIES), upper, strict=True)
        yield from zip((f"position{k}{axis}" for axis in AXES), joint.position, strict=True)
        yield from ((f"{name}{k}", getattr(joint.drive, name)) for name in DRIVE)
        yield from zip((f"{name}{k}" for name in LIMITS), (*joint.angle_range, joint.velocity_limit), strict=True)
    yield from zip((f"tip{axis}" for axis in AXES), robot.tip, strict=True)
    yield from zip((f"gravity{axis}" for axis in AXES), robot.gravity, strict=True)


Symbol = Callable[[str], Any]
"""Gives the symbol for a number by its name: 0.0 for one that is not among the numbers of the structure."""


def chain_of(structure: Structure, symbol: Symbol) -> Chain:
    """Return the frames, turned so that each joint's axis is z."""
    before = [UNTURNED, *structure.frames[:-1]]
    positions = [
        rotated(_transposed(frame), _vector(symbol, f"position{k}"))
        for k, frame in zip(structure.joints, before, strict=True)
    ]
    return Chain(structure.rotations, positions, rotated(_transposed(structure.frames[-1]), _vector(symbol, "tip")))


def bodies_of(structure: Structure, symbol: Symbol, payload: Any, place: Any, tip_payload: Any) -> list[Body]:
    """Return the links in the frames of `chain_of`, the last with two point masses.

    Args:
        structure: of the robot.
        symbol: gives its numbers.
        payload: mass [kg] between the last link's mass center (place 0) and the tip (place 1).
        place: where it is.
        tip_payload: mass [kg] at the tip.
    """
    bodies = []
    for k, frame in zip(structure.joints, structure.frames, strict=True):
        inertia = Inertia(*(symbol(f"inertia{k}{entry}") for entry in ENTRIES))
        back, center = _transposed(frame), _vector(symbol, f"center{k}")
        at_center = Body(symbol(f"mass{k}"), (0.0, 0.0, 0.0), rotated_inertia(back, inertia))
        bodies.append(moved(at_center, UNTURNED, rotated(back, center)))
    tip = rotated(back, _vector(symbol, "tip"))
    between = tuple(c + place * (t - c) for c, t in zip(rotated(back, center), tip, strict=True))
    for mass, point in ((payload, between), (tip_payload, tip)):
        carried = Body(mass, (0.0, 0.0, 0.0), Inertia(*[0.0] * len(ENTRIES)))
        bodies[-1] = joined(bodies[-1], moved(carried, UNTURNED, point))
    return bodies


def gravity_of(symbol: Symbol) -> tuple[Any, Any, Any]:
    """Return g [m/s²] in the base frame."""
    return _vector(symbol, "gravity")


def _vector(symbol: Symbol, name: str) -> tuple[Any, Any, Any]:
    x, y, z = (symbol(name + axis) for axis in AXES)
    return x, y, z


def _frame(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose third column is the axis; a permutation with signs for an axis along x, y or z."""
    along = int(np.abs(axis).argmax())
    first = np.eye(DIMENSIONS)[(along + (1 if axis[along] > 0.0 else 2)) % DIMENSIONS]
    first = first - (first @ axis) * axis
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=-1)


def _exact(rotation: np.ndarray) -> Rows:
    """Return a rotation whose entries within rounding of 0, 1 or -1 are exactly that."""
    near = np.rint(rotation)
    return as_rows(np.where(np.abs(rotation - near) <= ROUNDING, near, rotation) + 0.0)


def _transposed(rows: Rows) -> Rows:
    return tuple(zip(*rows, strict=True))
