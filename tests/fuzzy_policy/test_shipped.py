"""Every shipped controller file: proven, and a witness of what the README says of the paper."""

import json
from pathlib import Path

import numpy as np
import pytest
from slow_twins import slow_but
from support.shipped import CONTROLLERS

from fuzzyarm import Controller, certify
from fuzzyarm.fuzzy_policy.ts_model import NAMED_RULES

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


def load(name):
    return Controller.load(CONTROLLERS[name])


FEWER_RULES = [name for name in CONTROLLERS if "-32" not in name and "-16" not in name]


@pytest.mark.parametrize("name", slow_but(FEWER_RULES, sorted(CONTROLLERS)))
def test_every_file_is_proven(name):
    assert certify(load(name)).proven


@pytest.mark.parametrize("rules", NAMED_RULES)
def test_the_consistent_form_is_shipped_for_every_named_model(rules):
    controller = load(f"fuzzy-{rules}")
    assert (controller.form, controller.integral, controller.alpha) == ("consistent", True, 20.0)
    assert controller.model.kept == NAMED_RULES[rules]


def test_the_gains_found_on_the_sampled_arm_are_those_of_4_rules_times_six_factors():
    """One factor for the gains on angle, velocity and integral of each joint, at every vertex; see `tip_gains.json`."""
    sampled, plain = load("fuzzy-4-sampled"), load("fuzzy-4")
    assert (sampled.alpha, sampled.gamma, sampled.model.kept) == (20.0, 2e-4, plain.model.kept)
    found = json.loads((RESULTS / "tip_gains.json").read_text(encoding="utf-8"))["rows"][-1]
    factors = np.concatenate(found["factors"])
    np.testing.assert_array_equal(sampled.gains, plain.gains * factors)
    assert found["bears"] and factors.max() < 1.25


@pytest.mark.parametrize("rules", [4, 2, 1])
@pytest.mark.parametrize("kind", ["", "-integral", "-common", "-integral-common"])
def test_fewer_than_4_rules_are_feasible_in_the_paper_form_too(rules, kind):
    """Theorem 2 at the paper's alpha and Q, with |M_ik| <= 1e4 (24) and gains of order 1e4."""
    controller = load(f"paper-{rules}{kind}")
    assert (controller.form, controller.model.rules, controller.alpha) == ("paper", rules, 20.0)
    assert (controller.integral, controller.common_multiplier) == ("integral" in kind, "common" in kind)
    np.testing.assert_array_equal(controller.weight, [1e-5, 1e-5, 1.0, 1.0])
    n_e = controller.gains.shape[-1]
    M = controller.gains @ controller.P[:n_e, :n_e]
    assert np.linalg.norm(M, ord=2, axis=(-2, -1)).max() < 1e4 < np.abs(controller.gains[..., :4]).max() < 1e5
    free = load("paper-4-common-high-gain")  # without that bound gains of 1e9 are proven as well
    assert (free.form, free.model.rules) == ("paper", 4) and np.abs(free.gains[..., :2]).max() > 1e9
