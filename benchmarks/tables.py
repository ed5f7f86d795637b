"""A table of the documentation as data: its result, its columns, and the line that says how it was made.

A section is made of parts, tables or texts, and a line. A cell is a format string that is filled from a row, or a
function of the row; so is a text, of the documents of the section.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["Cell", "Section", "Table", "Text", "made_with", "markdown", "mm", "number", "title_of"]

Cell = str | Callable[[Any], str]
Columns = Mapping[str, Cell] | Sequence[tuple[str, Cell]]
Text = str | Callable[..., str]
COMMAND = "`{command}`"


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of documents.

    Attributes:
        columns: the cell of each column by its heading, or a function of the documents that returns them.
        rows: key of the rows in the document, or a function of the documents that returns them.
        left: columns that are aligned to the left.
    """

    columns: Columns | Callable[..., Columns]
    rows: str | Callable[..., Any] = "rows"
    left: int = 1

    def __call__(self, *documents: Any) -> str:
        """Return the table of these documents as Markdown."""
        columns = self.columns(*documents) if callable(self.columns) else self.columns
        pairs = list(columns.items() if isinstance(columns, Mapping) else columns)
        rows = documents[0][self.rows] if isinstance(self.rows, str) else self.rows(*documents)
        return markdown(
            [name for name, _ in pairs], [[_filled(cell, row) for _, cell in pairs] for row in rows], self.left
        )


@dataclasses.dataclass(frozen=True)
class Section:
    """A section: parts, and the line below them.

    Attributes:
        source: names of the results, the first one being that of format strings.
        parts: tables and texts.
        line: what stands before the machines and commits; None: there is no line.
    """

    source: str | Sequence[str]
    parts: Table | Text | Sequence[Table | Text]
    line: Text | None = COMMAND

    def text(self, stored: Callable[[str], Any]) -> str:
        """Return the section as Markdown; `stored` returns a result by its name."""
        documents = [stored(name) for name in ([self.source] if isinstance(self.source, str) else self.source)]
        parts = self.parts if isinstance(self.parts, list | tuple) else [self.parts]
        texts = [_filled(part, *documents) for part in parts]
        if self.line is not None:
            texts.append(f"{_filled(self.line, *documents)}; {made_with(*documents)}")
        return "\n\n".join(texts)


def _filled(text: Text, *documents: Any) -> str:
    return text.format(**documents[0]) if isinstance(text, str) else text(*documents)


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table, all but the first `left` columns aligned to the right."""
    rule = " --- |" * left + " ---: |" * (len(headings) - left)
    return "\n".join([f"| {' | '.join(headings)} |", f"|{rule}", *(f"| {' | '.join(row)} |" for row in rows)])


def number(key: str, form: str, missing: str = "-", factor: float = 1.0) -> Cell:
    """Return the cell of a number times a factor, or a word where there is none."""
    return lambda row: missing if row.get(key) is None else format(factor * row[key], form)


def mm(key: str, form: str) -> Cell:
    """Return the cell of a length [mm]."""
    return lambda row: millimetres(row[key], lambda value: format(value, form))


def title_of(row: Mapping[str, Any]) -> str:
    """Return the title of a row's case."""
    return CASES[row["case"]].title


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
