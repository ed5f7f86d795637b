"""Figures 2-10 of the paper for any policies, and an overview of the errors in all cases.

Every figure over time is a grid with a row per `_Panel` and a column per case. The path of the tip is drawn in the
plane of the two-joint arm; a path in space, in the plane closest to it.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fuzzyarm.common.checks import instance, path_of, sequence_of
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval._figure_files import figure_style, write_all
from fuzzyarm.eval.episodes.rollout import Rollout

__all__ = ["DASHES", "draw_figures", "policy_styles", "write_figures"]


_PLANE, _SPACE = 2, 3


@dataclasses.dataclass(frozen=True)
class _View:
    """The plane of a picture, onto which points are projected."""

    rows: np.ndarray  # (2, axes): unit vectors that point down and to the side in the picture
    labels: tuple[str, str]  # of the vertical and the horizontal axis
    upwards: bool  # whether the vertical axis counts upwards

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., axes) [m] in the picture: (..., 2) [m], down and to the side."""
        return np.asarray(points @ self.rows.T)


def _view_of(reference: np.ndarray) -> _View:
    """Return the view of a path (n, 2 or 3) [m].

    A path in space is projected onto the plane closest to it, with z upwards, or x downwards if that plane is level.
    """
    if reference.shape[-1] == _PLANE:
        return _View(np.eye(_PLANE), ("x, down [m]", "y, to the side [m]"), upwards=False)
    _, _, directions = np.linalg.svd(reference - reference.mean(axis=0), full_matrices=True)
    normal = directions[-1] * (1.0 if directions[-1].sum() >= 0.0 else -1.0)
    up = np.eye(_SPACE)[-1] - normal[-1] * normal
    if np.linalg.norm(up) < 0.1:  # a path in the plane of the base is seen from above, x downwards
        up = normal[0] * normal - np.eye(_SPACE)[0]
    up /= np.linalg.norm(up)
    side = np.cross(up, normal)
    return _View(np.stack([-up, side]), (f"along {_named(up)} [m]", f"along {_named(side)} [m]"), upwards=True)


def _named(direction: np.ndarray) -> str:
    """Return a vector in the base frame as text."""
    return "(" + ", ".join(f"{part + 0.0:.2g}" for part in np.round(direction, 2)) + ")"


_Signal = Callable[[Rollout], np.ndarray]  # (n,) [unit of the panel]


@dataclasses.dataclass(frozen=True)
class _Panel:
    """One quantity over time, a row of a figure.

    Panels of a figure with the same `scale` share their limits. On a logarithmic axis each case has its own limits, and
    values below its lowest decade are drawn at the edge. The scale of an error leaves out policies far worse than the
    best, see `_FOCUS`; the panel names them.
    """

    quantity: str
    unit: str
    signal: _Signal
    scale: str = ""
    target: _Signal | None = None  # what the signal should follow
    log: bool = False
    is_error: bool = False


_CIRCULARITY = _Panel("circularity error", "mm", lambda r: 1e3 * r.circularity_error, is_error=True)
_MOTOR_CIRCULARITY = _Panel("motors' circularity,\nas if rigid", "mm", lambda r: 1e3 * r.circularity_error_motor)
# Not an error panel: a policy that keeps the tip on the circle must move the motors off it.


@functools.cache
def _time_figures(joints: int) -> dict[str, tuple[_Panel, ...]]:
    """Return the panels of each figure over time, keyed by figure name, for an arm with this many joints."""
    each = zip(*map(_of_joint, range(joints)), strict=True)
    names = ("torque", "velocity", "motor-position", "friction")
    return {"circularity": (_CIRCULARITY, _MOTOR_CIRCULARITY)} | dict(zip(names, each, strict=True))


def _of_joint(k: int) -> tuple[_Panel, _Panel, _Panel, _Panel]:
    """Return the panels of one joint: torque, velocity, motor angle and friction."""
    name = f"joint {k + 1}"
    return (
        _Panel(f"motor torque,\n{name}", "N m", lambda r: r.torque[:, k], scale=name),
        _Panel(f"motor velocity,\n{name}", "rad/s", lambda r: r.dq_motor[:, k], target=lambda r: r.dq_reference[:, k]),
        _Panel(f"motor angle less\nq_d, {name}", "mrad", lambda r: 1e3 * (r.q_motor - r.q_reference)[:, k]),
        _Panel(f"friction torque,\n{name}", "N m", lambda r: r.friction_torque[:, k], scale=name),
    )


# The panels of the overview, one column for each case.
_OVERVIEW = (_Panel("tip error", "mm", lambda r: 1e3 * r.tip_error, scale="tip", log=True), _CIRCULARITY)


