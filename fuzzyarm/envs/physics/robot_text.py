"""A robot as the text of a TOML file, which `Robot.from_toml` reads back to an equal robot."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.robot import Robot

__all__ = ["arm_as_toml"]


def arm_as_toml(arm: AnyArm) -> str:
    """Return the TOML text of an arm; angles in rad, all other units SI, see `Joint` and `Drive`."""
    return _robot(arm) if isinstance(arm, Robot) else arm.to_toml()


def _robot(robot: Robot) -> str:
    content = dataclasses.asdict(robot)
    joints = content.pop("joints")
    lines = ["# Serial robot with elastic joints: rad, m, kg, N m.", *_fields(content)]
    for joint in joints:
        link, drive = joint.pop("link"), joint.pop("drive")
        lines += ["", "[[joints]]", *_fields(joint), "[joints.link]", *_fields(link), "[joints.drive]", *_fields(drive)]
    return "\n".join(lines) + "\n"


def _fields(content: dict[str, Any]) -> list[str]:
    return [f"{name} = {_value(value)}" for name, value in content.items() if value is not None]


def _value(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_value, value))}]"
    # A JSON text is a TOML text, but for DEL, which JSON leaves as it is.
    return json.dumps(value).replace("\x7f", "\\u007f") if isinstance(value, str) else repr(value)
