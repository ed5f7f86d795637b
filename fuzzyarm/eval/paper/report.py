"""What the paper says beside what we measure: tables in the terminal, Markdown and JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.markup import escape

from fuzzyarm.common import console as terminal
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.paper import drift
from fuzzyarm.eval.paper.claim import Claim
from fuzzyarm.eval.paper.claims import CLAIMS, ROLLOUTS, STATEMENTS, TABLE_2
from fuzzyarm.eval.paper.controllers import TITLES
from fuzzyarm.eval.paper.evidence import Evidence
from fuzzyarm.eval.provenance import current_provenance

__all__ = ["Comparison", "compare", "print_report", "renewed", "write_report"]

SCHEMA = "fuzzyarm-paper/1"
COLUMNS: Mapping[str, str] = {
    "printed-32": "printed form, 32",
    "printed-4": "printed form, 4",
    "consistent-32": "consistent form, 32",
    "consistent-4": "consistent form, 4",
    "printed-4-swapped": "printed K, H, consistent L, 4",
    "papers-gains": "the paper's own gains, 4",
}
"""Headings of the controllers' columns by their key."""
WHERE, SAYS, MEASURE, RULES = "where", "the paper says", "we measure", "Number of rules"
TEXT_COLUMNS = (WHERE, SAYS, MEASURE, RULES)  # aligned left
SIGN = {"equal": "", "order": "~ ", "at most": "<= ", "more than": "> "}
LEGEND = (
    "* agrees with the paper: in all printed digits; sizes of gains: within a factor of ten; a bound: it is kept; a "
    "comparison: it has the same order. Where the paper gives no number, nothing is marked."
)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Our value of every claim, the stored one, and how they differ.

    Attributes:
        measured: what was measured now.
        stored: what had been stored.
        drifted: the numbers that have drifted from the stored ones.
        made_with: commit, versions and machine of this measurement.
    """

    measured: drift.Numbers
    stored: drift.Numbers
    drifted: Sequence[drift.Drift]
    made_with: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        return {"schema": SCHEMA, **self.made_with, "claims": [self._entry(claim) for claim in CLAIMS]}

    def _entry(self, claim: Claim) -> dict[str, Any]:
        values = self.measured[claim.key]
        moved = {entry.label for entry in self.drifted if entry.key == claim.key}
        return {
            **{name: getattr(claim, name) for name in ("key", "where", "says", "quantity", "unit", "comparison")},
            "reason": claim.reason,
            "tolerance": claim.tolerance._asdict(),
            "values": [
                {
                    "label": label,
                    "paper": claim.papers_number(label),
                    "measured": value,
                    "agrees": claim.agrees(label, value),
                    "stored": self.stored.get(claim.key, {}).get(label),
                    "drifted": label in moved,
                }
                for label, value in values.items()
            ],
        }


def compare(evidence: Evidence, stored: drift.Numbers) -> Comparison:
    """Measure every claim and compare it with the stored numbers."""
    measured = {claim.key: dict(claim.measure(evidence)) for claim in CLAIMS}
    return Comparison(measured, stored, drift.find_drift(CLAIMS, measured, stored), current_provenance())


def renewed(comparison: Comparison) -> Comparison:
    """Return the comparison of the measured numbers with themselves: what it is after they have been stored."""
    return dataclasses.replace(comparison, stored=comparison.measured, drifted=[])


def write_report(comparison: Comparison, figures: Sequence[Path], folder: Path) -> list[Path]:
    """Write ``paper.md``, with the figures if there are any, and ``paper.json``; return their paths."""
    text, data = folder / "paper.md", folder / "paper.json"
    write_atomically(text, _markdown(comparison, figures))
    write_atomically(data, json.dumps(comparison.to_dict(), indent=1) + "\n")
    return [text, data]


def _outcome(comparison: Comparison) -> list[str]:
    """Return how many numbers have drifted, which the exit code is about, and how many of the paper's agree."""
    judged = [
        (claim.key, claim.agrees(label, value))
        for claim in CLAIMS
        for label, value in comparison.measured[claim.key].items()
        if claim.papers_number(label) is not None
    ]
    others = dict.fromkeys(key for key, agrees in judged if not agrees)
    return [
        f"{len(comparison.drifted)} of {sum(map(len, comparison.measured.values()))} numbers differ from the stored "
        "ones by more than allowed: the exit code is about these alone.",
        f"{sum(bool(agrees) for _, agrees in judged)} of {len(judged)} numbers agree with the paper's; those without * "
        f"do not: {', '.join(others)}.",
    ]


class _Table(NamedTuple):
    """A table of the report: its title, its headings and its rows of cells."""

    title: str
    headings: list[str]
    rows: list[list[str]]

    @property
    def text_columns(self) -> list[int]:
        """Indices of the columns that hold text and no numbers."""
        return [index for index, heading in enumerate(self.headings) if heading in TEXT_COLUMNS]


def print_report(comparison: Comparison, console: Console) -> None:
    """Print the tables and the reasons: with lines and fewer columns in a terminal, plain columns when piped."""
    narrow = console.is_terminal
    for shown in _tables(comparison, narrow):
        table = terminal.table(shown.headings, shown.text_columns, console=console, title=shown.title, fold=narrow)
        for row in shown.rows:
            table.add_row(*map(escape, row))
        terminal.print_table(table, console)
    reasons = (f"({number}) {reason}" for reason, number in _reason_numbers().items())
    for line in (LEGEND, *reasons, *_outcome(comparison)):
        console.print(line, highlight=False, markup=False)