# Figures of paths magnify the deviations by the first of these factors at which those of the best policy stay within
# `_ROOM`, a share of the curve's size; larger ones are cut off and their policies named, except at the factor 1.
_MAGNIFICATIONS, _ROOM = (20, 10, 5, 2, 1), 0.5
# An error panel is scaled to the policies whose peak is at most `_FOCUS` times that of the best policy. A best peak
# below 2 mm counts as 2 mm.
_FOCUS, _SMALL = 5.0, 2.0
# A logarithmic axis begins with the decade that all policies which reach the end exceed, except for a share `_DIPS` of
# the time, when the error passes through zero. It begins no lower than `_LOWEST`, which in mm is ten nanometres.
_LOWEST, _DIPS = 1e-5, 0.05
_TALLER = 1.6  # height of a row with a logarithmic axis, relative to the others: decades need room
# Strokes and gaps, in line widths; the first is solid. With the style's eight colours, up to 72 policies differ.
_STROKES = ((), (4, 1.5), (1, 1.2), (6, 1.5, 1, 1.5), (9, 2), (2, 2), (3, 1, 1, 1, 1, 1), (9, 1.5, 3, 1.5), (1, 3))
DASHES: tuple[Any, ...] = tuple((0, strokes) if strokes else "-" for strokes in _STROKES)
"""Line styles of Matplotlib, in the order in which policies get them."""
_REFERENCE: Mapping[str, Any] = {"label": "reference", "color": "black", "linewidth": 0.9, "zorder": 3.0}
# Over time the reference is a wide band below the curves: a line would hide the curves or be hidden by them.
_BAND: Mapping[str, Any] = {"label": "reference", "color": "#CCCCCC", "linewidth": 4.0, "zorder": 1.9}

_Styles = Mapping[str, Mapping[str, Any]]
_Columns = Mapping[str, Sequence[Rollout]]
_Limits = tuple[float, float]


def write_figures(
    rollouts: Sequence[Rollout],
    folder: Path,
    progress: Callable[[], None] | None = None,
    titles: Mapping[str, str] | None = None,
) -> list[Path]:
    """Write every figure of `draw_figures` as ``<name>.png`` and ``<name>.svg``; return the paths in that order.

    In the existing `folder`, files with the same names are replaced; `progress` is called after each figure. `titles`
    are those of the cases by name; None: those of the two-joint arm.

    Raises:
        ValueError: there are no rollouts.
        OSError: the folder is missing or not writable; no file is left half written.
    """
    folder = path_of("folder", folder)
    rollouts = [instance("rollouts", run, Rollout) for run in sequence_of("rollouts", rollouts)]
    return write_all(draw_figures(rollouts, titles), folder, progress or (lambda: None))


def draw_figures(rollouts: Sequence[Rollout], titles: Mapping[str, str] | None = None) -> dict[str, Figure]:
    """Return every figure by its name, ``<case>-<figure>`` or ``overview``; with several seeds the first is drawn.

    `titles` as for `write_figures`.
    """
    first: dict[str, dict[str, Rollout]] = {}
    for rollout in rollouts:
        first.setdefault(rollout.case, {}).setdefault(rollout.policy, rollout)
    known = {name: case.title for name, case in CASES.items()} if titles is None else titles
    titles = {case: known.get(case, case) for case in first}
    columns = {titles[case]: list(by_policy.values()) for case, by_policy in first.items()}
    figures = {}
    with figure_style():
        styles = policy_styles([rollout.policy for rollout in rollouts])
        for case, title in titles.items():
            episodes = columns[title]
            figures[f"{case}-path"] = _path_figure(title, episodes, styles)
            if any(episode.external_force.any() for episode in episodes):
                figures[f"{case}-force"] = _force_figure(title, _longest(episodes))
            for name, panels in _time_figures(episodes[0].torque.shape[-1]).items():
                figures[f"{case}-{name}"] = _time_figure({title: episodes}, panels, styles)
        figures["overview"] = _time_figure(columns, _OVERVIEW, styles)
    return figures


def policy_styles(labels: Sequence[str]) -> _Styles:
    """Return colour and dashes by policy, the same in every figure; call it within `figure_style`."""
    colors = itertools.cycle(matplotlib.rcParams["axes.prop_cycle"].by_key()["color"])
    looks = zip(dict.fromkeys(labels), colors, itertools.cycle(DASHES), strict=False)
    return {policy: {"color": color, "linestyle": dashes} for policy, color, dashes in looks}


