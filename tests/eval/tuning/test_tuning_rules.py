"""The rules that choose gains from rows that were measured."""

import math

import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.tuning import bandwidth, fuzzy_gains
from fuzzyarm.eval.tuning.conditions import radius_within

PAPER = ArmParameters()


def design(error, **changes):
    row = {
        "case_1_joint_error_rms_mrad": error,
        "gain_margin_upper": 4.1,
        "gain_margin_upper_1_sample_later": 1.6,
        "radius_worst_condition": 0.999,
    } | changes
    return {**row, "bears": fuzzy_gains.bears(PAPER, row)}


def test_the_fuzzy_design_with_the_smallest_error_that_bears_everything_is_chosen():
    rows = [
        design(0.1, gain_margin_upper=3.9),
        design(0.2, gain_margin_upper_1_sample_later=1.4),
        design(0.3, radius_worst_condition=radius_within(0.5, 1500) + 1e-9),
        design(0.4, gain_margin_upper=math.nan),
        design(0.6),
        design(0.5),
    ]
    assert fuzzy_gains.choice_of(rows) is rows[-1]
    assert fuzzy_gains.choice_of(rows[:4]) is None


def test_the_grid_of_table_1_is_the_papers_and_scales_with_inertia_and_decay_rate():
    assert fuzzy_gains.gammas_for(PAPER, 20.0) == fuzzy_gains.GAMMAS
    assert fuzzy_gains.gammas_for(PAPER, 10.0)[0] == pytest.approx(2 * fuzzy_gains.GAMMAS[0])
    # A tenth of every mass, moment of inertia and rotor is a tenth of the inertia.
    tenth = ArmParameters(mass=(1.5, 0.9), inertia=(0.031, 0.019), motor_inertia=(0.271, 0.05))
    assert fuzzy_gains.gammas_for(tenth, 20.0) == pytest.approx([10 * gamma for gamma in fuzzy_gains.GAMMAS])
    points = fuzzy_gains.points_of(PAPER, 4, 20.0)
    assert len(points) == 80 and {point.gamma for point in points[-10:]} == {max(fuzzy_gains.GAMMAS)}
    assert {point.fastest_pole for point in fuzzy_gains.points_of(PAPER, 2, 20.0)} == {None}


def loop(omega, error, **changes):
    return {
        "bandwidth": omega,
        "joint_error_rms_mrad": error,
        "gain_margin_upper": 2.5,
        "radius_delayed": 0.99,
        "decays_throughout": True,
    } | changes


def test_the_bandwidth_with_the_smallest_error_within_margins_is_chosen():
    rows = [
        loop(100.0, 0.1, gain_margin_upper=1.9),
        loop(90.0, 0.2, radius_delayed=1.0),
        loop(80.0, 0.3, decays_throughout=False),
        loop(70.0, None),
        loop(60.0, 0.5),
        loop(50.0, 0.4),
    ]
    assert bandwidth.choice_of(rows) is rows[-1]
    assert bandwidth.choice_of(rows[:4]) is None
