"""Figures 2-10 of the paper, recomputed: left, with its theorems as printed; right, in our consistent form.

Only the text of the paper was available, not its figures. The axes follow from the captions and section 6.2. Ranges
that the text states are drawn as grey bands. As in the paper, dotted blue means 32 rules or joint 1, and solid red
means 4 rules or joint 2.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fuzzyarm.eval._figure_files import figure_style, write_all
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.paper.evidence import FORMS, RULES, SIDES, Evidence

__all__ = ["draw_figures", "write_figures"]

_Look = Mapping[str, Any]
_BLUE: _Look = {"color": "#0072B2", "linestyle": (0, (1, 1.2)), "linewidth": 2.0, "zorder": 2.6}
_RED: _Look = {"color": "#D55E00", "linestyle": "-", "linewidth": 1.4, "zorder": 2.5}
_BY_RULES: Mapping[int, _Look] = dict(zip(RULES, (_BLUE, _RED), strict=True))
_REFERENCE: _Look = {"color": "black", "linewidth": 0.9, "zorder": 3.0, "label": "reference"}
_BANDS = ("#E6E6E6", "#CFCFCF")  # of ranges that the paper's text states, the wider range first
_COLUMN_TITLES = {"printed": "printed form, gains bounded by (24)", "consistent": "consistent form"}  # by form
_ZOOM = 0.012  # [m], side of the magnified square of Fig. 2


# Figs. 4-6: the range [mm] of the circularity error in each case as the paper's text states it; None: not stated.
_CIRCULARITY: Mapping[str, Any] = {"nominal": (-1.3, 1.3), "machining": (-2.3, 4.4), "payload": None}
# Figs. 7-10, a quantity of both joints in Case 1: number, title, label with unit, and signal (n, joints) of a rollout.
_JOINTS: Sequence[tuple[int, str, str, Callable[[Rollout], np.ndarray]]] = (
    (7, "actuator torques in Case 1", "Γ [N m]", lambda r: r.torque),
    (8, "joint velocities in Case 1 (motors)", "q̇ [rad/s]", lambda r: r.dq_motor),
    (9, "joint position errors in Case 1 (motors)", "q − q_d [mrad]", lambda r: 1e3 * (r.q_motor - r.q_reference)),
    (10, "friction torques in Case 1", "Γ_f [N m]", lambda r: r.friction_torque),
)
_OWN_SCALES = 9  # the figure whose columns differ in scale
_STATED = {7: (228.0, 47.0)}  # largest values of the joints by the paper's text, drawn as bands of both signs


def write_figures(evidence: Evidence, folder: Path, progress: Callable[[], None] = lambda: None) -> list[Path]:
    """Write ``figure-02.png`` to ``figure-10.png``, each atomically; call `progress` after each; return their paths."""
    figures = {f"figure-{number:02}": figure for number, figure in draw_figures(evidence).items()}
    return write_all(figures, folder, progress, svg=False)


def draw_figures(evidence: Evidence) -> dict[int, Figure]:
    """Return Figs. 2-10 by their number."""
    with figure_style():
        figures = {2: _paths(evidence), 3: _force(evidence)}
        figures |= {number: _circularity_figure(evidence, number, case) for number, case in enumerate(_CIRCULARITY, 4)}
        return figures | {row[0]: _joint_figure(evidence, *row) for row in _JOINTS}


def _paths(evidence: Evidence) -> Figure:
    """Return Fig. 2: tip paths to scale; an inset magnifies the place of the largest error with 4 rules."""
    figure, grid = _grid(2, "end-effector trajectories in Case 1", (9.2, 5.2), 1, sharex="row", sharey="row")
    for axes, form in zip(grid[0], FORMS, strict=True):
        runs = {rules: evidence.rollouts[f"{form}-{rules}", "nominal"] for rules in RULES}
        _draw_paths(axes, runs)
        axes.set(aspect="equal", xlabel="x [m]")
        _magnify_worst(axes, runs)
    grid[0, 0].set_ylabel("y [m]")
    _legend(figure, [Line2D([], [], **_REFERENCE), *_rule_handles()])
    return figure


def _magnify_worst(axes: Axes, runs: Mapping[int, Rollout]) -> None:
    """Add an inset around the largest circularity error of the 4-rule controller; `runs` by number of rules."""
    few = runs[4]
    worst = int(np.argmax(np.abs(few.circularity_error)))
    inset = axes.inset_axes((0.35, 0.34, 0.32, 0.32))
    _draw_paths(inset, runs)
    x, y = few.tip_reference[worst]
    inset.set(xlim=(x - _ZOOM / 2, x + _ZOOM / 2), ylim=(y - _ZOOM / 2, y + _ZOOM / 2), aspect="equal")
    inset.set(xticks=[], yticks=[])
    inset.spines[:].set_visible(True)
    inset.set_title(f"{1e3 * _ZOOM:.0f} mm wide", fontsize=8.5, loc="center", fontweight="normal")
    axes.indicate_inset_zoom(inset, edgecolor="#333333")


def _draw_paths(axes: Axes, runs: Mapping[int, Rollout]) -> None:
    axes.plot(*runs[4].tip_reference.T, **_REFERENCE)
    for rules, run in runs.items():
        axes.plot(*run.tip.T, **_BY_RULES[rules])


def _force(evidence: Evidence) -> Figure:
    """Return Fig. 3: the components of the external force in Case 2; x points down."""
    figure = Figure(figsize=(9.2, 3.4))
    figure.suptitle("Fig. 3: external force in Case 2", x=0.01, ha="left", fontweight="bold")
    axes, run = figure.subplots(), evidence.rollouts["consistent-4", "machining"]
    size = np.linalg.norm(run.external_force, axis=1)
    dashed: _Look = {"color": "#666666", "linewidth": 0.9, "linestyle": (0, (6, 2))}
    for sign in (1.0, -1.0):
        axes.axhspan(sign * 138.0, sign * 218.0, color=_BANDS[0], zorder=0.5)
        axes.plot(run.time, sign * size, **dashed)
    for look, component in zip((_BLUE, _RED), run.external_force.T, strict=True):
        axes.plot(run.time, component, **look)
    axes.set(xlabel="time [s]", ylabel="external force [N]")
    looks = {"vertical (x, down)": _BLUE, "horizontal (y)": _RED, "±|F_e|": dashed}
    lines = [Line2D([], [], label=label, **look) for label, look in looks.items()]
    _legend(figure, [*lines, Patch(color=_BANDS[0], label="stated: 138 to 218 N")])
    return figure


def _circularity_figure(evidence: Evidence, number: int, case: str) -> Figure:
    """Return one of Figs. 4-6, with a row for the tip and one for the motors; each column has its own scale."""
    stated, title = _CIRCULARITY[case], f"circularity error in Case {number - 3}"
    figure, grid = _grid(number, title, (9.2, 5.0), len(SIDES), sharey="col")
    for column, form in zip(grid.T, FORMS, strict=True):
        runs = [evidence.rollouts[f"{form}-{rules}", case] for rules in RULES]
        for axes, (side, error) in zip(column, SIDES.items(), strict=True):
            if stated is not None:
                axes.axhspan(*stated, color=_BANDS[0], zorder=0.5)
            for rules, run in zip(RULES, runs, strict=True):
                axes.plot(run.time, 1e3 * getattr(run, error), **_BY_RULES[rules])
            axes.margins(y=0.06)
            axes.set_ylabel("tip [mm]" if side == "tip" else "motors, as if rigid [mm]")
        column[-1].set_xlabel("time [s]")
    handles: list[Any] = _rule_handles()
    if stated is not None:
        text = f"±{stated[1]:g}" if -stated[0] == stated[1] else "{:g} to {:g}".format(*stated).replace("-", "−")
        handles.append(Patch(color=_BANDS[0], label=f"stated: {text} mm"))
    _legend(figure, handles)
    return figure


def _joint_figure(evidence: Evidence, number: int, title: str, label: str, signal: Callable[..., Any]) -> Figure:
    """Return one of Figs. 7-10, with a row for each number of rules and a column for each of `FORMS`.

    `signal` returns the curves (samples, joints) of a rollout; `label` is for their axis.
    """
    stated = tuple(zip(_BANDS, _STATED.get(number, ()), strict=False))
    figure, grid = _grid(number, title, (9.2, 5.0), len(RULES), sharey="col" if number == _OWN_SCALES else "all")
    for row, rules in zip(grid, RULES, strict=True):
        for axes, form in zip(row, FORMS, strict=True):
            run = evidence.rollouts[f"{form}-{rules}", "nominal"]
            for color, size in stated:
                axes.axhspan(-size, size, color=color, zorder=0.5)
            for look, values in zip((_BLUE, _RED), signal(run).T, strict=True):
                axes.plot(run.time, values, **look)
        row[0].set_ylabel(f"{rules} rules\n{label}")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    joints = [Line2D([], [], label=f"joint {number}", **look) for number, look in enumerate((_BLUE, _RED), start=1)]
    bands = [Patch(color=color, label=f"stated peak: {size:.0f} N m") for color, size in stated]
    _legend(figure, [*joints, *bands])
    return figure


def _grid(number: int, title: str, size: tuple[float, float], rows: int, **shared: Any) -> tuple[Figure, np.ndarray]:
    """Return Fig. `number` with the heading `title`, and its axes (rows, columns).

    Each of the `FORMS` has a column with its own heading. `shared` is passed to `subplots`.
    """
    two_scales = ", each column to its own scale" if shared.get("sharey") == "col" else ""
    figure = Figure(figsize=size)
    figure.suptitle(f"Fig. {number}: {title}{two_scales}", x=0.01, ha="left", fontweight="bold")
    grid = figure.subplots(rows, len(FORMS), squeeze=False, **({"sharex": "all"} | shared))
    for axes, form in zip(grid[0], FORMS, strict=True):
        axes.set_title(_COLUMN_TITLES[form], fontweight="normal")
    return figure, grid


def _rule_handles() -> list[Line2D]:
    return [Line2D([], [], label=f"{rules} rules", **look) for rules, look in _BY_RULES.items()]


def _legend(figure: Figure, handles: Sequence[Any]) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
