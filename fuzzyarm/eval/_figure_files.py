"""The Matplotlib figure style, and saving of figures as PNG and SVG files."""

import io
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path

import matplotlib.style
from matplotlib import rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from fuzzyarm.common.files import write_atomically

__all__ = ["MARKERS", "figure_style", "write_all"]

MARKERS = "os^Dv"
"""The markers of a figure's curves, in this order."""


def figure_style() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn: Matplotlib's defaults and ``fuzzyarm.mplstyle``."""
    return matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True)


def write_all(
    figures: Mapping[str, Figure], folder: Path, progress: Callable[[], None] = lambda: None, *, svg: bool = True
) -> list[Path]:
    """Write ``<name>.png`` and, if `svg`, ``<name>.svg`` of figures by name, each atomically; return their paths.

    A figure is laid out once and then drawn once for each format; `Figure.savefig` would draw twice for each format.
    """
    paths = []
    with figure_style():
        for name, figure in figures.items():
            layout = figure.get_layout_engine()
            if layout is not None and figure.axes:
                layout.execute(figure)
            figure.set_layout_engine("none")
            figure.set_dpi(float(rcParams["savefig.dpi"]))
            contents = {"png": io.BytesIO()}
            FigureCanvasAgg(figure).print_png(contents["png"])  # type: ignore[no-untyped-call]
            if svg:
                contents["svg"] = io.BytesIO()
                canvas = FigureCanvasSVG(figure)
                canvas.print_svg(contents["svg"], metadata={"Date": None})  # type: ignore[no-untyped-call]
            for kind, content in contents.items():
                paths.append(folder / f"{name}.{kind}")
                write_atomically(paths[-1], content.getvalue())
            progress()
    return paths
