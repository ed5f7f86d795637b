"""The float part of the bound of the tip error for any friction: what the linear sampled loop makes of such a friction.

With the closed loop x⁺ = Φ x + B w at a posture, w the friction of the motors held over a control period, |w| <= F_s,
and J the Jacobian of the tip,

    max over directions d of Σ_k |dᵀ J Φ^k B| F_s

is the largest deviation of the tip that friction of any such course can cause. It is what the proven bound of the set
``any-friction`` is mostly made of, at frozen postures and in floats; it proves nothing, and takes some hundredths of a
second in place of ten.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuzzyarm.envs.physics.dynamics import tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import State, columns
from fuzzyarm.eval.stability.local_loop import LocalLoop

__all__ = ["largest_deviation"]

DIRECTIONS = 16
"""Of the tip; the largest deviation along them is at most 0.5 % below the largest one."""


def largest_deviation(loops: Sequence[LocalLoop], arm: ArmParameters, periods: int) -> float:
    """Return the largest deviation of the tip [m] that friction of any course up to the static one can cause.

    Args:
        loops: at postures; stable, and of a policy whose torque reads all of its memory at each of them.
        arm: of the loops, with its static friction [N m] and its lengths [m].
        periods: control periods of the sum.
    """
    at = columns(State)
    turns = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    postures = np.array([loop.equilibrium[at.link] for loop in loops])
    rows = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ tip_jacobian(postures, arm.length)
    matrices = np.array([loop.matrix() for loop in loops])
    states = len(loops[0].plant)
    moved = np.zeros((*matrices.shape[:2], len(arm.static_friction)))
    moved[:, :states] = [loop.plant[:, states:] for loop in loops]
    total = np.zeros((len(loops), DIRECTIONS))
    for _ in range(periods):
        total += np.abs(rows @ moved[:, at.link]) @ np.array(arm.static_friction)
        moved = matrices @ moved
    return float(total.max())
