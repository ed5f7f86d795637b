"""What a policy answers when it is asked for its certificate."""

import json
from importlib import resources

import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy, tip_statement
from fuzzyarm.fuzzy_policy.proof.policy_certificate import statement

CIRCLE = JointReference()
PAPER_FORM = resources.files("fuzzyarm.fuzzy_policy.controllers") / "paper-4.json"


@pytest.fixture(scope="module")
def fuzzy():
    return load_policy("fuzzy-4", allow_unproven=True)


def test_the_fuzzy_policy_has_the_claim_of_its_controller_file(fuzzy):
    certificate, controller = fuzzy.certificate(CIRCLE), fuzzy.controller
    assert certificate.controller is controller and certificate.text == statement(controller)
    assert certificate.bounds == {
        "form": "consistent",
        "alpha": controller.alpha,
        "gamma": controller.gamma,
        "controller_digest": json.loads(controller.to_json())["digest"],
    }


def test_a_tip_policy_has_the_bounds_of_its_law_and_more_words(fuzzy):
    law, tip = fuzzy.certificate(CIRCLE), TipPolicy(fuzzy).certificate(CIRCLE)
    assert tip.bounds == law.bounds and tip.controller is law.controller
    assert tip.text == f"{law.text} {tip_statement(CIRCLE)}"


def test_motors_that_leave_the_box_leave_the_bounds_void(fuzzy):
    soft = ArmParameters(joint_limit=(3.0, 2.0055), stiffness=(6.4e4, 2e3))
    certificate = TipPolicy(fuzzy).certificate(JointReference(parameters=soft))
    assert certificate.bounds is None and "it has no certificate" in certificate.text


def test_the_proof_of_the_form_of_the_paper_does_not_hold_for_a_tip_policy():
    law = load_policy(PAPER_FORM, allow_unproven=True)
    assert law.certificate(CIRCLE).bounds["form"] == "paper"
    assert TipPolicy(law).certificate(CIRCLE) is None


def test_a_tip_policy_on_a_tip_policy_proves_nothing(fuzzy):
    """It would track θ_d of θ_d, of which no inequality speaks."""
    assert TipPolicy(TipPolicy(fuzzy)).certificate(CIRCLE) is None


@pytest.mark.parametrize("name", ["computed-torque", "computed-torque-tip", "elastic-observer", "ppo-robust"])
def test_other_policies_have_none(name):
    assert load_policy(name).certificate(CIRCLE) is None
