"""Robots in TOML files: the two-joint arm, and serial robots."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fuzzyarm
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot

from .arguments import driven
from .damage import damaged_bytes, damaged_document
from .documents import prepared
from .samples import scratch
from .surface import Broken, Surface, Try

__all__ = ["SURFACES"]

ROBOTS = Path(fuzzyarm.__file__).parent / "envs" / "physics" / "robots"


def _robot(good: str, use: Callable[[Path], Any]) -> Callable[[np.random.Generator], Try]:
    """Tries of a TOML file: its values or its bytes."""

    def attempt(rng: np.random.Generator) -> Try:
        if rng.random() < 0.6:
            values, text = damaged_document(rng, tomllib.loads(good))
            pairs = values.items() if isinstance(values, dict) else ()
            lines = (f"{key if key.isidentifier() else json.dumps(key)} = {_toml(value)}" for key, value in pairs)
            content = "\n".join(lines).encode("utf-8", "surrogatepass")
        else:
            content, text = damaged_bytes(rng, good.encode())

        def run() -> None:
            path = scratch() / "robot.toml"
            path.write_bytes(content)
            use(path)

        return Try(f"robot.toml: {text}", run)

    return attempt


def _driven_arm(path: Path) -> None:
    driven(FuzzyArmEnv(parameters=ArmParameters.from_toml(path)))


def _serial_robot(path: Path) -> None:
    """Read a robot; its equations are generated from finite numbers and unit vectors alone."""
    robot = Robot.from_toml(path)
    for joint in robot.joints:
        numbers = np.array([*joint.axis, *joint.position, *joint.link.center, joint.link.mass])
        if not np.isfinite(numbers).all() or abs(np.linalg.norm(joint.axis) - 1.0) > 1e-6:
            raise Broken(f"joint {joint.name} has numbers or an axis that is none")


def _toml(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else f"{'-' * (value < 0)}inf"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return "''" if value is None else json.dumps(value)


SURFACES = (
    Surface("robot TOML", "files", 1500, _robot(ArmParameters().to_toml(), _driven_arm), prepare=prepared),
    *(
        Surface(f"{name}.toml", "files", 600, _robot((ROBOTS / f"{name}.toml").read_text(), _serial_robot))
        for name in ("planar-3r", "panda")
    ),
)
