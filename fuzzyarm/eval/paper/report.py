"""What the paper says beside what we measure, and the drift from the stored numbers: tables, Markdown and JSON.

``fuzzyarm paper --renew FILE`` writes such numbers; a maintainer who has changed one on purpose names this folder's
``expected.json`` in a checkout.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from fuzzyarm.common.console import Sheet
from fuzzyarm.common.documents import read_checked, record
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.paper.claims import CLAIMS, Claim
from fuzzyarm.eval.paper.evidence import FORMS, PAPERS_OWN, RULES, SWAPPED, TITLES, Evidence
from fuzzyarm.eval.provenance import current_provenance, json_text

__all__ = ["EXPECTED", "Comparison", "compare", "load_expected", "print_report", "store_expected", "write_report"]


EXPECTED = Path(__file__).with_name("expected.json")
"""The stored numbers that come with the package."""
_EXPECTED_SCHEMA = "fuzzyarm-paper-expected/1"

_Numbers = Mapping[str, Mapping[str, float]]  # values by the key of their claim and their label


@dataclasses.dataclass(frozen=True)
class _Drift:
    """A number that differs from its stored value by more than `allowed`, that is new, or that no longer exists."""

    key: str  # of the claim
    label: str  # of the value
    unit: str  # of both values; "-" for a pure number
    stored: float | None  # None for a new number
    measured: float | None  # now; None for a number that no longer exists
    allowed: float  # largest difference

    def __str__(self) -> str:
        """Return the name of the number, both values and the allowed difference."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        was, now = ("none" if value is None else f"{value:.10g}{unit}" for value in (self.stored, self.measured))
        return f"{self.key}, {self.label}: measured {now}, stored {was}, allowed: within {self.allowed:.3g}{unit}"


@dataclasses.dataclass(frozen=True)
class _ExpectedFile:
    """Content of a file of stored numbers: the numbers, and what they were measured with."""

    schema: str
    measured: dict[str, dict[str, float]]
    commit: str | None = None
    versions: dict[str, str | None] = dataclasses.field(default_factory=dict)
    machine: dict[str, Any] = dataclasses.field(default_factory=dict)


def _find_drift(claims: Sequence[Claim], measured: _Numbers, stored: _Numbers) -> list[_Drift]:
    """Return every number that left its claim's tolerance around the stored value, that is missing, or that is new."""
    found = []
    for claim in claims:
        now, then = measured[claim.key], stored.get(claim.key, {})
        for label in dict.fromkeys([*then, *now]):
            value, before = now.get(label), then.get(label)
            allowed = 0.0 if before is None else claim.allowed(before)
            # "not <=" instead of ">", so that NaN counts as drift.
            if value is None or before is None or not abs(value - before) <= allowed:
                found.append(_Drift(claim.key, label, claim.unit, before, value, allowed))
    known = {claim.key for claim in claims}
    gone = [(key, label, value) for key in stored if key not in known for label, value in stored[key].items()]
    return found + [_Drift(key, label, "-", value, None, 0.0) for key, label, value in gone]


def load_expected(path: Path = EXPECTED) -> Mapping[str, Mapping[str, float]]:
    """Return the numbers stored in a file, by claim and label; ValueError if it is damaged or of another schema."""
    again = f"write such a file with fuzzyarm paper --out DIR --renew {path}"
    return read_checked(path, _EXPECTED_SCHEMA, again, lambda content: record(content, _ExpectedFile)).measured


def store_expected(measured: _Numbers, made_with: Mapping[str, Any], path: Path) -> None:
    """Write measured numbers, and what they were measured with, to a file that `load_expected` reads."""
    write_atomically(path, json_text({"schema": _EXPECTED_SCHEMA, **made_with, "measured": measured}))


