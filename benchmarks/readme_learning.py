"""The tables of learning: its speed, gradients through the arm beside PPO, and what the data sets teach."""

from __future__ import annotations

from typing import Any

from readme_markdown import made_with, table

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


def observer_tables(document: dict[str, Any]) -> str:
    """Return what PPO beside the elastic observer reached, what its settings are worth, and how it was measured."""
    rows = [_measured(name if " " in name else f"`{name}`", row) for name, row in document["references"].items()]
    titles = {
        "observer": "`observer`, {}",
        "longer": "`observer`, {}",
        "knobs": "{}",
        "robust": "`robust`: {}",
        "ppo-robust": "`ppo-robust`, {}",
    }
    parts = []
    for group, title in titles.items():
        runs = document["runs"][group]
        found = [_measured(title.format(name), run) for name, run in runs.items()]
        steps = sorted({run["steps"] for run in runs.values()})
        others = {made_with(run["provenance"]) for run in runs.values() if "provenance" in run}
        known = f"**{group}**, {', '.join(f'{count / 1e6:g}' for count in steps)} million steps"
        parts.append(f"{known}\n\n{table(_HEADINGS, [*(rows if group == 'observer' else []), *found])}")
        parts.extend(f"These: {words}" for words in sorted(others - {made_with(document)}))
    return "\n\n".join(
        [
            *parts,
            *(_curves(document["runs"][group]) for group in ("observer", "longer")),
            f"`{document['command']}`, one thread; {made_with(document)}",
        ]
    )


def _curves(runs: dict[str, dict[str, Any]]) -> str:
    """Return the errors of a group's seeds over the steps of the training."""
    rows = [
        [name, *(f"{row['machining']:.2f} / {row['payload']:.2f}" for row in run["curve"])]
        for name, run in runs.items()
    ]
    steps = [f"{row['steps'] / 1e6:.1f}" for row in next(iter(runs.values()))["curve"]]
    return table(["rms [mm] in Case 2 / 3 after million steps", *steps], rows)


_HEADINGS = (
    "policy",
    "development plants: median / mean / 99 % [mm]",
    "ended early",
    "rms, Cases 1 / 2 / 3 [mm]",
    "rms half a sample late",
    "torque rate [N m/ms]",
    "torque rate half a sample late",
    "spectral radius at rest, without delay / half a sample / one sample late",
    "processor time [s]",
)


def _measured(name: str, row: dict[str, Any]) -> list[str]:
    seen, cases, late = row["development"], row["cases"].values(), row.get("late", {}).values()
    radii = ["-" if radius is None else f"{radius:.3f}" for radius in row["radius"].values()]
    return [
        name,
        f"{seen['median_mm']:.2f} / {seen['mean_mm']:.2f} / {seen['p99_mm']:.1f}",
        str(seen["lost"]),
        " / ".join(f"{case['rms_mm']:.2g}" for case in cases),
        " / ".join(f"{case['rms_mm']:.2g}" for case in late),
        " / ".join(f"{case['torque_rate']:.2f}" for case in cases),
        " / ".join(f"{case['torque_rate']:.3g}" for case in late),
        " / ".join(radii),
        f"{row['cpu_time_s']:.0f}" if "cpu_time_s" in row else "",
    ]
