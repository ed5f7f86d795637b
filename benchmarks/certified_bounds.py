"""How close the rigid arm comes to what each controller file claims: decay rate and L2 gain.

    python benchmarks/certified_bounds.py [--json FILE]

Decay: the certified rate against the smallest -d ln V / 2dt of undisturbed rollouts, random ones and one started where
V decays slowest, and against the slowest pole of the loop frozen at any state of the box. Gain: the certified γ against
the largest ‖q - q_d‖₂ / ‖w‖₂ of disturbed rollouts from zero error, on the circle and at the worst held posture, and
against the largest H-infinity norm of a frozen loop. The inequality behind the certificate promises more than γ: the
same norm shifted by α, and that no rollout uses up the supply γ² ∫ wᵀw. A minute or two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from measuring import options_of, printed, write

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.proof.rigid_loop import (
    Motion,
    RigidLoop,
    decay_rates,
    disturbed_run,
    gain_at,
    library,
    worst_posture,
    worst_torque,
)

NAMES = (*(f"fuzzy-{rules}" for rules in (1, 2, 4, 8, 16, 32)), "fuzzy-4-sampled")
DURATION = 1.5  # [s] of a disturbed rollout; the circle takes as long
WORST_GAIN, WORST_SUPPLY = "worst gain", "worst supply"  # names of the torques found by power iteration


def decay(loop: RigidLoop) -> dict[str, float]:
    """Return the smallest rates of decay [1/s]: of V in rollouts, of V anywhere in the box, of a frozen pole."""
    rates = decay_rates(loop)
    return {
        "observed": rates.observed,
        "observed_random": rates.random,
        "lyapunov": rates.in_box,
        "pole": -loop.worst_point(lambda F, G, omega: np.linalg.eigvals(F).real.max(axis=-1)).value,
    }


def gain(loop: RigidLoop) -> dict[str, Any]:
    """Return the largest gains [rad/(N m)] in rollouts and of frozen loops, and the share of the supply used."""
    alpha, gamma = loop.controller.alpha, loop.controller.gamma
    runs = [disturbed(loop, motion) for motion in (JointReference(), worst_posture(loop))]
    (library_gain, probe), (worst, _) = (max(run[key] for run in runs) for key in ("library", "worst"))
    return {
        "observed": max(library_gain, worst),
        "observed_library": library_gain,
        "library_probe": probe,
        "supply_used": max(run["used"] for run in runs),
        "frozen": loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega)).value,
        "frozen_shifted": loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega - alpha)).value,
        "certified": gamma,
    }


def disturbed(loop: RigidLoop, motion: Motion) -> dict[str, Any]:
    """Return the largest gains under the library and the worst torques, with names, and the largest supply used."""
    probes = library(DURATION)
    worst = {
        name: worst_torque(loop, motion, DURATION, stored=stored)
        for name, stored in ((WORST_GAIN, False), (WORST_SUPPLY, True))
    }
    run = disturbed_run(loop, motion, probes | worst, DURATION)
    if not run.in_box.all() or run.dissipation.max() > 0.0:
        raise RuntimeError("a rollout left the box or broke the dissipation inequality: the certificate is in doubt")
    gains = dict(zip([*probes, *worst], run.gain.max(axis=0).tolist(), strict=True))
    used = 1.0 + run.dissipation[1:] / (loop.controller.gamma**2 * run.input[1:])
    library_gain, worst_gain = (max((gains[name], name) for name in names) for names in (probes, worst))
    return {"library": library_gain, "worst": worst_gain, "used": float(used.max())}


def assess(name: str) -> dict[str, Any]:
    """Return the certified, observed and frozen bounds of a shipped controller."""
    loop = RigidLoop(load_policy(name, allow_unproven=True).controller)
    return {"decay_per_s": {"certified": loop.controller.alpha, **decay(loop)}, "gain_rad_per_Nm": gain(loop)}


def main() -> None:
    """Assess, print and optionally write."""
    options = options_of(__doc__).parse_args()
    rows = printed({"policy": name, **assess(name)} for name in NAMES)
    write(options.json, "certified_bounds.py", bounds={row.pop("policy"): row for row in rows})


if __name__ == "__main__":
    main()
