"""How the adaptive observer begins, and how soon it doubts its motors: chosen without a case that has a load.

    python benchmarks/adaptive_start.py [--json FILE]

Searched is a grid: the share of the regulator's gain with which an episode begins (`first_gain`), for how long
(`soft_start`), and how much a surprise adds to the variance of the factor that the arm's constants share
(`scale_doubt`). The objective is that of `fuzzyarm.eval.tuning.adaptive_search`, the mean of the largest errors and a
tenth of the worst, summed over three groups: the random loads and paths of its known arm; plants of ``plants`` without
load whose motors give 1.5 times the torque; and of ``all`` without load, each two periods late. The error of the known
arm with noise is added. Whether the worst plant is at the cap is partly chance, so the best of a first round, and the
best of those without a soft start, are measured again on more and other plants. Other seeds than those of any table;
Cases 2 and 3 play no part.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from adaptive_cases import CAP_MM, LATEST, TORQUE, episode, plants

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep.distributions import DISTRIBUTIONS
from fuzzyarm.eval.tuning.adaptive_search import RandomArms, noisy_nominal
from fuzzyarm.eval.tuning.finding import PERIOD
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

GAINS, TIMES, DOUBTS = (0.4, 0.5, 0.6, 0.8), (0.01, 0.015, 0.03), (1e-6, 1.5e-3, 3e-3)
SEED, TAIL = 7_000_000, 0.1
PLANTS, FINALISTS = (300, 1500), 6  # plants of a group in the first and in the second round; who takes part in that
NEVER = 3.0
"""A `largest_swing` that no commands reach."""


def candidates() -> list[AdaptiveWeights]:
    """Return the weights of the grid; with the whole gain from the first sample on, the time has no effect."""
    starts = [(1.0, TIMES[0]), *itertools.product(GAINS, TIMES)]
    return [
        AdaptiveWeights(first_gain=gain, soft_start=time, scale_doubt=doubt, largest_swing=NEVER)
        for (gain, time), doubt in itertools.product(starts, DOUBTS)
    ]


def measured(last: bool, number: int) -> dict[str, Any]:
    """Return what a candidate reaches in the first or the last round."""
    weights, count, seed = candidates()[number], PLANTS[last], SEED + PLANTS[0] * last
    policy, arms = AdaptiveObserverPolicy(ArmParameters(), PERIOD, weights), RandomArms(seed, "known")
    groups = in_groups({"known": arms.largest_errors(policy), **unloaded_errors(policy, count, seed)})
    noise = noisy_nominal(policy)
    return {
        "weights": {name: getattr(weights, name) for name in ("first_gain", "soft_start", "scale_doubt")},
        "groups": groups,
        "noisy_nominal_max_mm": noise,
        "objective_mm": noise + objective(groups),
    }


def unloaded_errors(policy: AdaptiveObserverPolicy, count: int, seed: int) -> dict[str, np.ndarray]:
    """Return the largest tip errors (count,) [mm] of plants without load, strong ones and late ones."""
    strong, late = (plants("nominal", DISTRIBUTIONS[of], count, noise) for of, noise in _GROUPS)
    return {
        "strong": episode(policy, strong, seed, np.zeros(count, dtype=int), max(TORQUE), None)[0],
        "late": episode(policy, late, seed, np.full(count, LATEST), 1.0, None)[0],
    }


def in_groups(errors: Mapping[str, np.ndarray]) -> dict[str, dict[str, Any]]:
    """Return mean and worst of the largest tip errors of each group [mm], and how many are at the cap."""
    return {
        group: {"mean_mm": float(e.mean()), "worst_mm": float(e.max()), "lost": int((e >= CAP_MM).sum())}
        for group, e in errors.items()
    }


def objective(groups: Mapping[str, Mapping[str, Any]]) -> float:
    """Return the sum over groups of the mean and a share of the worst [mm]."""
    return sum(row["mean_mm"] + TAIL * row["worst_mm"] for row in groups.values())


def round_of(numbers: Sequence[int], *, last: bool) -> dict[int, dict[str, Any]]:
    """Return what these candidates reach, by number, the best one first."""
    rows = {}
    for number, row in Engine().run(functools.partial(measured, last), numbers):
        rows[number] = row
        print(row, flush=True)
    return dict(sorted(rows.items(), key=lambda item: item[1]["objective_mm"]))


_GROUPS = (("plants", 0.0), ("all", 1.0))  # of strong and of late plants: distribution, multiple of the noise


def main() -> None:
    """Search, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    first = round_of(range(len(candidates())), last=False)
    whole = next(number for number, row in first.items() if row["weights"]["first_gain"] == 1.0)
    last = round_of(list(dict.fromkeys([*list(first)[:FINALISTS], whole])), last=True)
    chosen = next(iter(last.values()))["weights"]
    print(f"chosen: {chosen}")
    own = dataclasses.asdict(AdaptiveWeights())
    if any(own[name] != value for name, value in chosen.items()):
        print("the policy's own weights are others")
    if options.json:
        rounds = {"first": list(first.values()), "last": list(last.values())}
        document = {"command": "python benchmarks/adaptive_start.py", **current_provenance(), "seed": SEED, **rounds}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
