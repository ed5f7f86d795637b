"""From a name or a file to a policy: the one registry."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fuzzyarm.envs.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.model_based import ModelBasedPolicy

NAMES = ("fuzzy-4", "computed-torque")


def load_policy(
    name: str | Path, *, control_period: float = 1e-3, robot: ArmParameters | None = None
) -> ModelBasedPolicy:
    """Return a policy by name, or from the path of a controller file.

    Args:
        name: one of `NAMES`, or the path of a controller file (ending in ``.json``).
        control_period: time between two calls of `predict` [s].
        robot: the arm the policy is for, default Table 1. A controller file must have been designed for it.

    Raises:
        ValueError: unknown name; the file is damaged, fails its own check, or was designed for another robot.
        OSError: the file cannot be read.
    """
    # Imported here: `import fuzzyarm` compiles and loads nothing.
    from fuzzyarm.envs.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.computed_torque import ComputedTorquePolicy
    from fuzzyarm.fuzzy_policy.pdc import FuzzyPolicy

    robot = robot or ArmParameters()
    text = str(name)
    if text == "computed-torque":
        return ComputedTorquePolicy(robot, control_period)
    if text in NAMES:
        with resources.as_file(resources.files("fuzzyarm.fuzzy_policy.controllers") / f"{text}.json") as path:
            return FuzzyPolicy(_trusted_controller(path, robot), control_period)
    if text.endswith(".json"):
        return FuzzyPolicy(_trusted_controller(Path(name), robot), control_period)
    raise ValueError(
        f"unknown policy {text!r}; choose from: {', '.join(NAMES)}, or the path of a controller file (.json)"
    )


def _trusted_controller(path: Path, robot: ArmParameters) -> Controller:
    """Load a controller file and check it: made for this robot, and every inequality holds."""
    from fuzzyarm.fuzzy_policy.certificate import certify
    from fuzzyarm.fuzzy_policy.controller import Controller, ControllerFileError

    controller = Controller.load(path)
    if controller.model.parameters != robot:
        differing = [
            key for key, value in robot.to_dict().items() if controller.model.parameters.to_dict()[key] != value
        ]
        raise ControllerFileError(
            f"{path} was designed for another robot ({', '.join(differing)} differ): pass robot=, or design it anew "
            "with fuzzyarm design --robot FILE"
        )
    certificate = certify(controller)
    if not certificate.holds:
        raise ControllerFileError(
            f"{path} fails its own check (smallest margin {certificate.margin:.2g}): "
            "the file was changed after its design"
        )
    return controller
