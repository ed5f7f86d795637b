"""Seeds of `learned-observer`: tip errors, margins, and held-out plants beside the model-based observers.

    for seed in 0 1 2 3 4; do fuzzyarm train estimate --seed $seed --out runs/estimate-$seed; done
    python benchmarks/learned_observer.py runs/estimate-*/policy [--json FILE]

    for seed in 0 1 2; do fuzzyarm train estimate --robot planar-3r --seed $seed --out runs/planar-3r-$seed; done
    python benchmarks/learned_observer.py --robot planar-3r runs/planar-3r-*/policy --plants 200 --others 0 --json FILE

Of every seed: tip errors in the paper's three cases, and the margins of `fuzzyarm margins`. The median seed has the
median rms error of Cases 2 and 3 together, among the seeds whose loop is stable in every condition if there are any.
Of the median seed, `elastic-observer` and `adaptive-observer`: largest tip errors over the plants of the sweeps'
distributions `loads` and `all`, which no training has seen, each plant under all policies; and the share of plants on
which a policy errs less than another, with a Wilson interval of 95 %. The other seeds meet the first `--others` of
these plants. Of every seed: at how many of the percentiles 1 to 99 of a case its largest tip error is below that of
`elastic-observer` over the same plants. The first `PUSHED` plants of `loads` also meet `PUSHES`: constant pushes, and
forces across the motion; and all seeds follow the courses of `learned_tasks`, which no training has drawn, in Cases 2
and 3 on the known arm. A robot is measured with its own cases, along its default course, beside the law with a network
that is silent, and without pushes and other courses.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from learned_tasks import TASKS
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.equations import PAPER, AnyArm, argument_of, chosen_arm, equations_of
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES, Case, add_case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.learned_policy.estimate.bundle import EstimateBundle
from fuzzyarm.learned_policy.estimate.network import EstimateNetwork, shapes_of
from fuzzyarm.learned_policy.estimate.policy import LearnedObserverPolicy
from fuzzyarm.rl_baselines.case_evaluation import evaluate_cases

GOALS_MM = {"nominal": 0.0005, "machining": 0.25, "payload": 0.22}  # rms
QUANTILES = (0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
PERCENTILES = np.arange(1, 100) / 100
DISTRIBUTIONS = "loads", "all"
LEARNED, BASE, ADAPTIVE = "learned-observer", "elastic-observer", "adaptive-observer"
SILENT = "without the network"
COURSES = tuple(name for name in TASKS if name not in PAPER_CASES)
SEED, CHUNK, BOUND = 500_000, 500, 20.0  # the first held-out seed; plants at once; mm
PUSHED, PUSH = 200, 150.0  # plants; N, about the mean force of Case 2


@dataclasses.dataclass(frozen=True)
class Across:
    """A force of `size` [N] to the left of the direction of travel, to its right if negative, faded out at rest.

    F = size R v / max(|v|, v_0), R a turn by a right angle.

    Attributes:
        size: of the force [N].
        fade_speed: v_0 [m/s].
    """

    size: float
    fade_speed: float = 0.01

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] for tip velocities (..., 2) [m/s]."""
        speed = np.maximum(np.linalg.norm(tip_velocity, axis=-1, keepdims=True), self.fade_speed)
        force: np.ndarray = self.size * np.stack([-tip_velocity[..., 1], tip_velocity[..., 0]], axis=-1) / speed
        return force


_DIRECTIONS = {"+x": (PUSH, 0.0), "+y": (0.0, PUSH), "-x": (-PUSH, 0.0), "-y": (0.0, -PUSH)}
PUSHES = {
    "constant push": {
        f"push {name}": Disturbance(tip_force=ConstantForce(force, 0.3, 0.9)) for name, force in _DIRECTIONS.items()
    },
    "force across the motion": {
        f"across, {side}": Disturbance(tip_force=Across(size)) for side, size in (("left", PUSH), ("right", -PUSH))
    },
}
"""Loads that are neither of the paper's, by kind and name; 150 N, which the plants of `loads` vary by half."""

