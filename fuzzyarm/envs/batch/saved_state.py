"""Checks of a saved state of a batch: kernels index by it, and a state may come from a file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.layout import CLOCK

__all__ = ["SavedArrays", "check_contents", "checked_arrays", "digest"]

SavedArrays = dict[str, np.ndarray]
"""Arrays of a state by name: ``values``, ``clock`` and ``drawn`` of the lanes, and ``made_of``; see `Lanes`."""


def checked_arrays(state: Any, like: SavedArrays) -> SavedArrays:
    """Return copies of the arrays of a state that are as those of `like`; what else the state holds is left out.

    Raises:
        TypeError: the state is no dictionary.
        ValueError: an array is missing, of another type or shape, or holds numbers that are not finite.
    """
    checks.instance("state", state, dict)
    arrays: SavedArrays = {}
    for name, own in like.items():
        given = state.get(name)
        if not isinstance(given, np.ndarray) or given.dtype != own.dtype or given.shape != own.shape:
            found = f"{given.dtype} {given.shape}" if isinstance(given, np.ndarray) else checks.shown(given)
            raise ValueError(f"state[{name!r}] is {found}; needed: an array {own.dtype} {own.shape}")
        if given.dtype.kind == "f" and not np.isfinite(given).all():
            raise ValueError(f"state[{name!r}] holds numbers that are not finite")
        arrays[name] = np.array(given, order="C")
    return arrays


def check_contents(arrays: SavedArrays, begun: SavedArrays, changing: int, over: np.ndarray | None = None) -> None:
    """Raise ValueError unless a state is one that the lanes can come to.

    All but the state of the arm and the present instant follows from the key of the episode.

    Args:
        arrays: of the state.
        begun: ``values``, ``clock`` and ``drawn`` at the beginning of the episodes with the keys of the state.
        changing: how many rows of ``values``, the first ones, change within an episode.
        over: (n,) the numbers of the lanes whose episode has ended: only these may be at their last row.
    """
    clock, expected = arrays["clock"], begun["clock"]
    row, first, last = clock[CLOCK.row], clock[CLOCK.first], clock[CLOCK.last]
    latest = last - 1
    if over is not None:
        latest[over] += 1
    wrong = (first != expected[CLOCK.first]) | (last != expected[CLOCK.last]) | (row < first) | (row > latest)
    if wrong.any():
        lane = int(np.argmax(wrong))
        begins, ends = expected[CLOCK.first, lane], expected[CLOCK.last, lane]
        raise ValueError(
            f"state['clock'] has lane {lane} at row {row[lane]} of {first[lane]} to {last[lane]}; allowed: {begins} to "
            f"{latest[lane]} of {begins} to {ends}"
        )
    if not np.array_equal(arrays["drawn"], begun["drawn"]):
        raise ValueError("state['drawn'] is not what the keys of its episodes draw")
    if not np.array_equal(arrays["values"][changing:], begun["values"][changing:]):
        raise ValueError("state['values'] holds other arms than the keys of its episodes draw")


def digest(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Return the SHA-256 of arrays of any shape as 32 numbers of uint8, shape (32,)."""
    content = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts))
    return np.frombuffer(content.digest(), dtype=np.uint8)
