"""The residual plot: measured less simulated, for each motor, with the band in which 95 % of white noise lies."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from fuzzyarm.common.files import write_atomically
from fuzzyarm.identification.fit import DEVIATIONS
from fuzzyarm.identification.result import Identified

__all__ = ["draw_residuals", "write_residuals"]

_ROWS = (("angle", "µrad", 1e6), ("velocity", "mrad/s", 1e3))
_DRAWN = 4000  # points a curve


def draw_residuals(found: Identified) -> Figure:
    """Return the figure: a row for angles and, if they were measured, one for velocities; a column for each joint."""
    residual, noise = found.fit.residual, found.fit.noise
    rows = _ROWS[: residual.shape[1] // 2]
    every = max(1, len(residual) // _DRAWN)
    time = np.arange(len(residual)) * found.period
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        figure = Figure(figsize=(9.0, 1.2 + 2.1 * len(rows)))
        grid = figure.subplots(len(rows), 2, sharex=True, squeeze=False)
        for row, (name, unit, factor) in enumerate(rows):
            for joint, axes in enumerate(grid[row]):
                channel = 2 * row + joint
                rms = factor * noise[channel]
                axes.plot(time[::every], factor * residual[::every, channel], linewidth=0.5)
                for side in (-DEVIATIONS, DEVIATIONS):
                    axes.axhline(side * rms, color="black", linewidth=0.9)
                axes.set_title(f"{name} of motor {joint + 1}, {rms:.3g} {unit} rms")
                axes.set_ylabel(f"residual [{unit}]")
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        figure.suptitle("Measured less simulated; between the lines: 95 % of white noise")
    return figure


def write_residuals(found: Identified, path: Path) -> None:
    """Write the figure to a PNG file.

    Raises:
        OSError: the file cannot be written.
    """
    content = io.BytesIO()
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        draw_residuals(found).savefig(content, format="png")
    write_atomically(path, content.getvalue())
