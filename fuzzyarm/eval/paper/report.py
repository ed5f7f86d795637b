"""The table "the paper says / we measure": printed, as Markdown and as JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.paper import drift
from fuzzyarm.eval.paper.claim import Claim
from fuzzyarm.eval.paper.claims import CLAIMS, ROLLOUTS, STATEMENTS, TABLE_2
from fuzzyarm.eval.paper.controllers import TITLES
from fuzzyarm.eval.paper.evidence import Evidence
from fuzzyarm.eval.provenance import provenance

SCHEMA = "fuzzyarm-paper/1"
COLUMNS: Mapping[str, str] = {
    "printed-32": "printed form, 32",
    "printed-4": "printed form, 4",
    "consistent-32": "consistent form, 32",
    "consistent-4": "consistent form, 4",
    "printed-4-swapped": "printed K, H, consistent L, 4",
    "papers-gains": "the paper's own gains, 4",
}
WORDS = ("where", "the paper says", "we measure")
LEFT = (*WORDS, "Number of rules")  # columns of words
SIGN = {"equal": "", "order": "~ ", "at most": "<= ", "more than": "> "}
LEGEND = (
    "* is the paper's number: to the digits it prints; for sizes of gains within a factor of ten; for a bound within "
    "it; of a comparison the same way round. Without a number in the paper nothing is marked."
)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """What was measured of every claim, what had been stored, what has drifted, and what it was made with."""

    measured: drift.Numbers
    stored: drift.Numbers
    drifted: Sequence[drift.Drift]
    made_with: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
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
    """Measure every claim and hold it against the stored numbers."""
    measured = {claim.key: dict(claim.measure(evidence)) for claim in CLAIMS}
    return Comparison(measured, stored, drift.find_drift(CLAIMS, measured, stored), provenance())


def renewed(comparison: Comparison) -> Comparison:
    """Return the comparison with what was measured taken for what is stored."""
    return dataclasses.replace(comparison, stored=comparison.measured, drifted=[])


def write_report(comparison: Comparison, figures: Sequence[Path], folder: Path) -> list[Path]:
    """Write ``paper.md``, with the figures if there are any, and ``paper.json``; return their paths."""
    text, data = folder / "paper.md", folder / "paper.json"
    write_atomically(text, _markdown(comparison, figures))
    write_atomically(data, json.dumps(comparison.to_dict(), indent=1) + "\n")
    return [text, data]


def print_report(comparison: Comparison, console: Console) -> None:
    """Print the tables and the reasons: with lines and fewer words in a terminal, plain columns when piped."""
    narrow = console.is_terminal
    for title, headings, rows in _tables(comparison, narrow):
        table = Table(
            title=title,
            title_justify="left",
            box=box.SIMPLE_HEAD if narrow else None,
            pad_edge=False,
            padding=(0, 1, 0, 0),
        )
        for heading in headings:
            side: Literal["left", "right"] = "left" if heading in LEFT else "right"
            table.add_column(escape(heading), justify=side, no_wrap=not narrow)
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
    console.print(LEGEND, highlight=False, markup=False)
    for number, reason in enumerate(_reasons(), start=1):
        console.print(f"({number}) {reason}", highlight=False, markup=False)


def _tables(comparison: Comparison, narrow: bool) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return title, headings and rows of the three tables; narrow ones have no keys, and a value a line."""
    words = [WORDS[0], WORDS[2]] if narrow else [*WORDS]
    return [
        (
            "Statements and settings",
            [*WORDS, "paper", "ours", "why"],
            [_statement_row(claim, comparison, narrow) for claim in STATEMENTS],
        ),
        (
            "Table 2",
            ["Number of rules", *comparison.measured[TABLE_2[0].key], "why"],
            _table_2_rows(comparison),
        ),
        (
            "On the arm",
            [*words, "paper", *COLUMNS.values(), "why"],
            [_rollout_row(claim, comparison, narrow) for claim in ROLLOUTS],
        ),
    ]