for _name, _load in (one for kind in PUSHES.values() for one in kind.items()):
    if _name not in CASES:
        add_case(Case(_name, _name, _load))


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


def largest_over(
    policies: dict[str, Any], distribution: str, plants: int, arm: AnyArm, cases: Sequence[str] = PAPER_CASES
) -> dict[str, np.ndarray]:
    """Return the largest tip errors (cases, plants) [mm] by policy; inf where an episode ended early."""
    config = SweepConfig((BASE,), tuple(cases), distribution=distribution, plants=plants, seed=SEED, **argument_of(arm))
    parts = [
        run_plants(config, policies, list(range(first, min(first + CHUNK, plants))))
        for first in range(0, plants, CHUNK)
    ]
    errors = np.concatenate([np.where(part.completed, part.max_mm, np.inf) for part in parts], axis=2)
    return dict(zip(policies, errors, strict=True))


def summary(errors: np.ndarray) -> dict[str, Any]:
    """Return quantiles of largest tip errors (plants,) [mm], and how many plants are lost or beyond 20 mm."""
    quantiles = np.quantile(errors, QUANTILES, method="inverted_cdf")
    return {
        "quantiles_mm": [float(value) if np.isfinite(value) else None for value in quantiles],
        "lost": int(np.count_nonzero(np.isinf(errors))),
        "above_20_mm": int(np.count_nonzero(errors > BOUND)),
    }


