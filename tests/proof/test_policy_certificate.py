"""What a policy answers when it is asked for its certificate."""

import dataclasses
import json

import pytest
from support.shipped import CONTROLLERS

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.proof.certificate import controller_statement
from fuzzyarm.proof.policy_certificate import certificate_of, tip_statement

CIRCLE = JointReference()


@pytest.fixture(scope="module")
def fuzzy():
    return load_policy("fuzzy-4", allow_unproven=True)


def test_the_fuzzy_policy_has_the_claim_of_its_controller_file(fuzzy):
    certificate, controller = certificate_of(fuzzy, CIRCLE), fuzzy.controller
    assert certificate.controller is controller and certificate.text == controller_statement(controller)
    claimed = {"form": "consistent", "alpha": controller.alpha, "gamma": controller.gamma}
    assert certificate.bounds == claimed | {"controller_digest": json.loads(controller.to_json())["digest"]}


def test_a_tip_policy_has_the_bounds_of_its_law_and_more_words(fuzzy):
    law, tip = certificate_of(fuzzy, CIRCLE), certificate_of(TipPolicy(fuzzy), CIRCLE)
    assert tip.bounds == law.bounds and tip.controller is law.controller
    assert tip.text == f"{law.text} {tip_statement(CIRCLE)}"
    for words in ("for the error from theta_d", "takes 64 % of the box", "measured, not proven"):
        assert words in tip.text


def test_motors_that_leave_the_box_leave_the_bounds_void(fuzzy):
    soft = ArmParameters(joint_limit=(3.0, 2.0055), stiffness=(6.4e4, 2e3))
    certificate = certificate_of(TipPolicy(fuzzy), JointReference(parameters=soft))
    assert certificate.bounds is None and "it has no certificate" in certificate.text and "theta_d2" in certificate.text


def test_other_policies_have_none(fuzzy):
    """A tip policy would track θ_d of θ_d, or by the form of the paper: no inequality speaks of either."""
    paper = load_policy(CONTROLLERS["paper-4"], allow_unproven=True)
    assert certificate_of(paper, CIRCLE).bounds["form"] == "paper"
    others = map(load_policy, ("computed-torque", "computed-torque-tip", "elastic-observer", "ppo-robust"))
    assert all(certificate_of(one, CIRCLE) is None for one in (TipPolicy(paper), TipPolicy(TipPolicy(fuzzy)), *others))


def test_a_controller_that_is_not_proven_gives_no_certificate(fuzzy):
    """Whoever made the policy: the paper's printed gains, or a file that is loaded unproven."""
    gains = fuzzy.controller.gains.copy()
    gains[0, 0, 0, 0] *= -1.0
    changed = load_policy(dataclasses.replace(fuzzy.controller, gains=gains), allow_unproven=True)
    for policy in (changed, TipPolicy(changed), load_policy("paper-4-printed")):
        assert certificate_of(policy, CIRCLE) is None
