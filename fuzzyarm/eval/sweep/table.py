"""The table of a sweep, for a terminal or plain for a pipe, and the same numbers as CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from fuzzyarm.common.console import print_paragraphs, print_table, table
from fuzzyarm.common.files import csv_text
from fuzzyarm.eval.episodes.metrics import millimetres
from fuzzyarm.eval.sweep.summary import QUANTILES

__all__ = ["print_sweep", "summary_csv"]

_SHOWN = (*(("max_mm", "largest tip error", f"{p:g}") for p in QUANTILES), ("rms_mm", "rms tip error", "0.5"))
"""The columns after the success rate: metric, words for it, and the level of the quantile."""
_ENDED_EARLY = "ended early"


def print_sweep(document: dict[str, Any], console: Console) -> None:
    """Print the rows of a summary, and what they mean."""
    config, terminal = document["config"], console.is_terminal
    # A terminal has one word of a heading a line; a number stays with its unit.
    space = "\N{NO-BREAK SPACE}" if terminal else " "
    headings = ["policy", f"success, below {config['bound']:g}{space}mm [%]"]
    headings += [f"{words}, {100 * float(level):g}{space}% [mm]" for _, words, level in _SHOWN]
    rows = table(headings, console=console)
    for case in config["cases"]:
        rows.add_section()
        rows.add_row(Text(document["titles"][case], style="bold"))
        for row in document["rows"]:
            if row["case"] == case:
                success = {name: 100.0 * share for name, share in row["success"].items()}
                cells = [_cell(success, "{:.2f}".format, terminal)]
                cells += [_cell(row[metric][level], millimetres, terminal) for metric, _, level in _SHOWN]
                rows.add_row(Text(row["policy"]), *cells)
    print_table(rows, console)
    note = (
        f"{document['method']['plants']} plants, the same for every policy and case. In brackets, confidence "
        f"intervals of 95 %. '{_ENDED_EARLY}' counts as larger than any error."
    )
    print_paragraphs(console, [note])


def summary_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Return a line for each policy and case, every number with its interval; empty for larger than any error."""
    flat = [
        {"policy": row["policy"], "case": row["case"], "ended_early": row["ended_early"]}
        | {f"success_{name}": value for name, value in row["success"].items()}
        | {
            f"{metric}_{level}_{name}": value
            for metric in ("max_mm", "rms_mm")
            for level, found in row[metric].items()
            for name, value in found.items()
        }
        for row in rows
    ]
    return csv_text(flat)


def _cell(found: dict[str, float | None], form: Callable[[float], str], terminal: bool) -> Text:
    """Return a value and its interval, on two lines of a terminal."""
    value, low, high = (
        _ENDED_EARLY if number is None else form(number) for number in map(found.get, ("value", "low", "high"))
    )
    if found["low"] is None and found["value"] is not None:
        return Text(value)  # a single plant has no interval
    interval = "" if value == low == high == _ENDED_EARLY else f"({low} to {high})"
    return Text(f"{value}\n{interval}" if terminal else f"{value} {interval}".rstrip())
