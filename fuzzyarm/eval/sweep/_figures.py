"""Figures of a sweep: the distribution of the tip error, and its heat map over two quantities for each policy."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fuzzyarm.eval._figure_files import MARKERS, figure_style, write_all
from fuzzyarm.eval.evaluation.figures import policy_styles
from fuzzyarm.eval.sweep._distributions import column_label
from fuzzyarm.eval.sweep._episodes import SweepResults
from fuzzyarm.eval.sweep.config import SweepConfig

__all__ = ["write_sweep_figures"]

# Ordered by lightness, to be read with any colour vision and in grey: dark is bad. Red: more than half ended early.
_COLORS = colormaps["viridis_r"].with_extremes(over="#CC3311")
_FINE, _COARSE = 1.0 / 40.0, 5.0  # ends of the colour scale, as shares of the bound of success
_LEFT = 1.0 / 200.0  # left end of the curves, as a share of the bound


class _Cells(NamedTuple):
    """The plane of a sweep's heat maps, divided into cells (across, up)."""

    edges: tuple[np.ndarray, ...]  # of the cells along each column of the plane, (across + 1,) and (up + 1,)
    places: np.ndarray  # (n, 2) the cell of each plant, as its indices across and up

    @classmethod
    def of(cls, config: SweepConfig, plants: np.ndarray) -> _Cells:
        """Divide the plane of a sweep into the cells of its grid or, for drawn plants, bins of about 12 plants each."""
        bins = int(np.clip(np.sqrt(len(plants) / 12), 2, 20))
        edges, places = [], []
        for column in config.plane:
            values = plants[column]
            edge = np.linspace(values.min(), values.max(), bins + 1)
            if config.grid or column == "delay":
                centers = np.unique(values)
                middles = 0.5 * (centers[1:] + centers[:-1])
                ends = 2.0 * centers[[0, -1]] - middles[[0, -1]]
                edge = np.concatenate([ends[:1], middles, ends[1:]])
            edges.append(edge)
            places.append(np.clip(np.searchsorted(edge, values, side="right") - 1, 0, len(edge) - 2))
        return cls(tuple(edges), np.stack(places, axis=1))

    def medians(self, errors: np.ndarray) -> np.ndarray:
        """Return the median of `errors` (plants,) [mm] in each cell, (up, across).

        The median is inf if more than half of the episodes ended early (error inf), and nan if the cell is empty.
        """
        across, up = (len(edges) - 1 for edges in self.edges)
        flat, order = self.places[:, 1] * across + self.places[:, 0], np.argsort(errors, kind="stable")
        found = np.full(up * across, np.nan)
        for cell in np.unique(flat):
            members = errors[order][flat[order] == cell]
            found[cell] = members[(len(members) - 1) // 2]
        return found.reshape(up, across)


def write_sweep_figures(
    config: SweepConfig,
    results: SweepResults,
    rows: Sequence[dict[str, Any]],
    folder: Path,
    progress: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write ``spread`` and, where two quantities vary, ``map-<policy>`` as PNG and SVG files; return their paths.

    `rows` are those of the summary; `progress` is called after each figure.
    """
    with figure_style():
        figures = _draw_sweep(config, results, rows)
    # Windows allows no colon in a file's name; the label of the user's own code has one.
    return write_all({name.replace(":", "-"): figure for name, figure in figures.items()}, folder, progress)


def _draw_sweep(config: SweepConfig, results: SweepResults, rows: Sequence[dict[str, Any]]) -> dict[str, Figure]:
    """Return the figures of `write_sweep_figures` by name."""
    errors = results.errors
    figures = {"spread": _spread(config, errors, rows)}
    if len(config.plane) == 2:
        cells = _Cells.of(config, results.plants)
        maps = np.array([[cells.medians(one) for one in by_case] for by_case in errors])
        shown = np.clip(maps[np.isfinite(maps)], _FINE * config.bound, _COARSE * config.bound)
        low, high = (shown.min(), shown.max()) if len(shown) else (_FINE, _COARSE)
        norm = LogNorm(low, max(high, 1.01 * low))
        for policy, by_case in zip(config.labels, maps, strict=True):
            figures[f"map-{policy}"] = _map(config, policy, cells, by_case, norm)
    return figures


def _spread(config: SweepConfig, errors: np.ndarray, rows: Sequence[dict[str, Any]]) -> Figure:
    """Return a figure of the distributions of `errors` (policies, cases, plants) [mm].

    Bars are the confidence intervals of the quantiles in the summary's `rows`.
    """
    figure = Figure(figsize=(1.0 + 3.1 * max(2, len(config.cases)), 3.7))
    panels = figure.subplots(1, len(config.cases), sharey=True, sharex=True, squeeze=False)[0]
    share = 100.0 * np.arange(1, errors.shape[-1] + 1) / errors.shape[-1]
    quantiles = {(row["policy"], row["case"]): row["max_mm"] for row in rows}
    bar = {"markersize": 5, "markeredgewidth": 1.0, "elinewidth": 2.2, "capsize": 3.5, "zorder": 4.0}
    handles: list[Line2D] = []
    looks = zip(policy_styles(config.labels).items(), itertools.cycle(MARKERS), strict=False)
    for by_case, ((policy, style), marker) in zip(errors, looks, strict=True):
        for axes, case, error in zip(panels, config.cases, by_case, strict=True):
            axes.step(np.sort(error), share, where="post", **style)
            for level, found in quantiles[policy, case].items():
                value, low, high = found["value"], found["low"], found["high"]
                if None not in (value, low, high):
                    reach = [[value - low], [high - value]]
                    axes.errorbar(value, 100.0 * float(level), xerr=reach, color=style["color"], marker=marker, **bar)
        handles.append(Line2D([], [], **style, marker=marker, markersize=5, label=policy))
    bound: dict[str, Any] = {"color": "#333333", "linewidth": 0.9}
    for axes, case in zip(panels, config.cases, strict=True):
        axes.axvline(config.bound, **bound, zorder=1.5)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set(title=config.titles[case], xlabel="largest tip error [mm]", ylim=(0.0, 102.0))
    panels[0].set_ylabel("share of plants at or below [%]")
    panels[0].set_xlim(left=max(_LEFT * config.bound, panels[0].get_xlim()[0]))
    handles.append(Line2D([], [], **bound, label=f"bound of success, {config.bound:g} mm"))
    title = "bars: 95 % intervals at 50, 90 and 99 %; none where episodes that ended early are among them"
    figure.legend(handles=handles, loc="outside lower center", ncols=3, title=title)
    return figure


def _map(config: SweepConfig, policy: str, cells: _Cells, medians: np.ndarray, norm: LogNorm) -> Figure:
    """Return the heat map of a policy's `medians` [mm], one panel per case; all policies share the colour scale."""
    figure = Figure(figsize=(1.6 + 2.9 * max(2, len(config.cases)), 3.9))
    panels = figure.subplots(1, len(config.cases), sharey=True, squeeze=False)[0]
    together = config.joints if config.grid else None
    across, up = (column_label(column, together=together).replace(" [", "\n[") for column in config.plane)
    assert norm.vmax is not None
    for axes, case, errors in zip(panels, config.cases, medians, strict=True):
        within = np.where(np.isinf(errors), 2.0 * norm.vmax, np.minimum(errors, norm.vmax))  # above it: ended early
        mesh = axes.pcolormesh(*cells.edges, within, norm=norm, cmap=_COLORS)
        axes.set(title=config.titles[case], xlabel=across)
        axes.grid(False)
    panels[0].set_ylabel(up)
    bar = figure.colorbar(mesh, ax=panels, pad=0.02, extend="max")
    what = "largest tip error [mm]" + (", median of the plants in a cell" if config.plants > 1 else "")
    bar.set_label(f"{what}\n(red: {'more than half ' if config.plants > 1 else ''}ended early)")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    bar.ax.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")
    figure.suptitle(policy, x=0.01, ha="left", fontsize=10.5)
    return figure
