"""The division of a set of plants into cells, for each of which a tip bound is proven, on several CPU cores.

A set may be too large for one tube, the enclosure of all its motions. Every plant lies in one of the cells, so the
largest of their bounds holds for the whole set. A cell without a tube is halved, and its parts again, until each
part has a tube. The range to halve is the widest as a fraction of the set's range.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from joblib import Parallel, delayed

from fuzzyarm.common.checks import choice, distinct, whole
from fuzzyarm.policies.tip_bound import TipBound, TipClaim, find_bound
from fuzzyarm.policies.tip_files import CellBound, save_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import AXES, BY_JOINT, RANGES, Axis, PlantSet

__all__ = ["bounds_of_cells", "cells"]

_Division = tuple[str, int]  # a name of `_DIVISIBLE`, and the number of equal parts into which its range is divided

_DIVISIBLE: dict[str, list[Axis]] = {
    **{name: [axis for axis in AXES if axis[0] == name] for name in RANGES},
    **{f"{name}-{joint + 1}": [(name, joint)] for name, joint in AXES if name in BY_JOINT},
}
"""The ranges that a name divides: those of a field, for both joints if it has two (mass), or for one (mass-2)."""


def cells(plants: PlantSet, divisions: Sequence[_Division]) -> Iterator[PlantSet]:
    """Yield the cells of a set: all combinations of the parts of its divided ranges."""
    distinct("cells", [name for name, _ in divisions])
    axes: list[list[tuple[Axis, tuple[float, float]]]] = []
    for name, parts in divisions:
        choice("cells", name, tuple(_DIVISIBLE))
        count = whole(f"cells of {name}", parts, low=1, high=1000)
        for axis in _DIVISIBLE[name]:
            if axis in {known for known, _ in itertools.chain(*axes)}:
                raise ValueError(f"cells = {name} divides a range that another entry divides already; remove one entry")
            low, high = plants.of_joint(*axis)
            ends = [low + (high - low) * k / count for k in range(count)] + [high]
            axes.append([(axis, pair) for pair in itertools.pairwise(ends)])
    if (count := math.prod(map(len, axes))) > 10_000:
        raise ValueError(f"these divisions give {count} cells; allowed: at most 10000. Choose fewer parts")
    for chosen in itertools.product(*axes):
        cell = plants
        for axis, part in chosen:
            cell = cell.narrowed(axis, part)
        yield cell


def bounds_of_cells(
    claim: TipClaim, divisions: Sequence[_Division], jobs: int, out: Path | None = None
) -> Iterator[list[CellBound]]:
    """Yield, for each cell of the claim's set, a list: the cell's bound, or the bounds of its parts.

    `divisions` are pairs: the name of a range of the set, and the number of its parts. `jobs` processes compute the
    bounds. With `out`, each bound is written to a file in its folder: ``NAME-001.json`` and so on for ``NAME.json``.
    `NoBound` if a cell has no bound; the message names the cell.
    """
    tasks = [dataclasses.replace(claim, plants=cell, set_name="cell") for cell in cells(claim.plants, divisions)]
    names = [name for name, _ in divisions]
    stems = [out and f"{out.stem}-{number:03}" for number in range(1, len(tasks) + 1)]

    def saved(task: TipClaim, stem: str | None) -> list[CellBound]:
        found = []
        for number, bound in enumerate(_bounds_of_cell(task, claim.plants, names)):
            path = out and out.with_name(f"{stem}{chr(ord('a') + number) if number else ''}.json")
            if path is not None:
                save_bound(bound, path)
            found.append(CellBound(bound.claim.plants, bound.largest, len(bound.tip), path))
        return found

    work = (delayed(saved)(task, stem) for task, stem in zip(tasks, stems, strict=True))
    yield from Parallel(n_jobs=jobs, return_as="generator")(work)


def _bounds_of_cell(claim: TipClaim, plants: PlantSet, names: Sequence[str], halvings: int = 6) -> Iterator[TipBound]:
    """Yield the bound for the claim's set, which is a cell, or for its parts after up to `halvings` halvings.

    `plants` is the whole set; `names`, keys of `_DIVISIBLE`, are the ranges to halve. `NoBound` if a part has no bound.
    """
    try:
        yield find_bound(claim)
        return
    except NoBound as error:
        axis = _widest(claim.plants, plants, names)
        if not halvings or axis is None:
            raise NoBound(f"{claim.plants.in_words(plants)}: {error}") from None
    low, high = claim.plants.of_joint(*axis)
    middle = 0.5 * (low + high)
    for part in ((low, middle), (middle, high)):
        half = dataclasses.replace(claim, plants=claim.plants.narrowed(axis, part))
        yield from _bounds_of_cell(half, plants, names, halvings - 1)


def _widest(cell: PlantSet, plants: PlantSet, names: Sequence[str]) -> Axis | None:
    """Return the range in which `cell` is widest, relative to the whole set `plants`; None if no range has a width."""

    def width(of: PlantSet, axis: Axis) -> float:
        low, high = of.of_joint(*axis)
        return high - low

    axes = [axis for name in names for axis in _DIVISIBLE[name] if width(plants, axis) > 0.0]
    return max(axes, key=lambda axis: width(cell, axis) / width(plants, axis), default=None)
