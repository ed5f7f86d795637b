"""Constants of the adaptive observer that its search leaves alone: the objective with each of them halved and doubled.

    python benchmarks/adaptive_constants.py [--json FILE]

The objective is that of `fuzzyarm.eval.tuning.adaptive_search`: mean and a tenth of the worst of the largest tip error
over random arms of each of its groups, and the error by encoder noise in Case 1, here the mean over `NOISY` seeds. The
arms have another seed than those of the search. The paper's circle under load and Cases 2 and 3 play no part.

The constants are compiled into the law, so each variant runs in a process with an empty cache of its own: a quarter of
an hour on two cores.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.tuning.adaptive_search import CAP, GROUPS, NOISE, TAIL, RandomArms

LAWS = "fuzzyarm.fuzzy_policy.laws.adaptive"
CONSTANTS = {  # by name: the module whose code reads it, and what it is
    "MISTRUST": ("filter", "least expected variance of a measurement, in variances of the noise that is read"),
    "INSIGNIFICANT": ("filter", "deviations up to which a load is none"),
    "LATENESS_DOUBT": ("filter", "variance of the lateness that a surprise adds [control periods²]"),
    "LARGEST_SCALE": ("filter", "variance above which the common factor is not doubted"),
    "DIRECTED": ("filter", "direction of the corrections from which on forces are not calm"),
}
FACTORS = (0.5, 1.0, 2.0)
SEED, ARMS, NOISY = 31, 100, 16


def measured() -> dict[str, Any]:
    """Return the objective, and its parts, of the policy as it is compiled in this process."""
    policy, groups = load_policy("adaptive-observer"), {}
    for group in GROUPS:
        errors = RandomArms(SEED, group, ARMS).largest_errors(policy)
        groups[group] = {
            "mean_mm": float(errors.mean()),
            "worst_mm": float(errors.max()),
            "lost": int((errors >= CAP).sum()),
        }
    envs = gym.make_vec("FuzzyArm-v0", num_envs=NOISY, disturbance=Disturbance(encoder_noise=NOISE))
    observation, _ = envs.reset(seed=SEED)
    state, largest, done = None, 0.0, np.zeros(1, dtype=bool)
    while not done.any():
        torque, state = policy.predict(observation, state)
        observation, _, terminated, truncated, info = envs.step(torque)
        done = terminated | truncated
        if not done.any():
            largest = np.maximum(largest, 1e3 * info["tip_error"])
    noise = float(np.mean(largest))
    cost = noise + sum(row["mean_mm"] + TAIL * row["worst_mm"] for row in groups.values())
    return {"groups": groups, "noisy_nominal_mm": noise, "objective_mm": cost}


def variant(name: str, factor: float) -> dict[str, Any]:
    """Return what the policy reaches with a constant multiplied; measured in a process of its own."""
    words = [sys.executable, __file__, "--variant", name, str(factor)]
    with tempfile.TemporaryDirectory() as cache:
        run = subprocess.run(words, env={**os.environ, "NUMBA_CACHE_DIR": cache}, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(f"{name} x {factor:g} failed:\n{run.stderr}")
    row: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    print(row, flush=True)
    return row


def measure_variant(name: str, factor: float) -> None:
    """Multiply a constant, measure and print; the law must not be compiled yet."""
    module = importlib.import_module(f"{LAWS}.{CONSTANTS[name][0]}")
    value = factor * getattr(module, name)
    setattr(module, name, value)
    print(json.dumps({"constant": name, "factor": factor, "value": value, **measured()}))


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--variant", nargs=2, metavar=("NAME", "FACTOR"), help="measure one, in this process")
    options = parser.parse_args()
    if options.variant:
        measure_variant(options.variant[0], float(options.variant[1]))
        return
    asked = [(name, factor) for name in CONSTANTS for factor in FACTORS if factor != 1.0]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        rows = list(pool.map(lambda one: variant(*one), [(next(iter(CONSTANTS)), 1.0), *asked]))
    if options.json:
        document = {"command": "python benchmarks/adaptive_constants.py", **current_provenance(), "seed": SEED}
        document |= {"arms": ARMS, "shipped": rows[0], "variants": rows[1:]}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
