"""The folder of a learned observer: arm, control period and record of its training, and the arrays of its network."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import listed, whole
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.learned_policy.estimate.network import EstimateNetwork
from fuzzyarm.learned_policy.folder import OBSERVER, BundleError, read_folder, tensors_in, write_folder

__all__ = ["EstimateBundle"]


@dataclasses.dataclass(frozen=True, eq=False)
class EstimateBundle:
    """A learned observer and where it comes from.

    Attributes:
        network: the recurrent network.
        parameters: the arm that it was trained for.
        control_period: for which it was trained [s].
        training: the settings of the training, a record for the reader.
        seed: of that training.
        curve: rows of the training, one mapping each.
        versions: of the libraries it was trained with.
    """

    network: EstimateNetwork
    parameters: ArmParameters
    control_period: float
    training: dict[str, Any] = dataclasses.field(default_factory=dict)
    seed: int = 0
    curve: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    versions: dict[str, Any] = dataclasses.field(default_factory=dict)

    def save(self, folder: Path) -> None:
        """Write the bundle atomically; an existing bundle is replaced.

        Raises:
            OSError: the folder cannot be written; what was there is left as it was.
            ValueError: the folder exists and is not a bundle.
        """
        description = {
            "schema": OBSERVER,
            "parameters": self.parameters.to_dict(),
            "control_period": self.control_period,
            "training": self.training,
            "seed": self.seed,
            "versions": self.versions,
            "weights_sha256": "",
            "curve": self.curve,
        }
        write_folder(folder, description, dataclasses.asdict(self.network))

    @classmethod
    def load(cls, folder: str | Path) -> EstimateBundle:
        """Read a bundle and check all of it.

        Raises:
            BundleError: a file is missing, too large, damaged, or not of this schema.
        """
        folder = Path(folder)
        description, weights = read_folder(folder, OBSERVER, _Description)
        try:
            return cls(
                network=_network(weights),
                parameters=ArmParameters.from_dict(description.parameters),
                control_period=checked_period("control_period", description.control_period),
                training=description.training,
                seed=whole("seed", description.seed),
                curve=description.curve,
                versions=description.versions,
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise BundleError(f"{folder} is no usable policy bundle: {' '.join(str(error).split())}") from None


@dataclasses.dataclass(frozen=True)
class _Description:
    """The content of ``policy.json``, in the order in which it is written."""

    schema: str
    parameters: dict[str, Any]
    control_period: float
    training: dict[str, Any]
    seed: int
    versions: dict[str, Any]
    weights_sha256: str
    curve: list[dict[str, Any]]


def _network(content: bytes) -> EstimateNetwork:
    """Return the network of a safetensors file."""
    tensors, names = tensors_in(content), {field.name for field in dataclasses.fields(EstimateNetwork)}
    if set(tensors) != names:
        raise ValueError(f"the weights hold {listed(tensors)}; needed: {', '.join(sorted(names))}")
    for name, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise ValueError(f"{name} is {tensor.dtype}; needed: float32")
    return EstimateNetwork(**tensors)
