"""The summary of a report: a chart of the tip errors of each case, and a table of all metrics."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from statistics import median
from typing import Any, NamedTuple

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import RESOLUTION
from fuzzyarm.eval.evaluation.result_table import COLUMNS, DECLARED, declared_rows, table_rows
from fuzzyarm.eval.report.chart import PALETTE, Axis, Errors, draw_chart, figure
from fuzzyarm.policies.declared import Declared

__all__ = ["best", "declared_table", "error_charts", "finished", "metrics_table"]

Row = dict[str, Any]
"""The metrics of one episode, a row of an `Evaluation`."""
Group = dict[str, list[Row]]
"""The rows of one case by policy, with one row for each seed."""


class _TipError(NamedTuple):
    """Tip error of a policy in a case [mm], over several seeds the medians."""

    rms: float
    maximum: float


def error_charts(rows: Sequence[Row], titles: Mapping[str, str] | None = None) -> str:
    """Return a chart of the tip errors for each case, all with the same axis; over several seeds medians.

    `titles` of the cases by name; None: those of the two-joint arm.
    """
    known = {name: case.title for name, case in CASES.items()} if titles is None else titles
    groups = _groups(rows)
    errors = {case: {policy: _tip_error(runs) for policy, runs in group.items()} for case, group in groups.items()}
    axis = _error_axis([value for group in errors.values() for error in group.values() for value in error])
    figures = []
    for case, group in groups.items():
        best_rms = min((errors[case][policy].rms for policy, runs in group.items() if finished(runs)), default=math.nan)
        drawn = []
        for policy, runs in group.items():
            rms, maximum = errors[case][policy]
            mark = "" if finished(runs) else " ×"
            drawn.append((policy, Errors(rms, maximum, finished(runs) and rms <= max(best_rms, RESOLUTION), mark)))
        title = known[case]
        description = f"{title}: root mean square and maximum of the tip error in mm"
        figures.append(figure(title, draw_chart(axis, drawn, description)))
    return "".join(figures)


def _tip_error(runs: Sequence[Row]) -> _TipError:
    return _TipError(*(float(median(run[key] for run in runs)) for key in ("tip_error_rms_mm", "tip_error_max_mm")))


def _error_axis(values: Sequence[float]) -> Axis:
    """Return a logarithmic axis of at least one decade that shows all positive, finite values."""
    positive = [value for value in values if 0.0 < value < math.inf] or [1.0]
    low, high = math.floor(math.log10(min(positive))), math.ceil(math.log10(max(positive)))
    return Axis("tip error [mm]", 10.0**low, 10.0 ** max(high, low + 1), log=True)


def metrics_table(rows: Sequence[Row], titles: Mapping[str, str] | None = None) -> str:
    """Return the table of all metrics: a body for each case, with the best cells of each column marked, see `best`.

    `titles` as for `error_charts`.
    """
    known = {name: case.title for name, case in CASES.items()} if titles is None else titles
    cells = iter(table_rows(rows))  # in the order of the groups
    headings = [escape(heading).replace("N m", "N&nbsp;m") for heading, _, _ in COLUMNS]
    heads = "".join(f'<th scope="col">{heading}</th>' for heading in headings)
    parts = [f'<table><thead><tr><th scope="col">policy</th>{heads}</tr></thead>']
    for case, group in _groups(rows).items():
        texts = {policy: _cells(next(cells)) for policy in group}
        parts.append(_table_body(known[case], group, texts))
    return "".join([*parts, "</table>"])


def _cells(row: tuple[str, str, list[str]]) -> list[str]:
    """Return the cells of a row of `table_rows`, without decimal points that no digit follows."""
    _, _, cells = row
    return [re.sub(r"\.(?!\d)", "", cell) for cell in cells]


def _table_body(title: str, group: Group, texts: dict[str, list[str]]) -> str:
    """Return the rows of a case; `texts` are the cells of each policy."""
    marked = [
        best(group, keys, {policy: cells[column] for policy, cells in texts.items()})
        for column, (_, keys, _) in enumerate(COLUMNS)
    ]
    span = f'scope="rowgroup" colspan="{len(COLUMNS) + 1}"'
    parts = [f"<tbody><tr><th {span}><span>{escape(title)}</span></th></tr>"]
    for index, (policy, runs) in enumerate(group.items()):
        name = f'<span class="swatch"></span>{escape(policy)}{_badge(runs)}'
        row = [
            f'<td class="best">{escape(text)}</td>' if policy in stars else f"<td>{escape(text)}</td>"
            for text, stars in zip(texts[policy], marked, strict=True)
        ]
        parts.append(f'<tr class="p{index % PALETTE}"><th scope="row">{name}</th>{"".join(row)}</tr>')
    return "".join([*parts, "</tbody>"])


def declared_table(declared: Mapping[str, Declared | None], certificates: Mapping[str, str | None]) -> str:
    """Return the table of what the policies declare, given that and their certificates in words by label."""
    heads = "".join(f'<th scope="col">{heading}</th>' for heading in DECLARED)
    rows = []
    for label, *cells in declared_rows(declared, certificates):
        said = "".join(f'<td class="words">{escape(cell)}</td>' for cell in cells)
        rows.append(f'<tr><th scope="row">{escape(label)}</th>{said}</tr>')
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def best(group: Group, keys: Sequence[str], texts: dict[str, str]) -> set[str]:
    """Return the policies that are marked as best in a column: the smallest value, and cells that read the same.

    The value of a cell is the largest absolute value of its metrics; over several seeds, their median. Only policies
    that finished all episodes compete. No policy is marked if only one finished, or if more than half of them would be.

    Args:
        group: the rows of a case.
        keys: the metrics in the cell.
        texts: the text of the cell by policy.
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


def finished(runs: Sequence[Row]) -> bool:
    """Return whether every episode followed the reference to its end."""
    return all(run["completed"] for run in runs)


def _groups(rows: Sequence[Row]) -> dict[str, Group]:
    groups: dict[str, Group] = {}
    for row in rows:
        groups.setdefault(row["case"], {}).setdefault(row["policy"], []).append(row)
    return groups


def _badge(runs: Sequence[Row]) -> str:
    ended = sum(not run["completed"] for run in runs)
    return f' <span class="badge">ended early in {ended} of {len(runs)}</span>' if ended else ""
