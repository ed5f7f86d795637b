"""The folder of a learned observer: arm, control period and record of its training, and the arrays of its network."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import listed, whole
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.laws.learned.bundle import OBSERVER, Trained, read_folder, tensors_in, usable, write_folder
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
        """Check that a network for the two-joint arm has its joints."""
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
        folder = Path(folder)
        found, weights = read_folder(folder, OBSERVER, _Description)
        with usable(folder):
            if (found.arm is None) == (found.parameters is None):
                raise ValueError("it names no arm, or two: needed is one of parameters and arm")
            return cls(
                _network(weights),
                found.arm or ArmParameters.from_dict(found.parameters or {}),
                checked_period("control_period", found.control_period),
                training=found.training,
                seed=whole("seed", found.seed),
                curve=found.curve,
                versions=found.versions,
            )


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


def _network(content: bytes) -> EstimateNetwork:
    """Return the network of a safetensors file."""
    tensors, names = tensors_in(content), {field.name for field in dataclasses.fields(EstimateNetwork)}
    if set(tensors) != names:
        raise ValueError(f"the weights hold {listed(tensors)}; needed: {', '.join(sorted(names))}")
    for name, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise ValueError(f"{name} is {tensor.dtype}; needed: float32")
    return EstimateNetwork(**tensors)
