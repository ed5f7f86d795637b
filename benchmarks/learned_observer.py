"""Seeds of `learned-observer`: tip errors, margins, and held-out plants beside the model-based observers.

    for seed in 0 1 2 3 4; do fuzzyarm train estimate --seed $seed --out runs/estimate-$seed; done
    python benchmarks/learned_observer.py runs/estimate-*/policy [--json FILE]

    for seed in 0 1 2; do fuzzyarm train estimate --robot planar-3r --seed $seed --out runs/planar-3r-$seed; done
    python benchmarks/learned_observer.py --robot planar-3r runs/planar-3r-*/policy --plants 200 [--json FILE]

Of every seed: tip errors in the paper's three cases, and the margins of `fuzzyarm margins`. The median seed has the
median rms error of Cases 2 and 3 together, among the seeds whose loop is stable in every condition if there are any.
Of the median seed, `elastic-observer` and `adaptive-observer`: largest tip errors over the plants of the sweeps'
distributions `loads` and `all`, which no training has seen, each plant under all policies; and the share of plants on
which a policy errs less than another, with a Wilson interval of 95 %. A robot is measured with its own cases, along its
default course, beside the law with a network that is silent.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import PAPER, AnyArm, argument_of, chosen_arm, equations_of
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle, EstimateNetwork, shapes_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.rl_baselines.case_evaluation import evaluate_cases

GOALS_MM = {"nominal": 0.0005, "machining": 0.25, "payload": 0.22}  # rms
QUANTILES = (0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0)
DISTRIBUTIONS = "loads", "all"
LEARNED, BASE, ADAPTIVE = "learned-observer", "elastic-observer", "adaptive-observer"
SILENT = "without the network"
SEED, CHUNK, BOUND = 500_000, 250, 20.0  # the first held-out seed; plants at once; mm


def assess(folder: Path, arm: AnyArm) -> dict[str, Any]:
    """Return errors [mm], margins and the settings of a seed."""
    bundle, policy = EstimateBundle.load(folder), load_policy(folder, robot=arm)
    return {
        "seed": bundle.seed,
        "training": bundle.training,
        "versions": bundle.versions,
        "cases": evaluate_cases(policy, arm),
        "margins": policy_margins(policy, arm, bundle.control_period),
        "curve": bundle.curve[:: max(1, len(bundle.curve) // 20)],
    }


def stable(row: dict[str, Any]) -> bool:
    """Return whether the loop is stable in every condition."""
    return all(radius is not None and radius < 1.0 for radius in row["margins"]["spectral_radius"].values())


def median_seed(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the row of the median seed, see the module."""
    among = [row for row in rows if stable(row)] or rows
    ranked = sorted(among, key=lambda row: row["cases"]["machining_rms_mm"] + row["cases"]["payload_rms_mm"])
    return ranked[(len(ranked) - 1) // 2]


def share_of(better: np.ndarray) -> dict[str, Any]:
    """Return the share of the plants on which `better` (plants,) is true, and its interval of 95 %."""
    count = int(np.count_nonzero(better))
    interval = binomtest(count, len(better)).proportion_ci(method="wilson")
    return {"share": count / len(better), "interval_95": [float(interval.low), float(interval.high)]}


def silent_on(arm: AnyArm) -> LearnedObserverPolicy:
    """Return the law with a network that is silent."""
    shapes = shapes_of(1, 1, joints_of(arm), equations_of(arm).axes)
    return LearnedObserverPolicy(EstimateNetwork(**{name: np.zeros(shape) for name, shape in shapes.items()}), arm)


def held_out(policies: dict[str, Any], distribution: str, plants: int, arm: AnyArm) -> dict[str, Any]:
    """Return quantiles of the largest tip errors [mm], and how often each policy beats the others, by case."""
    config = SweepConfig((BASE,), distribution=distribution, plants=plants, seed=SEED, **argument_of(arm))
    parts = [
        run_plants(config, policies, list(range(first, min(first + CHUNK, plants))))
        for first in range(0, plants, CHUNK)
    ]
    largest = np.concatenate([part.metrics["max_mm"] for part in parts], axis=2)
    completed = np.concatenate([part.completed for part in parts], axis=2).astype(bool)
    largest = np.where(completed, largest, np.inf)
    found = {}
    for number, name in enumerate(policies):
        for place, case in enumerate(PAPER_CASES):
            errors = largest[number, place]
            found[f"{name}, {case}"] = {
                "quantiles_mm": [
                    float(value) if np.isfinite(value) else None
                    for value in np.quantile(errors, QUANTILES, method="inverted_cdf")
                ],
                "lost": int(np.count_nonzero(~completed[number, place])),
                "above_20_mm": int(np.count_nonzero(errors > BOUND)),
                "better_than": {
                    rival: share_of(errors < largest[other, place])
                    for other, rival in enumerate(policies)
                    if other != number
                },
            }
    return {"plants": plants, "rows": found}


def print_document(document: dict[str, Any], console: Console) -> None:
    """Print the tables."""
    conditions = list(document["seeds"][0]["margins"]["spectral_radius"])
    table = Table("seed", *(f"{case} rms / max, mm" for case in PAPER_CASES), *conditions, "CPU, s")
    for row in document["seeds"]:
        cases, radius = row["cases"], row["margins"]["spectral_radius"]
        table.add_row(
            str(row["seed"]),
            *(f"{cases[f'{case}_rms_mm']:.4f} / {cases[f'{case}_max_mm']:.4f}" for case in PAPER_CASES),
            *("-" if radius[name] is None else f"{radius[name]:.4f}" for name in conditions),
            f"{row['training']['cpu_time_s']:.0f}",
        )
    console.print(table, f"median seed: {document['median']}")
    for title, part in document["held_out"].items():
        table = Table(title, *(f"{100 * q:g} %" for q in QUANTILES), "ended early", "above 20 mm", "better than")
        for name, row in part["rows"].items():
            better = (f"{other} {one['share']:.3f}" for other, one in row["better_than"].items())
            quantiles = ("ended early" if value is None else f"{value:.3f}" for value in row["quantiles_mm"])
            table.add_row(name, *quantiles, str(row["lost"]), str(row["above_20_mm"]), ", ".join(better))
        console.print(f"largest tip error, mm, {part['plants']} plants", table)


def main() -> None:
    """Measure and print, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--robot", default=PAPER, help="that the folders were trained for")
    parser.add_argument("--plants", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    arm = chosen_arm(arguments.robot, None)
    rows = sorted((assess(folder, arm) for folder in arguments.folders), key=lambda row: row["seed"])
    median = median_seed(rows)
    folder = next(one for one in arguments.folders if EstimateBundle.load(one).seed == median["seed"])
    policies = {name: load_policy(name, robot=arm) for name in (BASE, ADAPTIVE)}
    of_robot = {}
    if isinstance(arm, Robot):
        policies[SILENT] = silent_on(arm)
        of_robot = {
            "robot": arguments.robot,
            "plants": arguments.plants,
            "without": {name: evaluate_cases(policy, arm) for name, policy in policies.items()},
        }
    policies[LEARNED] = load_policy(folder, robot=arm)
    document = {
        "schema": "fuzzyarm-learned-observer/2",
        **current_provenance(),
        **of_robot,
        "goals_rms_mm": GOALS_MM,
        "median": median["seed"],
        "stable_in_every_condition": [row["seed"] for row in rows if stable(row)],
        "seeds": rows,
        "quantiles": list(QUANTILES),
        "first_held_out_seed": SEED,
        "held_out": {},
    }
    for name in DISTRIBUTIONS:
        document["held_out"][name] = held_out(policies, name, arguments.plants, arm)
        if arguments.json:  # after every part: the plants take minutes
            write_atomically(arguments.json, json.dumps(document, indent=1) + "\n")
    print_document(document, Console(width=200))


if __name__ == "__main__":
    main()
