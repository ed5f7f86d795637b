"""The proven bound of the tip error of a policy that was tuned, for the arm itself and for plants near it.

It is the bound of `fuzzyarm prove` along the arm's default circle, and takes ten seconds to find. Margins and the
motor error choose the gains. Between equally good ones the float part of the bound for any friction decides, see
`largest_deviation`. With the closed loop x⁺ = Φ x + B w at a posture, where w is the friction of the motors held over a
control period, |w| <= F_s, and J is the Jacobian of the tip,

    max over directions d of Σ_k |dᵀ J Φ^k B| F_s

is the largest deviation of the tip that any course of this friction can cause. It is the largest part of the proven
bound of the set ``any-friction``, here at frozen postures and in floats.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuzzyarm.common.arithmetic import at_most
from fuzzyarm.envs.physics.dynamics import tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import State, columns
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.stability.linearisation import LocalLoop
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.enclosures import NoBound
from fuzzyarm.proof.tip.plant import SETS

__all__ = ["bounds_in_words", "largest_deviation", "measured_bounds"]


_DIRECTIONS = 16  # of the tip; the largest deviation along them is at most 0.5 % below the largest one


def largest_deviation(loops: Sequence[LocalLoop], arm: ArmParameters, periods: int) -> float:
    """Return the largest deviation of the tip [m] that friction of any course up to the static one can cause.

    The loops, at postures of the arm, are stable, and the torque reads all of the policy's memory at each of them.
    """
    at = columns(State)
    turns = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    postures = np.array([loop.equilibrium[at.link] for loop in loops])
    rows = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ tip_jacobian(postures, arm.length)
    matrices = np.array([loop.matrix() for loop in loops])
    states = len(loops[0].plant)
    moved = np.zeros((*matrices.shape[:2], len(arm.static_friction)))
    moved[:, :states] = [loop.plant[:, states:] for loop in loops]
    total = np.zeros((len(loops), _DIRECTIONS))
    for _ in range(periods):
        total += np.abs(rows @ moved[:, at.link]) @ np.array(arm.static_friction)
        moved = matrices @ moved
    return float(total.max())


_PROVEN = {"table-1": ("tip_bound_mm", "the arm itself"), "near": ("tip_bound_near_mm", "plants near it (set near)")}
"""Sets of plants around the arm: the name of the bound in a finding [mm], and the set in words."""


def measured_bounds(policy: Policy, arm: ArmParameters) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Return the bounds of a policy by the names of `_PROVEN`; None where no bound is proven, with a sentence why."""
    found: dict[str, float | None] = {}
    notes = []
    for name, (key, words) in _PROVEN.items():
        claim = TipClaim("the policy", "nominal", name, SETS[name], duration=default_reference(arm).duration)
        try:
            found[key] = 1e3 * find_bound(claim, policy=policy).largest
        except NoBound as error:
            found[key] = None
            notes.append(f"No bound of the tip error is proven for {words}: {str(error).split(': ', 1)[1]}.")
    return found, tuple(notes)


def bounds_in_words(policy: str, folder: str, measured: dict[str, float | None]) -> str:
    """Return a sentence on the proven bounds of a policy's tip, with the command that proves them; "" without a bound.

    `policy` is the name in the folder of the tuning; `measured` is that of its finding.
    """
    found = {name: measured.get(key) for name, (key, _) in _PROVEN.items()}
    known = {name: bound for name, bound in found.items() if bound is not None}
    if not known:
        return ""
    within = ", ".join(f"within {at_most(bound, 2)} mm for {_PROVEN[name][1]}" for name, bound in known.items())
    return (
        f"{policy}: tip {within}, proven at every sample of the default circle, for the elastic arm with sampled "
        f"control; `fuzzyarm prove --policy {folder}/{policy} --set {list(known)[-1]}` proves it again."
    )
