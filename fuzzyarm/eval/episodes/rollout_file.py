"""Rollouts as one compressed file of plain arrays, ``rollouts.npz``, and the digest that links it to its results."""

from __future__ import annotations

import dataclasses
import hashlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from fuzzyarm.common.array_files import read_arrays
from fuzzyarm.common.checks import instance, path_of, sequence_of
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.episodes._beliefs import NO_BELIEFS
from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = ["NAME", "digest", "npz_bytes", "read_rollouts", "write_rollouts"]

NAME = "rollouts.npz"
"""Name of the file in an evaluation's folder."""
_FIELDS = tuple(field.name for field in dataclasses.fields(Rollout))
_KINDS = {str: "U", int: "i", float: "f", bool: "b"}  # of arrays, by the type of a field
_SINGLE = {name: _KINDS[kind] for name, kind in get_type_hints(Rollout).items() if kind in _KINDS}
_POINTS = ("tip", "tip_reference", "external_force")
_SCALARS = ("time", "tip_error", "circularity_error", "circularity_error_motor", "reward", "domain_use")
_LARGEST = 1e60  # the largest absolute value allowed for a number, whose powers are then finite


def digest(rollouts: Sequence[Rollout]) -> str:
    """Return the SHA-256 of all rollouts: names, types, shapes and bytes of every field, in order."""
    total = hashlib.sha256()
    for run in rollouts:
        for name in _FIELDS:
            array = _array(run, name)
            total.update(f"{name} {array.dtype} {array.shape} ".encode())
            total.update(array.tobytes())
    return total.hexdigest()


def write_rollouts(rollouts: Sequence[Rollout], folder: Path) -> Path:
    """Write every field of every rollout to ``rollouts.npz``, atomically; return its path.

    The field ``torque`` of the third rollout is the array ``2.torque``; names and flags are also arrays.
    """
    folder = path_of("folder", folder)
    runs = [instance("rollouts", run, Rollout) for run in sequence_of("rollouts", rollouts)]
    arrays = {f"{k}.{name}": _array(run, name) for k, run in enumerate(runs) for name in _FIELDS}
    write_atomically(folder / NAME, npz_bytes(arrays))
    return folder / NAME


def npz_bytes(arrays: Mapping[str, Any], *, compressed: bool = True) -> bytes:
    """Return arrays by name as the content of an NPZ file; nothing is pickled."""
    content, save = io.BytesIO(), np.savez_compressed if compressed else np.savez
    save(content, allow_pickle=False, **arrays)
    return content.getvalue()


def read_rollouts(path: Path) -> list[Rollout]:
    """Return the rollouts in a file that `write_rollouts` wrote; ValueError if it is damaged. Nothing is unpickled."""
    arrays = read_arrays(path)
    missing = [name for name in _FIELDS if f"0.{name}" not in arrays]
    if arrays and missing:
        raise ValueError(
            f"{path} is damaged, or was written by another version of fuzzyarm (its rollouts lack {missing[0]!r})"
        )
    count = len(arrays) // len(_FIELDS)
    if set(arrays) != {f"{k}.{name}" for k in range(count) for name in _FIELDS}:
        raise ValueError(f"{path} is damaged (it lacks arrays of a rollout, or has unknown ones)")
    try:
        return [_rollout({name: arrays[f"{k}.{name}"] for name in _FIELDS}) for k in range(count)]
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error})") from None


def _array(run: Rollout, name: str) -> np.ndarray:
    """Return a rollout's field `name` as an array; `belief_names` gives an array of strings even if it is empty."""
    return np.asarray(getattr(run, name), dtype=np.str_ if name == "belief_names" else None)


def _rollout(arrays: dict[str, np.ndarray]) -> Rollout:
    """Return a rollout from its fields; ValueError if a type or shape differs from that in `Rollout`."""
    steps, joints = len(np.atleast_1d(arrays["time"])), arrays["torque"].shape[-1] if arrays["torque"].ndim else 0
    axes = arrays["tip"].shape[-1] if arrays["tip"].shape[-1:] in ((2,), (3,)) else 2
    believed = len(set(arrays["belief_names"].ravel().tolist()))  # number of columns; all have different names
    shapes: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(_SINGLE, ()),
        **dict.fromkeys(_SCALARS, (steps,)),
        **dict.fromkeys(_POINTS, (steps, axes)),
        "beliefs": (steps, believed) if believed else NO_BELIEFS.shape,
        "belief_names": (believed,),
    }
    values: dict[str, Any] = {}
    for name, array in arrays.items():
        kind = "U" if name == "belief_names" else _SINGLE.get(name, "f")
        shape = shapes.get(name, (steps, joints))
        if array.dtype.kind != kind or array.shape != shape or steps == 0:
            needed = {"U": "strings", "f": "floats", "i": "integers", "b": "booleans"}.get(kind, kind)
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}; needed: {needed} of shape {shape}")
        unknown = np.isnan(array) if name == "beliefs" else False
        if kind == "f" and name != "step_time" and not (unknown | (np.abs(array) <= _LARGEST)).all():
            raise ValueError(f"{name} contains a number that is not finite, or not within ±{_LARGEST:g}")
        values[name] = array.item() if name in _SINGLE else tuple(array.tolist()) if kind == "U" else array
    return Rollout(**values)
