"""The summary of a report: a chart of the tip errors of each case, and a table of all metrics.

Charts are small SVGs with a row for each policy; colours are classes of the page's style, dark or light.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from statistics import median
from typing import Any

from fuzzyarm.eval.episodes.metrics import RESOLUTION, columns, millimetres
from fuzzyarm.eval.evaluation.result_table import DECLARED, by_case_and_policy, declared_rows, table_rows
from fuzzyarm.policies.declared import Declared

__all__ = [
    "Axis", "Bound", "Errors", "best", "declared_table", "digits", "draw_chart", "error_charts", "figure", "finished",
    "metrics_table",
]  # fmt: skip


_WIDTH, _LEFT, _RIGHT, _TOP, _ROW, _BOTTOM = 390, 150, 76, 6, 25, 40  # [px]: of the chart, its margins, and a row
_LONGEST_NAME = 19  # characters; a longer name is cut, and its tooltip shows all of it
_PALETTE = 8  # number of policy colours in page.css; further policies start again with the first


@dataclasses.dataclass(frozen=True)
class Axis:
    """A horizontal axis from `low` to `high`, labelled with quantity and unit."""

    label: str
    low: float
    high: float
    log: bool = False

    def x(self, value: float) -> float:
        """Return the position of a value [px]; a value beyond the axis is drawn at its end."""
        low, high = (math.log10(self.low), math.log10(self.high)) if self.log else (self.low, self.high)
        place = math.log10(max(value, 1e-300)) if self.log else value
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * min(max((place - low) / (high - low), 0.0), 1.0)

    def ticks(self) -> list[float]:
        """Return the labelled values: decades, or at most six round numbers."""
        if self.log:
            exponents = range(round(math.log10(self.low)), round(math.log10(self.high)) + 1)
            return [10.0**k for k in exponents if len(exponents) < 6 or k % 2 == 0]
        raw = (self.high - self.low) / 5.0
        unit = 10.0 ** math.floor(math.log10(raw))
        step = next(factor * unit for factor in (1.0, 2.0, 5.0, 10.0) if factor * unit >= raw)
        return [step * k for k in range(math.ceil(self.low / step), math.floor(self.high / step + 1e-9) + 1)]


@dataclasses.dataclass(frozen=True)
class Errors:
    """An error of a policy: its root mean square, its maximum, whether the former is the best, and a mark after it."""

    rms: float
    maximum: float
    best: bool
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Bound:
    """A certified bound and the worst observed value."""

    certified: float
    observed: float | None  # None if nothing was
    at_least: bool  # whether the bound is a lower one


def draw_chart(axis: Axis, rows: Sequence[tuple[str, Errors | Bound | str]], description: str) -> str:
    """Return the SVG of a chart: a row for each policy, with a text where there are neither errors nor a bound."""
    bottom = _TOP + _ROW * len(rows)
    parts = [
        f'<svg class="chart" role="img" viewBox="0 0 {_WIDTH} {bottom + _BOTTOM}" width="{_WIDTH}" '
        f'height="{bottom + _BOTTOM}"><title>{escape(description)}</title>'
    ]
    for tick in axis.ticks():
        x = axis.x(tick)
        parts.append(f'<path class="grid" d="M{x:.1f} {_TOP}V{bottom}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 15}">{_number(tick)}</text>')
    middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
    parts.append(f'<text class="axis" x="{middle}" y="{bottom + 33}">{escape(axis.label)}</text>')
    for index, (name, content) in enumerate(rows):
        parts.append(_row(axis, name, index, content))
    return "".join(parts) + "</svg>"


def _row(axis: Axis, name: str, index: int, content: Errors | Bound | str) -> str:
    y = _TOP + _ROW * (index + 0.5)
    short = name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"
    label = (
        f'<g class="p{index % _PALETTE}"><title>{escape(name)}</title><rect class="key" x="0" y="{y - 5}" width="9" '
        f'height="10" rx="2"/><text class="name" x="16" y="{y + 4}">{escape(short)}</text>'
    )
    if isinstance(content, str):
        return label + f'<text class="none" x="{_LEFT + 4}" y="{y + 4}">{escape(content)}</text></g>'
    drawn = _errors(axis, y, content) if isinstance(content, Errors) else _bound(axis, y, content)
    return label + drawn + "</g>"


def _errors(axis: Axis, y: float, errors: Errors) -> str:
    """Return a disc at the rms, a stroke at the maximum, and the rms in digits."""
    rms, maximum = axis.x(errors.rms), axis.x(errors.maximum)
    text = ('<tspan class="star">★ </tspan>' if errors.best else "") + escape(millimetres(errors.rms, digits))
    return (
        f'<path class="span" d="M{rms:.1f} {y}H{maximum:.1f}"/><path class="end" d="M{maximum:.1f} {y - 6}v12"/>'
        f'<circle class="dot" cx="{rms:.1f}" cy="{y}" r="5"/>'
        f'<text class="value" x="{_WIDTH - 2}" y="{y + 4}">{text}{errors.note}</text>'
    )


def _bound(axis: Axis, y: float, bound: Bound) -> str:
    """Return the range that the certificate excludes, hatched, its limit, and a disc at the worst observed value."""
    limit = axis.x(bound.certified)
    start, end = (axis.x(axis.low), limit) if bound.at_least else (limit, axis.x(axis.high))
    sign = "≥" if bound.at_least else "≤"
    drawn = (
        f'<rect class="ruled-out" x="{start:.1f}" y="{y - 7}" width="{end - start:.1f}" height="14"/>'
        f'<path class="limit" d="M{limit:.1f} {y - 10}v20"/>'
    )
    seen = ""
    if bound.observed is not None:
        drawn += f'<circle class="dot" cx="{axis.x(bound.observed):.1f}" cy="{y}" r="5"/>'
        seen = f"{digits(bound.observed)} "
    return drawn + f'<text class="value" x="{_WIDTH - 2}" y="{y + 4}">{seen}{sign} {bound.certified:.3g}</text>'


def digits(value: float) -> str:
    """Return a number with three digits, trailing zeros included; from 1000 on, with all digits before the point."""
    return f"{value:.0f}" if value >= 1000.0 else f"{value:#.3g}".rstrip(".")


def _number(value: float) -> str:
    """Return the label of a tick; small and large powers of ten have superscripts."""
    exponent = math.log10(value) if value > 0.0 else 0.0
    if exponent == round(exponent) and not -2 <= exponent <= 3:
        return "10" + str(round(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:g}"


def figure(title: str, content: str) -> str:
    """Return a chart with its title above."""
    return f"<figure><figcaption>{escape(title)}</figcaption>{content}</figure>"


_Row = Mapping[str, Any]  # the metrics of one episode
_Group = Mapping[str, Sequence[_Row]]  # the rows of one case by policy, with one row for each seed


def error_charts(rows: Sequence[_Row], titles: Mapping[str, str]) -> str:
    """Return a chart of the tip errors for each case, all with the same axis; over several seeds medians."""
    groups = by_case_and_policy(rows)
    errors = {
        case: {
            policy: tuple(float(median(run[f"tip_error_{key}_mm"] for run in runs)) for key in ("rms", "max"))
            for policy, runs in group.items()
        }
        for case, group in groups.items()
    }
    values = list(itertools.chain(*(error for group in errors.values() for error in group.values())))
    # A logarithmic axis of at least one decade shows all positive, finite values.
    positive = [value for value in values if 0.0 < value < math.inf] or [1.0]
    low, high = math.floor(math.log10(min(positive))), math.ceil(math.log10(max(positive)))
    axis = Axis("tip error [mm]", 10.0**low, 10.0 ** max(high, low + 1), log=True)
    figures = []
    for case, group in groups.items():
        held = [policy for policy, runs in group.items() if finished(runs)]
        best_rms = max(min((errors[case][policy][0] for policy in held), default=math.nan), RESOLUTION)
        drawn = []
        for policy, (rms, maximum) in errors[case].items():
            won = policy in held and rms <= best_rms
            drawn.append((policy, Errors(rms, maximum, won, "" if policy in held else " ×")))
        description = f"{titles[case]}: root mean square and maximum of the tip error in mm"
        figures.append(figure(titles[case], draw_chart(axis, drawn, description)))
    return "".join(figures)


def metrics_table(rows: Sequence[_Row], titles: Mapping[str, str]) -> str:
    """Return the table of all metrics: a body for each case, with the best cells of each column marked, see `best`."""
    cells = iter(table_rows(rows))  # in the order of the groups
    parts = [_head(["policy", *(heading.replace("N m", "N\u00a0m") for heading in columns())])]
    for case, group in by_case_and_policy(rows).items():
        # A decimal point that no digit follows is left out.
        texts = {policy: [re.sub(r"\.(?!\d)", "", cell) for cell in next(cells)[2]] for policy in group}
        parts.append(_table_body(titles[case], group, texts))
    return f"<table>{''.join(parts)}</table>"


def _head(headings: Sequence[str]) -> str:
    heads = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    return f"<thead><tr>{heads}</tr></thead>"


def _table_body(title: str, group: _Group, texts: dict[str, list[str]]) -> str:
    """Return the rows of a case; `texts` are the cells of each policy."""
    marked = [
        best(group, [metric.name for metric in metrics], {policy: cells[column] for policy, cells in texts.items()})
        for column, metrics in enumerate(columns().values())
    ]
    span = f'scope="rowgroup" colspan="{len(columns()) + 1}"'
    parts = [f"<tbody><tr><th {span}><span>{escape(title)}</span></th></tr>"]
    for index, (policy, runs) in enumerate(group.items()):
        ended = sum(not run["completed"] for run in runs)
        badge = f' <span class="badge">ended early in {ended} of {len(runs)}</span>' if ended else ""
        name = f'<span class="swatch"></span>{escape(policy)}{badge}'
        row = [
            ('<td class="best">' if policy in stars else "<td>") + f"{escape(text)}</td>"
            for text, stars in zip(texts[policy], marked, strict=True)
        ]
        parts.append(f'<tr class="p{index % _PALETTE}"><th scope="row">{name}</th>{"".join(row)}</tr>')
    return "".join([*parts, "</tbody>"])


def declared_table(declared: Mapping[str, Declared | None], certificates: Mapping[str, str | None]) -> str:
    """Return the table of what the policies declare, given that and their certificates in words by label."""
    rows = []
    for label, *cells in declared_rows(declared, certificates):
        said = "".join(f'<td class="words">{escape(cell)}</td>' for cell in cells)
        rows.append(f'<tr><th scope="row">{escape(label)}</th>{said}</tr>')
    return f"<table>{_head(DECLARED)}<tbody>{''.join(rows)}</tbody></table>"


def best(group: _Group, keys: Sequence[str], texts: Mapping[str, str]) -> set[str]:
    """Return the policies that are marked as best in a column: the smallest value, and cells that read the same.

    The value of a cell is the largest absolute value of its metrics; over several seeds, their median. Only policies
    that finished all episodes compete. No policy is marked if only one finished, or if more than half of them would be.

    `keys` are the metrics in the cell, `texts` the cells by policy.
    """
    sizes = {
        policy: max(median(abs(run[key]) for run in runs) for key in keys)
        for policy, runs in group.items()
        if finished(runs)
    }
    if len(sizes) < 2:
        return set()
    smallest = min(sizes, key=sizes.__getitem__)
    alike = {policy for policy in sizes if texts[policy] == texts[smallest]}
    return alike if len(alike) <= len(sizes) / 2 else set()


def finished(runs: Sequence[_Row]) -> bool:
    """Return whether every episode followed the reference to its end."""
    return all(run["completed"] for run in runs)
