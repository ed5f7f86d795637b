"""The folder of a learned policy: ``policy.json`` with everything but the weights, and ``weights.safetensors``.

The folder contains no code: JSON is parsed, safetensors holds arrays of numbers, and nothing is unpickled. The digest
of the weights stands in ``policy.json``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from fuzzyarm.common.console import escaped
from fuzzyarm.common.documents import check_schema, parse_json, read_bytes, read_json, record
from fuzzyarm.common.files import write_folder_atomically

__all__ = [
    "BEST", "DESCRIPTION", "LAST", "OBSERVER", "WEIGHTS", "BundleError", "is_observer", "read_folder", "tensors_in",
    "write_folder",
]  # fmt: skip

DESCRIPTION = "policy.json"
"""File with everything but the weights."""

WEIGHTS = "weights.safetensors"
"""File with the arrays of the network."""

LAST, BEST = "policy", "best"
"""What the folder is called in that of a training: the policy at its end, and that of its best evaluation."""

OBSERVER = "fuzzyarm-learned-observer/4"
"""Schema of a learned observer, see `estimate.bundle`."""

_ANY_OBSERVER = OBSERVER[: OBSERVER.index("/") + 1]

_LARGEST_DESCRIPTION, _LARGEST_WEIGHTS = 16 * 2**20, 64 * 2**20  # bytes
_LENGTH, _LARGEST_HEADER = 8, 2**16  # bytes at the beginning of the file with the weights
_SHOWN = 200  # characters of a foreign text in a message


class _Described(Protocol):
    """A record of ``policy.json``."""

    @property
    def weights_sha256(self) -> str:
        """Digest of the file with the weights."""


_Kind = TypeVar("_Kind", bound=_Described)


class BundleError(ValueError):
    """A folder is damaged, incomplete or no bundle; the message is one line that names the file and what to do."""


def write_folder(folder: Path, description: dict[str, Any], tensors: Mapping[str, np.ndarray]) -> None:
    """Write a bundle atomically, with the digest of its weights; an existing bundle is replaced.

    Args:
        folder: of the bundle.
        description: content of ``policy.json``, whose ``weights_sha256`` is filled in.
        tensors: arrays by name; written in single precision.

    Raises:
        OSError: the folder cannot be written; what was there is left as it was.
        ValueError: the folder exists and is not a bundle.
    """
    # Imported here: reading a definition needs no safetensors.
    from safetensors.numpy import save

    if folder.exists() and not (folder / DESCRIPTION).is_file():
        raise ValueError(f"{folder} exists and is no policy bundle; choose another folder")
    weights = save({name: np.ascontiguousarray(array, dtype=np.float32) for name, array in tensors.items()})
    sealed = {**description, "weights_sha256": hashlib.sha256(weights).hexdigest()}
    text = json.dumps(sealed, indent=1, allow_nan=False)
    write_folder_atomically(folder, {WEIGHTS: weights, DESCRIPTION: f"{text}\n"})


def is_observer(folder: Path) -> bool:
    """Return whether a bundle says that it is a learned observer, of whichever version.

    Raises:
        BundleError: there is no description, or it is damaged.
    """
    content = _content(folder / DESCRIPTION)
    return isinstance(content, dict) and str(content.get("schema")).startswith(_ANY_OBSERVER)


def read_folder(folder: Path, schema: str, kind: type[_Kind]) -> tuple[_Kind, bytes]:
    """Return the description of a bundle, a record whose parts are not checked yet, and the bytes of its weights.

    Raises:
        BundleError: a file is missing, too large or damaged, not of this schema, or the digest differs.
    """
    path = folder / DESCRIPTION
    content = _content(path)
    try:
        description = record(check_schema(content, schema), kind)
    except ValueError as error:
        raise BundleError(f"{path} is no description of a policy: {error}; train it anew") from None
    weights = _weights(folder / WEIGHTS)
    if hashlib.sha256(weights).hexdigest() != description.weights_sha256:
        raise BundleError(
            f"{folder / WEIGHTS} is not the file that {DESCRIPTION} was written with (its sha256 differs): copy "
            "the whole folder again, or train anew"
        )
    return description, weights


def tensors_in(content: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of a safetensors file by name; ValueError if it is damaged."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    length = int.from_bytes(content[:_LENGTH], "little")  # of the header: a mapping as JSON, one entry for each tensor
    if length > _LARGEST_HEADER:
        raise ValueError(f"{WEIGHTS} is damaged: a header of {length} bytes; allowed: {_LARGEST_HEADER}")
    try:
        parse_json(content[_LENGTH : _LENGTH + length])  # refuses what stands twice, which the library does not
        tensors: dict[str, np.ndarray] = load(content)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{WEIGHTS} is damaged: {escaped(str(error)[:_SHOWN])}") from None
    return tensors


def _content(path: Path) -> Any:
    """Return the content of ``policy.json``."""
    try:
        return read_json(path, largest=_LARGEST_DESCRIPTION)
    except OSError as error:
        raise _missing(path, error) from None
    except ValueError as error:
        raise BundleError(f"{error}; copy the bundle again, or train anew") from None


def _weights(path: Path) -> bytes:
    """Return the content of the file with the weights."""
    try:
        return read_bytes(path, largest=_LARGEST_WEIGHTS)
    except OSError as error:
        raise _missing(path, error) from None
    except ValueError as error:
        raise BundleError(f"{error}; that is no policy of this package") from None


def _missing(path: Path, error: OSError) -> BundleError:
    return BundleError(
        f"{path}: {error.strerror or error}; a policy bundle is a folder with {DESCRIPTION} and {WEIGHTS}"
    )
