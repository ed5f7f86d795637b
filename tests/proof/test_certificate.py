"""The certificate: what it states holds on the arm, a changed file does not pass, and what policies have of it."""

import dataclasses
import json
import re

import numpy as np
import pytest
from support.shipped import CONTROLLERS

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.proof.certificate import certify, controller_statement
from fuzzyarm.proof.policy_certificate import certificate_of, tip_statement

CIRCLE = JointReference()


@pytest.fixture(scope="module")
def fuzzy():
    return load_policy("fuzzy-4", allow_unproven=True)


@pytest.fixture(scope="module")
def controller(fuzzy):
    return fuzzy.controller


def test_the_error_stays_below_the_constant_that_is_stated_and_not_below_one(controller):
    """From an error of position alone the whole norm grows first: without its constant the bound would be false."""
    text = certify(controller).statement
    whole, of_position = (float(re.search(rf"<= (\S+) exp\(-20 t\) \|{x}\(0\)\|", text)[1]) for x in "xe")
    angles = np.linspace(0.0, np.pi, 20)
    errors = np.zeros((6, len(angles)))
    errors[:2] = np.cos(angles), np.sin(angles)
    model, z = controller.model, premises(np.zeros(2), np.zeros(2), controller.model.parameters)
    gain = np.einsum("i,k,ikab->ab", *model.weights(z), controller.gains)
    F, h, largest = np.eye(6, k=-4), 2e-4, np.zeros(2)
    F[:4] = np.linalg.solve(model.E(z), model.A(z) @ np.eye(4, 6) + model.B @ gain)
    for step in range(1, 500):
        errors = errors + h * F @ (errors + 0.5 * h * F @ errors)
        sizes = [np.linalg.norm(errors[:size], axis=0).max() for size in (6, 2)]
        largest = np.maximum(largest, np.multiply(sizes, np.exp(controller.alpha * h * step)))
    assert 10.0 < largest[0] < whole and largest[1] < of_position < 4.0
    root = np.sqrt(np.linalg.cond(controller.P))
    assert root <= whole < 1.001 * root


SCALARS = {"alpha": 2.0, "gamma": 0.3, "fastest_pole": 0.5}


@pytest.mark.parametrize("field", [*SCALARS, "gains", "P", "Q", "X", "tau", "pole_Q", "pole_X", "pole_tau"])
def test_a_changed_value_fails_the_check(controller, field):
    changed = np.array(getattr(controller, field))
    changed.flat[0] *= SCALARS.get(field, -1.0)
    forged = dataclasses.replace(controller, **{field: float(changed) if field in SCALARS else changed})
    failed = {claim.name[:3] for claim in certify(forged).claims if not claim.proven}
    assert failed == {"Phi"} if "pole" in field else failed & {"Psi", "P >"}


def test_every_inequality_of_both_claims_is_proven(controller):
    certificate = certify(controller)
    assert certificate.proven and certificate.proof_margin > 1e-6
    names = [claim.name for claim in certificate.claims]
    assert len(names) == 13 and names[0] == "P > 0" and len(set(names)) == len(names)
    assert [name.replace("Phi", "Psi") for name in names[7:]] == names[1:7]
    proven, _, missing = certificate.statement.partition("Not covered:")
    for part in ("rigid arm in continuous time", "exp(-20 t)", "than exp(-200 t)", "between -200 and -20 1/s"):
        assert part in proven
    for part in ("elastic joints", "sampling", "torque limits", "leaves the box"):
        assert part in missing


def test_gains_raised_out_of_the_region_fail_in_phi_alone(controller):
    """Ψ limits no gain: with M - ρ Sᵀ and its own slack moved along it still holds, at any ρ; Φ does not."""
    S = np.eye(6)[:, 2:4]
    largest = max(np.linalg.eigvalsh(E[2:, 2:])[-1] for E in controller.model.E_vertices)
    inverse = np.linalg.inv(controller.P)
    rho = 1e6 / np.abs(inverse[2:4, :2]).max()
    moved = {"X": controller.X + rho * S @ S.T, "Q": controller.Q - rho / largest * S @ S.T}
    raised = dataclasses.replace(controller, gains=controller.gains - rho * S.T @ inverse, **moved)
    proven = [claim.proven for claim in certify(raised).claims]
    assert all(proven[:7]) and not any(proven[7:])


def test_a_fuzzy_policy_has_the_claim_of_its_controller_file_with_more_words_for_the_tip(fuzzy):
    controller, law, tip = fuzzy.controller, certificate_of(fuzzy, CIRCLE), certificate_of(TipPolicy(fuzzy), CIRCLE)
    claimed = {"form": "consistent", "alpha": controller.alpha, "gamma": controller.gamma}
    assert law.bounds == tip.bounds == claimed | {"controller_digest": json.loads(controller.to_json())["digest"]}
    assert law.controller is tip.controller is controller
    assert law.text == controller_statement(controller) and tip.text == f"{law.text} {tip_statement(CIRCLE)}"
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
