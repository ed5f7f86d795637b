"""Parts of the README's tables: a Markdown table, and the line that says what a result was made with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

__all__ = ["made_with", "table"]


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table, all but the first `left` columns aligned to the right."""
    rule = " --- |" * left + " ---: |" * (len(headings) - left)
    return "\n".join([f"| {' | '.join(headings)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)])


def made_with(document: dict[str, Any]) -> str:
    """Return machine, versions and commit of a result in one line."""
    versions, machine = document["versions"], document["machine"]
    libraries = ", ".join(f"{name} {versions[name]}" for name in ("numpy", "numba", "clarabel"))
    commit, _, changes = (document["commit"] or "unknown").partition("+")
    commit = commit[:10] + (f" with {changes}" if changes else "")
    return f"{machine['cpu']}, {machine['cores']} cores, Python {versions['python']}, {libraries}, commit {commit}."
