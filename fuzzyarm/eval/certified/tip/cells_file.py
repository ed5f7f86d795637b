"""The file of a bound that was proven by cells: the whole set, and the files of its cells, which lie beside it."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.common.documents import DocumentError, check_schema, open_regular, read_json, record
from fuzzyarm.common.files import write_atomically
from fuzzyarm.common.rounding import at_most
from fuzzyarm.eval.certified.tip.bound import TipClaim
from fuzzyarm.eval.certified.tip.bound_file import LARGEST, BoundCheck, check_bound
from fuzzyarm.eval.certified.tip.cells import CellBound, missed
from fuzzyarm.eval.certified.tip.plant import RANGES, plants_of, ranges_in_words

__all__ = ["CELLS_SCHEMA", "CellsCheck", "check_cells", "is_cells", "save_cells"]

CELLS_SCHEMA = "fuzzyarm-tip-cells/2"
"""Of the file of a bound by cells."""


@dataclasses.dataclass(frozen=True)
class _CellsDocument:
    """The content of a file."""

    schema: str
    policy: str
    case: str
    set_name: str
    plants: dict[str, Any]
    path: str
    duration: float
    samples: int
    bound: float
    cells: list[str]


@dataclasses.dataclass(frozen=True)
class CellsCheck(BoundCheck):
    """What the check of a file and of all its cells found: as `BoundCheck`, of the whole set, with the largest `tip`.

    It is proven if every cell was confirmed and they cover the set.

    Attributes:
        cells: how many there are.
    """

    cells: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {**super().to_dict(), "cells": self.cells}


def save_cells(claim: TipClaim, found: Sequence[CellBound], path: Path) -> None:
    """Write the file of a bound by cells, atomically; each cell has a file in the same folder."""
    names = [cell.path.name for cell in found if cell.path is not None]
    document = _CellsDocument(
        CELLS_SCHEMA, claim.policy, claim.case, claim.set_name, claim.plants.to_dict(), claim.path, claim.duration,
        found[0].samples, max(cell.bound for cell in found), names,
    )  # fmt: skip
    write_atomically(path, json.dumps(dataclasses.asdict(document), indent=1) + "\n")


def is_cells(path: Path) -> bool:
    """Return whether a file begins as the file of a bound by cells does; OSError if it cannot be read."""
    with open_regular(path) as file:
        return CELLS_SCHEMA.encode() in file.read(64)


def check_cells(path: Path) -> CellsCheck:
    """Check every cell again, and that the cells cover the set.

    Raises:
        ValueError: no such file, or it or a cell is damaged, or the policy has changed.
        OSError: a file cannot be read.
    """
    content = read_json(path)
    try:
        document = record(check_schema(content, CELLS_SCHEMA), _CellsDocument)
        real("bound", document.bound, "m", low=0.0, high=LARGEST)
        if not document.cells or any(Path(name).name != name for name in document.cells):
            raise ValueError("cells: each is the name of a file in the same folder, and there is at least one")
        claim = TipClaim(
            document.policy, document.case, plants=plants_of(document.set_name, document.plants), path=document.path,
            duration=document.duration, steps=document.samples,
        )  # fmt: skip
    except (TypeError, ValueError) as error:
        raise DocumentError(f"{path}: {error}") from None
    begin = time.perf_counter()
    found = [check_bound(path.with_name(name)) for name in document.cells]
    reason = _why_not(claim, document, found)
    bound = document.bound if reason else max(document.bound, *(cell.bound for cell in found))
    samples = min(len(cell.tip) for cell in found)
    tip = np.max([cell.tip[:samples] for cell in found], axis=0)
    return CellsCheck(path, claim, found[0].arm, bound, reason, time.perf_counter() - begin, tip, len(found))


def _why_not(claim: TipClaim, document: _CellsDocument, found: Sequence[BoundCheck]) -> str:
    """Return what a bound by cells lacks; empty if it is proven."""
    for cell in found:
        ranges: dict[str, Any] = {name: getattr(claim.plants, name) for name in RANGES}
        parts = dataclasses.replace(cell.claim.plants, **ranges)
        whole = dataclasses.replace(cell.claim, plants=parts, set_name=claim.set_name)
        if not cell.proven:
            return f"{cell.path.name}: {cell.reason}"
        if whole != claim or cell.arm != found[0].arm:
            return f"{cell.path.name} is about something else"
        if cell.bound > document.bound * (1 + 1e-9):
            return f"{cell.path.name}: the tip may err by {at_most(1e3 * cell.bound, 4)} mm"
    hole = missed(claim.plants, [cell.claim.plants for cell in found])
    return "" if hole is None else f"no cell holds {ranges_in_words(hole, claim.plants)}"
