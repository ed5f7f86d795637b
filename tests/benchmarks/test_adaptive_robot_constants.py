"""How `adaptive_robot_constants.py` weighs robots against each other."""

import itertools

import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.robot import robot_named


@pytest.fixture
def script(module):
    """The script, which imports its neighbours."""
    return module("adaptive_robot_constants")


def rows(script, *objectives):
    pairs = itertools.product(script.SHARES, script.SIGNIFICANT)
    return [
        {"share": share, "c": c, "objective_mm": value} for (share, c), value in zip(pairs, objectives, strict=True)
    ]


def test_a_robot_that_errs_more_weighs_as_much_as_one_that_errs_less(script):
    count = len(script.SHARES) * len(script.SIGNIFICANT)
    calm, rough = [0.1] * count, [100.0] * count
    calm[0], rough[1] = 0.05, 90.0
    pairs = script.relative({"calm": rows(script, *calm), "rough": rows(script, *rough)})
    assert [(pair["share"], pair["c"]) for pair in pairs[:3]] == [
        (script.SHARES[0], script.SIGNIFICANT[0]),
        (script.SHARES[0], script.SIGNIFICANT[1]),
        (script.SHARES[1], script.SIGNIFICANT[0]),
    ]
    assert [pair["objective"] for pair in pairs[:2]] == pytest.approx([(1.0 + 10.0 / 9.0) / 2.0, 1.5])
    assert min(pairs, key=lambda pair: pair["objective"]) is pairs[0]


@pytest.mark.slow
def test_a_course_that_a_negative_payload_explains_is_not_lost_in_the_second_pass(script):
    """The arm left this course in its second pass when the first could teach a payload below zero."""
    env = script.environments(robot_named("planar-3r"), 11, 42)[10]
    first, second = script.largest_errors(load_policy("adaptive-observer", robot="planar-3r"), env)
    assert second < first < 0.5  # mm
