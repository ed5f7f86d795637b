"""Tables of speeds, accuracy, exported C, identification, data sets and mutants."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from tables import Section, Table, made_with, number

__all__ = ["TOOLS"]


def _mutants(document: dict[str, Any]) -> str:
    """Return how many mutants the tests noticed."""
    found = Counter(row["outcome"] for row in document["rows"])
    left = f"{found['equivalent']} are equivalent, {found['lived']} were not noticed"
    return f"Of {found.total()} mutants the tests noticed {found['died']}; {left}."


def _of_identified(document: dict[str, Any]) -> str:
    arms = document["arms"]
    covered = [inside for one in arms for inside in one["covered"].values()]
    told = [ratio for one in arms for ratio in one["stiffness"]]
    return (
        f"On {len(arms)} simulated elastic arms {100.0 * np.mean(covered):.0f} % of {len(covered)} nominal 95 % "
        f"intervals cover the truth, and {len(told)} stiffnesses are told, {min(told):.2f} to {max(told):.2f} times "
        f"the true ones. `{document['command']}`"
    )


_FLOAT = "float: torque off, rms / max [N m]"


def _in_float(row: dict[str, Any]) -> str:
    return "{torque_rms:.2g} / {torque_max:.2g}".format(**row["float"]) if row["float"] else "refused"


def _costs(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each law, core and type of numbers."""
    pairs = [(row["law"], *pair) for row in document["rows"] for pair in row["cortex"].items()]
    return [{"law": law, "core": core, "differing": "-", **cost} for law, core, cost in pairs]


