"""From when on the commands of an adaptive policy count as a swing, and its fallback acts.

    python benchmarks/adaptive_swing.py [--policy NAME] [--jobs N] [--json FILE]

Searched is `largest_swing` of `AdaptiveWeights`: too small a number takes the answer to a load for a swing, too large a
number notices a swing when the tip is far off already. The objective is that of `adaptive_start`, the mean of the
largest errors and a tenth of the worst, summed over four groups. Two have random loads, courses and starts: the known
arm, and unknown arms that are late and noisy. Two are plants without load: those of ``plants`` whose motors give 1.5
times the torque, and those of ``all``, each two periods late. Other seeds than those of any table; Cases 2 and 3 play
no part. What acts after a swing is the policy's own fallback: of ``adaptive-observer`` computed torque, of
``learned-observer`` the elastic observer alone.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
from adaptive_start import NEVER, in_groups, objective, unloaded_errors

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.tuning.adaptive_search import RandomArms
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy

POLICIES = ("adaptive-observer", "learned-observer")
SWINGS = (0.3, 0.36, 0.43, 0.5, 0.6, 0.72, NEVER)
SEED, PLANTS = 7_100_000, 1500
LOADED, ARMS, DRAWS = ("known", "unknown, late and noisy"), 100, 4  # groups of random arms, arms of a draw, draws


def policy_with(name: str, largest_swing: float) -> AdaptiveObserverPolicy | LearnedObserverPolicy:
    """Return the policy with this `largest_swing`."""
    policy = load_policy(name)
    weights = dataclasses.replace(adaptive_part(policy).weights, largest_swing=largest_swing)
    adaptive = AdaptiveObserverPolicy(policy.parameters, policy.control_period, weights)
    if not isinstance(policy, LearnedObserverPolicy):
        return adaptive
    policy = copy.copy(policy)
    policy.adaptive = adaptive
    return policy


def adaptive_part(policy: AdaptiveObserverPolicy | LearnedObserverPolicy) -> AdaptiveObserverPolicy:
    """Return the policy, or the adaptive observer in it."""
    return policy.adaptive if isinstance(policy, LearnedObserverPolicy) else policy


def measured(name: str, number: int) -> dict[str, Any]:
    """Return what the number of `SWINGS` reaches."""
    policy = policy_with(name, SWINGS[number])
    loaded = {
        group: np.concatenate([RandomArms(SEED + draw, group, ARMS).largest_errors(policy) for draw in range(DRAWS)])
        for group in LOADED
    }
    groups = in_groups({**loaded, **unloaded_errors(policy, PLANTS, SEED)})
    return {"largest_swing": SWINGS[number], "groups": groups, "objective_mm": objective(groups)}


def main() -> None:
    """Search, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", choices=POLICIES, default=POLICIES[0], help="default: %(default)s")
    parser.add_argument("--jobs", type=int, metavar="N", help="processes (default: one per core)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    rows = []
    for _, row in Engine(jobs=options.jobs).run(functools.partial(measured, options.policy), range(len(SWINGS))):
        print(row, flush=True)
        rows.append(row)
    chosen = min(rows, key=lambda row: row["objective_mm"])["largest_swing"]
    print(f"chosen: {chosen}")
    if chosen != adaptive_part(load_policy(options.policy)).weights.largest_swing:
        print("the policy's own number is another")
    if options.json:
        command = f"python benchmarks/adaptive_swing.py --policy {options.policy}"
        found = {"seed": SEED, "arms": ARMS * DRAWS, "plants": PLANTS, "chosen": chosen}
        found["variants"] = sorted(rows, key=lambda row: row["largest_swing"])
        document = {"command": command, **current_provenance(), **found}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
