"""Which policies are at a torque limit for long, and whether that is since they are unstable on the arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, bounds_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.stability.linearisation import spectral_radius

__all__ = ["saturation"]

LONG = 0.01
"""Share of an evaluation's steps with a motor at its limit, from which on it is said."""


def saturation(rollouts: Sequence[Rollout], policies: Mapping[str, Any], arm: AnyArm, period: float) -> tuple[str, ...]:
    """Return a line for each policy that is at a torque limit for long, with the stability of its loop.

    The loop is that of `linearisation`: at rest, around postures of the arm's default path, in a control period [s].
    """
    limit, lines = bounds_of(arm).torque, []
    for name, policy in policies.items():
        reached = [(np.abs(run.torque) >= limit).any(axis=1) for run in rollouts if run.policy == name]
        share = float(np.concatenate(reached).mean())
        if share > LONG:
            text = f"{name}: a motor is at its torque limit in {100.0 * share:.0f} % of the steps; "
            lines.append(text + _stability(policy, arm, period))
    return tuple(lines)


def _stability(policy: Any, arm: AnyArm, period: float) -> str:
    try:
        if policy.action_period != period:
            raise ValueError("it holds its action for several control periods; see fuzzyarm margins")
        radius = spectral_radius(policy, arm, control_period=period)
    except (AttributeError, TypeError, ValueError) as error:
        return f"whether its loop is stable on this arm was not found: {' '.join(str(error).split())}"
    measured = f"spectral radius {radius:.3g} at rest, see fuzzyarm margins"
    if radius > 1.0:
        return f"its loop is unstable on this arm ({measured})"
    return f"its loop is stable ({measured}), the motion asks for more torque than there is"