# Headings of the controllers' columns by their key.
_COLUMNS = {f"{form}-{rules}": f"{form} form, {rules}" for form in FORMS for rules in RULES}
_COLUMNS |= {SWAPPED: "printed K, H, consistent L, 4", PAPERS_OWN: "the paper's own gains, 4"}
_WHERE, _SAYS, _MEASURE, _RULES = _TEXTS = "where", "the paper says", "we measure", "Number of rules"  # aligned left
# The numbers of the reasons, which count from 1 in the order of the claims.
_REASONS = dict(zip(dict.fromkeys(claim.reason for claim in CLAIMS if claim.reason), itertools.count(1), strict=False))
_SIGN = {"equal": "", "order": "~ ", "at most": "<= ", "more than": "> "}
_LEGEND = (
    "* agrees with the paper: in all printed digits; sizes of gains: within a factor of ten; a bound: it is kept; a "
    "comparison: it has the same order. Where the paper gives no number, nothing is marked."
)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Our value of every claim and the stored one, by claim and label."""

    measured: _Numbers
    stored: _Numbers
    made_with: Mapping[str, Any]  # commit, versions and machine of this measurement

    @functools.cached_property
    def drifted(self) -> Sequence[_Drift]:
        """The numbers that have drifted from the stored ones."""
        return _find_drift(CLAIMS, self.measured, self.stored)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        moved = {(entry.key, entry.label) for entry in self.drifted}
        claims = [
            {
                name: getattr(claim, name)
                for name in ("key", "where", "says", "quantity", "unit", "comparison", "reason")
            }
            | {"tolerance": dict(zip(("relative", "absolute"), claim.tolerance, strict=True))}
            | {
                "values": [
                    {
                        "label": label,
                        "paper": claim.papers_number(label),
                        "measured": value,
                        "agrees": claim.agrees(label, value),
                        "stored": self.stored.get(claim.key, {}).get(label),
                        "drifted": (claim.key, label) in moved,
                    }
                    for label, value in self.measured[claim.key].items()
                ]
            }
            for claim in CLAIMS
        ]
        return {"schema": "fuzzyarm-paper/1", **self.made_with, "claims": claims}


def compare(evidence: Evidence, stored: _Numbers | None) -> Comparison:
    """Measure every claim and compare it with the stored numbers; None: with what is measured, to be stored."""
    measured = {claim.key: claim.measured(evidence) for claim in CLAIMS}
    return Comparison(measured, measured if stored is None else stored, current_provenance())


def write_report(comparison: Comparison, figures: Sequence[Path], folder: Path) -> list[Path]:
    """Write ``paper.md``, with the figures if there are any, and ``paper.json``; return their paths."""
    text, data = folder / "paper.md", folder / "paper.json"
    write_atomically(text, _markdown(comparison, figures))
    write_atomically(data, json_text(comparison.to_dict()))
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


def print_report(comparison: Comparison, console: Console) -> None:
    """Print the tables and the reasons: with lines and fewer columns in a terminal, plain columns when piped."""
    for sheet in _tables(comparison, narrow=console.is_terminal):
        sheet.print(console)
    reasons = (f"({number}) {reason}" for reason, number in _REASONS.items())
    for line in (_LEGEND, *reasons, *_outcome(comparison)):
        console.print(line, highlight=False, markup=False)


def _tables(comparison: Comparison, narrow: bool) -> list[Sheet]:
    """Return the three tables; `narrow` ones have no keys of claims, and each value on a line of its own."""
    texts = [_WHERE, _MEASURE] if narrow else [_WHERE, _SAYS, _MEASURE]
    statements, table_2, rollouts = (
        [(claim, comparison.measured[claim.key]) for claim in CLAIMS if claim.group == group]
        for group in ("statements", "table_2", "rollouts")
    )
    tables = {
        "Statements and settings": [
            [_WHERE, _SAYS, _MEASURE, "paper", "ours", "why"],
            *(_statement_row(*one, narrow) for one in statements),
        ],
        "Table 2": [[_RULES, *table_2[0][1], "why"], *_table_2_rows(table_2)],
        "On the arm": [
            [*texts, "paper", *_COLUMNS.values(), "why"],
            *(_rollout_row(*one, narrow) for one in rollouts),
        ],
    }
    return [
        Sheet(headings, rows, [at for at, one in enumerate(headings) if one in _TEXTS], title=title, fold=narrow)
        for title, (headings, *rows) in tables.items()
    ]


def _statement_row(claim: Claim, values: Mapping[str, float], narrow: bool) -> list[str]:
    marked = {label: _marked(claim, label, value) for label, value in values.items()}
    named = [f"{TITLES.get(label, label)}: {text}" for label, text in marked.items()]
    ours = named if len(values) > 1 else list(marked.values())
    papers = [text for text in dict.fromkeys(_papers(claim, label) for label in values) if text != "-"]
    cells = [", ".join(papers) or "-", ("\n" if narrow else ", ").join(ours), _note(claim)]
    return [claim.where, claim.says, _quantity(claim, narrow), *cells]


def _table_2_rows(claims: Sequence[tuple[Claim, Mapping[str, float]]]) -> list[list[str]]:
    """Return the rows of the paper, N_var and N_row, each followed by the rows that we measure for it."""
    rows: list[list[str]] = []
    for claim, values in claims:
        papers = [f"{claim.says.partition(':')[0]}, the paper", *(_papers(claim, label) for label in values), ""]
        if papers not in rows:
            rows.append(papers)
        ours = [_marked(claim, label, value) for label, value in values.items()]
        rows.append([f"{claim.key}: {claim.quantity}", *ours, _note(claim)])
    return rows


def _rollout_row(claim: Claim, values: Mapping[str, float], narrow: bool) -> list[str]:
    texts = [claim.where, *([] if narrow else [claim.says]), _quantity(claim, narrow)]
    # The paper's number is the same for all controllers.
    return [*texts, _papers(claim, ""), *(_marked(claim, key, values[key]) for key in _COLUMNS), _note(claim)]


def _quantity(claim: Claim, narrow: bool) -> str:
    unit = "" if claim.unit == "-" else f" [{claim.unit}]"
    return ("" if narrow else f"{claim.key}: ") + claim.quantity + unit


def _papers(claim: Claim, label: str) -> str:
    number = claim.papers_number(label)
    return "-" if number is None else _SIGN[claim.comparison] + _number(number)


def _marked(claim: Claim, label: str, value: float) -> str:
    return _number(value) + ("*" if claim.agrees(label, value) else "")


def _number(value: float) -> str:
    """Return a number with four digits; between 1000 and a million, with all digits before the decimal point."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"


