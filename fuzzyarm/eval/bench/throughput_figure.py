"""The figure of `fuzzyarm bench --lanes-sweep`: throughput against the number of lanes."""

from __future__ import annotations

import io
import itertools
from pathlib import Path
from typing import Any

import matplotlib.style
from matplotlib.figure import Figure

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.evaluation.figures import DASHES

__all__ = ["draw_throughput", "write_throughput_figure"]

MARKERS = "os^Dv"


def write_throughput_figure(document: dict[str, Any], path: Path) -> None:
    """Draw the throughput in a document of `run.run_bench` and write it as PNG.

    Raises:
        OSError: the folder is missing or not writable; no file is left half written.
    """
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        content = io.BytesIO()
        draw_throughput(document).savefig(content, format="png")
    write_atomically(path, content.getvalue())


def draw_throughput(document: dict[str, Any]) -> Figure:
    """Return the figure: median and quartiles of the steps per second, both axes logarithmic."""
    curves: dict[str, list[tuple[int, dict[str, float]]]] = {}
    for row in document["sweep"]:
        if row["steps_per_s"]:
            curves.setdefault(f"{row['name']}, {row['dtype']}", []).append((row["lanes"], row["steps_per_s"]))
    figure = Figure(figsize=(6.6, 4.4))
    axes = figure.subplots()
    for (label, points), dashes, marker in zip(
        curves.items(), itertools.cycle(DASHES), itertools.cycle(MARKERS), strict=False
    ):
        lanes = [lanes for lanes, _ in points]
        low, median, high = ([speed[key] for _, speed in points] for key in ("q1", "median", "q3"))
        (line,) = axes.plot(lanes, median, linestyle=dashes, marker=marker, markersize=4.5, label=label)
        axes.fill_between(lanes, low, high, color=line.get_color(), alpha=0.2, linewidth=0.0)
    axes.set_xscale("log", base=4)
    axes.set_yscale("log")
    axes.set(xlabel="lanes, environments in one batch [1]", ylabel="throughput [steps/s]")
    axes.set_title("Throughput of a batch, control steps of 1 ms")
    axes.xaxis.set_major_formatter(lambda lanes, _: f"{lanes:,.0f}".replace(",", " "))
    if curves:
        machine, threads = document["machine"], document["method"]["threads"]
        title = f"{machine['cpu']}, {machine['cores']} cores, at most {threads} threads; bands: quartiles"
        figure.legend(loc="outside lower center", ncols=1, title=title)
    return figure