def _time_figure(columns: _Columns, panels: Sequence[_Panel], styles: _Styles) -> Figure:
    """Return the grid of `panels` (rows) over the cases (columns)."""
    width = 6.6 if len(columns) == 1 else 1.0 + 3.0 * len(columns)
    heights = [_TALLER if panel.log else 1.0 for panel in panels]
    figure = Figure(figsize=(width, 0.9 + 1.75 * sum(heights)))
    grid = figure.subplots(len(panels), len(columns), sharex="col", squeeze=False, height_ratios=heights)
    on_circle = all(_is_circle(_longest(episodes).tip_reference) for episodes in columns.values())
    for row, panel in zip(grid, panels, strict=True):
        peers = [peer for peer in panels if peer.scale == panel.scale]
        limits = _limits(columns, peers)
        for axes, (title, episodes) in zip(row, columns.items(), strict=True):
            # The decades of one case would leave the panels of another half empty.
            own = _limits({title: episodes}, peers) if panel.log else limits
            _draw_panel(axes, panel, episodes, styles, own)
            axes.tick_params(labelleft=panel.log or axes is row[0])
        quantity = panel.quantity if on_circle else panel.quantity.replace("circularity", "contour")
        row[0].set_ylabel(f"{quantity} [{panel.unit}]")
    figure.align_ylabels(grid[:, 0])
    for top, bottom, title in zip(grid[0], grid[-1], columns, strict=True):
        top.set_title(title)
        bottom.set_xlabel("time [s]")
        bottom.locator_params(axis="x", nbins=8 if len(columns) == 1 else 4)
    band = [Line2D([], [], **_BAND)] if any(panel.target for panel in panels) else []
    _legend(figure, list(itertools.chain(*columns.values())), styles, band)
    return figure


def _limits(columns: _Columns, panels: Sequence[_Panel]) -> _Limits:
    """Return the axis limits (low, high), with a margin, for `panels` in all columns.

    Errors with a peak above `_FOCUS` times that of the best policy are ignored.
    """
    low, high = 0.0, 0.0
    for panel, episodes in itertools.product(panels, columns.values()):
        best = max(_SMALL, min(float(np.abs(panel.signal(episode)).max()) for episode in _finished(episodes)))
        for curve in (panel.signal(episode) for episode in episodes):
            if not panel.is_error or np.abs(curve).max() <= _FOCUS * best:
                low, high = min(low, float(curve.min())), max(high, float(curve.max()))
    if panels[0].log:
        finished = [e for episodes in columns.values() for e in _finished(episodes)]
        lowest = min(float(np.quantile(panels[0].signal(e), _DIPS)) for e in finished)
        first = float(10.0 ** np.floor(np.log10(max(lowest, _LOWEST))))
        return first, max(10.0 * first, 1.5 * high)
    margin = 0.06 * (high - low) or 1.0
    return (low - margin if low < 0.0 else 0.0), (high + margin if high > 0.0 or low == 0.0 else 0.0)


def _draw_panel(axes: Axes, panel: _Panel, episodes: Sequence[Rollout], styles: _Styles, limits: _Limits) -> None:
    if panel.target is not None:
        axes.plot(_longest(episodes).time, panel.target(_longest(episodes)), **_BAND)
    outside = []
    for episode in episodes:
        values = np.maximum(panel.signal(episode), limits[0]) if panel.log else panel.signal(episode)
        axes.plot(episode.time, values, **styles[episode.policy])
        if not episode.completed:
            _cross(axes, episode.time[-1], np.clip(values[-1], *limits), styles[episode.policy])
        if values.min() < limits[0] or values.max() > limits[1]:
            outside.append(f"{episode.policy} up to {np.abs(values).max():.3g} {panel.unit}")
    if panel.log:
        axes.set_yscale("log")
    axes.set_ylim(limits)
    _note(axes, outside)


def _note(axes: Axes, outside: Sequence[str], side: Literal["left", "right"] = "right") -> None:
    """Write `outside`, lines on policies off the scale, in an upper corner of the axes; nothing if there are none."""
    if outside:
        text = "\n".join(["off the scale:", *outside])
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
        right = 0.99 if side == "right" else 0.01
        axes.text(right, 0.97, text, transform=axes.transAxes, ha=side, va="top", fontsize=8, bbox=box, zorder=6)


