"""What the limits of the torques do to the integral: held there, as `Policy.command` does it, and not held.

    python benchmarks/saturation.py [--json FILE]

The paper's circle on the arm of Table 1, pushed at its tip to the side for 0.2 s, by forces up to more than the motors
can hold. No condition of a table of results is among them, and nothing is tuned. A few seconds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.policy import Policy

LAWS = ("fuzzy-4", "computed-torque", "fuzzy-4-tip")
FORCES = (500.0, 700.0, 1000.0, 1200.0)  # N, along y
BEGIN, END = 0.4, 0.6  # s


def assess(law: str, force: float, hold: bool) -> dict[str, Any]:
    """Return one row: what happens to a law under a force, with the integral held at the limits or not."""
    policy = load_policy(law)
    assert isinstance(policy, Policy) and policy.integral_at is not None
    if not hold:
        policy.integral_at = None
    env = FuzzyArmEnv(disturbance=Disturbance(tip_force=ConstantForce((0.0, force), BEGIN, END)))
    run = record_rollout(env, policy, policy_name=law, case="push", seed=0)
    at_limit = (np.abs(run.torque) >= np.array(env.parameters.torque_limit)).any(axis=1)
    after = run.tip_error[run.time > END]
    return {
        "law": law,
        "force": force,
        "held": hold,
        "completed": run.completed,
        "reason": run.reason,
        "at_limit_ms": int(np.count_nonzero(at_limit)),
        "max_mm": 1e3 * float(run.tip_error.max()),
        "rms_after_mm": 1e3 * float(np.sqrt(np.mean(after * after))) if run.completed else None,
    }


def main() -> None:
    """Run all, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    rows = [assess(law, force, hold) for law in LAWS for force in FORCES for hold in (False, True)]
    for row in rows:
        end = "completed" if row["completed"] else f"ended: {row['reason']}"
        after = "" if row["rms_after_mm"] is None else f", rms after the push {row['rms_after_mm']:.1f} mm"
        print(
            f"{row['law']:16} {row['force']:5.0f} N, integral {'held' if row['held'] else 'not held':8} "
            f"{row['at_limit_ms']:4d} ms at a limit, largest tip error {row['max_mm']:6.1f} mm{after}; {end}"
        )
    if options.json:
        document = {"command": "python benchmarks/saturation.py", **current_provenance(), "rows": rows}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
