"""A learned policy as a folder: ``policy.json`` says everything in words and numbers, ``weights.safetensors`` the rest.

Nothing in it is code: JSON is parsed, safetensors is a table of numbers, and nothing is unpickled.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.learned_policy.definition import ActionDefinition, FeatureDefinition, is_finite
from fuzzyarm.learned_policy.network import Network

SCHEMA = "fuzzyarm-learned-policy/1"
DESCRIPTION, WEIGHTS = "policy.json", "weights.safetensors"
KEYS = ("schema", "network", "features", "action", "training", "seed", "curve", "versions", "weights_sha256")
LARGEST_DESCRIPTION, LARGEST_WEIGHTS = 16 * 2**20, 64 * 2**20  # bytes
ACTIVATION = "tanh"


class BundleError(ValueError):
    """A bundle is damaged, incomplete or none; the message is one line that names the file and what to do."""


@dataclasses.dataclass(frozen=True, eq=False)
class PolicyBundle:
    """All of a learned policy, and where it comes from.

    Attributes:
        features: what the network sees.
        action: what it does.
        network: normaliser and layers.
        training: the configuration it was trained with, for the reader.
        seed: of that training.
        curve: what was measured on the way, one mapping per evaluation.
        versions: of the libraries it was trained with.

    Raises:
        ValueError: the network does not have as many inputs as there are features, or not two outputs.
    """

    features: FeatureDefinition
    action: ActionDefinition
    network: Network
    training: dict[str, Any] = dataclasses.field(default_factory=dict)
    seed: int = 0
    curve: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    versions: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """See that the parts fit together."""
        inputs, outputs = self.network.sizes[0], self.network.sizes[-1]
        if (inputs, outputs) != (self.features.size, 2):
            raise ValueError(
                f"the network has {inputs} inputs and {outputs} outputs; the definitions ask for {self.features.size} "
                "and 2"
            )

    def save(self, folder: Path) -> None:
        """Write the bundle, whole or not at all; a bundle that is there already is replaced.

        Raises:
            OSError: the folder cannot be written; what was there is left as it was.
            ValueError: the folder is there and is no bundle.
        """
        # Imported here: reading a definition needs no safetensors.
        from safetensors.numpy import save

        if folder.exists() and not (folder / DESCRIPTION).is_file():
            raise ValueError(f"{folder} is there and is no policy bundle; choose another folder")
        tensors = {}
        for number, (weight, bias) in enumerate(zip(self.network.weights, self.network.biases, strict=True)):
            tensors[f"layer{number}.weight"] = np.ascontiguousarray(weight, dtype=np.float32)
            tensors[f"layer{number}.bias"] = np.ascontiguousarray(bias, dtype=np.float32)
        weights = save(tensors)
        text = json.dumps(self._description(hashlib.sha256(weights).hexdigest()), indent=1, allow_nan=False)
        aside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
        try:
            for name, content in ((WEIGHTS, weights), (DESCRIPTION, f"{text}\n".encode())):
                with open(aside / name, "wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
            aside.chmod(0o755)  # mkdtemp makes it private
            _replace_folder(aside, folder)
        finally:
            shutil.rmtree(aside, ignore_errors=True)

    @classmethod
    def load(cls, folder: str | Path) -> PolicyBundle:
        """Read a bundle and check all of it.

        Raises:
            BundleError: a file is missing, too large, damaged, or not of this schema.
        """
        folder = Path(folder)
        description = _parsed(folder / DESCRIPTION)
        weights = _read(folder / WEIGHTS, LARGEST_WEIGHTS)
        if hashlib.sha256(weights).hexdigest() != description["weights_sha256"]:
            raise BundleError(
                f"{folder / WEIGHTS} is not the file that {DESCRIPTION} was written with (its sha256 differs): copy "
                "the whole folder again, or train anew"
            )
        try:
            return cls(
                features=FeatureDefinition(**_mapping(description, "features")),
                action=_action(_mapping(description, "action")),
                network=_network(_mapping(description, "network"), weights),
                training=_mapping(description, "training"),
                seed=_whole(description["seed"]),
                curve=_rows(description["curve"]),
                versions=_mapping(description, "versions"),
            )
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise BundleError(f"{folder} is no usable policy bundle: {' '.join(reason.split())}") from None

    def _description(self, digest: str) -> dict[str, Any]:
        network = {
            "sizes": list(self.network.sizes),
            "activation": ACTIVATION,
            "mean": self.network.mean.tolist(),
            "std": self.network.std.tolist(),
            "clip": self.network.clip,
        }
        return {
            "schema": SCHEMA,
            "network": network,
            "features": dataclasses.asdict(self.features),
            "action": dataclasses.asdict(self.action),
            "training": self.training,
            "seed": self.seed,
            "versions": self.versions,
            "weights_sha256": digest,
            "curve": self.curve,
        }


def _replace_folder(new: Path, folder: Path) -> None:
    """Put `new` in the place of `folder`; a folder that is not empty cannot be renamed over."""
    if not folder.exists():
        os.rename(new, folder)
        return
    old = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.old."))
    os.rename(folder, old / folder.name)
    try:
        os.rename(new, folder)
    except OSError:
        os.rename(old / folder.name, folder)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _read(path: Path, largest: int) -> bytes:
    """Return the content of a file of at most `largest` bytes."""
    try:
        with open(path, "rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise BundleError(
            f"{path}: {error.strerror or error}; a policy bundle is a folder with {DESCRIPTION} and {WEIGHTS}"
        ) from None
    if len(content) > largest:
        raise BundleError(f"{path} is larger than {largest} bytes; that is no policy of this package")
    return content


def _parsed(path: Path) -> dict[str, Any]:
    """Return the description with every key there and the schema ours."""

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is not finite")

    try:
        description = json.loads(_read(path, LARGEST_DESCRIPTION).decode("utf-8"), parse_constant=refuse)
    except BundleError:
        raise
    except (ValueError, RecursionError) as error:
        raise BundleError(f"{path} is damaged: {str(error)[:200]}; copy the bundle again, or train anew") from None
    schema = description.get("schema") if isinstance(description, dict) else None
    if schema != SCHEMA:
        raise BundleError(f"{path} has schema {str(schema)[:100]!r}; this version reads {SCHEMA!r}")
    if set(description) != set(KEYS):
        differing = ", ".join(sorted(set(description) ^ set(KEYS)))[:200]
        raise BundleError(f"{path} is damaged: missing or unknown: {differing}")
    parsed: dict[str, Any] = description
    return parsed


def _network(description: dict[str, Any], content: bytes) -> Network:
    """Return the network of a description with the tensors of a safetensors file."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    if description["activation"] != ACTIVATION:
        raise ValueError(f"activation {description['activation']!r} is unknown; this version has {ACTIVATION!r}")
    try:
        tensors = load(content)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{WEIGHTS} is damaged: {str(error)[:200]}") from None
    layers = range(len(tensors) // 2)
    names = {f"layer{number}.{part}" for number in layers for part in ("weight", "bias")}
    if set(tensors) != names or not names:
        raise ValueError(f"{WEIGHTS} holds {', '.join(sorted(tensors))[:200]}; needed: layer0.weight, layer0.bias, ...")
    for name, tensor in tensors.items():
        axes = 2 if name.endswith("weight") else 1
        if tensor.dtype != np.float32 or tensor.ndim != axes:
            raise ValueError(f"{name} is {tensor.dtype} with {tensor.ndim} axes; needed: float32 with {axes}")
    network = Network(
        mean=_numbers(description, "mean"),
        std=_numbers(description, "std"),
        clip=float(description["clip"]),
        weights=tuple(tensors[f"layer{number}.weight"] for number in layers),
        biases=tuple(tensors[f"layer{number}.bias"] for number in layers),
    )
    if list(network.sizes) != description["sizes"]:
        raise ValueError(f"the layers have sizes {list(network.sizes)}, {DESCRIPTION} says {description['sizes']}")
    return network


def _action(description: dict[str, Any]) -> ActionDefinition:
    scale = description["scale"]
    return ActionDefinition(**{**description, "scale": tuple(scale) if isinstance(scale, list) else scale})


def _mapping(description: dict[str, Any], name: str) -> dict[str, Any]:
    found = description[name]
    if not isinstance(found, dict):
        raise ValueError(f"{name} must be a mapping")
    return found


def _numbers(description: dict[str, Any], name: str) -> np.ndarray:
    found = description[name]
    if not (isinstance(found, list) and all(is_finite(number) for number in found)):
        raise ValueError(f"{name} must be a list of finite numbers")
    return np.array(found, dtype=np.float64)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"seed = {value!r} is out of range; allowed: 0, 1, 2, ...")
    return value


def _rows(value: Any) -> list[dict[str, Any]]:
    if not (isinstance(value, list) and all(isinstance(row, dict) for row in value)):
        raise ValueError("curve must be a list of mappings")
    return value
