"""The tables of learning: gradients through the arm beside PPO, and what the data sets teach."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

__all__ = ["dataset_table", "gradients_table"]


def gradients_table(document: dict[str, Any]) -> str:
    """Return the tip error of every seed, and how it was measured."""
    seeds = [run["seed"] for run in next(iter(document["runs"].values()))]
    rows = [
        [
            name,
            *(f"{run['tip_error_mm']:.2f}" for run in runs),
            f"{sum(run['steps'] for run in runs) / len(runs):,.0f}",
            " / ".join(f"{run['cpu_s'] - document['seconds']:.0f}" for run in runs),
        ]
        for name, runs in document["runs"].items()
    ]
    headings = [
        "mean tip error [mm]",
        *(f"seed {seed}" for seed in seeds),
        "decisions",
        "processor time beside learning [s]",
    ]
    return (
        f"{table(headings, rows)}\n\n`{document['command']}`: {document['seconds']:g} s of processor time of learning "
        f"each, one thread, in turns; {made_with(document)}"
    )


def dataset_table(document: dict[str, Any]) -> str:
    """Return the scores of the data and of each learner, and how they were measured."""
    learners = list(next(iter(document["rows"].values()))["learners"])
    headings = ["data set", "steps", "data", *(f"{name}: score / tip error [mm] / to the end" for name in learners)]
    rows = []
    for name, row in document["rows"].items():
        data = row["data"]
        found = [", ".join(map(_shown, runs)) for runs in row["learners"].values()]
        rows.append([f"`{name}`", f"{data['steps']:,}", f"{data['score']:.1f}", *found])
    return (
        f"{table(headings, rows)}\n\n`{document['command']}`: {document['seconds']:g} s of processor time of learning "
        f"each, one thread; {made_with(document)}"
    )


def _shown(run: dict[str, Any]) -> str:
    return f"{run['score']:.1f} / {run['tip_error_mm']:.1f} / {run['completed']} of {run['of']}"
