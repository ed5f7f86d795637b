"""The proven bound of the tip error of a policy that was tuned, for the arm itself and for plants near it.

It is that of `fuzzyarm prove` along the arm's default circle. Margins and the motor error choose the gains, and between
equally good ones the float part of the bound, see `tip_deviation`; the bound says what they are worth on the elastic,
sampled arm. It is not searched for all designs, since each takes ten seconds.
"""

from __future__ import annotations

from fuzzyarm.common.rounding import at_most
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound
from fuzzyarm.eval.certified.tip.enclosures import NoBound
from fuzzyarm.eval.certified.tip.plant_set import SETS
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["PROVEN", "bounds_in_words", "measured_bounds"]

PROVEN = {"table-1": "tip_bound_mm", "near": "tip_bound_near_mm"}
"""Sets of plants around the arm, and the name of the bound in a finding [mm]."""


def measured_bounds(policy: Policy, arm: ArmParameters) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Return the bounds of a policy by the names of `PROVEN`, None where there is none, and a sentence for each such.

    Args:
        policy: that is for the arm.
        arm: in the middle of both sets.
    """
    found: dict[str, float | None] = {}
    notes = []
    for name, key in PROVEN.items():
        claim = TipClaim("the policy", "nominal", name, SETS[name], duration=default_reference(arm).duration)
        try:
            found[key] = 1e3 * find_bound(claim, policy=policy).largest
        except NoBound as error:
            found[key] = None
            notes.append(f"No bound of the tip error is proven for {_NAMED[name]}: {str(error).split(': ', 1)[1]}.")
    return found, tuple(notes)


_NAMED = {"table-1": "the arm itself", "near": "plants near it (set near)"}


def bounds_in_words(policy: str, folder: str, measured: dict[str, float | None]) -> str:
    """Return what is proven of the tip of a policy, one sentence, with the command that proves it; empty without it.

    Args:
        policy: its name in the folder.
        folder: of the tuning.
        measured: of its finding.
    """
    bounds = {name: measured.get(key) for name, key in PROVEN.items()}
    known = {name: bound for name, bound in bounds.items() if bound is not None}
    if not known:
        return ""
    within = ", ".join(f"within {at_most(bound, 2)} mm for {_NAMED[name]}" for name, bound in known.items())
    return (
        f"{policy}: tip {within}, proven at every sample of the default circle, for the elastic arm with sampled "
        f"control; `fuzzyarm prove --policy {folder}/{policy} --set {list(known)[-1]}` proves it again."
    )
