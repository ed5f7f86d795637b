"""Figures 2-10 of the paper: its quantities over its axes, the printed form left, the consistent form right.

The figures themselves are not in the text this was written from: what is drawn over what is taken from captions and
section 6.2, and what ranges the text states are drawn as grey bands. Colours and strokes are the paper's in meaning,
dotted blue for 32 rules or joint 1 and solid red for 4 rules or joint 2, in the project's style.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.paper.controllers import FORMS, RULES
from fuzzyarm.eval.paper.evidence import Evidence
from fuzzyarm.eval.paper.measures import circularity_of, peak

Look = Mapping[str, Any]
BLUE: Look = {"color": "#0072B2", "linestyle": (0, (1, 1.2)), "linewidth": 2.0, "zorder": 2.6}
RED: Look = {"color": "#D55E00", "linestyle": "-", "linewidth": 1.4, "zorder": 2.5}
BY_RULES: Mapping[int, Look] = {32: BLUE, 4: RED}
BY_JOINT: Sequence[Look] = (BLUE, RED)
REFERENCE: Look = {"color": "black", "linewidth": 0.9, "zorder": 3.0, "label": "reference"}
BANDS = ("#E6E6E6", "#CFCFCF")  # what the paper's text states, the wider first
COLUMN_TITLES = {"printed": "printed form, gains bounded by (24)", "consistent": "consistent form"}
ZOOM = 0.012  # m, side of the magnified square of Fig. 2

Signal = Callable[[Rollout], np.ndarray]


@dataclasses.dataclass(frozen=True)
class JointFigure:
    """One of Figs. 7-10: a quantity of both joints in Case 1; a row for 32 and for 4 rules.

    Attributes:
        number: of the figure.
        title: what it shows.
        quantity: label of the vertical axis with its unit.
        signal: (n, 2), what is drawn.
        shared: whether both forms have the same scale.
        stated: the paper's largest values of joint 1 and 2, drawn as bands of both signs.
    """

    number: int
    title: str
    quantity: str
    signal: Signal
    shared: bool = True
    stated: Sequence[float] = ()


CIRCULARITY: Sequence[tuple[int, str, str, tuple[float, float] | None]] = (
    (4, "nominal", "circularity error in Case 1", (-1.3, 1.3)),
    (5, "machining", "circularity error in Case 2", (-2.3, 4.4)),
    (6, "payload", "circularity error in Case 3", None),
)
JOINTS = (
    JointFigure(7, "actuator torques in Case 1", "Γ [N m]", lambda r: r.torque, stated=(228.0, 47.0)),
    JointFigure(8, "joint velocities in Case 1 (motors)", "q̇ [rad/s]", lambda r: r.dq_motor),
    JointFigure(
        9,
        "joint position errors in Case 1 (motors)",
        "q − q_d [mrad]",
        lambda r: 1e3 * (r.q_motor - r.q_reference),
        shared=False,
    ),
    JointFigure(10, "friction torques in Case 1", "Γ_f [N m]", lambda r: r.friction_torque),
)


def write_figures(evidence: Evidence, folder: Path, progress: Callable[[], None] | None = None) -> list[Path]:
    """Write ``figure-02.png`` to ``figure-10.png``, each whole or not at all; return their paths.

    Raises:
        OSError: the folder is missing or not writable.
    """
    paths = []
    with _style():
        for number, figure in draw_figures(evidence).items():
            content, path = io.BytesIO(), folder / f"figure-{number:02}.png"
            figure.savefig(content, format="png")
            write_atomically(path, content.getvalue())
            paths.append(path)
            if progress is not None:
                progress()
    return paths


def draw_figures(evidence: Evidence) -> dict[int, Figure]:
    """Return Figs. 2-10 by their number."""
    with _style():
        figures = {2: _paths(evidence), 3: _force(evidence)}
        for number, case, title, stated in CIRCULARITY:
            figures[number] = _circularity(evidence, number, case, title, stated)
        return figures | {spec.number: _joint_figure(evidence, spec) for spec in JOINTS}


def _style() -> AbstractContextManager[None]:
    return matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True)


def _paths(evidence: Evidence) -> Figure:
    """Return Fig. 2: the plane of (26) to scale, and in the circle the place of the largest error magnified."""
    figure, grid = _grid(2, "end-effector trajectories in Case 1", (9.2, 5.2), 1, sharex="row", sharey="row")
    for axes, form in zip(grid[0], FORMS, strict=True):
        runs = {rules: evidence.rollouts[f"{form}-{rules}", "nominal"] for rules in RULES}
        _draw_paths(axes, runs)
        axes.set(aspect="equal", xlabel="x [m]")
        # Magnified where 4 rules are farthest off, if that fits into the square.
        worst = int(np.argmax(np.abs(runs[4].circularity_error)))
        if np.linalg.norm(runs[4].tip[worst] - runs[4].tip_reference[worst]) < 0.5 * ZOOM:
            inset = axes.inset_axes((0.35, 0.34, 0.32, 0.32))
            _draw_paths(inset, runs)
            x, y = runs[4].tip_reference[worst]
            inset.set(xlim=(x - ZOOM / 2, x + ZOOM / 2), ylim=(y - ZOOM / 2, y + ZOOM / 2), aspect="equal")
            inset.set(xticks=[], yticks=[])
            inset.spines[:].set_visible(True)
            inset.set_title(f"{1e3 * ZOOM:.0f} mm wide", fontsize=8.5, loc="center", fontweight="normal")
            axes.indicate_inset_zoom(inset, edgecolor="#333333")
    grid[0, 0].set_ylabel("y [m]")
    _legend(figure, [Line2D([], [], **REFERENCE), *_rule_handles()])
    return figure


def _draw_paths(axes: Axes, runs: Mapping[int, Rollout]) -> None:
    axes.plot(*runs[4].tip_reference.T, **REFERENCE)
    for rules, run in runs.items():
        axes.plot(*run.tip.T, **BY_RULES[rules])


def _force(evidence: Evidence) -> Figure:
    """Return Fig. 3: the components of the force of Case 2; x of (26) points down."""
    figure = Figure(figsize=(9.2, 3.4))
    figure.suptitle("Fig. 3: external force in Case 2", x=0.01, ha="left", fontweight="bold")
    axes, run = figure.subplots(), evidence.rollouts["consistent-4", "machining"]
    size = np.linalg.norm(run.external_force, axis=1)
    for sign in (1.0, -1.0):
        axes.axhspan(sign * 138.0, sign * 218.0, color=BANDS[0], zorder=0.5)
        axes.plot(run.time, sign * size, color="#666666", linewidth=0.9, linestyle=(0, (6, 2)))
    axes.plot(run.time, run.external_force[:, 0], **BLUE)
    axes.plot(run.time, run.external_force[:, 1], **RED)
    axes.set(xlabel="time [s]", ylabel="external force [N]")
    _legend(
        figure,
        [
            Line2D([], [], label="vertical (x, down)", **BLUE),
            Line2D([], [], label="horizontal (y)", **RED),
            Line2D([], [], label="±|F_e|", color="#666666", linewidth=0.9, linestyle=(0, (6, 2))),
            Patch(color=BANDS[0], label="stated: 138 to 218 N"),
        ],
    )
    return figure


def _circularity(evidence: Evidence, number: int, case: str, title: str, stated: tuple[float, float] | None) -> Figure:
    """Return one of Figs. 4-6: a row for the tip and for the motors; each column has its own scale."""
    figure, grid = _grid(number, title, (9.2, 5.0), 2, sharey="col")
    for column, form in zip(grid.T, FORMS, strict=True):
        for axes, side in zip(column, ("tip", "motors"), strict=True):
            runs = [evidence.rollouts[f"{form}-{rules}", case] for rules in RULES]
            if stated is not None:
                axes.axhspan(*stated, color=BANDS[0], zorder=0.5)
            for rules, run in zip(RULES, runs, strict=True):
                axes.plot(run.time, 1e3 * circularity_of(run, side), **BY_RULES[rules])
            _name_early_ends(axes, runs, side)
            label = "tip" if side == "tip" else "motors, as if rigid"
            axes.set_ylabel(f"{label} [mm]")
        _fit_column(column, [r for r in runs if r.completed], stated)
        column[-1].set_xlabel("time [s]")
    band = [] if stated is None else [Patch(color=BANDS[0], label=f"stated: {_range(stated)} mm")]
    _legend(figure, [*_rule_handles(), *band])
    return figure


def _fit_column(column: Sequence[Axes], completed: Sequence[Rollout], stated: tuple[float, float] | None) -> None:
    """Fit a column to the episodes that went on to the end; what left the box does not flatten them."""
    values = [1e3 * circularity_of(run, side) for run in completed for side in ("tip", "motors")]
    low = min([*(float(v.min()) for v in values), *(stated or ())])
    high = max([*(float(v.max()) for v in values), *(stated or ())])
    margin = 0.06 * (high - low)
    column[0].set_ylim(low - margin, high + margin)


def _name_early_ends(axes: Axes, runs: Sequence[Rollout], side: str) -> None:
    lines = []
    for rules, run in zip(RULES, runs, strict=True):
        if not run.completed:
            size = 1e3 * peak(circularity_of(run, side))
            lines.append(f"{rules} rules: out of the box (25) at {run.time[-1]:.2f} s, {size:.0f} mm")
    if lines:
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}
        text = "\n".join(lines)
        axes.text(0.99, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=8, bbox=box, zorder=6)


def _joint_figure(evidence: Evidence, spec: JointFigure) -> Figure:
    """Return one of Figs. 7-10."""
    figure, grid = _grid(spec.number, spec.title, (9.2, 5.0), 2, sharey="all" if spec.shared else "col")
    for row, rules in zip(grid, RULES, strict=True):
        for axes, form in zip(row, FORMS, strict=True):
            run = evidence.rollouts[f"{form}-{rules}", "nominal"]
            for color, size in zip(BANDS, spec.stated, strict=False):
                axes.axhspan(-size, size, color=color, zorder=0.5)
            for look, values in zip(BY_JOINT, spec.signal(run).T, strict=True):
                axes.plot(run.time, values, **look)
        row[0].set_ylabel(f"{rules} rules\n{spec.quantity}")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    joints = [Line2D([], [], label=f"joint {number}", **look) for number, look in enumerate(BY_JOINT, start=1)]
    bands = [
        Patch(color=color, label=f"stated peak: {size:.0f} N m")
        for color, size in zip(BANDS, spec.stated, strict=False)
    ]
    _legend(figure, [*joints, *bands])
    return figure


def _grid(number: int, title: str, size: tuple[float, float], rows: int, **shared: Any) -> tuple[Figure, np.ndarray]:
    """Return a figure with a column for each form and their titles."""
    two_scales = ", each column to its own scale" if shared.get("sharey") == "col" else ""
    figure = Figure(figsize=size)
    figure.suptitle(f"Fig. {number}: {title}{two_scales}", x=0.01, ha="left", fontweight="bold")
    grid = figure.subplots(rows, len(FORMS), squeeze=False, **({"sharex": "all"} | shared))
    for axes, form in zip(grid[0], FORMS, strict=True):
        axes.set_title(COLUMN_TITLES[form], fontweight="normal")
    return figure, grid


def _rule_handles() -> list[Line2D]:
    return [Line2D([], [], label=f"{rules} rules", **look) for rules, look in BY_RULES.items()]


def _legend(figure: Figure, handles: Sequence[Any]) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _range(ends: tuple[float, float]) -> str:
    text = f"±{ends[1]:g}" if -ends[0] == ends[1] else f"{ends[0]:g} to {ends[1]:g}"
    return text.replace("-", "−")