def compared(largest: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the summary of each policy in each of the paper's cases, and how often it beats the others."""
    return {
        f"{name}, {case}": summary(errors[place])
        | {
            "better_than": {
                rival: share_of(errors[place] < other[place]) for rival, other in largest.items() if rival != name
            }
        }
        for name, errors in largest.items()
        for place, case in enumerate(PAPER_CASES)
    }


def percentiles_below(errors: np.ndarray, rival: np.ndarray) -> int:
    """Return at how many of the percentiles 1 to 99 the errors (plants,) are below those of a rival (plants,)."""
    own, other = (np.quantile(one, PERCENTILES, method="inverted_cdf") for one in (errors, rival))
    return int(np.count_nonzero(own < other))


def of_seed(seed: int, errors: np.ndarray, base: np.ndarray) -> dict[str, Any]:
    """Return the summary of a seed's largest tip errors (cases, plants) beside those of `elastic-observer`."""
    return {
        "seed": seed,
        "plants": errors.shape[1],
        "rows": {
            case: summary(own) | {"percentiles_below_elastic": percentiles_below(own, rival)}
            for case, own, rival in zip(PAPER_CASES, errors, base, strict=True)
        },
    }


def pushed(policies: dict[str, Any], arm: AnyArm) -> dict[str, Any]:
    """Return the summary of each policy under each kind of push, all its directions together."""
    cases = [name for kind in PUSHES.values() for name in kind]
    largest = largest_over(policies, "loads", PUSHED, arm, cases)
    return {
        kind: {name: summary(errors[[cases.index(one) for one in loads]].ravel()) for name, errors in largest.items()}
        for kind, loads in PUSHES.items()
    }


def on_courses(policy: Any) -> dict[str, Any]:
    """Return largest and rms tip errors [mm] of the known arm on unseen courses in Cases 2 and 3, by course and case.

    An episode that ended early has null.
    """
    lanes = [(name, case) for name in COURSES for case in PAPER_CASES[1:]]
    envs = FuzzyArmVectorEnv(
        len(lanes), [case for _, case in lanes], reference=[TASKS[name].reference for name, _ in lanes], threads=1
    )
    errors = TipErrors(len(lanes))
    for step in episodes(envs, policy, envs.reset(seed=0)):
        errors.add(step)
    return {
        f"{name}, {case}": {
            "title": TASKS[name].title,
            "largest_mm": float(1e3 * errors.largest[k]) if errors.completed[k] else None,
            "rms_mm": float(1e3 * errors.rms[k]) if errors.completed[k] else None,
        }
        for k, (name, case) in enumerate(lanes)
    }


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
        table = Table(title, *(f"{100 * q:g} %" for q in QUANTILES), "lost", "above 20 mm", "better than")
        for name, row in part["rows"].items():
            better = (f"{other} {one['share']:.3f}" for other, one in row["better_than"].items())
            quantiles = ("lost" if value is None else f"{value:.3f}" for value in row["quantiles_mm"])
            table.add_row(name, *quantiles, str(row["lost"]), str(row["above_20_mm"]), ", ".join(better))
        console.print(f"largest tip error, mm, {part['plants']} plants", table)
        table = Table("seed, case", "plants", *(f"{100 * q:g} %" for q in QUANTILES), "lost", "percentiles below")
        for one in part["seeds"]:
            for case, row in one["rows"].items():
                quantiles = ("lost" if value is None else f"{value:.3f}" for value in row["quantiles_mm"])
                cells = str(one["plants"]), *quantiles, str(row["lost"]), str(row["percentiles_below_elastic"])
                table.add_row(f"{one['seed']}, {case}", *cells)
        console.print(table)
    for name, by_course in document.get("courses", {}).items():
        console.print(name, {key: (row["largest_mm"], row["rms_mm"]) for key, row in by_course.items()})
    for kind, by_policy in document.get("pushed", {}).get("kinds", {}).items():
        console.print(kind, *(f"{name}: {row}" for name, row in by_policy.items()), sep="\n")


def main() -> None:
    """Measure and print, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--robot", default=PAPER, help="that the folders were trained for")
    parser.add_argument("--plants", type=int, default=1000)
    parser.add_argument("--others", type=int, default=500, help="plants for the seeds beside the median; 0: none")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    arm = chosen_arm(arguments.robot, None)
    rows = sorted((assess(folder, arm) for folder in arguments.folders), key=lambda row: row["seed"])
    median = median_seed(rows)
    folders = {EstimateBundle.load(folder).seed: folder for folder in arguments.folders}
    policies = {name: load_policy(name, robot=arm) for name in (BASE, ADAPTIVE)}
    of_robot = {}
    if isinstance(arm, Robot):
        policies[SILENT] = silent_on(arm)
        of_robot = {
            "robot": arguments.robot,
            "plants": arguments.plants,
            "without": {name: evaluate_cases(policy, arm) for name, policy in policies.items()},
        }
    policies[LEARNED] = load_policy(folders[median["seed"]], robot=arm)
    document: dict[str, Any] = {
        "schema": "fuzzyarm-learned-observer/3",
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

    def write() -> None:
        """Write what there is: the plants take minutes."""
        if arguments.json:
            write_atomically(arguments.json, json.dumps(document, indent=1) + "\n")

    if not of_robot:
        seeds = {f"seed {seed}": load_policy(folder) for seed, folder in sorted(folders.items())}
        rivals = {name: policies[name] for name in (BASE, ADAPTIVE)}
        document["courses"] = {name: on_courses(policy) for name, policy in (rivals | seeds).items()}
        document["pushed"] = {"plants": PUSHED, "size_N": PUSH, "kinds": pushed(policies, arm)}
        write()
    for name in DISTRIBUTIONS:
        largest = largest_over(policies, name, arguments.plants, arm)
        part = {"plants": arguments.plants, "rows": compared(largest), "seeds": []}
        document["held_out"][name] = part
        for seed, folder in sorted(folders.items()) if arguments.others else []:
            own = largest[LEARNED]
            if seed != median["seed"]:
                others = min(arguments.others, arguments.plants)
                own = largest_over({LEARNED: load_policy(folder, robot=arm)}, name, others, arm)[LEARNED]
            part["seeds"].append(of_seed(seed, own, largest[BASE][:, : own.shape[1]]))
            write()
        write()
    print_document(document, Console(width=200))


if __name__ == "__main__":
    main()
