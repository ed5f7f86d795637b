"""The summary: a chart of the tip errors of each case, and the table of all metrics."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape
from statistics import median
from typing import Any

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.evaluation.result_table import COLUMNS, table_rows
from fuzzyarm.eval.report.chart import Axis, Errors, chart, figure

Row = dict[str, Any]
Group = dict[str, list[Row]]
"""The rows of one case by policy, one for each seed."""


def error_charts(rows: Sequence[Row]) -> str:
    """Return a chart of the tip errors for each case, all on the same axis; over several seeds medians."""
    groups = _groups(rows)
    errors = {
        (case, policy): tuple(float(median(run[f"tip_error_{key}_mm"] for run in runs)) for key in ("rms", "max"))
        for case, group in groups.items()
        for policy, runs in group.items()
    }
    positive = [value for pair in errors.values() for value in pair if 0.0 < value < math.inf] or [1.0]
    low, high = math.floor(math.log10(min(positive))), math.ceil(math.log10(max(positive)))
    axis = Axis("tip error [mm]", 10.0**low, 10.0 ** max(high, low + 1), log=True)
    figures = []
    for case, group in groups.items():
        best = min((errors[case, policy][0] for policy, runs in group.items() if finished(runs)), default=math.nan)
        drawn = []
        for policy, runs in group.items():
            rms, largest = errors[case, policy]
            content = Errors(rms, largest, finished(runs) and rms == best, "" if finished(runs) else " ×")
            drawn.append((policy, content))
        title = CASES[case].title
        description = f"{title}: root mean square and maximum of the tip error in mm"
        figures.append(figure(title, chart(axis, drawn, description)))
    return "".join(figures)


def table(rows: Sequence[Row]) -> str:
    """Return the table of all metrics, a body for each case, the best of each column marked by `best`."""
    cells = iter(table_rows(rows))  # in the order of the groups
    headings = [escape(heading).replace("N m", "N&nbsp;m") for heading, _, _ in COLUMNS]
    heads = "".join(f'<th scope="col">{heading}</th>' for heading in headings)
    parts = [f'<table><thead><tr><th scope="col">policy</th>{heads}</tr></thead>']
    for case, group in _groups(rows).items():
        span = f'scope="rowgroup" colspan="{len(COLUMNS) + 1}"'
        parts.append(f"<tbody><tr><th {span}>{escape(CASES[case].title)}</th></tr>")
        texts = {policy: [re.sub(r"\.(?!\d)", "", text) for text in next(cells)[2]] for policy in group}
        marked = [
            best(group, keys, {policy: text[column] for policy, text in texts.items()})
            for column, (_, keys, _) in enumerate(COLUMNS)
        ]
        for index, (policy, runs) in enumerate(group.items()):
            name = f'<span class="swatch"></span>{escape(policy)}{_badge(runs)}'
            row = [
                f'<td class="best">{escape(text)}</td>' if policy in marked[column] else f"<td>{escape(text)}</td>"
                for column, text in enumerate(texts[policy])
            ]
            parts.append(f'<tr class="p{index % 8}"><th scope="row">{name}</th>{"".join(row)}</tr>')
        parts.append("</tbody>")
    return "".join([*parts, "</table>"])


def best(group: Group, keys: Sequence[str], texts: dict[str, str]) -> set[str]:
    """Return the policies whose cell reads like that of the smallest size, among those that finished.

    The size of a cell is the largest absolute value of its metrics, over seeds their median. None is best if only one
    finished or more than half share the place.

    Args:
        group: the rows of a case.
        keys: the metrics in the cell.
        texts: the cell by policy.
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
    """Return whether every episode went on to its end."""
    return all(run["completed"] for run in runs)


def _groups(rows: Sequence[Row]) -> dict[str, Group]:
    groups: dict[str, Group] = {}
    for row in rows:
        groups.setdefault(row["case"], {}).setdefault(row["policy"], []).append(row)
    return groups


def _badge(runs: Sequence[Row]) -> str:
    ended = sum(not run["completed"] for run in runs)
    return f' <span class="badge">ended early in {ended} of {len(runs)}</span>' if ended else ""
