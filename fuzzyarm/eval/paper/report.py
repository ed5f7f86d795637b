"""What the paper says beside what we measure, and the drift from the stored numbers: tables, Markdown and JSON.

``fuzzyarm paper --renew FILE`` writes such numbers; a maintainer who has changed one on purpose names this folder's
``expected.json`` in a checkout.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from fuzzyarm.common import documents
from fuzzyarm.common.console import Sheet
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.paper.claims import CLAIMS, ROLLOUTS, STATEMENTS, TABLE_2, Claim
from fuzzyarm.eval.paper.evidence import FORMS, PAPERS_OWN, RULES, SWAPPED, TITLES, Evidence
from fuzzyarm.eval.provenance import current_provenance, json_text

__all__ = [
    "EXPECTED", "Comparison", "Numbers", "compare", "find_drift", "load_expected", "print_report", "renewed",
    "store_expected", "write_report",
]  # fmt: skip


EXPECTED = Path(__file__).with_name("expected.json")
"""The stored numbers that come with the package."""
_EXPECTED_SCHEMA = "fuzzyarm-paper-expected/1"

Numbers = Mapping[str, Mapping[str, float]]
"""Values by the key of their claim and their label."""


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


def find_drift(claims: Sequence[Claim], measured: Numbers, stored: Numbers) -> list[_Drift]:
    """Return every number that left its claim's tolerance around the stored value, that is missing, or that is new."""
    found = []
    for claim in claims:
        now, then = measured[claim.key], stored.get(claim.key, {})
        for label in dict.fromkeys([*then, *now]):
            value, before = now.get(label), then.get(label)
            allowed = 0.0 if before is None else claim.tolerance.of(before)
            # "not <=" instead of ">", so that NaN counts as drift.
            if value is None or before is None or not abs(value - before) <= allowed:
                found.append(_Drift(claim.key, label, claim.unit, before, value, allowed))
    known = {claim.key for claim in claims}
    gone = [(key, label, value) for key in stored if key not in known for label, value in stored[key].items()]
    return found + [_Drift(key, label, "-", value, None, 0.0) for key, label, value in gone]


def load_expected(path: Path = EXPECTED) -> Numbers:
    """Return the numbers stored in a file; ValueError if it is damaged or of another schema."""
    try:
        content = documents.check_schema(documents.read_json(path), _EXPECTED_SCHEMA)
        return documents.record(content, _ExpectedFile).measured
    except ValueError as error:
        raise documents.DocumentError(
            f"{path} holds no stored numbers ({error}); write such a file with fuzzyarm paper --out DIR --renew {path}"
        ) from None


def store_expected(measured: Numbers, made_with: Mapping[str, Any], path: Path) -> None:
    """Write measured numbers, and what they were measured with, to a file that `load_expected` reads."""
    write_atomically(path, json_text({"schema": _EXPECTED_SCHEMA, **made_with, "measured": measured}))


