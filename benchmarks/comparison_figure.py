"""The figure of `comparison.py`: each policy on plants and under forces that no training has drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

__all__ = ["draw_comparison"]

MODEL_BASED, LEARNED = "#0072B2", "#D55E00"


def draw_comparison(document: Mapping[str, Any]) -> Figure:
    """Return the figure: a panel for each case, a line for each policy."""
    rows, cases = document["rows"], document["cases"]
    figure = Figure(figsize=(11.0, 4.6))
    panels = figure.subplots(1, len(cases), sharey=True)
    for axes, (case, title) in zip(panels, cases.items(), strict=True):
        for place, row in enumerate(rows):
            found, color = row["plants"][case], LEARNED if row["learned"] else MODEL_BASED
            score, (low, _, high) = found["score_mm"], found["quantiles_mm"]
            if low is not None:
                axes.plot([low, high or 1e3], [place, place], color=color, linewidth=1.0, alpha=0.5)
            if score["mean"] is not None:
                axes.plot([score["low"], score["high"]], [place, place], color=color, linewidth=5.0, alpha=0.6)
                axes.plot(score["mean"], place, "o", color=color, markersize=4.5)
        axes.set_xscale("log")
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("tip error [mm]")
        axes.set_xlim(5e-2, 5e2)
        axes.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(rows)), [row["name"] for row in rows])
    panels[0].invert_yaxis()
    handles = [
        Line2D([], [], color=MODEL_BASED, marker="o", label="model-based"),
        Line2D([], [], color=LEARNED, marker="o", label="learned"),
    ]
    plants = document["method"]["plants"]
    title = f"dot: interquartile mean of rms over {plants} plants, bar: its interval; line: largest error, 1 to 99 %"
    figure.legend(handles=handles, loc="outside lower center", ncols=2, title=title)
    return figure
