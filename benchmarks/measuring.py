"""What benchmarks share: their options, rows that are printed, and results with versions, machine and commit."""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance

__all__ = ["RESULTS", "made_now", "options_of", "printed", "stored", "write", "write_rows"]

Key = Callable[[dict[str, Any]], Any]

RESULTS = Path(__file__).resolve().parent / "results"
"""Folder of the stored results."""


def options_of(description: str | None) -> argparse.ArgumentParser:
    """Return the parser of a benchmark, with the option ``--json``."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    return parser


def printed(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows, each of which is printed as soon as it is measured."""
    found = []
    for row in rows:
        print(json.dumps(row, ensure_ascii=False), flush=True)
        found.append(row)
    return found


def write(path: Path | None, command: str, **found: Any) -> None:
    """Write a result if a path is given: the command behind ``python benchmarks/``, what it was made with, the rest."""
    if path is not None:
        _write(path, _made(command) | found)


def write_rows(
    path: Path | None, command: str, rows: Sequence[dict[str, Any]], order: Sequence[Any], key: Key, **found: Any
) -> None:
    """Write a result of rows if a path is given.

    Where only some of the keys in `order` were measured, the rows are put among those of an earlier result, which keeps
    what it was made with; each row names its own commit.
    """
    if path is not None:
        partial = len(rows) < len(order) and path.is_file()
        document = json.loads(path.read_text(encoding="utf-8")) if partial else _made(command) | found
        known = {key(row): row for row in [*document.get("rows", ()), *rows]}
        _write(path, document | {"rows": [known[one] for one in order if one in known]})


def made_now() -> dict[str, Any]:
    """Return commit and processor, as rows store them that may come from different runs."""
    made = current_provenance()
    return {"commit": made["commit"], "cpu": made["machine"]["cpu"]}


def _made(command: str) -> dict[str, Any]:
    date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"command": f"python benchmarks/{command}", "date": date, **current_provenance()}


def _write(path: Path, document: Mapping[str, Any]) -> None:
    write_atomically(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def stored(name: str) -> dict[str, Any]:
    """Return a stored result by its name."""
    document: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return document
