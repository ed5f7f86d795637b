"""The bandwidth of computed torque: as high as a rule allows that considers only the nominal case and margins.

Rule: the smallest rms error of the motors in the nominal case among the bandwidths 5, 10, ..., 160 rad/s whose upper
gain margin on the sampled elastic arm is at least 2 (6 dB), and with which small deviations at least halve within the
movement in every condition of `fuzzyarm margins`: with one extra sample of delay, another loop gain, softer and stiffer
joints, the arm's payload. A rollout alone does not show that a loop is unstable: the torque limits keep it in a small
limit cycle, and the episode ends regularly.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.tuning.finding import PERIOD, halving_radius
from fuzzyarm.eval.tuning.search import Context, Found, motor_error, nothing
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy

__all__ = ["BANDWIDTHS", "find_bandwidth"]

BANDWIDTHS = [float(omega) for omega in range(5, 161, 5)]
"""The grid [rad/s]."""
_LEAST_GAIN_MARGIN = 2.0


def find_bandwidth(context: Context) -> Found:
    """Return the bandwidth ω [rad/s] that the rule picks for a two-joint arm."""
    arm: ArmParameters = context.arm
    row = _choice_of(context.run(functools.partial(_assessed, arm), BANDWIDTHS), halving_radius(arm))
    if row is None:
        reason = f"No bandwidth from {BANDWIDTHS[0]:g} to {BANDWIDTHS[-1]:g} rad/s has these margins."
        return nothing(reason, len(BANDWIDTHS))
    measured = {
        "joint_error_rms_mrad": row["motor_error"],
        "gain_margin_upper": row["loop_gain"]["upper"],
        "gain_margin_upper_delayed": row["loop_gain"]["upper_one_sample_later"],
    }
    return Found({"bandwidth": row["bandwidth"]}, measured, row["spectral_radius"], len(BANDWIDTHS))


def _assessed(arm: ArmParameters, bandwidth: float) -> dict[str, Any]:
    """Return the motor error [mrad] and the margins of a bandwidth [rad/s]."""
    policy = ComputedTorquePolicy(arm, PERIOD, bandwidth)
    return {"bandwidth": bandwidth, "motor_error": motor_error(policy, arm), **policy_margins(policy, arm, PERIOD)}


def _choice_of(rows: list[dict[str, Any]], allowed: float) -> dict[str, Any] | None:
    """Return the row that the rule picks, for the largest spectral radius allowed; None if no bandwidth qualifies."""
    eligible = [
        row
        for row in rows
        if row["motor_error"] < math.inf
        and (row["loop_gain"]["upper"] or 0.0) >= _LEAST_GAIN_MARGIN
        and all(radius is not None and radius <= allowed for radius in row["spectral_radius"].values())
    ]
    return min(eligible, key=lambda row: float(row["motor_error"]), default=None)