def _statement_row(claim: Claim, comparison: Comparison, narrow: bool) -> list[str]:
    values = comparison.measured[claim.key]
    ours = [f"{TITLES.get(label, label)}: {_marked(claim, label, value)}" for label, value in values.items()]
    if len(values) == 1:
        ours = [text.rsplit(": ", 1)[1] for text in ours]
    papers = [text for text in dict.fromkeys(_papers(claim, label) for label in values) if text != "-"]
    between = "\n" if narrow else ", "
    cells = [", ".join(papers) or "-", between.join(ours), _note(claim)]
    return [claim.where, claim.says, _quantity(claim, narrow), *cells]


def _table_2_rows(comparison: Comparison) -> list[list[str]]:
    """Return the paper's two rows, each followed by ours."""
    rows = []
    for claim in TABLE_2:
        values = comparison.measured[claim.key]
        papers = [claim.says.split(":")[0] + ", the paper", *(_papers(claim, label) for label in values), ""]
        if papers not in rows:
            rows.append(papers)
        ours = [_marked(claim, label, value) for label, value in values.items()]
        rows.append([f"{claim.key}: {claim.quantity}", *ours, _note(claim)])
    return rows


def _rollout_row(claim: Claim, comparison: Comparison, narrow: bool) -> list[str]:
    values = comparison.measured[claim.key]
    words = [claim.where, _quantity(claim, narrow)] if narrow else [claim.where, claim.says, _quantity(claim, narrow)]
    return [*words, _papers(claim, ""), *(_marked(claim, key, values[key]) for key in COLUMNS), _note(claim)]


def _quantity(claim: Claim, narrow: bool) -> str:
    unit = "" if claim.unit == "-" else f" [{claim.unit}]"
    return ("" if narrow else f"{claim.key}: ") + claim.quantity + unit


def _papers(claim: Claim, label: str) -> str:
    number = claim.papers_number(label)
    return "-" if number is None else SIGN[claim.comparison] + _number(number)


def _marked(claim: Claim, label: str, value: float) -> str:
    return _number(value) + ("*" if claim.agrees(label, value) else "")


def _number(value: float) -> str:
    """Return four digits, from 1000 up to a million no fraction."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"


def _note(claim: Claim) -> str:
    return f"({_reasons().index(claim.reason) + 1})" if claim.reason else ""


def _reasons() -> list[str]:
    """Return every reason once, in the order of the claims."""
    return list(dict.fromkeys(claim.reason for claim in CLAIMS if claim.reason))


def _markdown(comparison: Comparison, figures: Sequence[Path]) -> str:
    """Return tables, reasons, tolerances and figures as Markdown."""
    lines = ["# The paper's numbers, measured anew", ""]
    for title, headings, rows in _tables(comparison, narrow=False):
        aligned = ["---" if heading in LEFT else "---:" for heading in headings]
        escaped = [[cell.replace("*", "\\*").replace("|", "\\|") for cell in row] for row in rows]
        lines += [f"## {title}", "", *(f"| {' | '.join(cells)} |" for cells in (headings, aligned, *escaped)), ""]
    lines += [LEGEND.replace("*", "\\*"), "", "## Why", ""]
    lines += [f"{number}. {reason}" for number, reason in enumerate(_reasons(), start=1)]
    lines += ["", "## Drift", "", *_drift_lines(comparison), ""]
    if figures:
        lines += ["## Figures", "", *(f"![{path.stem}]({path.name})" for path in figures), ""]
    made = comparison.made_with
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items() if version)
    return "\n".join([*lines, f"`fuzzyarm paper`; {made['machine']['cpu']}, {versions}, commit {made['commit']}.", ""])


def _drift_lines(comparison: Comparison) -> list[str]:
    count = sum(len(values) for values in comparison.measured.values())
    groups: dict[str, list[str]] = {}
    for claim in CLAIMS:
        groups.setdefault(_allowance(claim), []).append(claim.key)
    allowed = "; ".join(f"{allowance}: {', '.join(keys)}" for allowance, keys in groups.items())
    moved = [f"- {entry}" for entry in comparison.drifted]
    head = f"{len(moved)} of {count} numbers are farther from the stored ones than allowed. Allowed: {allowed}."
    return [head, "", *moved]


def _allowance(claim: Claim) -> str:
    """Return a claim's tolerance in words."""
    relative, absolute = claim.tolerance
    parts = [f"{relative:g} of the stored value"] * bool(relative) + [f"{absolute:g} {claim.unit}"] * bool(absolute)
    return " and ".join(parts) or "nothing"
