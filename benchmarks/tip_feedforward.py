"""The effect of each part of the compensation of the bending joints on the tip error.

    python benchmarks/tip_feedforward.py [--json FILE]

A law that leads the motors along q_d; the same law on θ_d; with friction feedforward; with the feedforward averaged
over the coming hold; with both, which is what the ending -tip stands for. Each in the three cases, and in the nominal
case on plants whose stiffness is five percent off what the policy believes. A few seconds.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from measuring import options_of, printed, write

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.policy import Predictor

LAWS = ("fuzzy-4", "computed-torque")
VARIANTS: dict[str, dict[str, bool] | None] = {
    "motors on q_d": None,
    "motors on θ_d": {"friction": False, "average": False},
    "and friction": {"friction": True, "average": False},
    "and averaged hold": {"friction": False, "average": True},
    "and both (-tip)": {"friction": True, "average": True},
}
WRONG = 0.05  # share by which the stiffness is off


def tip_error(policy: Predictor, case: str, stiffness: float = 1.0) -> dict[str, float]:
    """Return maximum and rms tip error [mm] of one episode on a plant with `stiffness` times that of Table 1."""
    arm = ArmParameters()
    plant = dataclasses.replace(arm, stiffness=tuple(stiffness * k for k in arm.stiffness))
    run = record_rollout(FuzzyArmEnv(case, parameters=plant), policy, policy_name="", case=case, seed=0)
    values = metrics_of(run)
    return {"max_mm": values["tip_error_max_mm"], "rms_mm": values["tip_error_rms_mm"]}


def assess(law: str, variant: str) -> dict[str, Any]:
    """Return one row."""
    options = VARIANTS[variant]
    policy = load_policy(law) if options is None else TipPolicy(load_policy(law), **options)
    wrong = [tip_error(policy, "nominal", factor) for factor in (1.0 - WRONG, 1.0 + WRONG)]
    return {
        "law": law,
        "variant": variant,
        **{case: tip_error(policy, case) for case in PAPER_CASES},
        "stiffness_wrong": max(wrong, key=lambda errors: errors["max_mm"]),
    }


def main() -> None:
    """Assess all variants, print and optionally write."""
    options = options_of(__doc__).parse_args()
    rows = printed(assess(law, variant) for law in LAWS for variant in VARIANTS)
    write(options.json, "tip_feedforward.py", wrong=WRONG, rows=rows)


if __name__ == "__main__":
    main()
