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
from fuzzyarm.eval.evaluation.result_table import by_case_and_policy, declared_rows, table_rows
from fuzzyarm.policies.declared import Declared

__all__ = ["Axis", "declared_table", "digits", "error_charts", "figure", "finished", "metrics_table"]


_WIDTH, _LEFT, _RIGHT, _TOP, _ROW, _BOTTOM = 390, 150, 76, 6, 25, 40  # [px]: of the chart, its margins, and a row
_LONGEST_NAME = 19  # characters; a longer name is cut, and its tooltip shows all of it
_PALETTE = 8  # number of policy colours in page.css; further policies start again with the first


@dataclasses.dataclass(frozen=True)
class Axis:
    """The horizontal axis of a chart, from `low` to `high`, labelled with quantity and unit.

    `errors` and `bound` draw what a row of the chart shows, in the middle of the row.
    """

    label: str
    low: float
    high: float
    log: bool = False

    def _x(self, value: float) -> float:
        """Return the position of a value [px]; a value beyond the axis is drawn at its end."""
        low, high = (math.log10(self.low), math.log10(self.high)) if self.log else (self.low, self.high)
        place = math.log10(max(value, 1e-300)) if self.log else value
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * min(max((place - low) / (high - low), 0.0), 1.0)

    def _ticks(self) -> list[float]:
        """Return the labelled values: decades, or at most six round numbers."""
        if self.log:
            exponents = range(round(math.log10(self.low)), round(math.log10(self.high)) + 1)
            return [10.0**k for k in exponents if len(exponents) < 6 or k % 2 == 0]
        raw = (self.high - self.low) / 5.0
        unit = 10.0 ** math.floor(math.log10(raw))
        step = next(factor * unit for factor in (1.0, 2.0, 5.0, 10.0) if factor * unit >= raw)
        return [step * k for k in range(math.ceil(self.low / step), math.floor(self.high / step + 1e-9) + 1)]

    def errors(self, rms: float, maximum: float, mark: str) -> str:
        """Return a disc at the rms, a stroke at the maximum, and the rms in digits with a mark: "★", "×" or none."""
        at_rms, at_maximum = self._x(rms), self._x(maximum)
        text = ('<tspan class="star">★ </tspan>' if mark == "★" else "") + escape(millimetres(rms, digits))
        return (
            f'<path class="span" d="M{at_rms:.1f} 0H{at_maximum:.1f}"/>'
            f'<path class="end" d="M{at_maximum:.1f} -6v12"/><circle class="dot" cx="{at_rms:.1f}" cy="0" r="5"/>'
            f'<text class="value" x="{_WIDTH - 2}" y="4">{text}{" ×" if mark == "×" else ""}</text>'
        )

    def bound(self, certified: float, observed: float | None, *, lower: bool) -> str:
        """Return the range that a certificate excludes, hatched, its limit, and a disc at the worst observed value."""
        limit = self._x(certified)
        start, end = (self._x(self.low), limit) if lower else (limit, self._x(self.high))
        disc = "" if observed is None else f'<circle class="dot" cx="{self._x(observed):.1f}" cy="0" r="5"/>'
        seen = "" if observed is None else f"{digits(observed)} "
        return (
            f'<rect class="ruled-out" x="{start:.1f}" y="-7" width="{end - start:.1f}" height="14"/>'
            f'<path class="limit" d="M{limit:.1f} -10v20"/>{disc}'
            f'<text class="value" x="{_WIDTH - 2}" y="4">{seen}{"≥" if lower else "≤"} {certified:.3g}</text>'
        )

    def chart(self, rows: Sequence[tuple[str, str]], description: str) -> str:
        """Return the SVG of a chart with a row for each (policy, content); content without markup is shown as text."""
        bottom = _TOP + _ROW * len(rows)
        parts = [
            f'<svg class="chart" role="img" viewBox="0 0 {_WIDTH} {bottom + _BOTTOM}" width="{_WIDTH}" '
            f'height="{bottom + _BOTTOM}"><title>{escape(description)}</title>'
        ]
        for tick in self._ticks():
            x = self._x(tick)
            parts.append(f'<path class="grid" d="M{x:.1f} {_TOP}V{bottom}"/>')
            parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 15}">{_number(tick)}</text>')
        middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
        parts.append(f'<text class="axis" x="{middle}" y="{bottom + 33}">{escape(self.label)}</text>')
        for index, (name, drawn) in enumerate(rows):
            short = name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"
            text = f'<text class="none" x="{_LEFT + 4}" y="4">{escape(drawn)}</text>'
            parts.append(
                f'<g class="p{index % _PALETTE}" transform="translate(0 {_TOP + _ROW * (index + 0.5)})">'
                f'<title>{escape(name)}</title><rect class="key" x="0" y="-5" width="9" height="10" rx="2"/>'
                f'<text class="name" x="16" y="4">{escape(short)}</text>{drawn if drawn[0] == "<" else text}</g>'
            )
        return "".join(parts) + "</svg>"


def digits(value: float) -> str:
    """Return a number with three significant digits; from 1000 on, with all digits before the decimal point."""
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
    values = itertools.chain(*(error for group in errors.values() for error in group.values()))
    # A logarithmic axis of at least one decade shows all positive, finite values.
    positive = [value for value in values if 0.0 < value < math.inf] or [1.0]
    low, high = math.floor(math.log10(min(positive))), math.ceil(math.log10(max(positive)))
    axis = Axis("tip error [mm]", 10.0**low, 10.0 ** max(high, low + 1), log=True)
    figures = []
    for case, group in groups.items():
        held = [policy for policy, runs in group.items() if finished(runs)]
        best_rms = max(min((errors[case][policy][0] for policy in held), default=math.nan), RESOLUTION)
        drawn = [
            (policy, axis.errors(rms, maximum, "×" if policy not in held else "★" if rms <= best_rms else ""))
            for policy, (rms, maximum) in errors[case].items()
        ]
        description = f"{titles[case]}: root mean square and maximum of the tip error in mm"
        figures.append(figure(titles[case], axis.chart(drawn, description)))
    return "".join(figures)


def metrics_table(rows: Sequence[_Row], titles: Mapping[str, str]) -> str:
    """Return the table of all metrics: a body for each case, with the best cells of each column marked, see `_best`."""
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
        _best(group, [metric.name for metric in metrics], {policy: cells[column] for policy, cells in texts.items()})
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
    """Return the table of what the policies declare, from declarations and certificates in words by label."""
    headings, *policies = declared_rows(declared, certificates)
    rows = []
    for label, *cells in policies:
        said = "".join(f'<td class="words">{escape(cell)}</td>' for cell in cells)
        rows.append(f'<tr><th scope="row">{escape(label)}</th>{said}</tr>')
    return f"<table>{_head(headings)}<tbody>{''.join(rows)}</tbody></table>"


def _best(group: _Group, keys: Sequence[str], texts: Mapping[str, str]) -> set[str]:
    """Return the policies that are marked as best in a column: those whose cells read the same as the smallest value.

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
