"""The table of the identification: how wide the intervals are, and how often they cover the truth."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["identification_table"]


def identification_table(document: dict[str, Any]) -> str:
    """Return a row for each parameter: the truth, the interval, coverage and deviation, for both kinds of logs."""
    logs = list(document["logs"].values())
    headings = ["parameter", "unit", "truth"]
    for name, log in document["logs"].items():
        headings += [f"{name}: 95 % interval, ±", f"covered, of {log['runs']} logs", "deviation"]
    rows = []
    for k, first in enumerate(logs[0]["rows"]):
        cells = [f"`{first['name']}`", first["unit"], f"{first['truth']:g}"]
        for log in logs:
            row = log["rows"][k]
            told = row["told"] == log["runs"]
            covered = f"{row['covered']}" if told else f"{row['covered']} of {row['told']} that tell it"
            cells += (
                ["-", "-", "-"]
                if not row["told"]
                else [f"{row['half_width']:.2g}", covered, f"{row['deviation_rms']:.2f}"]
            )
        rows.append(cells)
    covered, told = (sum(row[what] for row in logs[0]["rows"]) for what in ("covered", "told"))
    note = (
        f"With velocities, {covered} of {told} intervals cover the truth ({100.0 * covered / told:.1f} %). Logs of "
        f"{document['duration']:g} s at 1 kHz, {logs[0]['seconds']:.0f} s of processor time each to identify; "
        f"`{document['command']}`; {made_with(document)}"
    )
    return f"{table(headings, rows, left=2)}\n\n{note}"
