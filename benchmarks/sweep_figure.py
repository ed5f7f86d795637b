"""The figure of the sweep over plants with loads: quantiles of the largest tip error, each with its interval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

__all__ = ["LEVELS", "draw"]

LEVELS = {"0.5": "o", "0.9": "s", "0.99": "D"}
"""Markers by level of the quantile, as `rows` of the sweep have them."""
COLOR, BOUND = "#0072B2", "#333333"


def draw(document: Mapping[str, Any]) -> Figure:
    """Return the figure: a panel for each case, a line for each policy, from the median to the last quantile."""
    cases, bound = document["config"]["cases"], document["config"]["bound"]
    policies = list(dict.fromkeys(row["policy"] for row in document["rows"]))
    figure = Figure(figsize=(10.3, 1.6 + 0.26 * len(policies)))
    panels = dict(zip(cases, figure.subplots(1, len(cases), sharex=True, sharey=True), strict=True))
    for row in document["rows"]:
        _draw(panels[row["case"]], policies.index(row["policy"]), row["max_mm"])
    for case, axes in panels.items():
        axes.axvline(bound, color=BOUND, linewidth=0.9, zorder=1.5)
        axes.set(title=document["titles"][case], xlabel="largest tip error [mm]", xscale="log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_yticks(range(len(policies)), policies)
    axes.margins(x=0.05, y=0.08)
    axes.invert_yaxis()
    handles = [
        Line2D([], [], color=COLOR, marker=marker, markersize=5, linewidth=1.0, label=f"{100.0 * float(level):g} %")
        for level, marker in LEVELS.items()
    ]
    handles.append(Line2D([], [], color=BOUND, linewidth=0.9, label=f"bound of success, {bound:g} mm"))
    title = f"not exceeded by so many of {document['config']['plants']:,} plants; bar: interval of 95 %"
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), title=title)
    return figure


def _draw(axes: Axes, place: int, quantiles: Mapping[str, Mapping[str, float | None]]) -> None:
    """Draw a policy in a case; a quantile among episodes that ended early has no number and no marker."""
    found = {level: quantiles[level] for level in LEVELS if quantiles[level]["value"] is not None}
    axes.plot([one["value"] for one in found.values()], [place] * len(found), color=COLOR, linewidth=1.0)
    for level, one in found.items():
        axes.plot([one["low"], one["high"]], [place, place], color=COLOR, linewidth=5.0, alpha=0.5)
        axes.plot(one["value"], place, LEVELS[level], color=COLOR, markersize=5, markeredgewidth=1.0)
