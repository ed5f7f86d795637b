"""The tables of learning: its speed, gradients through the arm beside PPO, and what the data sets teach."""

from __future__ import annotations

import statistics
from typing import Any

from readme_markdown import made_with, table

from fuzzyarm.eval.episodes.metrics import millimetres

__all__ = ["dataset_table", "gradients_table", "observer_tables", "training_speed_table"]


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
    shown = "score / mean tip error [mm] / episodes completed"
    headings = ["data set", "steps", "data", *(f"{name}: {shown}" for name in learners)]
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


def training_speed_table(document: dict[str, Any]) -> str:
    """Return the environment steps a second of each trainer beside the library's, and how they were measured."""
    headings = ["", "lanes", "steps/s", "the library's", "ratio: median, quartiles", "an evaluation [s]", "every steps"]
    rows = [
        [
            f"`fuzzyarm train {row['algorithm']}`",
            str(row["lanes"]),
            f"{row['steps_per_s']['median']:,.0f}",
            f"{row['library_steps_per_s']['median']:,.0f}",
            "{median:.2f}, {q1:.2f} to {q3:.2f}".format(**row["ratio"]),
            f"{row['pause_s']:.1f}",
            f"{row['evaluation_interval']:,}",
        ]
        for row in document["rows"]
    ]
    libraries = ", ".join(
        f"{name} {document['versions'][name]}" for name in ("torch", "stable-baselines3", "sb3-contrib")
    )
    return (
        f"{table(headings, rows)}\n\nMedians of {document['rounds']} rounds of {document['seconds']:g} s or one "
        f"update, in turns, of one thread each. `{document['command']}`; {libraries}; {made_with(document)}"
    )


GROUPS = ("observer", "told", "longer", "knobs", "robust", "smooth")


def observer_tables(document: dict[str, Any]) -> str:
    """Return what PPO beside the elastic observer reached, what its settings are worth, and how it was measured."""
    rows = [_measured(f"`{name}`", [row]) for name, row in document["references"].items()]
    parts = []
    for group in GROUPS:
        runs = document["runs"][group]
        settings = list(dict.fromkeys(run["setting"] for run in runs))
        if len(settings) == 1:
            found = [_measured(f"`observer`, seed {run['seed']}", [run]) for run in runs]
        else:
            found = [_measured(name, [run for run in runs if run["setting"] == name]) for name in settings]
        steps = sorted({run["steps"] for run in runs})
        title = f"**{group}**, {', '.join(f'{count / 1e6:g}' for count in steps)} million steps"
        if settings != ["as is"] and len(settings) == 1:
            title += f", {settings[0]}"
        if len(settings) > 1:
            title += f", medians and ranges of seeds {', '.join(map(str, sorted({run['seed'] for run in runs})))}"
        parts.append(f"{title}\n\n{table(_HEADINGS, [*(rows if group == 'observer' else []), *found])}")
    return "\n\n".join(
        [
            *parts,
            *(_curves(document["runs"][group]) for group in ("observer", "longer")),
            f"`{document['command']}`, one thread; {made_with(document)}",
        ]
    )


def _curves(runs: list[dict[str, Any]]) -> str:
    """Return the errors of a group's seeds over the steps of the training."""
    rows = [
        [f"seed {run['seed']}", *(f"{row['machining']:.2f} / {row['payload']:.2f}" for row in run["curve"])]
        for run in runs
    ]
    steps = [f"{row['steps'] / 1e6:.1f}" for row in runs[0]["curve"]]
    return table(["rms [mm] in Case 2 / 3 after million steps", *steps], rows)


_HEADINGS = (
    "policy",
    "development plants: median / mean / 99 % [mm]",
    "ended early there",
    "torque rate there [N m/ms]",
    "rms, Cases 1 / 2 / 3 [mm]",
    "rms half a sample late",
    "torque rate [N m/ms]",
    "torque rate half a sample late",
    "spectral radius at rest, without delay / half a sample / one sample late",
    "processor time [s]",
)


def _measured(name: str, runs: list[dict[str, Any]]) -> list[str]:
    """Return a row: the values of one run, or medians and ranges of several."""
    seen = [run["development"] for run in runs]
    return [
        name,
        " / ".join(
            _range([row[key] for row in seen], form)
            for key, form in (("median_mm", ".2f"), ("mean_mm", ".2f"), ("p99_mm", ".1f"))
        ),
        _range([row["lost"] for row in seen], "g"),
        _range([row.get("torque_rate") for row in seen], ".2f"),
        *(_in_cases(runs, at, "rms_mm", "mm") for at in ("cases", "late")),
        *(_in_cases(runs, at, "torque_rate", form) for at, form in (("cases", ".2f"), ("late", ".3g"))),
        " / ".join(_range([run["radius"][delay] for run in runs], ".3f") for delay in runs[0]["radius"]),
        _range([run.get("cpu_time_s") for run in runs], ".0f"),
    ]


def _in_cases(runs: list[dict[str, Any]], at: str, key: str, form: str) -> str:
    return " / ".join(_range([run[at][case][key] for run in runs], form) for case in runs[0].get(at, {}))


def _range(values: list[float | None], form: str) -> str:
    """Return one value, or median and range; a dash if a value is missing."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return "-"
    if len(known) == 1:
        return _formatted(known[0], form)
    middle, least, largest = (_formatted(value, form) for value in (statistics.median(known), min(known), max(known)))
    return f"{middle} ({least} to {largest})"


def _formatted(value: float, form: str) -> str:
    """Return a number in a format, "mm" for a length."""
    return millimetres(value, "{:.2g}".format) if form == "mm" else format(value, form)
