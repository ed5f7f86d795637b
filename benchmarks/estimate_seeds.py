"""Every seed of `learned-observer` over held-out plants, under pushes, and on courses that no training has drawn.

    python benchmarks/estimate_seeds.py benchmarks/estimates/seed-* [--loads N] [--all N] [--pushed N] [--jobs N]
                                        [--errors FOLDER] [--json FILE]

Plants: largest tip errors over the first held-out plants of `loads` and of `all`, those of `learned_observer.py`, and
at how many of the percentiles 1 to 99 of a case they are below those of `elastic-observer` over the same plants.

Pushes: constant pushes and forces across the motion, `PUSHES`, over the first of the plants of `loads`.

Courses: the courses of `learned_tasks` but the paper's circle, in Cases 2 and 3, on the known arm.

Pushes are met by the shipped policy, pushes and courses also by `elastic-observer` and `adaptive-observer`.

With --errors the errors of each seed and distribution are kept in a folder and taken from there by the next run with as
many plants, so that a run that was cut off goes on. Delete the file of a seed that was trained again.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from learned_observer import ADAPTIVE, BASE, LEARNED, SEED
from learned_tasks import TASKS
from plant_errors import Population, errors_of, measured
from rich.console import Console

from fuzzyarm import load_policy
from fuzzyarm.common.console import progress
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES, Case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle
from fuzzyarm.fuzzy_policy.policy import Policy

QUANTILES = (0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1.0)
PERCENTILES = np.arange(1, 100) / 100
CASES_MET = tuple(CASES[name] for name in PAPER_CASES)
POPULATIONS = {name: Population(name, CASES_MET, SEED, chunk=500) for name in ("loads", "all")}
COURSES = tuple(name for name in TASKS if name not in PAPER_CASES)
PUSH = 150.0  # N, about the mean force of Case 2


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
"""Loads that are neither of the paper's, by kind and name; the plants of `loads` scale them by 0.5 to 1.5."""


def summary(errors: np.ndarray) -> dict[str, Any]:
    """Return quantiles of largest tip errors (plants,) [mm], None where lost, and how many plants are lost."""
    quantiles = np.quantile(errors, QUANTILES, method="inverted_cdf")
    return {
        "quantiles_mm": [float(value) if np.isfinite(value) else None for value in quantiles],
        "lost": int(np.count_nonzero(np.isinf(errors))),
    }


def percentiles_below(errors: np.ndarray, rival: np.ndarray) -> int:
    """Return at how many of the percentiles 1 to 99 the errors (plants,) are below those of a rival (plants,)."""
    own, other = (np.quantile(one, PERCENTILES, method="inverted_cdf") for one in (errors, rival))
    return int(np.count_nonzero(own < other))


def beside(errors: np.ndarray, rival: np.ndarray) -> dict[str, Any]:
    """Return by case what the table says of largest tip errors (cases, plants) [mm] beside those of a rival."""
    return {
        case: summary(own) | {"percentiles_below_elastic": percentiles_below(own, other)}
        for case, own, other in zip(PAPER_CASES, errors, rival, strict=True)
    }


def pushed(policies: Mapping[str, Policy], plants: int, jobs: int | None) -> dict[str, Any]:
    """Return the summary of each policy under each kind of push, all its directions together."""
    found: dict[str, Any] = {}
    for kind, loads in PUSHES.items():
        population = Population("loads", tuple(Case(name, name, load) for name, load in loads.items()), SEED, chunk=200)
        found[kind] = {
            name: summary(errors_of(policy, population, plants, jobs, lambda _: None).largest_mm.ravel())
            for name, policy in policies.items()
        }
    return found


def on_courses(policy: Policy) -> dict[str, Any]:
    """Return largest and rms tip errors [mm] of the known arm by course and case; None where it ended early."""
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


def main() -> None:
    """Measure, print, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    for name in POPULATIONS:
        parser.add_argument(f"--{name}", type=int, default=1000, metavar="N", help=f"plants of `{name}`")
    parser.add_argument("--pushed", type=int, default=200, help="plants that meet the pushes")
    parser.add_argument("--jobs", type=int, help="processes (default: one per core)")
    parser.add_argument("--errors", type=Path, metavar="FOLDER", help="keep errors here, and use those that are here")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.errors is not None:
        arguments.errors.mkdir(parents=True, exist_ok=True)
    seeds = {EstimateBundle.load(folder).seed: load_policy(folder) for folder in arguments.folders}
    rivals = {name: load_policy(name) for name in (BASE, ADAPTIVE)}
    compared = rivals | {f"seed {seed}": seeds[seed] for seed in sorted(seeds)}
    console = Console(width=180)
    document: dict[str, Any] = {
        "schema": "fuzzyarm-estimate-seeds/2",
        **current_provenance(),
        "quantiles": list(QUANTILES),
        "first_held_out_seed": SEED,
        "courses": {name: on_courses(policy) for name, policy in compared.items()},
        "pushed": {
            "plants": arguments.pushed,
            "size_N": PUSH,
            "kinds": pushed(rivals | {LEARNED: load_policy(LEARNED)}, arguments.pushed, arguments.jobs),
        },
        "plants": {name: getattr(arguments, name) for name in POPULATIONS},
        "held_out": {},
    }
    console.print(document["courses"], document["pushed"])
    held_out = {BASE: rivals[BASE]} | {f"seed {seed}": seeds[seed] for seed in sorted(seeds)}
    total = len(held_out) * sum(document["plants"].values())
    with progress("plants", total) as advance:
        done = 0
        for name, population in POPULATIONS.items():
            found, plants = document["held_out"].setdefault(name, {}), document["plants"][name]
            for label, policy in held_out.items():
                file = f"{name}-{label.replace(' ', '-')}-{plants}.npz"
                path = None if arguments.errors is None else arguments.errors / file
                report = functools.partial(_report, advance, f"{name}, {label}", done)
                largest = measured(path, policy, population, plants, arguments.jobs, report).largest_mm
                if label == BASE:
                    base = largest
                found[label] = beside(largest, base)
                done += plants
                if arguments.json:  # after every seed: the plants take minutes
                    write_atomically(arguments.json, json.dumps(document, indent=1) + "\n")
    console.print(document["held_out"])


def _report(advance: Callable[..., None], label: str, before: int, done: int) -> None:
    advance(label, completed=before + done)


if __name__ == "__main__":
    main()
