"""A robot from a URDF or MJCF file without an overlay: the values that the model lacks, and typical values for them.

The typical values are those of a shipped robot, whose file states their sources. For a joint with torque limit Γ, they
are those of the shipped robot's joint with the nearest limit Γ', times Γ/Γ' (angles and speeds unchanged).
"""

import dataclasses
import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.physics import _robot_models as models
from fuzzyarm.envs.physics.joint import DRIVE_UNITS, Drive, Joint
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots

__all__ = ["UNITS", "Lacking", "Typical", "completed", "joints_of_model", "typical"]

UNITS = {**DRIVE_UNITS, "velocity_limit": "rad/s", "angle_range": "rad"}
"""The quantities of a joint that can be given, with their units."""
_ASKED = tuple(name for name in UNITS if name not in ("static_friction", "stribeck_velocity"))  # both have defaults
_WORDS = {"motor_inertia": "rotor", "stiffness": "stiffness", "damping": "damping", "torque_limit": "torque limit"}
_FRICTION = ("viscous_friction", "coulomb_friction")  # 0 in a model that does not state them

Given = Mapping[str, Mapping[str, Any]]  # values by joint and quantity


class Lacking(ValueError):
    """Error for a model that lacks values; the message lists all of them.

    Attributes:
        quantities: the missing quantities, each with the joints that lack it.
    """

    def __init__(self, message: str, quantities: dict[str, list[str]]) -> None:
        super().__init__(message)
        self.quantities = quantities


class Typical(NamedTuple):
    """Values of a shipped robot, and the sources that its file states for them."""

    robot: str
    values: dict[str, tuple[float, ...]]  # by quantity, one for each joint from the base on
    sources: tuple[str, ...]


def completed(
    path: Path, tip: Any = None, given: Given | None = None, like: str | None = None, fixed: Collection[str] = ()
) -> Robot:
    """Return the robot of a URDF or MJCF file, completed with given and typical values.

    Args:
        path: the URDF or MJCF file.
        tip: name of a link or site, or a point (3,) [m] in the last link's frame.
        given: values by joint and quantity, see `UNITS`; they take precedence over the model's values.
        like: name of a shipped robot, whose values are used where they are neither given nor in the model.
        fixed: names of joints locked at their angles in the model.

    Raises:
        Lacking: values or the tip are missing.
        ModuleNotFoundError: MuJoCo is not installed; the message names the extra.
        ValueError: the model is not a chain of revolute joints, or a value is out of range or unknown.
        OSError: the file cannot be read.
    """
    tree = models.read_model(path, fixed)
    numbers, assumed = {name: dict(own) for name, own in (given or {}).items()}, list[str]()
    for name in numbers:
        if name not in tree.joints:
            raise ValueError(f"{shown(name)} is not a moving joint of {path}; choose from: {', '.join(tree.joints)}")
    lacking: dict[str, list[str]] = {}
    for name, number in zip(tree.joints, tree.numbers, strict=True):
        own = numbers.setdefault(name, {})
        stated = tree.stated(name, number)
        absent = [q for q in _ASKED if q not in own and (stated.get(q) is None or (q in _FRICTION and not stated[q]))]
        if like is not None and absent:
            limit = own.get("torque_limit", stated.get("torque_limit"))
            near, factor = _nearest(robot_named(like), limit)
            own |= {quantity: _of_joint(near, quantity, factor) for quantity in absent}
            assumed.append(f"{name}: values of joint {near.name} of {like}, times {factor:.3g}: {', '.join(absent)}.")
            absent = []
        for quantity in absent:
            lacking.setdefault(quantity, []).append(name)
    if lacking or tip is None:
        lines = [f"{quantity} [{UNITS[quantity]}] of {', '.join(names)}" for quantity, names in lacking.items()]
        if tip is None:
            lines.append(f"the tip, one of {', '.join(tree.places())}, or a point x,y,z [m] in the last link's frame")
        raise Lacking("\n".join(lines), lacking)
    said = f"{path.name}: frames, inertias, and the quantities that it states"
    chosen = [f"{name}: values given by the user: {', '.join(own)}." for name, own in (given or {}).items() if own]
    return models.robot_of_model(tree, tip, numbers, (said, *_sources(like)), (*chosen, *assumed))


def joints_of_model(path: Path, fixed: Collection[str] = ()) -> tuple[str, ...]:
    """Return the names of the moving joints of a model, without those `fixed`; errors as in `completed`."""
    return models.read_model(path, fixed).joints


def typical(quantities: Collection[str]) -> list[Typical]:
    """Return the values of these drive quantities in each shipped robot that states a source, with the source texts."""
    found = []
    for name in shipped_robots():
        robot, said = robot_named(name), dict[str, None]()
        for quantity in quantities:
            word = "friction" if quantity in _FRICTION else _WORDS.get(quantity, quantity)
            about = [text for text in (*robot.assumptions, *robot.sources) if re.search(word, text, re.IGNORECASE)]
            said |= dict.fromkeys(about[:1] or robot.sources[:1])
        values = {quantity: tuple(robot.drive(quantity).tolist()) for quantity in quantities if quantity in DRIVE_UNITS}
        if values and not robot.sources[0].startswith("None"):
            found.append(Typical(name, values, tuple(said)))
    return found


def _sources(like: str | None) -> tuple[str, ...]:
    return () if like is None else (f"What the model lacks: the file of {like} in this package, with its own sources",)


def _nearest(robot: Robot, limit: float | None) -> tuple[Joint, float]:
    """Return the joint whose torque limit is nearest to `limit` [N m], and `limit` divided by it.

    For None, the last joint and 1.
    """
    if limit is None:
        return robot.joints[-1], 1.0
    near = min(robot.joints, key=lambda joint: abs(math.log(joint.drive.torque_limit / limit)))
    return near, limit / near.drive.torque_limit


def _of_joint(joint: Joint, quantity: str, factor: float) -> Any:
    if quantity in {field.name for field in dataclasses.fields(Drive)}:
        return factor * getattr(joint.drive, quantity)
    return getattr(joint, quantity)
