"""The two figures of `learned_comparison.py`: the worst task of each learned policy, and the learning curves.

This module only draws. The comparison decides what is shown, what failed and what the texts say.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator

from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.evaluation import figures

MAGNIFICATIONS = (100, 50, *figures.MAGNIFICATIONS)  # of a deviation, the largest that has room
BOUND: Mapping[str, Any] = {"color": "#666666", "linewidth": 1.0, "linestyle": (0, (1, 2)), "zorder": 1.8}
MEDIAN: Mapping[str, Any] = {"color": "#0072B2", "linewidth": 2.4, "zorder": 3.0}
# The seeds share one colour, lighter than that of the median, because none of them matters by itself.
SEED: Mapping[str, Any] = {"color": "#6BAAD0", "linewidth": 0.9, "zorder": 2.5}
CROSS: Mapping[str, Any] = {"marker": "x", "markersize": 5.0, "markeredgewidth": 1.2}
LEVEL_COLORS = ("#D55E00", "#333333", "#009E73", "#CC79A7", "#E69F00")


@dataclasses.dataclass(frozen=True)
class Shown:
    """An episode in the figure of the worst tasks.

    Attributes:
        run: what happened.
        label: in the legend.
        failed_at: sample at which it failed, where a cross is drawn; None if it did not.
    """

    run: Rollout
    label: str
    failed_at: int | None = None


@dataclasses.dataclass(frozen=True)
class WorstTask:
    """A row of that figure.

    Attributes:
        title: says which policy and which task.
        reference: the motion of the task.
        episodes: of the learned policy and of those beside it.
        bound: tip error at which a policy has lost the path [mm].
    """

    title: str
    reference: JointReference
    episodes: Sequence[Shown]
    bound: float


@dataclasses.dataclass(frozen=True)
class Training:
    """A row of the figure of the learning curves.

    Attributes:
        name: of the learned policy.
        curves: by seed, one mapping per evaluation with ``steps``, and by case ``<case>_rms_mm`` and ``<case>_share``,
            the share of the episode after which it ended; 1 if that is missing.
        median_seed: drawn thicker.
    """

    name: str
    curves: Mapping[int, Sequence[Mapping[str, Any]]]
    median_seed: int


def png(draw: Callable[[], Figure]) -> bytes:
    """Return the figure that `draw` makes as PNG, drawn in the project's style."""
    content = io.BytesIO()
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        draw().savefig(content, format="png")
    return content.getvalue()


def draw_worst_tasks(rows: Sequence[WorstTask]) -> Figure:
    """Return the figure: in each row the path in the plane beside the tip error over time."""
    figure = Figure(figsize=(9.0, 4.6 * len(rows)))
    for part, row in zip(figure.subfigures(len(rows), 1, squeeze=False)[:, 0], rows, strict=True):
        plane, errors = part.subplots(1, 2)
        _draw_plane(plane, row)
        _draw_errors(errors, row)
        part.suptitle(row.title, x=0.01, ha="left", fontsize=10.5, weight="bold")
        part.legend(loc="outside lower center", ncols=3)
    return figure


