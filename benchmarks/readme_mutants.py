"""The table of one-line mutants, and how many of them the tests notice."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["mutants_table"]

WHAT = {
    "common": "checks of arguments, documents, archives, writing of files",
    "fuzzy_policy": "controller files, and the proofs of their claims",
    "proof": "bounds of the tip",
    "": "checkpoints, learned policies, sweeps, data sets",
}
"""By the beginning of a file's name; the first that fits counts."""


def mutants_table(document: dict[str, Any]) -> str:
    """Return a row for each part of the package: mutants, and what came of them."""
    rows, left, ends = [], list(document["rows"]), ("died", "equivalent", "lived")
    for start, text in WHAT.items():
        members = [row for row in left if row["file"].startswith(start)]
        left = [row for row in left if row not in members]
        rows.append([text, str(len(members)), *(str(sum(row["outcome"] == end for row in members)) for end in ends)])
    rows.append(["all", *(str(sum(int(row[column]) for row in rows)) for column in range(1, 5))])
    headings = ["mutants of", "made", "noticed", "equivalent", "not noticed"]
    return f"{table(headings, rows)}\n\n`{document['command']}`; {made_with(document)}"
