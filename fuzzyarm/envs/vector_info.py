"""The `info` of a batch: for each key an array with a row per lane, and a mask ``_key`` of the lanes that have it.

Quantities are in SI units [m, rad, rad/s, N m, N, s], as the kernels leave them.
"""

from __future__ import annotations

from collections.abc import Iterable
from mmap import mmap
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.layout import INFO, SCALARS
from fuzzyarm.envs.termination import Termination

__all__ = ["final_info", "flags", "masked", "partial_info", "reasons", "values"]

_REWARD, _REASON = map(SCALARS.index, ("reward", "reason"))
_FLAGS = ("torque_clipped", "truncated", "reason")
assert SCALARS[-len(_FLAGS) :] == _FLAGS
_LARGE = 1 << 18  # bytes; to ask for pages takes as long as to zero so many
_REASON_TEXTS = np.array([reason.text for reason in Termination], dtype=object)


def flags(scalars: np.ndarray) -> np.ndarray:
    """Return (3, lanes) booleans from the scalars (10, lanes): torque clipped, truncated, terminated."""
    return np.asarray(scalars[-len(_FLAGS) :] != 0.0)


def values(vectors: Iterable[np.ndarray], scalars: np.ndarray, flagged: np.ndarray | None = None) -> dict[str, Any]:
    """Return the numbers of `info` by name.

    Args:
        vectors: (lanes, numbers of the vector) each, as `Layout.each` gives them.
        scalars: (10, lanes) of the results.
        flagged: their `flags`, where they are known.
    """
    clipped, _, terminated = flags(scalars) if flagged is None else flagged
    return dict(zip(INFO, (*vectors, *scalars[:_REWARD], ~terminated, clipped), strict=True))


def masked(entries: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Return the entries with the mask (lanes,) of lanes that have them beside each, as Gymnasium's infos do."""
    return {**entries, **{f"_{key}": mask for key in entries}}


def partial_info(
    vectors: Iterable[np.ndarray], scalars: np.ndarray, drawn: dict[str, np.ndarray], mask: np.ndarray
) -> dict[str, Any]:
    """Return the info of some lanes; the rows of the others are zero.

    Args:
        vectors: (lanes, numbers of the vector) each, as `Layout.each` gives them.
        scalars: (10, lanes).
        drawn: what the episodes drew, by quantity: (lanes,) or (lanes, joints); empty if nothing is drawn.
        mask: (lanes,) of booleans.
    """
    which = np.flatnonzero(mask)
    info: dict[str, Any] = {name: _rows_of(which, rows) for name, rows in values(vectors, scalars).items()}
    if drawn:
        info["randomisation"] = masked({name: _rows_of(which, rows) for name, rows in drawn.items()}, mask)
    return masked(info, mask)


def _rows_of(which: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the rows (lanes, ...) of the lanes `which` (n,), zero elsewhere."""
    if rows.nbytes < _LARGE:
        some = np.zeros(rows.shape, rows.dtype)
    else:  # pages of zeros that the system makes when they are written, which few are: a batch ends lane by lane
        some = np.frombuffer(mmap(-1, rows.nbytes), rows.dtype).reshape(rows.shape)
    some[which] = rows[which]
    return some


def reasons(scalars: np.ndarray) -> dict[str, Any]:
    """Return why episodes were terminated, from the scalars (10, lanes) of the results; empty if none was."""
    terminated = scalars[_REASON] != 0.0
    if not terminated.any():
        return {}
    texts = np.empty(len(terminated), dtype=object)  # of None
    texts[terminated] = _REASON_TEXTS[scalars[_REASON, terminated].astype(int)]
    return masked({"reason": texts}, terminated)


def final_info(
    observation: np.ndarray,
    vectors: Iterable[np.ndarray],
    scalars: np.ndarray,
    drawn: dict[str, np.ndarray],
    ended: np.ndarray,
) -> dict[str, Any]:
    """Return the last observation and info of the episodes that ended, for the step in which the next ones begin.

    Args:
        observation: (lanes, 5 joints), as in the results.
        vectors: as in `partial_info`, and so are the next two.
        scalars: with a column per lane.
        drawn: by quantity.
        ended: (lanes,) of booleans.
    """
    final_obs = np.empty(len(ended), dtype=object)  # of None
    for lane in np.flatnonzero(ended):
        final_obs[lane] = observation[lane].copy()
    info = {**partial_info(vectors, scalars, drawn, ended), **reasons(scalars)}
    return masked({"final_obs": final_obs, "final_info": info}, ended)
