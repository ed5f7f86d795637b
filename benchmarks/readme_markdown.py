"""Parts of the README's tables: a Markdown table, and the line that says what a result was made with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

__all__ = ["made_with", "table"]


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table, all but the first `left` columns aligned to the right."""
    rule = " --- |" * left + " ---: |" * (len(headings) - left)
    return "\n".join([f"| {' | '.join(headings)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)])


def made_with(*parts: Any) -> str:
    """Return every machine and commit that results, or rows of them, name, with the versions, in one line."""
    found: dict[str, list[str]] = {}
    for words, commit in _sources(parts):
        commits = found.setdefault(words, [])
        if commit not in commits and (words or all(commit not in others for others in found.values())):
            commits.append(commit)
    lines = [f"{words or 'machine not stored'}, {_commits(commits)}" for words, commits in found.items() if commits]
    return "; ".join(lines) + "."


def _sources(part: Any) -> Iterator[tuple[str, str]]:
    """Yield machine with versions, empty if unknown, and commit of each part of a result that has a commit."""
    if isinstance(part, Mapping) and "commit" in part:
        yield _machine(part), part["commit"] or "unknown"
    if isinstance(part, Mapping | list | tuple):
        for value in part.values() if isinstance(part, Mapping) else part:
            yield from _sources(value)


def _machine(made: Mapping[str, Any]) -> str:
    machine, versions = made.get("machine"), made.get("versions")
    if machine is None or versions is None:
        return str(made.get("cpu", ""))
    names = [name for name in ("numpy", "numba", "llvmlite", "clarabel") if name in versions]  # numba: older results
    libraries = ", ".join(f"{name} {versions[name]}" for name in names)
    return f"{machine['cpu']}, {machine['cores']} cores, Python {versions['python']}, {libraries}"


def _commits(commits: Sequence[str]) -> str:
    """Return commits in ten digits each, with what was changed beside them."""
    parts = (commit.partition("+") for commit in commits)
    words = [first[:10] + (f" with {changes}" if changes else "") for first, _, changes in parts]
    return f"commit{'s' if len(words) > 1 else ''} {', '.join(words)}"
