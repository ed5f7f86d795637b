"""The equations of an arm, whatever describes it, and what it may be given as."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots
from fuzzyarm.envs.physics.two_joints import two_joints

__all__ = [
    "IN_FOLDER", "PAPER", "AnyArm", "Bounds", "argument_of", "bounds_of", "chosen_arm",
    "common_equations", "equations_of", "robot_of",
]  # fmt: skip

AnyArm = ArmParameters | Robot
"""The two-joint arm by its parameters, or any serial robot."""

PAPER = "paper"
"""The robot that is the two-joint arm of Table 1."""


IN_FOLDER = "robot.toml"
"""The file of the arm in a folder of `fuzzyarm tune`."""


class Bounds(NamedTuple):
    """Limits of an arm of n joints: lowest and highest angles [rad], speeds [rad/s] and torques [N m], each (n,)."""

    low: np.ndarray
    high: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


def equations_of(arm: AnyArm) -> Physics:
    """Return the equations of motion of an arm; arms of one structure have the same object."""
    if isinstance(arm, ArmParameters):
        return two_joints()
    from fuzzyarm.envs.physics.serial import physics_of  # the paper's arm needs no recursion

    return physics_of(arm)


def bounds_of(arm: AnyArm) -> Bounds:
    """Return the limits of an arm, all of shape (joints,)."""
    physics = equations_of(arm)
    limits = physics.limits(physics.plant_of(arm))
    low, high = physics.angle_range(limits)
    return Bounds(*(np.array(part) for part in (low, high, limits.velocity, limits.torque)))


def chosen_arm(robot: Any, parameters: Any) -> AnyArm:
    """Return the arm that the arguments ``robot`` and ``parameters`` of an environment name; neither: Table 1.

    Args:
        robot: name of a shipped robot, path of the TOML file of a robot or of a two-joint arm, folder of `fuzzyarm
            tune`, a `Robot`, or `ArmParameters`; None: the two-joint arm.
        parameters: of the two-joint arm, or None.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: both are given, or there is no such robot; the message names the choices.
        OSError: the file cannot be read.
    """
    if robot is None:
        return ArmParameters() if parameters is None else checks.instance("parameters", parameters, ArmParameters)
    if parameters is not None:
        raise ValueError(
            f"give either robot = {checks.shown(getattr(robot, 'name', robot))} or parameters of the two-joint arm, "
            "not both"
        )
    if isinstance(robot, Robot | ArmParameters):
        return robot
    if not isinstance(robot, str | os.PathLike):
        raise TypeError(
            f"robot is {type(robot).__name__}; it must be a name, the path of a TOML file, a Robot or ArmParameters"
        )
    return _named(os.fspath(robot))


def argument_of(arm: AnyArm) -> dict[str, Any]:
    """Return the argument of an environment that names an arm: ``parameters`` or ``robot``."""
    return {"parameters": arm} if isinstance(arm, ArmParameters) else {"robot": arm}


def _named(robot: str) -> AnyArm:
    if robot == PAPER:
        return ArmParameters()
    if robot in shipped_robots():
        return robot_named(robot)
    if os.path.isfile(Path(robot) / IN_FOLDER):
        robot = str(Path(robot) / IN_FOLDER)
    if Path(robot).suffix == ".toml":
        if {"joints", "model", "name", "tip"}.isdisjoint(read_toml(Path(robot))):
            return ArmParameters.from_toml(robot)
        from fuzzyarm.envs.physics.robot_models import read_robot  # the paper's arm needs no reader

        return read_robot(robot)
    raise ValueError(
        f"unknown robot {checks.shown(robot)}; choose from: {', '.join(shipped_robots())}, or give a .toml file or a "
        "folder of fuzzyarm tune"
    )


def robot_of(arm: AnyArm) -> Robot:
    """Return an arm as a robot."""
    return Robot.of(arm) if isinstance(arm, ArmParameters) else arm


def common_equations(arms: Sequence[AnyArm]) -> Physics:
    """Return the equations of all these arms; ValueError if they differ."""
    first, *others = map(equations_of, arms)
    if any(other is not first for other in others):
        same = "joint axes, joint rotations, and which of their other numbers are zero"
        raise ValueError(f"the arms of a batch must have the same structure: {same}; make one batch for each")
    return first
