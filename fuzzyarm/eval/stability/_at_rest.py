"""Remarks on policies that are at a torque limit for long, or whose sampled loop is unstable at rest."""

from __future__ import annotations

from typing import Any

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.eval.stability._linearisation import largest_radius, linearise_path

__all__ = ["remark_on"]

_LONG = 0.01  # share of the steps with a motor at its limit, above which there is a remark
_GROWTH = 1e-6  # tolerance of a spectral radius above 1: a memory that keeps its value has eigenvalue 1


def remark_on(name: str, policy: Any, arm: AnyArm, period: float, share: float) -> str | None:
    """Return a line on a policy if a motor is often at its torque limit or its loop is unstable at rest, else None.

    The loop is linearised as in `_linearisation`: at rest, in postures of the arm's default path.

    Args:
        name: name of the policy.
        policy: the policy to linearise.
        arm: plant and model of the policy.
        period: control period [s].
        share: share of the steps with a motor at its torque limit [1].
    """
    limited = f"a motor is at its torque limit in {100.0 * share:.0f} % of the steps; " if share > _LONG else ""
    try:
        if policy.action_period != period:
            raise ValueError("the policy holds each action for several control periods; use fuzzyarm margins")
        radius = largest_radius(linearise_path(policy, arm, period))
    except (AttributeError, TypeError, ValueError) as error:
        reason = f"it is unknown whether its loop is stable on this arm: {' '.join(str(error).split())}"
        return f"{name}: {limited}{reason}" if limited else None
    measured = f"spectral radius {radius:.3g} at rest, see fuzzyarm margins"
    if radius > 1.0 + _GROWTH:
        return f"{name}: {limited}its loop is unstable on this arm ({measured})"
    if limited:
        return f"{name}: {limited}its loop is stable ({measured}), but the motors lack the torque for the motion"
    return None
