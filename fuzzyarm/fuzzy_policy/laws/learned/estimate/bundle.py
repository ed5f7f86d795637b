"""The folder of a learned observer: arm, control period and record of its training, and the arrays of its network."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import listed
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.laws.learned.bundle import OBSERVER, Trained, read_bundle, write_folder
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateNetwork

__all__ = ["EstimateBundle"]


@dataclasses.dataclass(frozen=True, eq=False)
class EstimateBundle(Trained):
    """A learned observer and where it comes from."""

    network: EstimateNetwork  # the recurrent network
    arm: ArmParameters | ArmDefinition  # that it was trained for: the two-joint arm, or what tells a robot from others
    control_period: float  # for which it was trained [s]

    def __post_init__(self) -> None:
        joints = len(ArmParameters().length)
        if isinstance(self.arm, ArmParameters) and (self.network.joints, self.network.axes) != (joints, joints):
            raise ValueError(f"it is for the two-joint arm, and its network for {self.network.joints} joints")

    def serves(self, arm: AnyArm) -> bool:
        """Return whether it was trained for an arm."""
        if isinstance(self.arm, ArmParameters):
            return arm == self.arm
        return isinstance(arm, Robot) and arm.digest == self.arm.digest

    def save(self, folder: Path) -> None:
        """Write the bundle, see `write_folder`."""
        arm = self.arm
        described = (
            {"parameters": arm.to_dict()} if isinstance(arm, ArmParameters) else {"arm": dataclasses.asdict(arm)}
        )
        record = {"training": self.training, "seed": self.seed, "versions": self.versions, "weights_sha256": ""}
        description = {"schema": OBSERVER, **described, "control_period": self.control_period, **record}
        write_folder(folder, {**description, "curve": self.curve}, dataclasses.asdict(self.network))

    @classmethod
    def load(cls, folder: str | Path) -> EstimateBundle:
        """Read a bundle and check all of it; BundleError as of `PolicyBundle.load`."""

        def build(found: _Description, tensors: dict[str, np.ndarray], trained: Any) -> EstimateBundle:
            names = {field.name for field in dataclasses.fields(EstimateNetwork)}
            if set(tensors) != names:
                raise ValueError(f"the weights hold {listed(tensors)}; needed: {', '.join(sorted(names))}")
            if (found.arm is None) == (found.parameters is None):
                raise ValueError("it names no arm, or two: needed is one of parameters and arm")
            arm = found.arm or ArmParameters.from_dict(found.parameters or {})
            period = checked_period("control_period", found.control_period)
            return cls(EstimateNetwork(**tensors), arm, period, **trained)

        return read_bundle(Path(folder), OBSERVER, _Description, build)


@dataclasses.dataclass(frozen=True)
class _Description:
    """The content of ``policy.json``; of the last two there is one."""

    schema: str
    control_period: float
    training: dict[str, Any]
    seed: int
    versions: dict[str, Any]
    weights_sha256: str
    curve: list[dict[str, Any]]
    parameters: dict[str, Any] | None = None
    arm: ArmDefinition | None = None