def _path_figure(title: str, episodes: Sequence[Rollout], styles: _Styles) -> Figure:
    """Return the figure of the reference r and each policy's tip path p, whose deviation p - r is drawn magnified."""
    figure = Figure(figsize=(6.0, 6.0))
    axes = figure.subplots()
    view = _view_of(_longest(episodes).tip_reference)
    reference = view.of(_longest(episodes).tip_reference)
    room = _ROOM * float(np.ptp(reference, axis=0).max()) or 1.0
    best = min(float(episode.tip_error.max()) for episode in _finished(episodes))
    factor = next((factor for factor in _MAGNIFICATIONS if factor * best <= room), 1)
    drawn = [view.of(e.tip_reference + factor * (e.tip - e.tip_reference)) for e in episodes]
    points = np.concatenate([reference, *drawn])
    if factor == 1:  # true paths are shown whole, however far from the curve they lead
        room = float(np.ptp(points, axis=0).max()) or 1.0
    low = np.maximum(points.min(axis=0), reference.min(axis=0) - room) - 0.1 * room
    high = np.minimum(points.max(axis=0), reference.max(axis=0) + room) + 0.1 * room
    outside = []
    for episode, path in zip(episodes, drawn, strict=True):
        axes.plot(path[:, 1], path[:, 0], **styles[episode.policy])
        if np.any((path < low) | (path > high)):
            outside.append(f"{episode.policy} up to {1e3 * episode.tip_error.max():.3g} mm")
        seen = path[np.all((low <= path) & (path <= high), axis=1)]
        if not episode.completed and len(seen):
            _cross(axes, seen[-1, 1], seen[-1, 0], styles[episode.policy])
    axes.plot(reference[:, 1], reference[:, 0], **_REFERENCE)
    axes.plot(*reference[0, ::-1], "o", color="black", markersize=5, zorder=4.0)
    third, last = len(reference) // 3, len(reference) - 1
    ahead = min(third + 10, last)
    (x, y), (x_ahead, y_ahead) = reference[third], reference[ahead]
    arrow = {"arrowstyle": "-|>", "color": "black", "mutation_scale": 15, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (y_ahead, x_ahead), (y, x), arrowprops=arrow)  # the direction of motion
    axes.set(xlim=(low[1], high[1]), ylim=(high[0], low[0]), aspect="equal")
    if view.upwards:
        axes.yaxis.set_major_formatter(lambda value, _: f"{-value:.4g}")
    _note(axes, outside, "left")  # the paper's circle begins at the right, where paths leave it
    vertical, side = view.labels
    axes.set(xlabel=side, ylabel=vertical, title=f"{title}, tip deviation × {factor}")
    _legend(figure, episodes, styles, [Line2D([], [], **_REFERENCE)])
    return figure


def _force_figure(title: str, episode: Rollout) -> Figure:
    """Return the figure of the external force, by component; it depends on the case, not on the policy."""
    figure = Figure(figsize=(6.6, 2.9))
    axes = figure.subplots()
    force, colors = episode.external_force.T, ("black", "#666666", "#AAAAAA")
    names = ("x, down", "y, to the side") if len(force) == _PLANE else ("x", "y", "z")
    for component, name, color, dashes in zip(force, names, colors, DASHES, strict=False):
        axes.plot(episode.time, component, color=color, linestyle=dashes, label=name)
    axes.set(xlabel="time [s]", ylabel="external force [N]", title=title)
    figure.legend(loc="outside lower center", ncols=len(names))
    return figure


def _legend(figure: Figure, episodes: Sequence[Rollout], styles: _Styles, others: Sequence[Line2D]) -> None:
    """Put a legend below the axes: `others`, every policy, and the meaning of the cross if there is one."""
    policies = dict.fromkeys(episode.policy for episode in episodes)
    handles = [*others, *(Line2D([], [], label=policy, **styles[policy]) for policy in policies)]
    if not all(episode.completed for episode in episodes):
        handles.append(Line2D([], [], label="ended early", color="#333333", marker="x", linestyle="none"))
    entry = 0.75 + 0.07 * max(len(str(handle.get_label())) for handle in handles)  # inches
    rows = -(-len(handles) // max(1, int(figure.get_figwidth() / entry)))
    figure.legend(handles=handles, loc="outside lower center", ncols=-(-len(handles) // rows))


def _cross(axes: Axes, right: float, up: float, style: Mapping[str, Any]) -> None:
    axes.plot(right, up, marker="x", linestyle="none", color=style["color"], clip_on=False, zorder=5.0)


def _longest(episodes: Sequence[Rollout]) -> Rollout:
    return max(episodes, key=lambda episode: len(episode.time))


def _finished(episodes: Sequence[Rollout]) -> Sequence[Rollout]:
    """Return the completed episodes, or all if no episode was completed."""
    return [episode for episode in episodes if episode.completed] or episodes


def _is_circle(points: np.ndarray) -> bool:
    """Return whether the points lie on a circle: |p|² = a·p + b with the same a, b for all of them, to 1e-6 m²."""
    terms, squares = np.column_stack([points, np.ones(len(points))]), np.sum(points**2, axis=1)
    return bool(np.abs(terms @ np.linalg.lstsq(terms, squares)[0] - squares).max() < 1e-6)
