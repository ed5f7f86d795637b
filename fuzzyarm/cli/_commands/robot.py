"""`fuzzyarm robot`: a robot's file from its URDF or MJCF model."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, output_file
from fuzzyarm.common.console import say

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.from_model import Lacking

__all__ = ["Options"]

_NOT_MODELLED = "Backlash is not modelled: gears have no play here, and joints are linear springs."


@dataclass(frozen=True)
class Options:
    """Write the file of a robot, with every number that the package needs, from its URDF or MJCF model.

    A model has no joint stiffness, and seldom rotor inertia or friction. One message lists all missing numbers, with
    the values of the shipped robots and their sources. Backlash is not modelled. Needs `fuzzyarm[robots]`.
    """

    model: Annotated[Path, Parameter(name="", metavar="FILE")]
    """Model of a chain of revolute joints (.urdf or .xml)"""
    _: KW_ONLY
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """File of the robot to write (.toml; default: the model's name, in the working folder)"""
    tip: Annotated[str | None, Parameter(metavar="NAME|X,Y,Z")] = None
    """Link or site of the model, or a point [m] in the last link's frame"""
    set: Annotated[tuple[str, ...], Parameter(metavar="KEY=VALUE...")] = ()
    """Value for all joints or for one, such as stiffness=3e4, elbow.motor_inertia=0.6 or elbow.angle_range=-1,2. Drive
    quantities are as seen from the joint's side of the gear. May be repeated"""
    like: Annotated[str | None, Parameter(metavar="ROBOT")] = None
    """Shipped robot that provides the values still missing: those of its joint with the nearest torque limit, scaled in
    proportion to that limit"""
    fixed: Annotated[tuple[str, ...], Parameter(metavar="JOINT...")] = ()
    """Joint that stays fixed as in the model, such as one of a gripper. May be repeated"""

    def run(self) -> int:
        """Write the robot's file and return 0; if values are missing, list them and return 1."""
        from fuzzyarm.common.files import write_atomically
        from fuzzyarm.envs.physics.from_model import Lacking, completed

        out = Path(self.model.name).with_suffix(".toml") if self.out is None else self.out
        output_file(out, ".toml")
        if self.model.suffix not in (".urdf", ".xml"):
            raise UsageError(f"{self.model} must be a file ending in .urdf or .xml")
        try:
            robot = completed(self.model, _tip(self.tip), self._given(), self.like, self.fixed)
        except ModuleNotFoundError as error:
            raise UsageError(str(error)) from None
        except Lacking as error:
            _ask(self.model, error)
            return 1
        if self.out is None and out.exists():
            raise UsageError(f"{out} already exists; choose another file with --out FILE")
        write_atomically(out, robot.to_toml())
        say("\n".join(robot.assumptions))
        say(f"{_NOT_MODELLED}\n{len(robot)} joints, written to {out}")
        return 0

    def _given(self) -> dict[str, dict[str, Any]]:
        """Return the values of `set` by joint and quantity; a value for one joint overrides a value for all."""
        from fuzzyarm.envs.physics.from_model import UNITS, joints_of_model

        everywhere: dict[str, Any] = {}
        single: dict[str, dict[str, Any]] = {}
        for entry in self.set:
            key, equals, text = entry.partition("=")
            joint, _, quantity = key.rpartition(".")
            if not equals or quantity not in UNITS:
                raise UsageError(f"--set {entry} must be KEY=VALUE or JOINT.KEY=VALUE; keys: {', '.join(UNITS)}")
            (single.setdefault(joint, {}) if joint else everywhere)[quantity] = _number(entry, quantity, text)
        if not everywhere:
            return single
        joints = joints_of_model(self.model, self.fixed)
        return {name: everywhere | single.pop(name, {}) for name in joints} | single


def _number(entry: str, quantity: str, text: str) -> Any:
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) != (2 if quantity == "angle_range" else 1):
        wanted = "two numbers LOW,HIGH" if quantity == "angle_range" else "a number"
        raise UsageError(f"--set {entry}: {quantity} must be {wanted}")
    return numbers if quantity == "angle_range" else numbers[0]


def _tip(text: str | None) -> Any:
    if text is None or "," not in text:
        return text
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise UsageError(f"--tip {text} must be the name of a link or site, or three numbers X,Y,Z [m]") from None
    return x, y, z


def _ask(model: Path, lacking: Lacking) -> None:
    """Print what a model lacks, and typical values with their sources."""
    from fuzzyarm.envs.physics.from_model import UNITS, typical

    say(f"{model} does not specify:\n" + "\n".join(f"  {line}" for line in str(lacking).splitlines()))
    for robot, values, sources in typical(lacking.quantities):
        say(f"\ntypical values, from {robot}, joint by joint from the base:")
        for quantity, numbers in values.items():
            say(f"  {quantity} = {', '.join(f'{number:.3g}' for number in numbers)} {UNITS[quantity]}")
        say("\n".join(f"  source: {text}" for text in sources))
    say(f"\n{_NOT_MODELLED}")
    say(
        "nothing was written: give each value with --set KEY=VALUE or --set JOINT.KEY=VALUE, or use --like ROBOT "
        "to take the rest from a shipped robot",
        error=True,
    )
