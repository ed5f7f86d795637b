"""The table of what was thrown at the package, and what held."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["abuse_table"]

WHAT = {
    "arguments": "arguments of arms, paths, references, disturbances, configurations, laws",
    "environments": "arguments, resets, actions and states of environments",
    "policies": "observations and states given to policies",
    "files": "files of every format: values, structure, bytes, signed again, special files",
    "command line": "options: wrong, missing, repeated, huge, with control characters",
    "processes": "kills, interrupts, full disks, closed streams, missing homes",
}
"""By the group of a surface."""


def abuse_table(document: dict[str, Any]) -> str:
    """Return a row for each group: tries, and what came of them."""
    rows, totals = [], [0, 0, 0, 0]
    for group, text in WHAT.items():
        members = [row for row in document["rows"] if row["group"] == group]
        counts = [sum(row[key] for row in members) for key in ("tried", "refused", "accepted")]
        counts.append(sum(len(row["broken"]) for row in members))
        totals = [total + count for total, count in zip(totals, counts, strict=True)]
        rows.append([text, *map(str, counts)])
    rows.append(["all", *map(str, totals)])
    headings = ["input", "tried", "refused", "accepted, right", "broken"]
    return f"{table(headings, rows)}\n\n`{document['command']}`; {made_with(document)}"
