"""The paper's numbers compared with ours, and the drift from the stored numbers: tables, Markdown and JSON.

``fuzzyarm paper --renew FILE`` stores our present numbers in a file. A maintainer renews the ``expected.json`` of this
folder with it after an intended change.
"""

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
from fuzzyarm.eval.paper._claims import CLAIMS, PaperNumber
from fuzzyarm.eval.paper.evidence import TITLES, Evidence
from fuzzyarm.eval.provenance import current_provenance, json_text

__all__ = [
    "EXPECTED", "compare", "load_expected", "print_report", "store_expected", "write_report",
]  # fmt: skip


EXPECTED = Path(__file__).with_name("expected.json")
"""The stored numbers that come with the package."""
_EXPECTED_SCHEMA = "fuzzyarm-paper-expected/1"

_Numbers = Mapping[str, Mapping[str, float]]  # values by the key of their claim and their label


@dataclasses.dataclass(frozen=True)
class _ExpectedFile:
    """Content of a file of stored numbers: the numbers, and the versions used to measure them."""

    schema: str
    measured: dict[str, dict[str, float]]
    commit: str | None = None
    versions: dict[str, str | None] = dataclasses.field(default_factory=dict)
    machine: dict[str, Any] = dataclasses.field(default_factory=dict)


def load_expected(path: Path = EXPECTED) -> Mapping[str, Mapping[str, float]]:
    """Return the numbers stored in a file, by claim and label; ValueError if it is damaged or of another schema."""
    again = f"write such a file with fuzzyarm paper --out DIR --renew {path}"
    return read_checked(path, _EXPECTED_SCHEMA, again, lambda content: record(content, _ExpectedFile)).measured


def store_expected(measured: _Numbers, made_with: Mapping[str, Any], path: Path) -> None:
    """Write measured numbers, and the versions used, to a file that `load_expected` reads."""
    write_atomically(path, json_text({"schema": _EXPECTED_SCHEMA, **made_with, "measured": measured}))


@dataclasses.dataclass(frozen=True)
class _Value:
    """One number of a claim, as stored and as measured now; `str` also shows the allowed difference."""

    claim: PaperNumber
    label: str
    measured: float | None  # now; None for a number that no longer exists
    stored: float | None  # None for a new number

    @property
    def drifted(self) -> bool:
        """Whether the number is outside the tolerance around the stored value, is new, or no longer exists."""
        if self.measured is None or self.stored is None:
            return True
        # "not <=" instead of ">", so that NaN counts as drift.
        return not abs(self.measured - self.stored) <= self.claim.allowed(self.stored)

    @property
    def agrees(self) -> bool | None:
        """Whether the number agrees with the paper's; None if either is missing."""
        return None if self.measured is None else self.claim.agrees(self.label, self.measured)

    def __str__(self) -> str:
        unit = "" if self.claim.unit == "-" else f" {self.claim.unit}"
        was, now = ("none" if value is None else f"{value:.10g}{unit}" for value in (self.stored, self.measured))
        allowed = 0.0 if self.stored is None else self.claim.allowed(self.stored)
        return f"{self.claim.key}, {self.label}: measured {now}, stored {was}, allowed: within {allowed:.3g}{unit}"


@dataclasses.dataclass(frozen=True)
class _Values:
    """The numbers of every claim as measured now and as stored in a file, by claim and label."""

    measured: _Numbers
    stored: _Numbers
    made_with: Mapping[str, Any]  # commit, versions and machine of this measurement

    @functools.cached_property
    def values(self) -> Sequence[_Value]:
        """Every number, in the order of the claims; numbers of claims that no longer exist come last."""
        keys = {claim.key for claim in CLAIMS}
        gone = [PaperNumber(key, "", "", "", "-", None, "") for key in self.stored if key not in keys]
        found = []
        for claim in (*CLAIMS, *gone):
            now, then = (numbers.get(claim.key, {}) for numbers in (self.measured, self.stored))
            found += [_Value(claim, label, now.get(label), then.get(label)) for label in dict.fromkeys([*then, *now])]
        return found

    @property
    def drifted(self) -> Sequence[_Value]:
        """The numbers that have drifted from the stored ones."""
        return [value for value in self.values if value.drifted]

    def to_dict(self) -> dict[str, Any]:
        """Return the claims with their measured and stored numbers as plain data for JSON."""
        claims = {
            claim.key: dataclasses.asdict(claim)
            | {"tolerance": dict(zip(("relative", "absolute"), claim.tolerance, strict=True)), "values": []}
            for claim in CLAIMS
        }
        for value in self.values:
            if value.measured is not None:
                numbers = {name: getattr(value, name) for name in ("label", "measured", "stored", "agrees", "drifted")}
                paper = value.claim.papers_number(value.label)
                claims[value.claim.key]["values"].append(numbers | {"paper": paper})
        return {"schema": "fuzzyarm-paper/1", **self.made_with, "claims": list(claims.values())}


