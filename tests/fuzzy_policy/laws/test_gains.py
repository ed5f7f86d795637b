"""Default gains: their linear algebra, and the rule that chooses them."""

import dataclasses
import itertools
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from fuzzyarm import ArmParameters, Robot, robot_named
from fuzzyarm.eval.stability._linearisation import linearise_at
from fuzzyarm.fuzzy_policy.known_arm import with_drives
from fuzzyarm.fuzzy_policy.laws import computed_torque, observer_gains
from fuzzyarm.fuzzy_policy.laws._gain_schedule import nearest_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws._riccati import exponential, riccati
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy, bandwidth_for
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import Condition, ObserverWeights, softened, weights_for, worst_radius
from fuzzyarm.numbers.linear import product, solved

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


RANDOM = np.random.default_rng(0)


def test_products_solutions_and_exponentials_of_several_matrices():
    a, b = RANDOM.normal(size=(3, 5, 5)), RANDOM.normal(size=(3, 5, 2))
    a[0, 0, 0] = 0.0  # needs a pivot
    np.testing.assert_allclose(product(a, b), a @ b, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(solved(a, b), np.linalg.solve(a, b), rtol=1e-11)
    wanted = expm(20.0 * a)
    np.testing.assert_allclose(exponential(20.0 * a), wanted, rtol=1e-9, atol=1e-10 * np.abs(wanted).max())
    np.testing.assert_array_equal(exponential(np.zeros((2, 2))), np.eye(2))
    assert np.isnan(solved(np.zeros((2, 2)), np.eye(2))).all()


def test_the_equation_is_solved_where_it_has_a_solution():
    A, B = RANDOM.normal(size=(4, 6, 6)), RANDOM.normal(size=(4, 6, 2))
    A[3], B[3] = np.eye(6), 0.0  # nothing can be stabilised there
    Q = np.broadcast_to(np.eye(6), A.shape)
    found = riccati(A, B @ np.swapaxes(B, -1, -2), Q)
    expected = [solve_discrete_are(a, b, np.eye(6), np.eye(2)) for a, b in zip(A[:3], B[:3], strict=True)]
    np.testing.assert_allclose(found[:3], expected, rtol=1e-9, atol=1e-9)
    assert np.isnan(found[3]).all()


PROGRAM = """
import sys
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import feedback_table
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, gain_tables
arm = chosen_arm(sys.argv[1], None)
_, *tables = gain_tables(arm, 1e-3, ObserverWeights())
print(*(table.tobytes().hex() for table in (*tables, feedback_table(arm, 1e-3, AdaptiveWeights()))))
"""


@pytest.mark.parametrize("robot", ["paper", pytest.param("planar-3r", marks=pytest.mark.slow)])
def test_gains_are_the_same_bits_with_every_kernel(robot):
    found = set()
    for kernel in ("Haswell", "Sandybridge"):  # which every processor of the last ten years can run; else ignored
        words, environment = [sys.executable, "-c", PROGRAM, robot], os.environ | {"OPENBLAS_CORETYPE": kernel}
        found.add(subprocess.run(words, env=environment, capture_output=True, check=True).stdout)
    assert len(found) == 1
