"""The bandwidth of computed torque: as high as a rule allows that considers the nominal case and margins only.

Rule: the smallest rms motor-side joint error in the nominal case among the bandwidths 5, 10, ..., 160 rad/s whose upper
gain margin on the sampled elastic arm is at least 2 (6 dB), and with which small deviations at least halve within the
movement in every condition of `fuzzyarm margins`: with one extra sample of delay, another loop gain, softer and stiffer
joints, the arm's payload. The motor
side counts because a controller of this kind measures only the motors. The error includes the start: the motors begin
at their static deflection. A rollout alone does not show that a loop is unstable: the torque limits keep it in a small
limit cycle, and the episode ends regularly.
"""

from __future__ import annotations

import math
from typing import Any

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.stability.linearisation import Linearisable, gain_limits, largest_radius, linearise_path
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.tuning.finding import PERIOD, finite, periods_of, radius_within
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy

__all__ = ["BANDWIDTHS", "LEAST_GAIN_MARGIN", "assess", "assess_policy", "choice_of", "decays_throughout"]

BANDWIDTHS = [float(omega) for omega in range(5, 161, 5)]
"""The grid [rad/s]."""
_LEFT = 0.5  # of a small deviation after the movement
LEAST_GAIN_MARGIN = 2.0
"""Factor on the loop gain that a loop has to bear."""
_MEASURED = ("tip_error_max_mm", "tip_error_rms_mm", "joint_error_rms_mrad", "torque_peak_1", "torque_peak_2")
_MARGINS = ("radius", "radius_delayed", "gain_margin_lower", "gain_margin_upper", "gain_margin_upper_delayed")


def assess(arm: ArmParameters, bandwidth: float) -> dict[str, Any]:
    """Return the row of `assess_policy` for computed torque of a bandwidth [rad/s]."""
    policy = ComputedTorquePolicy(arm, PERIOD, bandwidth)
    return {"bandwidth": bandwidth} | assess_policy(arm, policy, f"{bandwidth:g} rad/s")


def assess_policy(arm: ArmParameters, policy: Any, name: str) -> dict[str, Any]:
    """Return one row: the nominal rollout and the margins; None for what an unstable loop does not have."""
    env = FuzzyArmEnv("nominal", parameters=arm)
    run = record_rollout(env, policy, policy_name=name, case="nominal", seed=0)
    measured = metrics_of(run) if run.completed else {}
    row: dict[str, Any] = {key: measured.get(key, math.nan) for key in (*_MEASURED, "torque_rate_rms")}
    try:
        loops = linearise_path(policy, arm, PERIOD)
        radii = largest_radius(loops), largest_radius(loops, delay=1)
        row |= zip(_MARGINS, (*radii, *gain_limits(loops), gain_limits(loops, 1).upper), strict=True)
    except ValueError:  # no equilibrium within the torque limits
        row |= dict.fromkeys(_MARGINS, math.nan)
    return {"policy": name} | finite(row) | {"decays_throughout": decays_throughout(arm, policy)}


def decays_throughout(arm: AnyArm, policy: Linearisable) -> bool:
    """Return whether deviations at least halve within the movement in every condition of `fuzzyarm margins`."""
    radii = policy_margins(policy, arm, PERIOD)["spectral_radius"].values()
    allowed = radius_within(_LEFT, periods_of(arm))
    return all(radius is not None and radius <= allowed for radius in radii)


def choice_of(rows: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the row that the rule picks; None if no bandwidth qualifies."""
    eligible = [
        row
        for row in rows
        if row["joint_error_rms_mrad"] is not None
        and row["gain_margin_upper"] is not None
        and row["gain_margin_upper"] >= LEAST_GAIN_MARGIN
        and row["radius_delayed"] < 1.0
        and row["decays_throughout"]
    ]
    return min(eligible, key=lambda row: float(row["joint_error_rms_mrad"])) if eligible else None