def compare(evidence: Evidence, stored: _Numbers | None) -> _Values:
    """Measure the numbers of every claim and compare them with the stored ones; with themselves if `stored` is None."""
    measured = {claim.key: claim.measured(evidence) for claim in CLAIMS}
    return _Values(measured, measured if stored is None else stored, current_provenance())


# The numbers of the reasons, which count from 1 in the order of the claims.
_REASONS = dict(zip(dict.fromkeys(claim.reason for claim in CLAIMS if claim.reason), itertools.count(1), strict=False))
_SIGN = {"equal": "", "order": "~ ", "at most": "<= ", "more than": "> "}
_GROUPS = {"statements": "Statements and settings", "table_2": "Table 2", "rollouts": "On the arm"}
_LEGEND = (
    "* marks agreement with the paper: a number agrees in all printed digits, the size of a gain within a factor of "
    "ten, a bound if it is met, a comparison if the order is the same. Where the paper gives no number, nothing is "
    "marked."
)


def _outcome(comparison: _Values) -> list[str]:
    """Return two sentences: how many numbers have drifted from the stored ones, and how many agree with the paper."""
    judged = [value for value in comparison.values if value.agrees is not None]
    others = dict.fromkeys(value.claim.key for value in judged if not value.agrees)
    return [
        f"{len(comparison.drifted)} of {sum(map(len, comparison.measured.values()))} numbers differ from the stored "
        "ones by more than allowed; only these set the exit code.",
        f"{len([value for value in judged if value.agrees])} of {len(judged)} numbers agree with the paper's; the "
        f"others, without *, belong to {', '.join(others)}.",
    ]


def print_report(comparison: _Values, console: Console) -> None:
    """Print the tables of the claims, the reasons for differences, and how many numbers have drifted or agree."""
    for sheet in _tables(comparison):
        sheet.print(console)
    reasons = (f"({number}) {reason}" for reason, number in _REASONS.items())
    for line in (_LEGEND, *reasons, *_outcome(comparison)):
        console.print(line, highlight=False, markup=False)


def _tables(comparison: _Values) -> list[Sheet]:
    """Return a table for each group of claims; each label is a column, except in the table of statements."""
    sheets = []
    for group, title in _GROUPS.items():
        found = [(claim, comparison.measured[claim.key]) for claim in CLAIMS if claim.group == group]
        together = group == "statements"
        labels = ["ours"] if together else [TITLES.get(label, label) for label in found[0][1]]
        headings = ["quantity", "where", "the paper says", "paper", *labels, "why"]
        rows = [_row(claim, values, together) for claim, values in found]
        sheets.append(Sheet(headings, rows, range(5 if together else 3), title=title, fold=True))
    return sheets


def _row(claim: PaperNumber, values: Mapping[str, float], together: bool) -> list[str]:
    """Return the cells of a claim's row, with all our values in one cell if `together`, else with one cell for each."""
    ours = {label: _number(value) + "*" * bool(claim.agrees(label, value)) for label, value in values.items()}
    papers = dict.fromkeys(map(claim.papers_number, values))
    cells = [
        f"{claim.key}: {claim.quantity}" + ("" if claim.unit == "-" else f" [{claim.unit}]"),
        *(claim.where, claim.says),
        ", ".join(_SIGN[claim.comparison] + _number(number) for number in papers if number is not None) or "-",
    ]
    named = [f"{TITLES.get(label, label)}: {text}" for label, text in ours.items()]
    texts = ["; ".join(named) if len(named) > 1 else "".join(ours.values())] if together else list(ours.values())
    return [*cells, *texts, f"({_REASONS[claim.reason]})" if claim.reason else ""]


def _number(value: float) -> str:
    """Return a number as text with four significant digits; between 1000 and a million, as a whole number."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.4g}"


def write_report(comparison: _Values, figures: Sequence[Path], folder: Path) -> list[Path]:
    """Write ``paper.md``, with the figures if there are any, and ``paper.json``; return their paths."""
    lines = ["# The paper's numbers, recomputed", ""]
    for sheet in _tables(comparison):
        lines += [f"## {sheet.title}", "", sheet.markdown().replace("*", "\\*"), ""]
    lines += [_LEGEND.replace("*", "\\*"), "", "## Why", ""]
    lines += [f"{number}. {reason}" for reason, number in _REASONS.items()]
    lines += ["", "## Drift", "", *_outcome(comparison), "", *(f"- {value}" for value in comparison.drifted), ""]
    if figures:
        lines += ["## Figures", "", *(f"![{path.stem}]({path.name})" for path in figures), ""]
    made = comparison.made_with
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items() if version)
    lines += [f"`fuzzyarm paper`; {made['machine']['cpu']}, {versions}, commit {made['commit']}.", ""]
    text, data = folder / "paper.md", folder / "paper.json"
    write_atomically(text, "\n".join(lines))
    write_atomically(data, json_text(comparison.to_dict()))
    return [text, data]
