"""How long a sweep takes beside that of an older commit, in turns on one core.

    git worktree add BEFORE 68f4fe8
    python benchmarks/sweep_before.py BEFORE [--json FILE]

BEFORE is a checkout of the older commit. Both run with the Python and the packages of this process. A round is a sweep
of `FEW` and one of `MANY` plants with each version; the difference of the two is the time of the plants alone, without
start and compilation. At 68f4fe8 every step of a sweep went through the environment and `predict`, and the laws were
evaluated lane by lane.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance

NOW = Path(__file__).resolve().parents[1]
POLICIES = ("fuzzy-4-tip", "elastic-observer")
FEW, MANY, ROUNDS, STEPS = 500, 5000, 5, 3 * 1500  # plants, rounds, control steps of a plant in the three cases


def seconds(checkout: Path, policy: str, plants: int) -> float:
    """Return how long `fuzzyarm sweep` of a checkout takes [s]."""
    with tempfile.TemporaryDirectory() as name:
        words = ["sweep", "--policy", policy, "--plants", str(plants), "--jobs", "1", "--out", f"{name}/sweep"]
        begin = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "fuzzyarm", *words],
            env={**os.environ, "PYTHONPATH": str(checkout)},
            cwd=name,
            check=True,
            capture_output=True,
        )
        return time.perf_counter() - begin


def compared(before: Path, policy: str) -> dict[str, Any]:
    """Return steps per second of both versions, and how many times as fast this one is; medians and quartiles."""
    checkouts = {"before": before, "now": NOW}
    for checkout in checkouts.values():
        seconds(checkout, policy, FEW)  # compile
    rounds = [
        {name: seconds(checkout, policy, MANY) - seconds(checkout, policy, FEW) for name, checkout in checkouts.items()}
        for _ in range(ROUNDS)
    ]
    steps = (MANY - FEW) * STEPS
    found: dict[str, Any] = {
        f"{name}_steps_per_s": _quartiles([steps / taken[name] for taken in rounds]) for name in checkouts
    }
    return {"policy": policy, **found, "ratio": _quartiles([taken["before"] / taken["now"] for taken in rounds])}


def _quartiles(values: list[float]) -> dict[str, float]:
    q1, median, q3 = np.quantile(values, (0.25, 0.5, 0.75))
    return {"median": float(median), "q1": float(q1), "q3": float(q3)}


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, metavar="BEFORE", help="checkout of the older commit")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    before = options.before.resolve()
    if not (before / "fuzzyarm" / "__main__.py").is_file():
        parser.error(f"{options.before} is no checkout of FuzzyArm: it has no fuzzyarm/__main__.py")
    commit = subprocess.run(
        ["git", "-C", str(before), "rev-parse", "HEAD"], check=True, capture_output=True, text=True
    ).stdout.strip()
    rows = []
    for policy in POLICIES:
        rows.append(compared(before, policy))
        print(rows[-1], flush=True)
    if options.json:
        document = {"command": f"python benchmarks/sweep_before.py BEFORE, at {commit[:10]}", **current_provenance()}
        document |= {"before": commit, "rounds": ROUNDS, "plants": MANY - FEW, "rows": rows}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
