"""How close the rigid arm comes to what each controller file claims: decay rate and L2 gain.

    python benchmarks/certified_bounds.py [--json FILE]

Decay: the certified rate against the smallest -d ln V / 2dt of undisturbed rollouts, random ones and one started where
V decays slowest, and against the slowest pole of the loop frozen at any state of the box. Gain: the certified γ against
the largest ‖q - q_d‖₂ / ‖w‖₂ of disturbed rollouts from zero error, on the circle and at the worst held posture, and
against the largest H-infinity norm of a frozen loop. The inequality behind the certificate promises more than γ: the
same norm shifted by α, and that no rollout uses up the supply γ² ∫ wᵀw. A minute or two.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from measuring import options_of, printed, write

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.proof.invariant_set import invariant_set

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from support import rigid_loop
from support.rigid_loop import RigidLoop, gain_at

NAMES = (*(f"fuzzy-{rules}" for rules in (1, 2, 4, 8, 16, 32)), "fuzzy-4-sampled")
DURATION = 1.5  # [s] of a disturbed rollout; the circle takes as long


def decay(loop: RigidLoop) -> dict[str, float]:
    """Return the smallest rates of decay [1/s]: of V in rollouts, of V anywhere in the box, of a frozen pole."""
    random, (in_box, slowest) = rigid_loop.random_decay(loop), rigid_loop.slowest_decay(loop)
    return {
        "observed": float(min(random.rate.min(), slowest.rate.min())),
        "observed_random": float(random.rate.min()),
        "lyapunov": in_box,
        "pole": -loop.worst_point(lambda F, G, omega: np.linalg.eigvals(F).real.max(axis=-1))[0],
    }


def gain(loop: RigidLoop) -> dict[str, Any]:
    """Return the largest gains [rad/(N m)] in rollouts and of frozen loops, and the share of the supply used."""
    runs = [disturbed(loop, motion) for motion in (JointReference(), rigid_loop.worst_posture(loop))]
    (library_gain, probe), (worst, _) = (max(run[key] for run in runs) for key in ("library", "worst"))
    return {
        "observed": max(library_gain, worst),
        "observed_library": library_gain,
        "library_probe": probe,
        "supply_used": max(run["used"] for run in runs),
        "frozen": loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega))[0],
        "frozen_shifted": loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega - loop.controller.alpha))[0],
        "certified": loop.controller.gamma,
    }


def disturbed(loop: RigidLoop, motion: Any) -> dict[str, Any]:
    """Return the largest gains under the library and the worst torques, with names, and the largest supply used."""
    names, run = rigid_loop.disturbed(loop, motion, DURATION)
    if not run.in_box.all() or run.dissipation.max() > 0.0:
        raise RuntimeError("a rollout left the box or broke the dissipation inequality: the certificate is in doubt")
    gains = [*zip(run.gain.max(axis=0).tolist(), names, strict=True)]
    used = 1.0 + run.dissipation[1:] / (loop.controller.gamma**2 * run.input[1:])
    return {"library": max(gains[:-2]), "worst": max(gains[-2:]), "used": float(used.max())}


def assess(name: str) -> dict[str, Any]:
    """Return the certified, observed and frozen bounds of a shipped controller, and its invariant set."""
    loop = RigidLoop(load_policy(name).controller)
    decays, found = {"certified": loop.controller.alpha, **decay(loop)}, invariant_set(loop.controller)
    sizes = {"level": found.level, "disturbance_Nm": found.disturbance, "start_rad": found.start}
    return {"decay_per_s": decays, "gain_rad_per_Nm": gain(loop), "invariant_set": sizes}


def main() -> None:
    """Assess, print and optionally write."""
    options = options_of(__doc__).parse_args()
    rows = printed({"policy": name, **assess(name)} for name in NAMES)
    write(options.json, "certified_bounds.py", bounds={row.pop("policy"): row for row in rows})


if __name__ == "__main__":
    main()
