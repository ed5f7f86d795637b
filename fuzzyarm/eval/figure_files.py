"""The style of Matplotlib's figures, and a figure as a PNG and an SVG file."""

from __future__ import annotations

import io
from contextlib import AbstractContextManager
from pathlib import Path

import matplotlib.style
from matplotlib import rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from fuzzyarm.common.files import write_atomically

__all__ = ["MARKERS", "figure_style", "write_figure"]

MARKERS = "os^Dv"
"""Of the curves of a figure, one after the other."""


def figure_style() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn: Matplotlib's defaults and ``fuzzyarm.mplstyle``."""
    return matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True)


def write_figure(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write ``<name>.png`` and ``<name>.svg``, each atomically, and return their paths.

    The figure is laid out once and drawn once for each format: `Figure.savefig` would draw it twice.
    """
    layout = figure.get_layout_engine()
    if layout is not None and figure.axes:
        layout.execute(figure)
    figure.set_layout_engine("none")
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    pixels, shapes = io.BytesIO(), io.BytesIO()
    figure.set_dpi(float(rcParams["savefig.dpi"]))
    FigureCanvasAgg(figure).print_png(pixels)  # type: ignore[no-untyped-call]
    FigureCanvasSVG(figure).print_svg(shapes, metadata={"Date": None})  # type: ignore[no-untyped-call]
    for path, content in zip(paths, (pixels, shapes), strict=True):
        write_atomically(path, content.getvalue())
    return paths
