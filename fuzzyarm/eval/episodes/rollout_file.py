"""Rollouts as one compressed file of plain arrays, ``rollouts.npz``, and the digest that ties it to its results."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = ["NAME", "digest", "read_rollouts", "write_rollouts"]

NAME = "rollouts.npz"
"""Name of the file in an evaluation's folder."""
_FIELDS = tuple(field.name for field in dataclasses.fields(Rollout))


def digest(rollouts: Sequence[Rollout]) -> str:
    """Return the SHA-256 of all rollouts: names, types, shapes and bytes of every field, in order."""
    total = hashlib.sha256()
    for run in rollouts:
        for name in _FIELDS:
            array = np.asarray(getattr(run, name))
            total.update(f"{name} {array.dtype} {array.shape} ".encode())
            total.update(array.tobytes())
    return total.hexdigest()


def write_rollouts(rollouts: Sequence[Rollout], folder: Path) -> Path:
    """Write every field of every rollout to ``rollouts.npz``, atomically; return its path.

    The array of field ``torque`` of the third rollout is called ``2.torque``; names and flags are arrays as well.
    """
    content = io.BytesIO()
    arrays = {f"{k}.{name}": np.asarray(getattr(run, name)) for k, run in enumerate(rollouts) for name in _FIELDS}
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    write_atomically(folder / NAME, content.getvalue())
    return folder / NAME


def read_rollouts(path: Path) -> list[Rollout]:
    """Return the rollouts of a file written by `write_rollouts`; nothing is unpickled.

    Raises:
        ValueError: the file is damaged or holds something else.
        OSError: it cannot be read.
    """
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            rollouts: list[Rollout] = []
            while f"{len(rollouts)}.policy" in file:
                values = {name: file[f"{len(rollouts)}.{name}"] for name in _FIELDS}
                rollouts.append(Rollout(**{k: v.item() if v.ndim == 0 else v for k, v in values.items()}))
            return rollouts
    except (ValueError, KeyError, EOFError, AttributeError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path} is damaged ({error})") from None
