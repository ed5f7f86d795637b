"""The table of a sweep, for a terminal or plain for a pipe, and the same numbers as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.sweep.summary import QUANTILES

SHOWN = (*(("max_mm", "largest tip error", f"{p:g}") for p in QUANTILES), ("rms_mm", "rms tip error", "0.5"))
BEYOND = "ended early"


def print_sweep(document: dict[str, Any], console: Console) -> None:
    """Print the rows of a summary, and what they mean."""
    bound, terminal = document["config"]["bound"], console.is_terminal
    headings = [f"success, below {bound:g} mm [%]"]
    headings += [f"{words}, {100 * float(level):g} % [mm]" for _, words, level in SHOWN]
    table = Table(box=box.SIMPLE_HEAD if terminal else None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("policy", no_wrap=True)
    for heading in headings:
        table.add_column(Text(heading), justify="right", no_wrap=not terminal)
    last = None
    for row in sorted(document["rows"], key=lambda row: document["config"]["cases"].index(row["case"])):
        if row["case"] != last:
            table.add_section()
            table.add_row(Text(CASES[row["case"]].title, style="bold"))
            last = row["case"]
        success = {name: 100.0 * share for name, share in row["success"].items()}
        cells = [_cell(success, "{:.2f}", terminal)]
        cells += [_cell(row[measure][level], "{:#.3g}", terminal) for measure, _, level in SHOWN]
        table.add_row(Text(row["policy"]), *cells)
    console.print(table)
    note = (
        f"{document['method']['plants']} plants, the same for every policy and case. In brackets intervals of 95 %. "
        f"'{BEYOND}' is larger than any error."
    )
    console.print(f"\n{note}", highlight=False, markup=False)


def summary_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Return a line for each policy and case, every number with its interval; empty is "beyond every bound"."""
    text = io.StringIO()
    flat = [
        {"policy": row["policy"], "case": row["case"], "ended_early": row["ended_early"]}
        | {f"success_{name}": value for name, value in row["success"].items()}
        | {
            f"{measure}_{level}_{name}": value
            for measure in ("max_mm", "rms_mm")
            for level, found in row[measure].items()
            for name, value in found.items()
        }
        for row in rows
    ]
    writer = csv.DictWriter(text, fieldnames=list(flat[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return text.getvalue()


def _cell(found: dict[str, float | None], form: str, terminal: bool) -> Text:
    value, low, high = (
        BEYOND if found[name] is None else form.format(found[name]) for name in ("value", "low", "high")
    )
    if found["low"] is None and found["value"] is not None:
        return Text(value)  # of a single plant
    interval = "" if value == low == high == BEYOND else f"({low} to {high})"
    return Text(f"{value}\n{interval}" if terminal else f"{value} {interval}".rstrip())
