"""Every figure of the documentation: from which stored results it is drawn, and which policies are run for it.

The results are in `results`. An episode or a few, which takes seconds, are run again; that they have the errors of the
stored table is checked before they are drawn.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import io
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.style
from learned_comparison import MODEL_BASED
from matplotlib.figure import Figure
from measuring import stored

from fuzzyarm.eval.evaluation.run import Evaluation, EvaluationConfig, evaluate, write_results
from fuzzyarm.policies import ANY_ROBOT, COMPARED

__all__ = ["FIGURES", "Picture"]

ROOT = Path(__file__).resolve().parents[1]
MOVING = ("fuzzy-4", "learned-observer", "adaptive-observer")
"""Policies of the moving picture, from left to right."""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure of the documentation.

    Attributes:
        draw: returns the content of the file; None for the figure of a finished study, which is kept.
        results: names of the stored results that it shows.
        policies: names of the shipped policies that are run to draw it.
        browser: whether it is a picture of a page in Chromium.
    """

    draw: Callable[[], bytes] | None = None
    results: tuple[str, ...] = ()
    policies: tuple[str, ...] = ()
    browser: bool = False


def png(draw: Callable[[], Figure]) -> bytes:
    """Return the figure that `draw` makes as PNG, drawn in the project's style."""
    content = io.BytesIO()
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        draw().savefig(content, format="png")
    return content.getvalue()


def _from_result(name: str, module: str | None = None, function: str = "draw") -> Picture:
    """Return a figure that a function of a module, by default of the result's name, draws from a stored result."""

    def draw() -> bytes:
        drawing: Callable[[dict[str, Any]], Figure] = getattr(importlib.import_module(module or name), function)
        return png(lambda: drawing(stored(name)))

    return Picture(draw, (name,))


def _animation() -> bytes:
    from animation import gif

    return gif(MOVING)


def _arm(*arguments: str) -> bytes:
    """Return what the example draws with these arguments behind the file's name."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.png"
        subprocess.run([sys.executable, str(ROOT / "examples" / "picture.py"), str(file), *arguments], check=True)
        return file.read_bytes()


@functools.cache
def _evaluation() -> Evaluation:
    document = stored("evaluate")
    return _repeated(EvaluationConfig(), document["results"], document["date"])


def _on_robot() -> Evaluation:
    document = stored("robot_comparison_ur5")
    return _repeated(EvaluationConfig(ANY_ROBOT, robot="ur5"), document["cases"], document["date"])


def _repeated(config: EvaluationConfig, rows: Sequence[Mapping[str, Any]], date: str) -> Evaluation:
    """Return an evaluation run again, dated as the stored one; ValueError if an error is not that of its rows."""
    fresh, then = evaluate(config), {(row["policy"], row["case"]): row for row in rows}
    for row in fresh.rows:
        for key in ("tip_error_rms_mm", "tip_error_max_mm"):
            before = then[row["policy"], row["case"]][key]
            if not math.isclose(row[key], before, rel_tol=1e-4, abs_tol=1e-9):
                where = f"{row['policy']} in {row['case']}"
                raise ValueError(f"{key} of {where} is {row[key]:g}, the stored result has {before:g}: measure again")
    return dataclasses.replace(fresh, made_with=fresh.made_with | {"date": date})


def _overview() -> bytes:
    from fuzzyarm.eval.evaluation.figures import draw_figures

    return png(lambda: draw_figures(_evaluation().rollouts)["overview"])


def _page(evaluation: Evaluation) -> bytes:
    """Return the report of an evaluation as it opens in Chromium, in the case of the machining force."""
    from fuzzyarm.eval.episodes.rollout_file import write_rollouts
    from fuzzyarm.eval.report.page import write_report

    sys.path.append(str(ROOT / "tests"))
    from support.browser import chromium

    with tempfile.TemporaryDirectory() as name, chromium() as tab:
        folder = Path(name)
        write_results(evaluation, folder)
        write_rollouts(evaluation.rollouts, folder)
        write_report(folder, folder / "report.html")
        tab.open(folder / "report.html", width=1400, height=900)
        tab.press("2")  # the second case
        tab.screenshot(folder / "report.png")
        return (folder / "report.png").read_bytes()


def _paper() -> bytes:
    from fuzzyarm.eval.paper.evidence import gather
    from fuzzyarm.eval.paper.figures import draw_figures

    return png(lambda: draw_figures(gather())[4])


FIGURES: dict[str, Picture] = {
    "animation.gif": Picture(_animation, policies=MOVING),
    "arm.png": Picture(_arm, policies=("fuzzy-4",)),
    "robot.png": Picture(functools.partial(_arm, "ur5", "computed-torque"), policies=("computed-torque",)),
    "overview.png": Picture(_overview, ("evaluate",), COMPARED),
    "report.png": Picture(lambda: _page(_evaluation()), ("evaluate",), COMPARED, browser=True),
    "robot_report.png": Picture(lambda: _page(_on_robot()), ("robot_comparison_ur5",), ANY_ROBOT, browser=True),
    "comparison.png": _from_result("comparison", "comparison_figure", "draw_comparison"),
    "learned.png": Picture(results=("learned_comparison",), policies=MODEL_BASED),
    "sweep.png": _from_result("sweep", "sweep_figure"),
    "adaptive_passes.png": _from_result("adaptive_cases"),
    "adaptive_front.png": Picture(results=("adaptive_margins",)),
    "estimate_front.png": Picture(results=("estimate_front",)),
    "learning.png": _from_result("learning_curves"),
    "complexity.png": Picture(results=("complexity",)),
    "tip_bound.png": _from_result("tip_bound"),
    "throughput.png": _from_result("bench", "fuzzyarm.eval.bench.speed_table", "draw_throughput"),
    "paper-figure-04.png": Picture(_paper, policies=("fuzzy-32", "fuzzy-4")),
    "paper_feedforward.png": Picture(results=("paper_feedforward",)),
}
"""By file name in `docs/figures`."""
