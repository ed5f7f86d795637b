"""Weights on robots: softened by no more than the regulator's stability at random postures asks for."""

import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.law import adaptive_weights_for, largest_radius, softened

PERIOD = 1e-3


def test_the_two_joint_arm_has_the_weights_of_table_1():
    assert adaptive_weights_for(ArmParameters(mass=(14.0, 8.0)), PERIOD) == AdaptiveWeights()


def test_a_robot_whose_regulator_is_stable_has_them_too():
    robot = robot_named("manutec-r3")
    assert largest_radius(robot, PERIOD, AdaptiveWeights()) < 1.0
    assert adaptive_weights_for(robot, PERIOD) == AdaptiveWeights()


@pytest.mark.slow
def test_the_smallest_factor_with_a_stable_regulator_is_taken():
    robot = robot_named("ur5")
    chosen = adaptive_weights_for(robot, PERIOD)
    assert chosen.travel_walk == AdaptiveWeights().travel_walk and chosen.link_angle > AdaptiveWeights().link_angle
    assert chosen.first_gain == 1.0  # what is softened for good needs no soft start
    assert largest_radius(robot, PERIOD, chosen) < 1.0 <= largest_radius(robot, PERIOD, softened(chosen, 0.5))