def _note(claim: Claim) -> str:
    return f"({_REASONS[claim.reason]})" if claim.reason else ""


def _markdown(comparison: Comparison, figures: Sequence[Path]) -> str:
    """Return tables, reasons, tolerances and figures as Markdown."""
    lines = ["# The paper's numbers, recomputed", ""]
    for sheet in _tables(comparison, narrow=False):
        escaped = dataclasses.replace(sheet, rows=[[cell.replace("*", "\\*") for cell in row] for row in sheet.rows])
        lines += [f"## {sheet.title}", "", escaped.markdown(), ""]
    lines += [_LEGEND.replace("*", "\\*"), "", "## Why", ""]
    lines += [f"{number}. {reason}" for reason, number in _REASONS.items()]
    groups: dict[str, list[str]] = {}
    for claim in CLAIMS:
        relative, absolute = claim.tolerance
        parts = [f"{relative:g} of the stored value"] * bool(relative) + [f"{absolute:g} {claim.unit}"] * bool(absolute)
        groups.setdefault(" and ".join(parts) or "nothing", []).append(claim.key)
    allowed = "; ".join(f"{allowance}: {', '.join(keys)}" for allowance, keys in groups.items())
    moved = [f"- {entry}" for entry in comparison.drifted]
    lines += ["", "## Drift", "", *_outcome(comparison), f"Allowed: {allowed}.", "", *moved, ""]
    if figures:
        lines += ["## Figures", "", *(f"![{path.stem}]({path.name})" for path in figures), ""]
    made = comparison.made_with
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items() if version)
    return "\n".join([*lines, f"`fuzzyarm paper`; {made['machine']['cpu']}, {versions}, commit {made['commit']}.", ""])
