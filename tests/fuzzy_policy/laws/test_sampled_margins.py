"""The rule of the default gains: its linear loops against those of the policies, and what it chooses."""

import dataclasses
import itertools

import numpy as np
import pytest

from fuzzyarm import ArmParameters, Robot, robot_named
from fuzzyarm.eval.stability._linearisation import linearise_at
from fuzzyarm.fuzzy_policy.known_arm import with_drives
from fuzzyarm.fuzzy_policy.laws import computed_torque, observer_gains
from fuzzyarm.fuzzy_policy.laws._gain_schedule import nearest_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy, bandwidth_for
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import Condition, ObserverWeights, softened, weights_for, worst_radius

PERIOD = 1e-3
TWO = dataclasses.replace(Robot.of(ArmParameters()), gravity=(0.0, 0.0, 0.0))
"""Without gravity, which the linear loops leave out."""


def observer(place, inertia, weights):
    """The linear law of the observer at a place, with gains designed for an inertia."""
    given = place.robot, PERIOD, inertia, weights
    gains = observer_gains.feedback_gain(*given), observer_gains._observer_gain(*given)
    return observer_gains._linear_observer(place, *gains)


@pytest.mark.slow
@pytest.mark.parametrize("condition", [Condition(), Condition(1.5, 1), Condition(stiffness=1.2)])
def test_linear_loops_are_those_of_the_policies(condition):
    weights = softened(ObserverWeights(), 2.0)
    policy, schedule = ElasticObserverPolicy(TWO, PERIOD, weights), schedule_of(TWO)
    plant = with_drives(TWO, stiffness=condition.stiffness * TWO.drive("stiffness"))
    (place, *_), q = observer_gains.places_of(TWO, PERIOD, 1), np.array([0.4, 0.25 * np.pi])
    place = dataclasses.replace(place, q=q, inertia=nearest_inertia(schedule, q))  # at a point, M is that of the table
    for law, linear in (
        (policy, observer(place, place.inertia, weights)),
        (ComputedTorquePolicy(TWO, PERIOD, 50.0), computed_torque._linear_computed_torque(place, 50.0)),
    ):
        matrix = linearise_at(law, plant, q, PERIOD)[0].matrix(condition.loop_gain, condition.delay)
        # the policy's plant moves by a symplectic step, and the rule's by its exponential
        radius = np.abs(np.linalg.eigvals(matrix)).max()
        assert 1.0 - worst_radius(place, linear, (condition,)) == pytest.approx(1.0 - radius, rel=2e-2)


def test_the_two_joint_arm_keeps_its_gains_as_a_robot():
    robot = Robot.of(ArmParameters())
    assert bandwidth_for(robot, PERIOD) == bandwidth_for(ArmParameters(), PERIOD) == computed_torque._BANDWIDTH
    assert weights_for(robot, PERIOD) == weights_for(ArmParameters(), PERIOD) == ObserverWeights()


@pytest.mark.parametrize("name", ["planar-3r", pytest.param("panda", marks=pytest.mark.slow)])
def test_robots_get_the_largest_gains_with_margins(name):
    """The next larger bandwidth has no margins, nor have weights of the next smaller factor."""
    robot = robot_named(name)
    places, schedule = observer_gains.places_of(robot, PERIOD), schedule_of(robot)

    def bandwidth_radius(bandwidth):
        laws = [computed_torque._linear_computed_torque(place, bandwidth) for place in places]
        return max(map(worst_radius, places, laws, itertools.repeat(observer_gains.ONE_AT_A_TIME)))

    def observer_radius(weights):
        laws = [observer(place, nearest_inertia(schedule, place.q), weights) for place in places]
        return max(map(worst_radius, places, laws, itertools.repeat(observer_gains._CONDITIONS)))

    chosen = bandwidth_for(robot, PERIOD)
    assert bandwidth_radius(chosen) < 1.0 <= bandwidth_radius(chosen + 5.0)
    offered = [softened(ObserverWeights(), factor) for factor in observer_gains.SOFTENINGS]
    number = offered.index(weights_for(robot, PERIOD))
    assert observer_radius(offered[number]) < 1.0 <= observer_radius(offered[number - 1])
