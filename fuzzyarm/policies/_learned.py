"""Learned policies of any kind, loaded from their folders."""

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
    from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle
    from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["learned_files", "learned_policy"]


def _bundle(folder: Path) -> PolicyBundle | EstimateBundle:
    if not is_observer(folder):
        return PolicyBundle.load(folder)
    # Imported here: the network of a learned torque needs no Riccati equations.
    from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle

    return EstimateBundle.load(folder)


def learned_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256, by file name, of a learned policy's ``policy.json``, and of the files of its base policy."""
    own, bundle = {DESCRIPTION: file_digest(folder / DESCRIPTION)}, _bundle(folder)
    base = bundle.action.base if isinstance(bundle, PolicyBundle) else None
    # Loading the policy refuses a base without a known name.
    return own | resolve(base).files() if base is not None and resolve(base).named else own


def learned_policy(folder: Path, control_period: float, robot: AnyArm) -> Policy:
    """Load a learned policy for a control period [s], together with its base policy if it has one.

    ValueError if the folder is damaged, or the policy was trained for another arm or another control period.
    """
    bundle, label = _bundle(folder), resolve(str(folder)).label
    if isinstance(bundle, PolicyBundle):
        serves = robot == ArmParameters() if bundle.arm is None else robot_of(robot).digest == bundle.arm.digest
        instead = "that arm (--robot), computed-torque, design a controller with fuzzyarm design"
        instead += " --robot NAME|FILE, or train a policy for this arm with fuzzyarm train ppo"
    else:
        serves = bundle.serves(robot)
        instead = "that arm (--robot), adaptive-observer, or train one for this arm with fuzzyarm train estimate"
    if not serves:
        arm = bundle.arm or ArmParameters()
        known = "the arm of Table 1" if arm == ArmParameters() else "another arm"
        trained = known if isinstance(arm, ArmParameters) else escaped(arm.name)
        raise ValueError(f"{label} was trained on {trained} and works only on it; use {instead} --robot NAME|FILE")
    if not isinstance(bundle, PolicyBundle):
        from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy

        if control_period != bundle.control_period:
            raise ValueError(
                f"{label} was trained for control_period = {bundle.control_period:g} s, not {control_period:g} s; use "
                f"{bundle.control_period:g} s, or the policy elastic-observer"
            )
        return LearnedObserverPolicy(bundle.network, robot, control_period)
    base = bundle.action.base
    if base is not None and not resolve(base).named:
        raise ValueError(
            f"{folder} was trained with the base {base!r}, which is unknown; known: {', '.join(known_names())}"
        )
    added = None if base is None else load_policy(base, control_period=control_period, robot=robot)
    return LearnedPolicy(bundle, control_period, robot, added)