def _tables(comparison: Comparison, narrow: bool) -> list[_Table]:
    """Return the three tables; `narrow` ones have no keys of claims, and each value on a line of its own."""
    texts = [WHERE, MEASURE] if narrow else [WHERE, SAYS, MEASURE]
    return [
        _Table(
            "Statements and settings",
            [WHERE, SAYS, MEASURE, "paper", "ours", "why"],
            [_statement_row(claim, comparison, narrow) for claim in STATEMENTS],
        ),
        _Table("Table 2", [RULES, *comparison.measured[TABLE_2[0].key], "why"], _table_2_rows(comparison)),
        _Table(
            "On the arm",
            [*texts, "paper", *COLUMNS.values(), "why"],
            [_rollout_row(claim, comparison, narrow) for claim in ROLLOUTS],
        ),
    ]


def _statement_row(claim: Claim, comparison: Comparison, narrow: bool) -> list[str]:
    values = comparison.measured[claim.key]
    marked = {label: _marked(claim, label, value) for label, value in values.items()}
    if len(values) == 1:
        ours = list(marked.values())
    else:
        ours = [f"{TITLES.get(label, label)}: {text}" for label, text in marked.items()]
    papers = [text for text in dict.fromkeys(_papers(claim, label) for label in values) if text != "-"]
    between = "\n" if narrow else ", "
    cells = [", ".join(papers) or "-", between.join(ours), _note(claim)]
    return [claim.where, claim.says, _quantity(claim, narrow), *cells]


def _table_2_rows(comparison: Comparison) -> list[list[str]]:
    """Return the rows of the paper, N_var and N_row, each followed by the rows that we measure for it."""
    rows: list[list[str]] = []
    for claim in TABLE_2:
        values = comparison.measured[claim.key]
        name, _, _ = claim.says.partition(":")
        papers = [f"{name}, the paper", *(_papers(claim, label) for label in values), ""]
        if papers not in rows:
            rows.append(papers)
        ours = [_marked(claim, label, value) for label, value in values.items()]
        rows.append([f"{claim.key}: {claim.quantity}", *ours, _note(claim)])
    return rows


def _rollout_row(claim: Claim, comparison: Comparison, narrow: bool) -> list[str]:
    values = comparison.measured[claim.key]
    quantity = _quantity(claim, narrow)
    texts = [claim.where, quantity] if narrow else [claim.where, claim.says, quantity]
    # The paper's number is the same for all controllers.
    return [*texts, _papers(claim, ""), *(_marked(claim, key, values[key]) for key in COLUMNS), _note(claim)]


def _quantity(claim: Claim, narrow: bool) -> str:
    unit = "" if claim.unit == "-" else f" [{claim.unit}]"
    return ("" if narrow else f"{claim.key}: ") + claim.quantity + unit


def _papers(claim: Claim, label: str) -> str:
    number = claim.papers_number(label)
    return "-" if number is None else SIGN[claim.comparison] + _number(number)


def _marked(claim: Claim, label: str, value: float) -> str:
    return _number(value) + ("*" if claim.agrees(label, value) else "")


def _number(value: float) -> str:
    """Return a number with four digits; between 1000 and a million, with all digits before the decimal point."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"


def _note(claim: Claim) -> str:
    return f"({_reason_numbers()[claim.reason]})" if claim.reason else ""


def _reason_numbers() -> dict[str, int]:
    """Return the number of each reason, which counts from 1 in the order of the claims."""
    reasons = dict.fromkeys(claim.reason for claim in CLAIMS if claim.reason)
    return {reason: number for number, reason in enumerate(reasons, start=1)}


def _markdown(comparison: Comparison, figures: Sequence[Path]) -> str:
    """Return tables, reasons, tolerances and figures as Markdown."""
    lines = ["# The paper's numbers, recomputed", ""]
    for title, headings, rows in _tables(comparison, narrow=False):
        aligned = ["---" if heading in TEXT_COLUMNS else "---:" for heading in headings]
        escaped = [[cell.replace("*", "\\*").replace("|", "\\|") for cell in row] for row in rows]
        lines += [f"## {title}", "", *(f"| {' | '.join(cells)} |" for cells in (headings, aligned, *escaped)), ""]
    lines += [LEGEND.replace("*", "\\*"), "", "## Why", ""]
    lines += [f"{number}. {reason}" for reason, number in _reason_numbers().items()]
    lines += ["", "## Drift", "", *_drift_lines(comparison), ""]
    if figures:
        lines += ["## Figures", "", *(f"![{path.stem}]({path.name})" for path in figures), ""]
    made = comparison.made_with
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items() if version)
    return "\n".join([*lines, f"`fuzzyarm paper`; {made['machine']['cpu']}, {versions}, commit {made['commit']}.", ""])


def _drift_lines(comparison: Comparison) -> list[str]:
    groups: dict[str, list[str]] = {}
    for claim in CLAIMS:
        groups.setdefault(_allowance(claim), []).append(claim.key)
    allowed = "; ".join(f"{allowance}: {', '.join(keys)}" for allowance, keys in groups.items())
    moved = [f"- {entry}" for entry in comparison.drifted]
    return [*_outcome(comparison), f"Allowed: {allowed}.", "", *moved]


def _allowance(claim: Claim) -> str:
    """Return a claim's tolerance in words."""
    relative, absolute = claim.tolerance
    parts = [f"{relative:g} of the stored value"] * bool(relative) + [f"{absolute:g} {claim.unit}"] * bool(absolute)
    return " and ".join(parts) or "nothing"
