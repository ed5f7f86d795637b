"""The figure of `comparison.py`: each policy on new plants and under forces of no training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from compared_policies import POLICIES
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

__all__ = ["draw_comparison"]

MODEL_BASED, LEARNED = "#0072B2", "#D55E00"


def draw_comparison(document: Mapping[str, Any]) -> Figure:
    """Return the figure: a panel for each case, a line for each policy."""
    rows, cases, method = document["rows"], document["cases"], document["method"]
    figure = Figure(figsize=(11.0, 2.0 + 0.26 * len(rows)))
    panels = figure.subplots(1, len(cases), sharey=True)
    limits = _limits(rows)
    for axes, (case, title) in zip(panels, cases.items(), strict=True):
        for place, row in enumerate(rows):
            _draw(axes, place, row["plants"][case], LEARNED if POLICIES[row["name"]].learned else MODEL_BASED, limits)
        axes.set_xscale("log")
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("tip error [mm]")
        axes.set_xlim(*limits)
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(rows)), [row["name"] for row in rows])
    panels[0].invert_yaxis()
    handles = [
        Line2D([], [], color=MODEL_BASED, marker="o", label="model-based"),
        Line2D([], [], color=LEARNED, marker="o", label="learned"),
    ]
    title = (
        f"line: largest error, 1 to 99 % of {method['plants']:,} plants, an arrow where more than 1 % ended early\n"
        f"dot: interquartile mean of the rms error, bar: its interval of 95 %; with several seeds over these, of "
        f"{method['seed_plants']:,} plants each"
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=2, title=title, title_fontsize=9)
    return figure


def _draw(axes: Axes, place: int, found: Mapping[str, Any], color: str, limits: tuple[float, float]) -> None:
    """Draw a policy in a case; words stand where it has no mean."""
    score, (low, _, high) = found["score_mm"], found["quantiles_mm"]
    if low is not None:
        axes.plot([low, high or limits[1]], [place, place], color=color, linewidth=1.0, alpha=0.5)
        if high is None:
            axes.plot(0.97 * limits[1], place, ">", color=color, markersize=4.0, alpha=0.5)
    if score["mean"] is None:
        axes.text(limits[0] * 1.2, place, "no mean: ended early", color=color, fontsize=7, va="center")
        return
    axes.plot([score["low"], score["high"] or limits[1]], [place, place], color=color, linewidth=5.0, alpha=0.6)
    axes.plot(score["mean"], place, "o", color=color, markersize=4.5)


def _limits(rows: list[Mapping[str, Any]]) -> tuple[float, float]:
    """Return the range of the axes [mm], in which everything that is drawn lies."""
    found = [found for row in rows for found in row["plants"].values()]
    drawn = [value for one in found for value in (*one["quantiles_mm"], *one["score_mm"].values()) if value is not None]
    return 0.7 * min(drawn), 1.5 * max(drawn)
