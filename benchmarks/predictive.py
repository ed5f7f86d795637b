"""Model-predictive control on the observers' estimates: does it gain anything, here and where the limits bind?

    python benchmarks/predictive.py [--json FILE]

At each sample minimise, over the torques of the next N samples,

    Σ |q error/link_angle|² + |q̇ error/link_velocity|² + |w/Γ|² + V(e_N),   e_(i+1) = A_i e_i + B_i w_i,   |u_i| <= Γ,

with u = u_ff - d̂ + w, the estimate (x̂, d̂), the weights and the target of ``elastic-observer``, not tuned again. A and B
are the elastic arm without dry friction, linearised along the reference, sample by sample; V is the value function of
the problem without limits from there on. Where no limit binds, the optimum is that of the Riccati recursion; otherwise
Clarabel solves the quadratic program. Unlike the other policies it is given the whole reference beforehand.

On the adaptive estimate u_ff, target, A and B are those of the arm, the payload and the forces on which
``adaptive-observer`` acts, and the weights are its regulator's; see `predictive_laws`.

Policies: the shipped observers; ``ltv``, the Riccati recursion with its torques clipped (preview, but no limits);
``mpc``; both on the adaptive estimate; and both with the payload told to feedforward, target, model and observer, which
no other policy is: what a perfect estimate would give. Tasks: the paper's cases, which are reported and not tuned on,
and the circle with 5 kg in durations around the one at which an arm that knew its payload would just reach its limits.
Three minutes on one core, one of which compiles the filter.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from predictive_laws import OnAdaptiveEstimate, OnElasticEstimate
from predictive_plan import HORIZON, LIMIT, PERIOD, Model, motion
from scipy.optimize import brentq

from fuzzyarm import load_policy, metrics_of, run_episode
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.provenance import current_provenance

SHARES = (1.1, 1.0, 0.95, 0.9)  # of the shortest duration that a known payload allows
PAYLOAD = 5.0  # kg


def loaded_peak(duration: float) -> float:
    """Return the largest share of the torque limits that the circle in a duration [s] needs with the payload."""
    torque = motion(JointReference(duration=duration), np.linspace(0.0, duration, 2001), Model.of(PAYLOAD))[1]
    return float(np.max(np.abs(torque) / LIMIT))


def policies_for(task: str, case: str, reference: JointReference) -> dict[str, Any]:
    """Return the policies of a task by name, each for one episode."""
    policies: dict[str, Any] = {name: load_policy(name) for name in ("elastic-observer", "adaptive-observer")}
    for payload in (0.0, PAYLOAD) if case == "payload" else (0.0,):
        for name in ("ltv", "mpc"):
            told = ", payload told" if payload else ""
            policies[name + told] = OnElasticEstimate(reference, name == "mpc", payload)
    for name in ("ltv", "mpc"):
        policies[f"{name}, adaptive estimate"] = OnAdaptiveEstimate(reference, name == "mpc")
    if task == "payload":
        policies["ltv, adaptive estimate, own start"] = OnAdaptiveEstimate(reference, False, own_start=True)
    return policies


def row(name: str, policy: Any, task: str, case: str, reference: JointReference) -> dict[str, Any]:
    """Return what a policy reaches in a task; its `optimum`, if it has one, counts its programs."""
    run, optimum = run_episode(policy, case, reference=reference), getattr(policy, "optimum", None)
    metrics = metrics_of(run)
    used = np.abs(run.torque) / LIMIT
    return {
        "policy": name,
        "task": task,
        "completed": run.completed,
        "rms_mm": metrics["tip_error_rms_mm"],
        "max_mm": metrics["tip_error_max_mm"],
        "at_limit": float((used > 1.0 - 1e-9).any(axis=1).mean()),
        "predict_us": metrics["predict_us"],
        "programs": optimum.solves if optimum else 0,
        "program_ms": 1e3 * optimum.seconds / optimum.solves if optimum and optimum.solves else None,
    }


def main() -> None:
    """Run every policy in every task, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    shortest = float(brentq(lambda duration: loaded_peak(duration) - 1.0, 0.5, 1.5, xtol=1e-4))
    print(f"with {PAYLOAD:g} kg the circle takes {shortest:.4f} s at least")
    tasks = [(case, case, JointReference()) for case in PAPER_CASES]
    for share in SHARES:
        duration = PERIOD * round(share * shortest / PERIOD)
        tasks.append((f"circle in {duration:.3f} s with {PAYLOAD:g} kg", "payload", JointReference(duration=duration)))
    rows = []
    for task, case, reference in tasks:
        for name, policy in policies_for(task, case, reference).items():
            rows.append(found := row(name, policy, task, case, reference))
            print(
                f"{task}: {name}: rms {found['rms_mm']:.4g}, max {found['max_mm']:.4g} mm, "
                f"at a limit {100 * found['at_limit']:.1f} %, {found['programs']} programs, "
                f"{'completed' if found['completed'] else 'ended early'}",
                flush=True,
            )
    if options.json:
        document = {
            "command": "python benchmarks/predictive.py",
            **current_provenance(),
            "horizon": HORIZON,
            "shortest_s": shortest,
            "rows": rows,
        }
        write_atomically(options.json, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
