"""From a name or a file to a policy: the one registry."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.controller import Controller
    from fuzzyarm.fuzzy_policy.policy import Policy

_FUZZY = ("fuzzy-32", "fuzzy-16", "fuzzy-8", "fuzzy-4", "fuzzy-2", "fuzzy-1")
_MOTOR_SIDE = (*_FUZZY, "computed-torque")
TIP = "-tip"
"""Ending of the name, or of the file, of a policy that is told to bring the tip to the reference, not the motors."""

LEARNED = ("ppo-nominal", "ppo-robust", "ppo-residual")
"""Policies trained with PPO, of each the median seed; what they were trained on is in their ``policy.json``."""

NAMES = (*_MOTOR_SIDE, *(name + TIP for name in _MOTOR_SIDE), "elastic-observer", *LEARNED)
"""Policies by name. More controller files, witnesses of the paper's own form, lie beside those of the fuzzy ones."""

COMPARED = (
    "fuzzy-4",
    "computed-torque",
    "fuzzy-4-tip",
    "computed-torque-tip",
    "elastic-observer",
    "ppo-robust",
    "ppo-residual",
)
"""What `fuzzyarm evaluate` runs if not told otherwise; `ppo-nominal` leaves the domain where it was not trained."""


def load_policy(
    name: str | Path,
    *,
    control_period: float = 1e-3,
    robot: ArmParameters | None = None,
    allow_unproven: bool = False,
) -> Policy:
    """Return a policy by name, or from the path of a controller file or of a learned policy's folder.

    With the ending ``-tip`` the policy compensates the bending of the joints, see `fuzzy_policy.tip`. Nothing that a
    name can say makes this function run code: a name may stand in a file, and a file is not to be trusted.

    Args:
        name: one of `NAMES`, or the path of a controller file (ending in ``.json`` or ``.json-tip``), or the folder of
            a learned policy (`learned_policy.bundle`).
        control_period: time between two calls of `predict` [s].
        robot: the arm the policy is for, default Table 1. A controller file must have been designed for it, and
            learned policies know none but Table 1.
        allow_unproven: take a controller file whose inequalities are not all proven, for experiments.

    Raises:
        ValueError: unknown name; the file or folder is damaged, not proven, or was designed for another robot.
        OSError: the file cannot be read.
    """
    # Imported here: `import fuzzyarm` compiles and loads nothing.
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
    from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
    from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
    from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy

    robot = robot or ArmParameters()
    text = str(name)
    known = text in NAMES or text.removesuffix(TIP).endswith(".json")
    if known and text.endswith(TIP):
        law = load_policy(
            text.removesuffix(TIP), control_period=control_period, robot=robot, allow_unproven=allow_unproven
        )
        return TipPolicy(law)
    if text == "elastic-observer":
        return ElasticObserverPolicy(robot, control_period)
    if text == "computed-torque":
        return ComputedTorquePolicy(robot, control_period)
    if text in _FUZZY:
        with resources.as_file(resources.files("fuzzyarm.fuzzy_policy.controllers") / f"{text}.json") as path:
            return FuzzyPolicy(_trusted_controller(path, robot, allow_unproven), control_period)
    if text in LEARNED:
        with resources.as_file(resources.files("fuzzyarm.learned_policy.policies") / text) as folder:
            return _learned(folder, control_period, robot)
    if text.endswith(".json"):
        return FuzzyPolicy(_trusted_controller(Path(name), robot, allow_unproven), control_period)
    if Path(name).is_dir():
        return _learned(Path(name), control_period, robot)
    if is_code(text):
        raise ValueError(
            f"{text} names code, which load_policy does not run: import it, or give it to fuzzyarm evaluate --policy"
        )
    raise ValueError(
        f"unknown policy {text!r}; choose from: {', '.join(NAMES)}, or the path of a controller file (.json, "
        f".json{TIP}), or of a learned policy's folder, on the command line also package.module:factory"
    )


def is_code(name: str) -> bool:
    """Return whether a name is of the form ``package.module:factory``, which `eval.own_policy` imports."""
    module, _, factory = name.partition(":")
    parts = (*module.split("."), *factory.split("."))
    return all(part.isidentifier() for part in parts) and not Path(name).exists()


def policy_label(name: str) -> str:
    """Return what a policy is called in tables and figures: its name, or its file's without folder and ``.json``."""
    return Path(name).name.replace(".json", "")


def _learned(folder: Path, control_period: float, robot: ArmParameters) -> Policy:
    """Load a learned policy, with the policy that it is based on if there is one."""
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.learned_policy.bundle import PolicyBundle
    from fuzzyarm.learned_policy.policy import LearnedPolicy

    if robot != ArmParameters():
        raise ValueError(
            f"{folder.name} was trained on the arm of Table 1 and knows no other; take computed-torque, or design a "
            "controller with fuzzyarm design --robot FILE"
        )
    bundle = PolicyBundle.load(folder)
    base = bundle.action.base
    if base is not None and base not in NAMES:
        raise ValueError(f"{folder} was trained on the base {base!r}, which is none of: {', '.join(NAMES)}")
    added = None if base is None else load_policy(base, control_period=control_period, robot=robot)
    return LearnedPolicy(bundle, control_period, robot, added)


def _trusted_controller(path: Path, robot: ArmParameters, allow_unproven: bool) -> Controller:
    """Load a controller file, see that it was made for this robot, and prove every inequality anew."""
    from fuzzyarm.fuzzy_policy.controller import Controller, ControllerFileError
    from fuzzyarm.fuzzy_policy.proof.certificate import certify

    controller = Controller.load(path)
    if controller.model.parameters != robot:
        differing = [
            key for key, value in robot.to_dict().items() if controller.model.parameters.to_dict()[key] != value
        ]
        raise ControllerFileError(
            f"{path} was designed for another robot ({', '.join(differing)} differ): pass robot=, or design it anew "
            "with fuzzyarm design --robot FILE"
        )
    if allow_unproven:
        return controller
    failed = [claim.name for claim in certify(controller).claims if not claim.proven]
    if failed:
        raise ControllerFileError(
            f"{path} is not proven ({len(failed)} inequalities fail, first: {failed[0]}): it was changed after "
            "its design, or never held; load_policy(..., allow_unproven=True) takes it all the same"
        )
    return controller
