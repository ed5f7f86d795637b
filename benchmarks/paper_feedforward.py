"""The family of the paper's form from the smallest L to the consistent one: gains, proofs and errors in three cases.

    python benchmarks/paper_feedforward.py [--json FILE]

Theorems 1 and 2 leave L free. Here L is a share of the consistent form's, 0 to 1, and K and H are designed for each,
with the smallest bound on the gains at alpha = 20, gamma = 1000 and the paper's Q, as `fuzzyarm design --theorem paper
--feedforward SHARE` does; every member is proven before it is simulated. "solver" leaves L to the solver, and
"paper" takes the L that the paper prints (for i = 1, used for i = 2 too) with K and H of the share 0, with 4 rules.
The share is not chosen by any of the cases: all shares need the same gains within 0.3 %, and the smallest L is shipped.

Nearest to the paper is, on each side of the joints, the member with the smallest sum of the differences from 1.3 mm in
Case 1 and from -2.3 mm and 4.4 mm in Case 2. Six minutes, almost all of them for 32 rules.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.rollout import Rollout, record_rollout
from fuzzyarm.eval.paper.evidence import PAPER_L
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.states import INTEGRAL, POSITION, VELOCITY
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES
from fuzzyarm.proof.certificate import certify
from fuzzyarm.synthesis import Specification, design
from fuzzyarm.synthesis.search import scaled_gain

COMMAND = "python benchmarks/paper_feedforward.py"
RULES = (4, 32)
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
GAMMA = 1000.0
SIDES = {"tip": "circularity_error", "motors": "circularity_error_motor"}
PAPER = {"nominal": 1.3, "machining": (-2.3, 4.4)}  # mm


def members(rules: int) -> dict[str, Controller]:
    """Return the members of the family by their share of L, and those with other L."""
    asked = Specification(NAMED_RULES[rules], "paper", gamma=GAMMA, common_multiplier=rules == min(RULES))
    found = {f"{s:g}": design(dataclasses.replace(asked, feedforward=s)).controller for s in SHARES}
    if rules == min(RULES):
        found["paper"] = dataclasses.replace(found["0"], feedforward=np.stack([PAPER_L] * len(PAPER_L)))
    found["solver"] = design(dataclasses.replace(asked, feedforward=None)).controller
    return found


def measured(rules: int, name: str, controller: Controller, reference: JointReference) -> dict[str, Any]:
    """Return gains, whether they are proven, and errors [mm] of a member."""
    K = np.abs(controller.gains)
    row: dict[str, Any] = {
        "rules": rules,
        "L": name,
        "proven": bool(certify(controller).proven),
        "gain_bound": scaled_gain(controller),
        "position_gain": float(K[..., POSITION].max()),
        "velocity_gain": float(K[..., VELOCITY].max()),
        "integral_gain": float(K[..., INTEGRAL].max()),
        "largest_L": float(np.abs(controller.feedforward_gains).max()),
    }
    for case in PAPER_CASES:
        env = FuzzyArmEnv(case=case, reference=reference)
        run = record_rollout(env, FuzzyPolicy(controller), policy_name=name, case=case, seed=0)
        row[case] = {side: _ends(run, field) for side, field in SIDES.items()} | {"end": float(run.time[-1])}
    row["distance_mm"] = {side: distance(row, side) for side in SIDES}
    return row


def _ends(run: Rollout, field: str) -> list[float]:
    error = 1e3 * getattr(run, field)
    return [float(error.min()), float(error.max())]


def distance(row: dict[str, Any], side: str) -> float:
    """Return the sum of the differences [mm] from the paper's three numbers on one side of the joints."""
    largest = max(map(abs, row["nominal"][side]))
    ends = zip(row["machining"][side], PAPER["machining"], strict=True)
    return abs(largest - PAPER["nominal"]) + sum(abs(ours - papers) for ours, papers in ends)


def draw(document: dict[str, Any]) -> Figure:
    """Return the range of the circularity error over the share of L, for each case and side."""
    rows, figure = document["rows"], Figure(figsize=(10.0, 5.2))
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes_row, side in zip(grid, SIDES, strict=True):
        for number, (axes, case) in enumerate(zip(axes_row, PAPER_CASES, strict=True), start=1):
            for index, rules in enumerate(RULES):
                of = [row for row in rows if row["rules"] == rules and row["L"] not in ("paper", "solver")]
                shares, ends = [float(row["L"]) for row in of], np.array([row[case][side] for row in of])
                axes.fill_between(shares, ends[:, 0], ends[:, 1], color=f"C{index}", alpha=0.25, label=f"{rules} rules")
                axes.plot(shares, ends, color=f"C{index}")
            for value in np.ravel({"nominal": (-1.3, 1.3), "machining": (-2.3, 4.4)}.get(case, ())):
                axes.axhline(value, color="black", linestyle=":", linewidth=1.0)
            axes.set_title(f"Case {number}, {side}")
        axes_row[0].set_ylabel("circularity error [mm]")
    for axes in grid[-1]:
        axes.set_xlabel("L as a share of the consistent form's")
    grid[0, 0].legend(loc="upper right", fontsize="small")
    return figure


def main() -> None:
    """Design, prove, simulate and print a line for each member; optionally write and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows, reference = [], JointReference()
    for rules in RULES:
        for name, controller in members(rules).items():
            rows.append(measured(rules, name, controller, reference))
            print(json.dumps(rows[-1]), flush=True)
    nearest = {
        side: {name: best[name] for name in ("rules", "L")}
        for side in SIDES
        for best in [min((row for row in rows if row["L"] != "paper"), key=lambda row: row["distance_mm"][side])]
    }
    print("nearest to the paper:", json.dumps(nearest))
    if options.json:
        document = {"command": COMMAND, "gamma": GAMMA, **current_provenance(), "nearest": nearest, "rows": rows}
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
