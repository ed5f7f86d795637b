"""A set that is too large for one tube, divided into cells, each with a tube of its own, on several cores.

A constant lies in the range of one of the cells, so the largest of their bounds holds for the whole set. Divided are
ranges of one number; the factors of both joints share a range, although they are independent.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound
from fuzzyarm.eval.certified.tip.bound_file import save_bound
from fuzzyarm.eval.certified.tip.enclosures import NoBound
from fuzzyarm.eval.certified.tip.plant_set import PlantSet

__all__ = ["DIVISIBLE", "CellBound", "bounds_of_cells", "cells"]

DIVISIBLE = ("payload", "force")
"""What can be divided: ranges of one number."""


@dataclasses.dataclass(frozen=True)
class CellBound:
    """What was found of one cell.

    Attributes:
        plants: the cell.
        bound: of the tip error [m]; None where there is none.
        reason: why there is none; empty where there is one.
        samples: of the motion that are bounded.
        path: file of the bound; None where none was written.
    """

    plants: PlantSet
    bound: float | None
    reason: str
    samples: int
    path: Path | None


def cells(plants: PlantSet, field: str, count: int) -> Iterator[PlantSet]:
    """Yield the cells of a set, whose range of one field is divided into `count` equal parts that touch."""
    if field not in DIVISIBLE:
        raise ValueError(f"{field} cannot be divided; choose from: {', '.join(DIVISIBLE)}")
    low, high = getattr(plants, field)
    ends = [low + (high - low) * k / count for k in range(count)] + [high]
    for k in range(count):
        part: dict[str, Any] = {field: (ends[k], ends[k + 1])}
        yield dataclasses.replace(plants, **part)


def bounds_of_cells(claim: TipClaim, field: str, count: int, jobs: int, out: Path | None = None) -> Iterator[CellBound]:
    """Yield what is found of each cell of the claim's set, computed in `jobs` processes.

    With `out`, the file of each bound is written beside it: ``NAME-001.json`` and so on for ``NAME.json``.
    """
    tasks = [dataclasses.replace(claim, plants=cell) for cell in cells(claim.plants, field, count)]
    paths = [out and out.with_name(f"{out.stem}-{number:03}.json") for number in range(1, count + 1)]
    work = (delayed(_bound)(task, path) for task, path in zip(tasks, paths, strict=True))
    yield from Parallel(n_jobs=jobs, return_as="generator")(work)


def _bound(claim: TipClaim, path: Path | None) -> CellBound:
    try:
        bound = find_bound(claim)
    except NoBound as error:
        return CellBound(claim.plants, None, str(error), 0, None)
    if path is not None:
        save_bound(bound, path)
    return CellBound(claim.plants, bound.largest, "", len(bound.tip), path)
