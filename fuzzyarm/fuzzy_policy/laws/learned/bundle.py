"""A learned policy as a folder: ``policy.json`` with everything but the weights, and ``weights.safetensors``.

A bundle contains no code: JSON is parsed, safetensors contains arrays of numbers, and nothing is unpickled.
``policy.json`` contains the digest of the weights.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fuzzyarm.common.checks import listed, whole
from fuzzyarm.common.console import escaped
from fuzzyarm.common.documents import check_schema, parse_json, read_bytes, read_json, record
from fuzzyarm.common.files import write_folder_atomically
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, ArmDefinition, FeatureDefinition
from fuzzyarm.fuzzy_policy.laws.learned.network import Network

__all__ = [
    "BEST", "DESCRIPTION", "LAST", "OBSERVER", "WEIGHTS", "BundleError", "PolicyBundle", "Trained", "is_observer",
    "read_bundle", "write_folder",
]  # fmt: skip

DESCRIPTION = "policy.json"  # file with everything but the weights
WEIGHTS = "weights.safetensors"  # file with the arrays of the network
LAST, BEST = "policy", "best"
"""Names of the bundles in a training run's folder: the final policy, and the policy with the best evaluation."""

OBSERVER = "fuzzyarm-learned-observer/4"  # schema of a learned observer, see `estimate.rnn`
_ANY_OBSERVER = OBSERVER[: OBSERVER.index("/") + 1]

_LARGEST_DESCRIPTION, _LARGEST_WEIGHTS = 16 * 2**20, 64 * 2**20  # bytes
_LENGTH, _LARGEST_HEADER = 8, 2**16  # bytes of a weights file's length field and largest header
_SHOWN = 200  # characters of a library's text in a message

_Bundle = TypeVar("_Bundle")


class BundleError(ValueError):
    """Error for a folder that is damaged, incomplete or not a bundle; one line names the file and the remedy."""


def write_folder(folder: Path, description: dict[str, Any], tensors: Mapping[str, np.ndarray]) -> None:
    """Write a bundle atomically, its arrays in single precision; an existing bundle is replaced.

    ``weights_sha256`` of the description is filled in. ValueError if the folder exists and is not a bundle; OSError if
    it cannot be written, with existing content unchanged.
    """
    # Imported here: reading a definition needs no safetensors.
    from safetensors.numpy import save

    if folder.exists() and not (folder / DESCRIPTION).is_file():
        raise ValueError(f"{folder} exists and is not a policy bundle; choose another folder")
    weights = save({name: np.ascontiguousarray(array, dtype=np.float32) for name, array in tensors.items()})
    sealed = {**description, "weights_sha256": hashlib.sha256(weights).hexdigest()}
    text = json.dumps(sealed, indent=1, allow_nan=False)
    write_folder_atomically(folder, {WEIGHTS: weights, DESCRIPTION: f"{text}\n"})


def is_observer(folder: Path) -> bool:
    """Return whether a bundle's schema names a learned observer, of any version; BundleError if it is damaged."""
    content = _content(folder / DESCRIPTION)
    return isinstance(content, dict) and str(content.get("schema")).startswith(_ANY_OBSERVER)


def read_bundle(
    folder: Path, schema: str, kind: type, build: Callable[[Any, dict[str, np.ndarray], Any], _Bundle]
) -> _Bundle:
    """Read a bundle and return ``build(description, arrays, trained)``.

    The description is a `kind`; the arrays and the fields of `Trained` are given by name.
    BundleError if a file is missing, too large, damaged or of another schema, if the digest of the weights differs, if
    an array is not in single precision, or if the parts do not fit together.
    """
    path = folder / DESCRIPTION
    content = _content(path)
    try:
        description: Any = record(_without_off(check_schema(content, schema)), kind)
    except ValueError as error:
        raise BundleError(f"{path} is not a description of a policy: {error}; train the policy again") from None
    weights = _read(folder / WEIGHTS, read_bytes, _LARGEST_WEIGHTS, "it is not a policy of this package")
    if hashlib.sha256(weights).hexdigest() != description.weights_sha256:
        raise BundleError(
            f"{folder / WEIGHTS} is not the file that belongs to {DESCRIPTION} (its sha256 differs): copy the whole "
            "folder again, or train the policy again"
        )
    try:
        tensors = _tensors_in(weights)
        trained = {field.name: getattr(description, field.name) for field in dataclasses.fields(Trained)}
        return build(description, tensors, trained | {"seed": whole("seed", description.seed)})
    except (TypeError, ValueError, OverflowError) as error:
        raise BundleError(f"{folder} is not a usable policy bundle: {' '.join(str(error).split())}") from None


# Former settings, for actions beside an observer, with the values that turned them off: shipped files contain them.
_OFF: tuple[tuple[str, Any], ...] = (
    ("innovation_times", []), ("innovation_scale", 1e-6), ("innovation_rate_scale", 2e-3), ("load_scale", 100.0),
    ("gate", 0.0),
)  # fmt: skip


def _without_off(content: dict[str, Any]) -> dict[str, Any]:
    parts = {name: content[name] for name in ("features", "action") if isinstance(content.get(name), dict)}
    return content | {name: dict(pair for pair in part.items() if pair not in _OFF) for name, part in parts.items()}


