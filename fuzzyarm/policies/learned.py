"""The folder of a learned policy of any kind, as a policy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fuzzyarm.common.console import escaped
from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.learned.bundle import DESCRIPTION, PolicyBundle, is_observer
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.policies.registry import known_names
from fuzzyarm.policies.spec import file_digest, load_policy, resolve

if TYPE_CHECKING:
    from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
    from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["learned_files", "learned_policy"]


def learned_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256, by name, of ``policy.json`` and of the files of the policy's base."""
    own = {DESCRIPTION: file_digest(folder / DESCRIPTION)}
    if is_observer(folder):
        from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle

        EstimateBundle.load(folder)
        return own
    base = PolicyBundle.load(folder).action.base
    # A base that is no known name is refused when the policy is loaded.
    return own | resolve(base).files() if base is not None and resolve(base).named else own


def learned_policy(folder: Path, control_period: float, robot: AnyArm) -> Policy:
    """Load a learned policy for a control period [s], with the policy that it is based on if there is one.

    ValueError if the folder is damaged, the arm is not the one it was trained for, or the period does not fit.
    """
    if is_observer(folder):
        return _learned_observer(folder, control_period, robot)
    bundle = PolicyBundle.load(folder)
    if bundle.arm is None:
        _check_arm(folder, robot == ArmParameters(), "the arm of Table 1")
    else:
        _check_arm(folder, robot_of(robot).digest == bundle.arm.digest, escaped(bundle.arm.name))
    base = bundle.action.base
    if base is not None and not resolve(base).named:
        raise ValueError(f"{folder} was trained on the base {base!r}, which is none of: {', '.join(known_names())}")
    added = None if base is None else load_policy(base, control_period=control_period, robot=robot)
    return LearnedPolicy(bundle, control_period, robot, added)


def _learned_observer(folder: Path, control_period: float, robot: AnyArm) -> LearnedObserverPolicy:
    # Imported here: the network of a learned torque needs no Riccati equations.
    from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle
    from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy

    bundle = EstimateBundle.load(folder)
    if isinstance(bundle.arm, ArmParameters):
        trained = "the arm of Table 1" if bundle.arm == ArmParameters() else "another arm"
    else:
        trained = escaped(bundle.arm.name)
    _check_arm(
        folder,
        bundle.serves(robot),
        trained,
        "adaptive-observer, or train one for this arm with fuzzyarm train estimate --robot NAME|FILE",
    )
    if control_period != bundle.control_period:
        raise ValueError(
            f"{resolve(str(folder)).label} was trained for control_period = {bundle.control_period:g} s, not "
            f"{control_period:g} s: take that period, or elastic-observer"
        )
    return LearnedObserverPolicy(bundle.network, robot, control_period)


_OTHERS = (
    "computed-torque, design a controller with fuzzyarm design --robot NAME|FILE, or train a policy for this arm with "
    "fuzzyarm train ppo --robot NAME|FILE"
)


def _check_arm(folder: Path, same: bool, name: str, instead: str = _OTHERS) -> None:
    if not same:
        raise ValueError(f"{resolve(str(folder)).label} was trained on {name} and knows no other; take {instead}")
