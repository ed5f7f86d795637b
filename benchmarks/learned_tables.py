"""The two tables of `learned_comparison.py`."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from learned_seeds import MEASURED_TIMES
from learned_tasks import LOST, MEASURES

from fuzzyarm.common.console import Sheet

if TYPE_CHECKING:
    from rich.console import Console


def error_cells(document: Mapping[str, Any]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return the headings, and for each row the title of its task and its cells as text."""
    titles = {task["name"]: task["title"] for task in document["tasks"]}
    rows = []
    for row in document["rows"]:
        errors = ["-" if row[key] is None else _spread(*row[key].values()) for key in MEASURES]
        rows.append((titles[row["task"]], [row["policy"], *errors, f"{row['failed']} of {row['episodes']}"]))
    return ["policy", *MEASURES.values(), "failed"], rows


def training_cells(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return headings and cells of the trainings; a dash stands for what is missing for one of the seeds."""
    rows = []
    for one in document["learned"]:
        runs = one["runs"]
        times = [_median([run[name] for run in runs], "{:.0f}") for name in MEASURED_TIMES]
        ratio = _median([run["plateau"] for run in runs], "{:.2f}")
        seeds = ", ".join(str(run["seed"]) for run in runs)
        steps = ", ".join(f"{count:,}" for count in sorted({run["steps"] for run in runs}))
        rows.append([one["name"], seeds, str(one["median_seed"]), steps, *times, ratio])
    headings = ["learned policy", "seeds", "median seed", "steps of a seed", *MEASURED_TIMES.values()]
    return [*headings, "last tenth / tenth before"], rows


def print_tables(document: Mapping[str, Any], console: Console) -> None:
    """Print both tables, each with an explanation below it."""
    headings, rows = error_cells(document)
    Sheet(headings, [cells for _, cells in rows], groups=[title for title, _ in rows]).print(console)
    console.print(
        "\nTip error, interquartile mean over the seeds that did not fail (bootstrap interval of 95 %); failed: ended "
        f"early, or the tip was ever more than {LOST:g} mm off. Where a heading does not say otherwise, on the paper's "
        "circle in 1.5 s.\n",
        highlight=False,
        soft_wrap=True,
    )
    Sheet(*training_cells(document)).print(console)
    console.print(
        "\nTimes and ratios: median over the seeds (range). Last tenth / tenth before: of a training, the mean rms in "
        "the cases by which it is judged.",
        highlight=False,
        soft_wrap=True,
    )


def _median(values: Sequence[float | None], form: str) -> str:
    """Return the median and the range; a dash if a value is missing."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return "-"
    return "{} ({} to {})".format(*map(form.format, (statistics.median(known), min(known), max(known))))


def _spread(mean: float, low: float | None, high: float | None) -> str:
    """Return a mean with its interval, if there is one."""
    interval = "" if low is None or high is None else f" ({three_digits(low)} to {three_digits(high)})"
    return three_digits(mean) + interval


def three_digits(value: float) -> str:
    """Return a number with three significant digits, or as a whole number from 100 on."""
    return f"{value:#.3g}" if value < 99.95 else f"{value:.0f}"
