"""The summary of a report: a chart of the tip errors of each case, and a table of all metrics.

Charts are small SVGs with a row for each policy; colours are classes of the page's style, dark or light.
"""

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

__all__ = ["declared_table", "error_charts", "figure", "metrics_table"]


_WIDTH, _LEFT, _RIGHT, _TOP, _ROW, _BOTTOM = 390, 150, 76, 6, 25, 40  # [px]: of the chart, its margins, and a row
_LONGEST_NAME = 19  # characters; a longer name is cut, and its tooltip shows all of it
_PALETTE = 16  # number of policy colours in page.css; further policies reuse them from the first on


def _digits(value: float) -> str:
    """Return a number with three significant digits; values of 1000 and above as whole numbers."""
    return f"{value:.0f}" if value >= 1000.0 else f"{value:#.3g}".rstrip(".")


def figure(title: str, content: str) -> str:
    """Return the HTML of a chart, `content`, with its title above it."""
    return f"<figure><figcaption>{escape(title)}</figcaption>{content}</figure>"


_Row = Mapping[str, Any]  # the metrics of one episode


def error_charts(rows: Sequence[_Row], titles: Mapping[str, str]) -> str:
    """Return a chart of the tip errors for each case, all with the same axis; with several seeds, of the medians."""
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
    decades, figures = (low, max(high, low + 1)), []
    for case, group in groups.items():
        held = [policy for policy, runs in group.items() if all(run["completed"] for run in runs)]
        best = max(min((errors[case][policy][1] for policy in held), default=math.nan), RESOLUTION)
        marks = {
            policy: "×" if policy not in held else "★" * (most <= best) for policy, (_, most) in errors[case].items()
        }
        figures.append(figure(titles[case], _error_chart(titles[case], errors[case], marks, decades)))
    return "".join(figures)


def _error_chart(
    title: str, errors: Mapping[str, Sequence[float]], marks: Mapping[str, str], decades: tuple[int, int]
) -> str:
    """Return the SVG of a case: for each policy a disc at the rms, a stroke at the maximum, and the maximum in digits.

    `errors` are rms and maximum [mm] by policy, `marks` are "★", "×" or empty, and the axis spans `decades`, two powers
    of ten.
    """
    low, high = decades

    def x(error: float) -> float:
        place = (math.log10(max(error, 1e-300)) - low) / (high - low)
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * min(max(place, 0.0), 1.0)

    bottom = _TOP + _ROW * len(errors)
    description = f"{title}: root mean square and maximum of the tip error in mm"
    parts = [
        f'<svg class="chart" role="img" viewBox="0 0 {_WIDTH} {bottom + _BOTTOM}" width="{_WIDTH}" '
        f'height="{bottom + _BOTTOM}"><title>{escape(description)}</title>'
    ]
    for exponent in range(low, high + 1, 1 if high - low < 5 else 2):
        at = x(10.0**exponent)
        parts.append(f'<path class="grid" d="M{at:.1f} {_TOP}V{bottom}"/>')
        parts.append(f'<text class="tick" x="{at:.1f}" y="{bottom + 15}">{10.0**exponent:g}</text>')
    middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
    parts.append(f'<text class="axis" x="{middle}" y="{bottom + 33}">tip error [mm]</text>')
    for index, (name, (rms, maximum)) in enumerate(errors.items()):
        short = name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"
        star = '<tspan class="star">★ </tspan>' if marks[name] == "★" else ""
        parts.append(
            f'<g class="p{index % _PALETTE}" transform="translate(0 {_TOP + _ROW * (index + 0.5)})">'
            f'<title>{escape(name)}</title><rect class="key" x="0" y="-5" width="9" height="10" rx="2"/>'
            f'<text class="name" x="16" y="4">{escape(short)}</text>'
            f'<path class="span" d="M{x(rms):.1f} 0H{x(maximum):.1f}"/>'
            f'<path class="end" d="M{x(maximum):.1f} -6v12"/><circle class="dot" cx="{x(rms):.1f}" cy="0" r="5"/>'
            f'<text class="value" x="{_WIDTH - 2}" y="4">{star}{escape(millimetres(maximum, _digits))}'
            f"{' ×' if marks[name] == '×' else ''}</text></g>"
        )
    return "".join(parts) + "</svg>"


def metrics_table(rows: Sequence[_Row], titles: Mapping[str, str]) -> str:
    """Return the table of all metrics, with one table body for each case."""
    cells = iter(table_rows(rows))  # in the order of the groups
    parts = [_head(["policy", *(heading.replace("N m", "N\u00a0m") for heading in columns())])]
    for case, group in by_case_and_policy(rows).items():
        title = f'<th scope="rowgroup" colspan="{len(columns()) + 1}"><span>{escape(titles[case])}</span></th>'
        parts.append(f"<tbody><tr>{title}</tr>")
        for index, (policy, runs) in enumerate(group.items()):
            ended = sum(not run["completed"] for run in runs)
            badge = f' <span class="badge">ended early in {ended} of {len(runs)}</span>' if ended else ""
            name = f'<span class="swatch"></span>{escape(policy)}{badge}'
            texts = (re.sub(r"\.(?!\d)", "", cell) for cell in next(cells)[2])  # without a trailing point
            row = "".join(f"<td>{escape(text)}</td>" for text in texts)
            parts.append(f'<tr class="p{index % _PALETTE}"><th scope="row">{name}</th>{row}</tr>')
        parts.append("</tbody>")
    return f"<table>{''.join(parts)}</table>"


def _head(headings: Sequence[str]) -> str:
    heads = "".join(f'<th scope="col">{escape(heading)}</th>' for heading in headings)
    return f"<thead><tr>{heads}</tr></thead>"


def declared_table(declared: Mapping[str, Declared | None], certificates: Mapping[str, str | None]) -> str:
    """Return the table of the policies' declarations; both arguments are keyed by policy label."""
    headings, *policies = declared_rows(declared, certificates)
    rows = []
    for label, *cells in policies:
        said = "".join(f'<td class="words">{escape(cell)}</td>' for cell in cells)
        rows.append(f'<tr><th scope="row">{escape(label)}</th>{said}</tr>')
    return f"<table>{_head(headings)}<tbody>{''.join(rows)}</tbody></table>"