def _draw_plane(axes: Axes, row: WorstTask) -> None:
    """Draw the plane of the arm, y to the right and x down: r and for each policy r + factor (p - r)."""
    reference = row.reference.tip(np.linspace(0.0, row.reference.duration, 1001)).position
    room = figures.ROOM * float(np.ptp(reference, axis=0).max())
    largest = max(float(shown.run.tip_error.max()) for shown in row.episodes)
    factor = next((factor for factor in MAGNIFICATIONS if factor * largest <= room), 1)
    for shown, look in zip(row.episodes, _looks(), strict=False):
        path = shown.run.tip_reference + factor * (shown.run.tip - shown.run.tip_reference)
        axes.plot(path[:, 1], path[:, 0], **look)
        if shown.failed_at is not None:
            _cross(axes, path[shown.failed_at, 1], path[shown.failed_at, 0], look)
    axes.plot(reference[:, 1], reference[:, 0], **figures.REFERENCE)
    axes.plot(*reference[0, ::-1], "o", color="black", markersize=5, zorder=4.0)
    axes.margins(0.05)
    axes.set(xlabel="y, to the side [m]", ylabel="x, down [m]", title=f"tip, deviation × {factor}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()


def _draw_errors(axes: Axes, row: WorstTask) -> None:
    """Draw the tip error over time, a micrometre at least; its labels are the legend of both panels."""
    for shown, look in zip(row.episodes, _looks(), strict=False):
        error = 1e3 * np.maximum(shown.run.tip_error, 1e-3 * figures.LOWEST)
        axes.plot(shown.run.time, error, label=shown.label, **look)
        if shown.failed_at is not None:
            _cross(axes, shown.run.time[shown.failed_at], error[shown.failed_at], look)
    if any(shown.failed_at is not None for shown in row.episodes):
        axes.axhline(row.bound, **BOUND)
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
        axes.annotate(
            f"lost beyond {row.bound:g} mm",
            (0.99, row.bound),
            xytext=(0, -4),
            xycoords=axes.get_yaxis_transform(),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=8,
            bbox=box,
        )
    axes.set(yscale="log", xlabel="time [s]", ylabel="tip error [mm]", title="tip error")


def _cross(axes: Axes, right: float, up: float, look: Mapping[str, Any]) -> None:
    axes.plot(right, up, "x", color=look["color"], clip_on=False, zorder=5.0)


def _looks() -> list[dict[str, Any]]:
    colors = matplotlib.rcParams["axes.prop_cycle"].by_key()["color"]
    return [{"color": color, "linestyle": dashes} for color, dashes in zip(colors, figures.DASHES, strict=False)]


def draw_learning_curves(trainings: Sequence[Training], levels: Mapping[str, Mapping[str, float]]) -> Figure:
    """Return the figure: a row per learned policy, a panel per case, the error over the steps of the training.

    Args:
        trainings: the rows.
        levels: by case and policy the rms tip error [mm] at which to draw a line for orientation.
    """
    policies = list(dict.fromkeys(policy for of in levels.values() for policy in of))
    looks = {
        policy: {"color": color, "linewidth": 1.3, "linestyle": dashes, "zorder": 2.0}
        for policy, color, dashes in zip(policies, LEVEL_COLORS, figures.DASHES[1:], strict=False)
    }
    figure = Figure(figsize=(10.0, 0.4 + 2.9 * len(trainings)))
    heights = [2.9] * len(trainings) + [0.4]
    *parts, foot = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for part, training in zip(parts, trainings, strict=True):
        part.suptitle(training.name, x=0.01, ha="left", fontsize=10.5, weight="bold")
        row = part.subplots(1, len(PAPER_CASES))
        for axes, case in zip(row, (CASES[name] for name in PAPER_CASES), strict=True):
            _draw_curves(axes, training, case.name)
            for policy, level in levels[case.name].items():
                axes.axhline(level, **looks[policy])
            _number_decades(axes)
            axes.set_title(case.title, fontweight="normal")
            axes.set_xlabel("environment steps [million]")
        row[0].set_ylabel("rms tip error [mm]")
    handles = [Line2D([], [], label="a seed", **SEED), Line2D([], [], label="median seed", **MEDIAN)]
    handles += [Line2D([], [], label=policy, **look) for policy, look in looks.items()]
    evaluations = (row for training in trainings for curve in training.curves.values() for row in curve)
    if any(_ended_early(row, case) for row in evaluations for case in PAPER_CASES):
        handles.append(Line2D([], [], label="ended early", color="#333333", linestyle="none", **CROSS))
    foot.legend(handles=handles, loc="center", ncols=len(handles))
    return figure


def _draw_curves(axes: Axes, training: Training, case: str) -> None:
    """Draw the rms tip error of every seed in a case, with a cross where the episode ended early."""
    for seed, curve in training.curves.items():
        look = MEDIAN if seed == training.median_seed else SEED
        steps = np.array([1e-6 * row["steps"] for row in curve])
        error = np.array([row[f"{case}_rms_mm"] for row in curve])
        axes.plot(steps, error, marker=".", markersize=2.0 * look["linewidth"], markeredgewidth=0.0, **look)
        early = np.array([_ended_early(row, case) for row in curve])
        axes.plot(steps[early], error[early], color=look["color"], linestyle="none", zorder=3.5, **CROSS)
    axes.set(yscale="log", xlim=(0.0, None))
    axes.locator_params(axis="x", nbins=5)


def _number_decades(axes: Axes) -> None:
    """Write 0.1, 1 and 10 at a logarithmic axis, and where there are few of them also 0.2, 0.3, 0.5 and so on."""
    low, high = axes.get_ylim()
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}" if high < 100.0 * low else ""))
    if high < 100.0 * low:
        axes.yaxis.set_minor_locator(LogLocator(subs=(2.0, 3.0, 5.0)))


def _ended_early(row: Mapping[str, Any], case: str) -> bool:
    return bool(row.get(f"{case}_share", 1.0) < 1.0)
