"""The folder that `fuzzyarm tune` writes: an arm, its controller files, and the parameters of its other laws.

    robot.toml      the arm, in the format for `--robot`
    fuzzy-4.json    a controller file
    laws.json       the parameters of the laws and the names of the policies (`TunedLaws`)

``folder/fuzzy-4-tip``, ``folder/computed-torque`` and so on are names of policies, and the folder is also accepted as a
robot. The file of the laws is valid only for its arm: a folder with a changed arm is refused.
"""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fuzzyarm.common.checks import choice, distinct, listed, real
from fuzzyarm.policies.registry import ADAPTIVE_OBSERVER, COMPUTED_TORQUE, LAWS, TIP, make_law

if TYPE_CHECKING:
    from fuzzyarm.envs.physics.equations import AnyArm
    from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["NAME", "SCHEMA", "TunedLaws", "is_tuned", "policies_of", "tuned_policy"]

SCHEMA = "fuzzyarm-tuned/1"  # schema of the file of the laws
NAME = "laws.json"  # the file of the laws in the folder


@dataclasses.dataclass(frozen=True)
class TunedLaws:
    """The checked content of the file ``laws.json`` in a folder of `fuzzyarm tune`."""

    schema: str  # `SCHEMA`
    arm_sha256: str  # digest of the arm for which the laws were tuned, `Robot.digest`
    control_period: float  # T [s] of all policies
    policies: tuple[str, ...]  # names of the policies in the folder, without the folder
    bandwidth: float | None = None  # ω of computed torque [rad/s]; None without this law
    observer: dict[str, float] | None = None  # weights of the elastic observer, by name; None without this law
    adaptive: dict[str, float] | None = None  # weights of the adaptive observer, by name; None without this law
    # versions of the packages that made the folder, by name
    made_with: dict[str, str | None] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        choice("schema", self.schema, (SCHEMA,))
        real("control_period", self.control_period, "s", above=0.0, high=0.1)
        distinct("policies", self.policies)
        if self.bandwidth is not None:
            real("bandwidth", self.bandwidth, "rad/s", above=0.0, high=1e6)
        given = self.numbers()
        for name in self.policies:
            inner = name.removesuffix(TIP)
            if not name.isprintable() or any(mark in name for mark in "/\\:"):
                raise ValueError(f"policies: {name!a} must be the name of a policy in the folder, without a path")
            if inner in LAWS and given[inner] is None:
                raise ValueError(f"policies: {name} is listed, but the parameters of {inner} are missing")

    @classmethod
    def read(cls, folder: Path, arm: AnyArm) -> TunedLaws:
        """Return the laws of a folder of `fuzzyarm tune`; ValueError if it is damaged or was tuned for another arm."""
        from fuzzyarm.common.documents import check_schema, read_json, record
        from fuzzyarm.envs.physics.equations import robot_of

        path = folder / NAME
        content = read_json(path, largest=2**16)
        try:
            laws = record(check_schema(content, SCHEMA), cls)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {error}; make the folder again with fuzzyarm tune") from None
        if laws.arm_sha256 != robot_of(arm).digest:
            raise ValueError(
                f"{folder} was tuned for a different arm: give --robot {folder} (robot=), or, if its robot.toml was "
                "changed, tune its policies again with fuzzyarm tune --robot FILE"
            )
        return laws

    def numbers(self) -> dict[str, Any]:
        """Return the bandwidth or weights of each law, None if the law is missing; ValueError if a weight is wrong."""
        from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
        from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights

        weights = []
        for name, kind in (("observer", ObserverWeights), ("adaptive", AdaptiveWeights)):
            values = getattr(self, name)
            given, names = set(values or ()), {field.name for field in dataclasses.fields(kind)}
            if given and (missing := names - given) | (odd := given - names):
                raise ValueError(f"{name}: missing weights: {listed(missing) or None}; unknown: {listed(odd) or None}")
            weights.append(kind(**values) if values else None)
        return dict(zip(LAWS, (self.bandwidth, *weights), strict=True))

    def to_json(self) -> str:
        """Return the content as the text of the file ``laws.json``."""
        return json.dumps(dataclasses.asdict(self), indent=1, allow_nan=False) + "\n"


def is_tuned(folder: Path) -> bool:
    """Return whether a folder contains ``laws.json``, as a folder of `fuzzyarm tune` does."""
    return os.path.isfile(folder / NAME)  # unlike `Path.is_file`, False for names that are impossible in a file system


def policies_of(robot: object) -> tuple[str, ...] | None:
    """Return the policies of a tuned folder, with the folder in each name; None if `robot` is not such a folder."""
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.physics.robot import shipped_robots

    if not isinstance(robot, str | os.PathLike) or robot in shipped_robots() or not is_tuned(Path(robot)):
        return None
    folder = Path(robot)
    return tuple(str(folder / name) for name in TunedLaws.read(folder, chosen_arm(folder, None)).policies)


def tuned_policy(folder: Path, name: str, arm: AnyArm, control_period: float) -> Policy:
    """Return the law `name` of `LAWS` with the parameters in a folder tuned for `arm` and `control_period` [s]."""
    laws = TunedLaws.read(folder, arm)
    if name not in {policy.removesuffix(TIP) for policy in laws.policies}:
        raise ValueError(f"{folder} has no policy {name}; choose from: {', '.join(laws.policies)}")
    if control_period != laws.control_period:
        raise ValueError(
            f"{folder / name} was tuned for control_period = {laws.control_period:g} s, not {control_period:g} s; "
            f"use {laws.control_period:g} s"
        )
    numbers, period = laws.numbers(), laws.control_period
    if name != ADAPTIVE_OBSERVER:
        return make_law(name, arm, period, numbers[name])
    from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
    from fuzzyarm.policies._controller_policy import controller_policy

    certified = [policy.removesuffix(TIP) for policy in laws.policies if policy.removesuffix(TIP) not in LAWS]
    fallback = (
        controller_policy(folder / f"{certified[0]}.json", arm, period)
        if certified
        else make_law(COMPUTED_TORQUE, arm, period, laws.bandwidth)
    )
    return make_law(name, arm, period, numbers[name], TipPolicy(fallback))