def _of_speed(bench: dict[str, Any], mujoco: dict[str, Any], soak: dict[str, Any]) -> str:
    """Return how the speeds were measured, the agreement with MuJoCo, and the results of the soak test."""
    method = bench["method"]
    missing = sorted({f"{row['name']}: {row['reason']}" for row in bench["rows"] if row["reason"]})
    errors = [mujoco[arm]["our_tip_error_um"] for arm in ("frictionless", "Coulomb")]
    finest = [min(row["tip_error_um"] for row in mujoco[arm]["mujoco"]) for arm in ("frictionless", "Coulomb")]
    parts = []
    for row in soak["rows"]:
        memory = [value for value in row["resident_MB"] if value is not None]
        growth = memory[-1] - memory[len(memory) // 4] if memory else float("nan")
        parts.append(
            f"{row['actions']}: {row['env_steps']:.3g} env-steps, {row['episodes']} episodes, {row['seconds']:.0f} s, "
            f"memory {growth:+.1f} MB over the last three quarters"
        )
    return (
        f"Medians of {method['rounds']} rounds of {method['seconds']:g} s in which everyone takes turns. "
        f"{' '.join(f'Not measured: {line}.' for line in missing)} A further lane takes "
        f"{bench['memory_per_lane']['bytes']:.0f} bytes. `{bench['command']}`; {made_with(bench)}\n\n"
        "Against the event integrator, without friction / with Coulomb friction alone, our tip error is "
        f"{errors[0]:.2f} / {errors[1]:.2f} µm, and MuJoCo's goes down to {finest[0]:.1g} / {finest[1]:.2g} µm as its "
        f"step shrinks (`{mujoco['command']}`; {made_with(mujoco).removesuffix('.')}). Soak, without a number that is "
        f"not finite: {'; '.join(parts)} (`python benchmarks/soak.py`; {made_with(soak).removesuffix('.')})."
    )


def _accuracy(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [{"case": case, "of": row} for case, row in document["max_tip_difference_um"].items()]


def _data(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [{"name": name, **row} for name, row in document["rows"].items()]


def _scores(learner: str) -> Any:
    form = "{score:.1f} / {tip_error_mm:.1f} / {completed} of {of}"
    return lambda row: ", ".join(form.format(**run) for run in row["learners"][learner])


def _learners(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a row for each learner: the medians of its seeds, and their lists of scores."""
    rows = []
    for learner, runs in document["runs"].items():
        cases = np.median([run["cases_mm"] for run in runs], axis=0)
        row: dict[str, Any] = {name: np.median([run[name] for run in runs]) for name in ("steps", "seconds")}
        row |= {name: sorted(run[name] for run in runs) for name in ("N", "q90_mm")}
        rows.append({"learner": learner, "cases": " / ".join(f"{value:.3g}" for value in cases), **row})
    return rows


def _spread(name: str, form: str) -> Callable[[dict[str, Any]], str]:
    """Return the cell that lists the numbers of the seeds."""
    return lambda row: ", ".join(form.format(value) for value in row[name])


TOOLS = {
    "exported-c": Section(
        "exported_c",
        (
            Table(
                {
                    **{"law": "{law}", "core": "{core}", "flash [bytes]": "{flash:,}", "stack [bytes]": "{stack:,}"},
                    **{"state [bytes]": "{state:,}", "instructions, mean": "{mean:,}", "largest": "{largest:,}"},
                    **{"calls": "{calls:,}", "torques that differ": "{differing}"},
                },
                _costs,
            ),
            Table({"law": "{law}", "ticks": "{ticks:,}", "numbers that differ": "{differing}", _FLOAT: _in_float}),
        ),
        lambda document: f"`{document['command']}`; {', '.join(document['compilers'].values())}",
    ),
    "identification": Section(
        "identification",
        Table(
            {
                "design": "{design}",
                "logs": "{logs}",
                "published model, joints 1 / 2 [mrad]": "{published[0]:.0f} / {published[1]:.0f}",
                "rigid arm, held out": "{ours[rigid][0]:.0f} / {ours[rigid][1]:.0f}",
                "with exact stick": "{ours[sticking][0]:.0f} / {ours[sticking][1]:.0f}",
                "elastic": "{ours[elastic][0]:.0f} / {ours[elastic][1]:.0f}",
            },
            lambda document: document["recorded"],
        ),
        _of_identified,
    ),
    "mutants": Section("mutants", _mutants),
    "learning-curves": Section(
        "learning_curves",
        Table(
            {
                "learner": "{learner}",
                "steps": "{steps:,.0f}",
                "time of one core [s]": "{seconds:.0f}",
                "N of each seed": _spread("N", "{:.1f}"),
                "90 % quantile of the rms [mm]": _spread("q90_mm", "{:.3g}"),
                "rms in Cases 1, 2, 3, median [mm]": "{cases}",
            },
            _learners,
        ),
        "N and the quantile on the held-out set of version {version}. `{command}`",
    ),
    "dataset-scores": Section(
        "dataset_scores",
        Table(
            lambda document: {
                "data set": "`{name}`",
                "steps": "{data[steps]:,}",
                "N of the data": "{data[score]:.1f}",
                **{
                    f"{learner}: N / mean tip error [mm] / episodes completed": _scores(learner)
                    for learner in next(iter(document["rows"].values()))["learners"]
                },
            },
            _data,
        ),
        "`{command}`: {seconds:g} s of processor time of learning each, one thread",
    ),
    "speed": Section(
        ("bench", "mujoco_arm", "soak"),
        (
            Table(
                {
                    "": "{name}",
                    "lanes": "{lanes}",
                    "threads": "{threads}",
                    "numbers": "{dtype}",
                    "thousand steps/s": lambda row: (
                        "not measured" if row["steps_per_s"] is None else f"{1e-3 * row['steps_per_s']['median']:.0f}"
                    ),
                    "tip error [µm]": number("tip_error_um", ".2g", ""),
                    "times as fast as": lambda row: ", ".join(
                        f"{peer} {ratio['median']:.3g}" for peer, ratio in row["ratios"].items()
                    ),
                }
            ),
            _of_speed,
        ),
        None,
    ),
    "accuracy": Section(
        "accuracy",
        Table(
            lambda document: {
                "case": "{case}",
                **{
                    f"h = {1e3 * float(h):g} ms [µm]": f"{{of[{h}]:.3f}}"
                    for h in next(iter(document["max_tip_difference_um"].values()))
                },
            },
            _accuracy,
        ),
        "The default is h = 0.2 ms. `{command}`",
    ),
}
"""Sections by name."""