def _tensors_in(content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of a safetensors file by name; ValueError if it is damaged."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    length = int.from_bytes(content[:_LENGTH], "little")  # of the header: a mapping as JSON, one entry for each tensor
    if length > _LARGEST_HEADER:
        raise ValueError(f"{WEIGHTS} is damaged: its header has {length} bytes; allowed: at most {_LARGEST_HEADER}")
    try:
        parse_json(content[_LENGTH : _LENGTH + length])  # refuses duplicate names, which the library accepts
        tensors: dict[str, np.ndarray] = load(content)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{WEIGHTS} is damaged: {escaped(str(error)[:_SHOWN])}") from None
    for name, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise ValueError(f"the array {escaped(name)} has type {tensor.dtype}; needed: float32")
    return tensors


def _content(path: Path) -> Any:
    return _read(path, read_json, _LARGEST_DESCRIPTION, "copy the bundle again, or train the policy again")


def _read(path: Path, read: Callable[..., Any], largest: int, instead: str) -> Any:
    try:
        return read(path, largest=largest)
    except OSError as error:
        needed = f"a policy bundle is a folder with {DESCRIPTION} and {WEIGHTS}"
        raise BundleError(f"{path}: {error.strerror or error}; {needed}") from None
    except ValueError as error:
        raise BundleError(f"{error}; {instead}") from None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trained:
    """The origin of a learned policy: its training run."""

    training: dict[str, Any] = dataclasses.field(default_factory=dict)  # settings of the training run
    seed: int = 0  # of the training run
    curve: list[dict[str, Any]] = dataclasses.field(default_factory=list)  # rows of the learning curve, a mapping each
    versions: dict[str, Any] = dataclasses.field(default_factory=dict)  # of the libraries used in the training run

    @property
    def _record(self) -> dict[str, Any]:
        """The entries of ``policy.json`` for these fields and the digest, which `write_folder` fills in."""
        own = {"training": self.training, "seed": self.seed, "versions": self.versions}
        return {**own, "weights_sha256": "", "curve": self.curve}


_SCHEMA = "fuzzyarm-learned-policy/1"
_OUTPUT = "clip"  # default output, which a description omits
_PAPERS_JOINTS = 2


@dataclasses.dataclass(frozen=True, eq=False)
class PolicyBundle(Trained):
    """A learned policy and its origin.

    ValueError if the network does not have one input per feature and one output per joint, or if features and action
    are for different numbers of joints.
    """

    features: FeatureDefinition  # definition of the network's inputs
    action: ActionDefinition  # meaning of the network's outputs
    network: Network  # normaliser and layers
    arm: ArmDefinition | None = None  # arm for which it was trained; None: the arm of Table 1

    def __post_init__(self) -> None:
        joints = len(self.action.scale)
        if self.features.joints != joints:
            raise ValueError(f"features.joints = {self.features.joints}, but action.scale is for {joints} joint(s)")
        if self.arm is None and joints != _PAPERS_JOINTS:
            raise ValueError("arm is missing; only a policy for the default arm may omit it")
        found, needed = (self.network.sizes[0], self.network.sizes[-1]), (self.features.size, joints)
        if found != needed:
            text = "the network has {} inputs and {} outputs; the features and the action need {} and {}"
            raise ValueError(text.format(*found, *needed))

    def save(self, folder: Path) -> None:
        """Write the bundle, see `write_folder`; ValueError for a recurrent network, which has no file format."""
        network, arrays, tensors = self.network, ("mean", "std"), {}
        if network.cell is not None:
            raise ValueError("a recurrent network cannot be saved: keep the model file of the library that trained it")
        for number, layer in enumerate(zip(network.weights, network.biases, strict=True)):
            tensors[f"layer{number}.weight"], tensors[f"layer{number}.bias"] = layer
        described = {"sizes": list(network.sizes), "activation": network.activation}
        described |= {name: getattr(network, name).tolist() for name in arrays} | {"clip": network.clip}
        described |= {} if network.output == _OUTPUT else {"output": network.output}
        parts = {"features": dataclasses.asdict(self.features), "action": dataclasses.asdict(self.action)}
        arm = {} if self.arm is None else {"arm": dataclasses.asdict(self.arm)}
        write_folder(folder, {"schema": _SCHEMA, "network": described, **parts, **self._record, **arm}, tensors)

    @classmethod
    def load(cls, folder: str | Path) -> PolicyBundle:
        """Read a bundle and check all of it; BundleError if a file is missing, damaged, or of another schema."""

        def build(found: _Description, tensors: dict[str, np.ndarray], trained: Any) -> PolicyBundle:
            return cls(found.features, found.action, _network(found.network, tensors), found.arm, **trained)

        return read_bundle(Path(folder), _SCHEMA, _Description, build)


@dataclasses.dataclass(frozen=True)
class _NetworkDescription:
    """The part of ``policy.json`` that describes the network."""

    sizes: list[int]
    activation: str
    mean: list[float]
    std: list[float]
    clip: float
    output: str = _OUTPUT


@dataclasses.dataclass(frozen=True)
class _Description:
    """The content of ``policy.json``."""

    schema: str
    network: _NetworkDescription
    features: FeatureDefinition
    action: ActionDefinition
    training: dict[str, Any]
    seed: int
    versions: dict[str, Any]
    weights_sha256: str
    curve: list[dict[str, Any]]
    arm: ArmDefinition | None = None


def _network(description: _NetworkDescription, tensors: dict[str, np.ndarray]) -> Network:
    layers = range(len(tensors) // 2)
    if set(tensors) != {f"layer{number}.{part}" for number in layers for part in ("weight", "bias")} or not layers:
        raise ValueError(f"{WEIGHTS} has the arrays ({listed(tensors)}); needed: layer0.weight, layer0.bias, ...")
    mean, std = np.array(description.mean, dtype=np.float64), np.array(description.std, dtype=np.float64)
    weights, biases = (tuple(tensors[f"layer{n}.{part}"] for n in layers) for part in ("weight", "bias"))
    network = Network(mean, std, description.clip, weights, biases, description.activation, description.output)
    if list(network.sizes) != description.sizes:
        raise ValueError(f"the layers have sizes {list(network.sizes)}, but {DESCRIPTION} says {description.sizes}")
    return network
