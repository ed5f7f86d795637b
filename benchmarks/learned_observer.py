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

from pathlib import Path
from typing import Any

import numpy as np
from measuring import options_of, printed, write
from scipy.stats import binomtest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.equations import AnyArm, argument_of, chosen_arm, equations_of
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.sweep._episodes import run_plants
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle, EstimateNetwork, shapes_of
from fuzzyarm.rl_baselines._case_evaluation import evaluate_cases

QUANTILES = (0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0)
DISTRIBUTIONS = "loads", "all"
LEARNED, BASE, ADAPTIVE = "learned-observer", "elastic-observer", "adaptive-observer"
SILENT = "without the network"
SEED, CHUNK = 500_000, 250  # the first held-out seed; plants at once


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
                "better_than": {
                    rival: share_of(errors < largest[other, place])
                    for other, rival in enumerate(policies)
                    if other != number
                },
            }
    return {"plants": plants, "rows": found}


def main() -> None:
    """Measure and print, and write the document."""
    parser = options_of(__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--robot", default="paper", help="that the folders were trained for")
    parser.add_argument("--plants", type=int, default=1000)
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
    document: dict[str, Any] = {
        "schema": "fuzzyarm-learned-observer/2",
        **of_robot,
        "median": median["seed"],
        "stable_in_every_condition": [row["seed"] for row in rows if stable(row)],
        "seeds": rows,
        "quantiles": list(QUANTILES),
        "first_held_out_seed": SEED,
        "held_out": {},
    }
    printed(rows)
    words = f" --robot {arguments.robot}" * bool(of_robot) + f" --plants {arguments.plants}"
    for name in DISTRIBUTIONS:
        document["held_out"][name] = held_out(policies, name, arguments.plants, arm)
        printed([document["held_out"][name]])
        write(arguments.json, f"learned_observer.py{words}", **document)  # after every part: the plants take minutes


if __name__ == "__main__":
    main()
