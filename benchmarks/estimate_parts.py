"""What the parts of `learned-observer` give, and what they cost in margins: both laws, their join, and the network.

    python benchmarks/estimate_parts.py benchmarks/estimates/seed-* [--json FILE]

Of `elastic-observer`, of `adaptive-observer`, of the law of `learned-observer` with a network that is silent, and of
every trained one: tip errors in the paper's three cases and the rate of the torques, on time and half a sample late,
and the largest tip errors over development plants of `loads` and `all`, which are none of the held-out ones.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from learned_observer import ADAPTIVE, BASE
from ppo_observer import in_cases
from rich.console import Console
from rich.table import Table

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle, EstimateNetwork, shapes_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy

SILENT = "both laws, without a network"
SEED, DISTRIBUTIONS, SHARES = 50_000, ("loads", "all"), (0.5, 0.99)


def silent() -> Policy:
    """Return the law with a network whose arrays are zero."""
    return LearnedObserverPolicy(
        EstimateNetwork(**{name: np.zeros(shape) for name, shape in shapes_of(1, 1, 2, 2).items()})
    )


def over_plants(policy: Policy, plants: int) -> dict[str, dict[str, Any]]:
    """Return quantiles of the largest tip errors [mm] and how many episodes ended early, by distribution and case."""
    found: dict[str, dict[str, Any]] = {}
    for name in DISTRIBUTIONS:
        config = SweepConfig(policies=("one",), distribution=name, plants=plants, seed=SEED)
        run = run_plants(config, {"one": policy}, list(range(plants)))
        found[name] = {
            case: {
                "quantiles_mm": np.quantile(run.metrics["max_mm"][0, place], SHARES, method="inverted_cdf").tolist(),
                "lost": int(np.count_nonzero(run.completed[0, place] == 0)),
            }
            for place, case in enumerate(PAPER_CASES)
        }
    return found


def main() -> None:
    """Measure, print, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    policies = {BASE: load_policy(BASE), ADAPTIVE: load_policy(ADAPTIVE), SILENT: silent()}
    for folder in arguments.folders:
        policies[f"seed {EstimateBundle.load(folder).seed}"] = load_policy(folder)
    rows: dict[str, Any] = {}
    document = {
        "schema": "fuzzyarm-estimate-parts/1",
        **current_provenance(),
        "first_plant_seed": SEED,
        "plants": arguments.plants,
        "quantiles": list(SHARES),
        "policies": rows,
    }
    table = Table("policy", *(f"{case}, rms mm / N m/ms, on time, half late" for case in PAPER_CASES), *DISTRIBUTIONS)
    for name, policy in policies.items():
        row = {"cases": in_cases(policy), "late": in_cases(policy, late=True)}
        rows[name] = row | {"plants": over_plants(policy, arguments.plants)}
        cells = [[f"{m['rms_mm']:.3f} / {m['torque_rate']:.1f}" for m in part.values()] for part in row.values()]
        medians = (
            " / ".join(f"{one['quantiles_mm'][0]:.2f}" for one in by_case.values())
            for by_case in rows[name]["plants"].values()
        )
        table.add_row(name, *(", ".join(pair) for pair in zip(*cells, strict=True)), *medians)
        if arguments.json:
            write_atomically(arguments.json, json.dumps(document, indent=1) + "\n")
    Console(width=180).print(table)


if __name__ == "__main__":
    main()
