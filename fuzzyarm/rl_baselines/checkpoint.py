"""The checkpoint of a training: one file, replaced as a whole, so that a complete one is always there.

The file is a line, ``fuzzyarm-checkpoint/2 SHA256``, followed by what `torch.save` makes of tensors, numbers and text.
It is read with ``weights_only=True``: no code in it is run.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import random
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fuzzyarm.common.files import write_atomically

__all__ = [
    "CheckpointError",
    "as_array",
    "random_state",
    "read_checkpoint",
    "set_random_state",
    "write_checkpoint",
]

_SCHEMA = b"fuzzyarm-checkpoint/2"
_LARGEST = 2**31  # bytes
_SHOWN = 200  # characters of a library's message


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged or of another training; the message is one line that says what to do."""


def write_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint; until it is completely on the disk, the previous one stays.

    Args:
        path: file to write or replace.
        content: nested mappings and lists of tensors, NumPy arrays, numbers and text.

    Raises:
        OSError: it cannot be written; the previous checkpoint is untouched, and the message says so.
    """
    buffer = io.BytesIO()
    torch.save(_as_tensors(content), buffer)
    data = buffer.getvalue()
    try:
        write_atomically(path, _SCHEMA + b" " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)
    except OSError as error:
        intact = "the previous checkpoint is intact: free some space and resume"
        left = intact if path.exists() else "there is no checkpoint yet"
        raise OSError(error.errno, f"{error.strerror or error}; {left}", str(path)) from None


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read what `write_checkpoint` wrote; arrays come back as tensors.

    Raises:
        CheckpointError: the file is missing, damaged or not a checkpoint.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(_LARGEST + 1)
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror or error}; there is nothing to resume here") from None
    line, _, data = content.partition(b"\n")
    schema, _, digest = line.partition(b" ")
    if schema != _SCHEMA:
        raise CheckpointError(f"{path} is no checkpoint of this version ({_SCHEMA.decode()}); start the training anew")
    if hashlib.sha256(data).hexdigest().encode() != digest:
        raise CheckpointError(f"{path} is damaged (its sha256 differs); start the training anew")
    try:
        loaded = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError, KeyError) as error:
        reason = str(error).split("\n", maxsplit=1)[0][:_SHOWN]
        raise CheckpointError(
            f"{path} holds something else than tensors, numbers and text: {reason}; start the training anew"
        ) from None
    if not isinstance(loaded, dict):
        raise CheckpointError(f"{path} holds no mapping; start the training anew")
    return loaded


def random_state() -> dict[str, Any]:
    """Return the states of the random generators of torch, NumPy and Python, all of which stable-baselines3 uses."""
    kind, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002
    version, words, following = random.getstate()
    return {
        "torch": torch.get_rng_state(),
        "numpy": {"kind": kind, "keys": keys, "position": position, "has_gauss": has_gauss, "gauss": gauss},
        "python": {"version": version, "words": list(words), "following": following},
    }


def set_random_state(state: dict[str, Any]) -> None:
    """Put the random generators back to what `random_state` returned.

    Raises:
        KeyError, TypeError, ValueError, RuntimeError: it is no such state.
    """
    torch.set_rng_state(state["torch"])
    drawn, python = state["numpy"], state["python"]
    keys = as_array(drawn["keys"]).astype(np.uint32)
    np.random.set_state((drawn["kind"], keys, drawn["position"], drawn["has_gauss"], drawn["gauss"]))  # noqa: NPY002
    random.setstate((python["version"], tuple(python["words"]), python["following"]))


def as_array(tensor: torch.Tensor) -> np.ndarray:
    """Return a copy of a tensor as an array of the same shape."""
    return np.array(tensor.numpy())


def _as_tensors(content: Any) -> Any:
    """Return the content with tensors in place of NumPy arrays, which the safe reader does not know."""
    if isinstance(content, dict):
        return {name: _as_tensors(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return type(content)(_as_tensors(value) for value in content)
    if isinstance(content, np.ndarray):
        # Older versions of torch have no unsigned integers of 32 bits.
        wide = content.astype(np.int64) if content.dtype == np.uint32 else content
        return torch.from_numpy(np.array(wide))
    return content.item() if isinstance(content, np.generic) else content
