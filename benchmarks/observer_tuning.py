"""The four weights of the elastic-observer policy: the smallest error over random plants and loads, within margins.

    python benchmarks/observer_tuning.py [--json FILE]

The objective, the constraint and the search are those of `fuzzyarm.eval.tuning.observer_search`, with which `fuzzyarm
tune` chooses for any arm; here it is the arm of Table 1, with the longer search that chose the shipped weights. They
are the first guess and stay unless others are one per cent better. Hold-out arms and Cases 2 and 3 play no part and are
only reported. Seeded; two and a half minutes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES, find_case
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import gain_limits, linearise_path
from fuzzyarm.eval.tuning.finding import PERIOD, with_stiffness
from fuzzyarm.eval.tuning.observer_search import (
    BOX,
    FIRST_STEP,
    FULL,
    NOISE,
    SEED,
    follow,
    logarithms_of,
    objective_for,
    radii,
    random_arms,
    rms,
    weights_of,
)
from fuzzyarm.eval.tuning.search import found_weights, sobol_points
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights

ARM = ArmParameters()
HOLD_OUT_SEEDS = (2, 3, 4)
MIDDLE = slice(100, 1400)  # of an episode, without its start and its end: 0.1 to 1.4 s


def settings(chosen: ObserverWeights) -> str:
    """Return what was searched for, in words."""
    return ", ".join(f"{name} = {value:g}" for name, value in list(dataclasses.asdict(chosen).items())[: len(BOX)])


def search() -> tuple[ObserverWeights, float]:
    """Return the weights found and their objective [mm]."""
    best, guess = found_weights(
        objective_for,
        ARM,
        logarithms_of(ObserverWeights()),
        sobol_points(list(BOX.values()), FULL.sobol, SEED),
        FIRST_STEP,
        FULL,
        engine=Engine(),
    )
    return ObserverWeights() if best == guess else weights_of(best.point), best.cost


def report(chosen: ObserverWeights) -> dict[str, Any]:
    """Return what the chosen weights give: margins, hold-out, the three cases, wrong stiffness, encoder noise."""
    policy = ElasticObserverPolicy(ARM, PERIOD, chosen)
    nominal = linearise_path(policy, ARM, PERIOD)
    tasks = {name: (find_case(name).disturbance, ARM) for name in PAPER_CASES}
    tasks |= {
        f"nominal, stiffness x{factor:g}": (Disturbance(), with_stiffness(ARM, factor)) for factor in (0.95, 1.05)
    }
    tasks["nominal, encoder noise"] = (Disturbance(encoder_noise=NOISE), ARM)
    envs = gym.make_vec(
        "FuzzyArm-v0",
        num_envs=len(tasks),
        disturbance=[disturbance for disturbance, _ in tasks.values()],
        parameters=[arm for _, arm in tasks.values()],
    )
    error, torque = follow(envs, policy)
    rate = rms(np.diff(torque, axis=0) / PERIOD).mean(axis=1)
    rows = [
        {"task": name, "max_mm": top, "rms_mm": mean, "max_mm_0.1_to_1.4_s": middle, "torque_rate_rms": change}
        for name, top, mean, middle, change in zip(
            tasks, *(x.tolist() for x in (error.max(0), rms(error), error[MIDDLE].max(0), rate)), strict=True
        )
    ]
    return {
        "spectral_radius": radii(policy, ARM, nominal),
        "gain_margin": gain_limits(nominal),
        "gain_margin_one_sample_later": gain_limits(nominal, 1.0),
        "hold_out_mm": {
            str(seed): float(rms(follow(random_arms(ARM, seed), policy, seed)[0]).mean()) for seed in HOLD_OUT_SEEDS
        },
        "tasks": rows,
    }


def show(found: dict[str, Any]) -> None:
    """Print a report."""
    for name, radius in found["spectral_radius"].items():
        print(f"  spectral radius, {name}: {radius:.4f}")
    for key in ("gain_margin", "gain_margin_one_sample_later"):
        print("  " + key.replace("_", " ") + ": {:.2f} to {:.2f}".format(*found[key]))
    print("  mean rms tip error on hold-out arms [mm]: " + ", ".join(f"{x:.3f}" for x in found["hold_out_mm"].values()))
    table = Table("task", box=None, pad_edge=False)
    for heading in ("tip max [mm]", "rms [mm]", "max, 0.1 to 1.4 s [mm]", "torque rate rms [N m/s]"):
        table.add_column(heading, justify="right")
    for row in found["tasks"]:
        name, *values = row.values()
        table.add_row(name, *(f"{value:.4g}" for value in values))
    Console(width=120).print(table)


def main() -> None:
    """Search, report and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    chosen, cost = search()
    print(f"chosen: {settings(chosen)}; objective {cost:.4f} mm")
    if chosen != ObserverWeights():
        print(f"the policy's own weights are others: {settings(ObserverWeights())}")
    found = report(chosen)
    show(found)
    if options.json:
        document = {
            "command": "python benchmarks/observer_tuning.py",
            **current_provenance(),
            "weights": dataclasses.asdict(chosen),
            "objective_mm": cost,
            **found,
        }
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
