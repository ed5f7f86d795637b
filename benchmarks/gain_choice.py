"""How large the gains of the shipped 4-rule controller should be: a grid over γ, the only free number of the design.

    python benchmarks/gain_choice.py [--json FILE]

Rule: the smallest γ of the grid (the stiffest controller) whose loop on the sampled elastic arm bears twice its gain
and stays stable with two extra samples of delay; judged in the nominal case only. Half a minute.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.eval.margins import gain_margin, spectral_radius
from fuzzyarm.eval.metrics import metrics
from fuzzyarm.eval.provenance import provenance
from fuzzyarm.eval.rollout import rollout
from fuzzyarm.files import write_atomically
from fuzzyarm.fuzzy_policy.pdc import FuzzyPolicy
from fuzzyarm.synthesis.design import Specification, design

GRID = (2.5e-5, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4)  # rad/(N m)
LEAST_GAIN_MARGIN = 2.0
DELAY = 2


def assess(gamma: float) -> dict[str, Any]:
    """Design for one γ and return its gains, nominal error and margins."""
    made = design(Specification(gamma=gamma))
    controller, certificate = made.controller, made.certificate
    policy, arm = FuzzyPolicy(controller), ArmParameters()
    run = rollout(FuzzyArmEnv(), policy, policy_name="fuzzy-4", case="nominal", seed=0)
    return {
        "gamma": gamma,
        "margin": certificate.margin,
        "largest_gain": float(abs(controller.gains[..., :2]).max()),
        "joint_error_rms_mrad": metrics(run)["joint_error_rms_mrad"],
        "gain_margin_upper": gain_margin(policy, arm, control_period=1e-3)[1],
        "radius": spectral_radius(policy, arm, control_period=1e-3),
        "radius_delayed": spectral_radius(policy, arm, control_period=1e-3, delay=DELAY),
    }


def main() -> None:
    """Assess the grid, choose, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    rows = []
    for gamma in GRID:
        rows.append(row := assess(gamma))
        print("  ".join(f"{key} = {value:.4g}" for key, value in row.items()), flush=True)
    fit = [row for row in rows if row["gain_margin_upper"] >= LEAST_GAIN_MARGIN and row["radius_delayed"] < 1.0]
    chosen = min(row["gamma"] for row in fit)
    print(f"chosen: gamma = {chosen:g} rad/(N m)")
    if options.json:
        document = {"command": "python benchmarks/gain_choice.py", **provenance(), "chosen_gamma": chosen, "rows": rows}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