# Headings of the controllers' columns by their key.
_COLUMNS = {f"{form}-{rules}": f"{form} form, {rules}" for form in FORMS for rules in RULES}
_COLUMNS |= {SWAPPED: "printed K, H, consistent L, 4", PAPERS_OWN: "the paper's own gains, 4"}
_WHERE, _SAYS, _MEASURE, _RULES = _TEXTS = "where", "the paper says", "we measure", "Number of rules"  # aligned left
_SIGN = {"equal": "", "order": "~ ", "at most": "<= ", "more than": "> "}
_LEGEND = (
    "* agrees with the paper: in all printed digits; sizes of gains: within a factor of ten; a bound: it is kept; a "
    "comparison: it has the same order. Where the paper gives no number, nothing is marked."
)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Our value of every claim, the stored one, and how they differ."""

    measured: Numbers
    stored: Numbers
    drifted: Sequence[_Drift]
    made_with: Mapping[str, Any]  # commit, versions and machine of this measurement

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        return {"schema": "fuzzyarm-paper/1", **self.made_with, "claims": [self._entry(claim) for claim in CLAIMS]}

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


def compare(evidence: Evidence, stored: Numbers) -> Comparison:
    """Measure every claim and compare it with the stored numbers."""
    measured = {claim.key: dict(claim.measure(evidence)) for claim in CLAIMS}
    return Comparison(measured, stored, find_drift(CLAIMS, measured, stored), current_provenance())


def renewed(comparison: Comparison) -> Comparison:
    """Return the comparison of the measured numbers with themselves: what it is after they have been stored."""
    return dataclasses.replace(comparison, stored=comparison.measured, drifted=[])


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
    narrow = console.is_terminal
    for sheet in _tables(comparison, narrow):
        sheet.print(console)
    reasons = (f"({number}) {reason}" for reason, number in _reason_numbers().items())
    for line in (_LEGEND, *reasons, *_outcome(comparison)):
        console.print(line, highlight=False, markup=False)


def _tables(comparison: Comparison, narrow: bool) -> list[Sheet]:
    """Return the three tables; `narrow` ones have no keys of claims, and each value on a line of its own."""
    texts = [_WHERE, _MEASURE] if narrow else [_WHERE, _SAYS, _MEASURE]
    tables = {
        "Statements and settings": [
            [_WHERE, _SAYS, _MEASURE, "paper", "ours", "why"],
            *(_statement_row(claim, comparison, narrow) for claim in STATEMENTS),
        ],
        "Table 2": [[_RULES, *comparison.measured[TABLE_2[0].key], "why"], *_table_2_rows(comparison)],
        "On the arm": [
            [*texts, "paper", *_COLUMNS.values(), "why"],
            *(_rollout_row(claim, comparison, narrow) for claim in ROLLOUTS),
        ],
    }
    return [
        Sheet(headings, rows, [at for at, one in enumerate(headings) if one in _TEXTS], title=title, fold=narrow)
        for title, (headings, *rows) in tables.items()
    ]


def _statement_row(claim: Claim, comparison: Comparison, narrow: bool) -> list[str]:
    values = comparison.measured[claim.key]
    marked = {label: _marked(claim, label, value) for label, value in values.items()}
    named = [f"{TITLES.get(label, label)}: {text}" for label, text in marked.items()]
    ours = named if len(values) > 1 else list(marked.values())
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
    return f"({_reason_numbers()[claim.reason]})" if claim.reason else ""


def _reason_numbers() -> dict[str, int]:
    """Return the number of each reason, which counts from 1 in the order of the claims."""
    reasons = dict.fromkeys(claim.reason for claim in CLAIMS if claim.reason)
    return {reason: number for number, reason in enumerate(reasons, start=1)}


def _markdown(comparison: Comparison, figures: Sequence[Path]) -> str:
    """Return tables, reasons, tolerances and figures as Markdown."""
    lines = ["# The paper's numbers, recomputed", ""]
    for sheet in _tables(comparison, narrow=False):
        escaped = dataclasses.replace(sheet, rows=[[cell.replace("*", "\\*") for cell in row] for row in sheet.rows])
        lines += [f"## {sheet.title}", "", escaped.markdown(), ""]
    lines += [_LEGEND.replace("*", "\\*"), "", "## Why", ""]
    lines += [f"{number}. {reason}" for reason, number in _reason_numbers().items()]
    groups: dict[str, list[str]] = {}
    for claim in CLAIMS:
        relative, absolute = claim.tolerance
        parts = [f"{relative:g} of the stored value"] * bool(relative) + [f"{absolute:g} {claim.unit}"] * bool(absolute)
        groups.setdefault(" and ".join(parts) or "nothing", []).append(claim.key)
    allowed = "; ".join(f"{allowance}: {', '.join(keys)}" for allowance, keys in groups.items())
    moved = [f"- {entry}" for entry in comparison.drifted]
    lines += ["", "## _Drift", "", *_outcome(comparison), f"Allowed: {allowed}.", "", *moved, ""]
    if figures:
        lines += ["## Figures", "", *(f"![{path.stem}]({path.name})" for path in figures), ""]
    made = comparison.made_with
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items() if version)
    return "\n".join([*lines, f"`fuzzyarm paper`; {made['machine']['cpu']}, {versions}, commit {made['commit']}.", ""])
