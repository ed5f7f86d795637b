"""Numbers that a certificate states: what is printed is proven, also if it is rounded."""

import dataclasses
import json
import re
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slow_twins import slow_but
from support.shipped import CONTROLLERS

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, Controller
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.proof.certificate import certify, controller_statement
from fuzzyarm.proof.definiteness import stated
from fuzzyarm.proof.verification import Verification, verify_file
from fuzzyarm.synthesis import Specification, describe, design

ROUND = "(0.0002|0.00014|1000)"  # the gains of the shipped files, as they were designed


def shipped(name):
    return Controller.load(CONTROLLERS[name])


def numbers(pattern, text):
    """Return the groups of a pattern in a text as exact rationals."""
    found = re.search(pattern, text)
    assert found, text
    return [Fraction(group) for group in found.groups()]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_float_is_the_decimal_that_is_printed(value):
    number = stated(value)
    assert Fraction(int(number.p), int(number.q)) == Fraction(repr(value))


@settings(max_examples=50, deadline=None)
@given(
    alpha=st.floats(RATES[0], 0.4 * RATES[1]),
    strip=st.floats(1.001, 2.0),
    gamma=st.floats(*GAINS),
    box=st.tuples(st.floats(0.1, 3.14), st.floats(0.1, 100.0)),
)
def test_every_number_of_the_words_is_rounded_to_the_side_that_holds(alpha, strip, gamma, box):
    arm = ArmParameters(joint_limit=(box[0], 2.0), velocity_limit=(box[1], 15.0))
    pole = alpha * strip
    claimed = {"model": TSModel(arm), "alpha": alpha, "gamma": gamma, "fastest_pole": pole}
    text = controller_statement(dataclasses.replace(shipped("fuzzy-4"), **claimed))
    angle, _ = numbers(r"\|q\| <= \((\S+), (\S+)\) rad", text)
    speed, _ = numbers(r"\|dq/dt\| <= \((\S+), (\S+)\) rad/s", text)
    slowest, fastest = numbers(r"at least as exp\(-(\S+) t\) .* no faster than exp\(-(\S+) t\)", text)
    (largest,) = numbers(r"is at most (\S+) rad/\(N m\)", text)
    assert angle <= Fraction(repr(box[0])) and speed <= Fraction(repr(box[1]))
    assert slowest <= Fraction(repr(alpha)) and fastest >= Fraction(repr(pole))
    assert largest >= Fraction(repr(gamma))
    assert numbers(r"between -(\S+) and -(\S+) 1/s", text) == [fastest, slowest]
    for given_number, printed in ((alpha, slowest), (pole, fastest), (gamma, largest), (box[0], angle)):
        assert float(printed) == pytest.approx(given_number, rel=1e-2)


def words_of(controller):
    """What is said of a controller, but for the residual and the tip."""
    return Verification(Path("a.json"), certify(controller), 0.0, controller, None, None).to_text()


# As they stand, all shipped files are proven in test_shipped.py.
ONE_OF_EACH_KIND = ["fuzzy-1", "fuzzy-4", "paper-1", "paper-4-common-high-gain"]


@pytest.mark.parametrize("name", slow_but(ONE_OF_EACH_KIND, sorted(CONTROLLERS)))
def test_what_the_words_of_a_shipped_file_say_is_proven_itself(name):
    controller = shipped(name)
    text = words_of(controller)
    alpha, gamma = numbers(r"alpha = (\S+) 1/s, gamma = ([^\s,]+)", text)
    (printed,) = numbers(r"L2 gain from .* is at most ([\d.e-]+\d)", text)
    assert printed == gamma and re.search(rf"gamma = {ROUND}\b", text) and alpha == 20
    assert certify(dataclasses.replace(controller, alpha=float(alpha), gamma=float(gamma))).proven


def test_the_constants_of_the_shipped_four_rules_are_those_of_the_page():
    text = controller_statement(shipped("fuzzy-4"))
    page = (Path(__file__).parents[2] / "docs" / "theory" / "certificate.md").read_text(encoding="utf-8")
    whole, of_position = re.findall(r"<= (\S+) exp\(-20 t\) \|[xe]\(0\)\|", text)
    assert (whole, of_position) == ("9154", "3.119") and "9154" in page and "3.119" in page


def test_a_design_says_no_smaller_gain_than_it_proves():
    made = design(Specification(kept=(), alpha=20.00000049, gamma=2.0049e-4))
    assert "alpha = 20 1/s, gamma = 0.0002005," in describe(made)
    for text in (describe(made), words_of(made.controller)):
        assert "is at most 0.000201 rad/(N m)" in text and "0.0002 " not in text
    tighter = dataclasses.replace(made.controller, gamma=2e-4)
    assert not certify(tighter).proven
    assert certify(dataclasses.replace(tighter, gamma=0.000201)).proven


def test_the_residual_is_rounded_up_and_what_is_sampled_of_the_tip_is_no_bound():
    one_rule = verify_file(CONTROLLERS["fuzzy-1"])
    text, report = one_rule.to_text(), json.loads(json.dumps(one_rule.to_dict()))
    assert "The feedforward residual in d is at most (159, 98.4) N m along the paper's circle" in text
    assert report["residual_bound"][0] > 158.4843 and report["residual_bound"][1] > 98.3134
    sampled = one_rule.tip.split("Sampled at 501 instants")[1]
    assert "at most" not in sampled and "not bounded between them" in sampled
