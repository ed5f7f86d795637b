"""What only some lanes do at an instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel

__all__ = ["in_lanes"]


def in_lanes(flags: np.ndarray, wanted: float, act: Callable[..., Any], seen: np.ndarray, *changed: np.ndarray) -> None:
    """Call ``act(seen, *changed)`` with the rows of the lanes whose flag (lanes,) is the wanted number.

    Args:
        flags: a number for each lane.
        wanted: that of the lanes that act.
        act: changes the rows of `changed` in place.
        seen: (lanes, ...), read.
        *changed: (lanes, ...) each, changed in place, in these lanes only.
    """
    count = _count(flags, wanted)
    if count == len(flags):
        act(seen, *changed)
    elif count:
        which = flags == wanted
        rows = [array[which] for array in changed]
        act(seen[which], *rows)
        for array, row in zip(changed, rows, strict=True):
            array[which] = row


@kernel
def _count(flags: np.ndarray, wanted: float) -> int:
    """Return how many entries (lanes,) are the wanted number."""
    count = 0
    for flag in flags:
        count += flag == wanted
    return count
