"""What a tuning says of the proven bound of the tip error."""

import types

import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.stability.margins import LIMITS
from fuzzyarm.eval.tuning import tip_bounds
from fuzzyarm.eval.tuning.steps import FUZZY, found
from fuzzyarm.eval.tuning.summary import decision, summary
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies.tip_bound import TipClaim, find_bound
from fuzzyarm.proof.tip.enclosures import NoBound

SOFT = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 5e3))


def policy():
    return TipPolicy(ComputedTorquePolicy(SOFT, 1e-3, 40.0))


def test_the_arm_of_a_bound_is_that_of_the_policy():
    """The soft arm follows the circle closely with the policy that knows it; its start has other motors' angles."""
    own = find_bound(TipClaim("it", steps=3), policy=policy())
    papers = find_bound(TipClaim("computed-torque-tip", steps=3))
    assert own.largest < 1e-6
    assert abs(own.steps[0].segments[0].end[0] - papers.steps[0].segments[0].end[0]) > 1e-3


def test_a_set_without_a_bound_is_one_sentence(monkeypatch):
    def find(claim, policy):
        if claim.set_name == "near":
            raise NoBound("it, nominal, set near: no bound beyond t = 0.048 s: motor 1 may reach its limit")
        return types.SimpleNamespace(largest=5.71e-6)

    monkeypatch.setattr(tip_bounds, "find_bound", find)
    measured, notes = tip_bounds.measured_bounds(policy(), SOFT)
    assert measured == {"tip_bound_mm": pytest.approx(5.71e-3), "tip_bound_near_mm": None}
    assert notes == (
        "No bound of the tip error is proven for plants near it (set near): no bound beyond t = 0.048 s: motor 1 may "
        "reach its limit.",
    )
    step = found(SOFT, FUZZY, {"alpha": 15.0}, measured, {"nominal": 0.9}, tried=1, rule="The smallest.", notes=notes)
    row = {"policy": FUZZY, "control_period": 1e-3, "spectral_radius": {"nominal": 0.9}, "reasons": {}}
    row["loop_gain"] = dict.fromkeys(LIMITS)
    page = summary(SOFT, "my-arm", [step], {"rows": [row], "method": {"control_period": 1e-3, "postures": 1}})
    assert "fuzzy-4-tip: tip within 0.0058 mm for the arm itself, proven at every sample" in page
    assert "`fuzzyarm prove --policy my-arm/fuzzy-4-tip --set table-1`" in page and notes[0] in page
    assert "alpha 15 1/s" in decision(step)
