"""`learned-observer` of robots by their frames: what its network sees, its bundles, and that it acts."""

import dataclasses

import numpy as np
import pytest
from support.bundles import estimate_network

from fuzzyarm import load_policy
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import filled
from fuzzyarm.envs.physics.rigid_body import tip_jacobian
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.fuzzy_policy.known_arm import _constants_of as constants_of
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateBundle
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import context_of, context_parts, scale_of, turns_of, units_of

PLANAR, PERIOD = robot_named("planar-3r"), 1e-3


def test_a_bundle_of_a_robot_is_refused_for_any_other(tmp_path):
    folder = tmp_path / "mine"
    EstimateBundle(estimate_network(3, 3), ArmDefinition(PLANAR.name, PLANAR.digest), PERIOD).save(folder)
    assert EstimateBundle.load(folder).serves(dataclasses.replace(PLANAR, name="the same numbers"))
    for robot in ("ur5", "paper", dataclasses.replace(PLANAR, gravity=(9.8, 0.0, 0.0))):
        with pytest.raises(ValueError, match="mine was trained on planar-3r and works on no other; use adaptive-obs"):
            load_policy(folder, robot=robot)


def test_units_of_a_robot_are_those_of_the_same_arm_and_angles_add_about_parallel_axes():
    paper, robot = ArmParameters(), Robot.of(ArmParameters())
    assert scale_of(robot) == scale_of(paper) == (1.0, 1.0, 1.0)
    for name in ("torque", "load", "velocity", "acceleration", "slow", "slow_tip", "rest", "length"):
        np.testing.assert_allclose(getattr(units_of(robot), name), getattr(units_of(paper), name), rtol=1e-12)
    np.testing.assert_array_equal(turns_of(robot), turns_of(paper))
    np.testing.assert_array_equal(turns_of(paper), [0, 1])
    np.testing.assert_array_equal(turns_of(robot_named("ur5")), [0, 0, 1, 1, 0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_the_context_of_a_robot_is_its_equations(name):
    robot = robot_named(name)
    joints, physics, units = len(robot), equations_of(robot), units_of(robot)
    part, generator = context_parts(joints, 3), np.random.default_rng(0)
    c, o, feedforward = np.empty(part.motion.stop), generator.normal(size=5 * joints), generator.normal(size=joints)
    limit, turns = robot.drive("torque_limit"), turns_of(robot)
    seen = observed(o)
    arm = filled(physics.Arm, constants_of(robot))
    context_of(physics)(seen, feedforward, limit, turns, arm, units, c)
    q, _, _, dq, ddq = np.split(o, 5)
    jacobian = tip_jacobian(robot, q)
    velocity = jacobian @ dq
    travel = velocity / np.sqrt(velocity @ velocity + (0.02 * scale_of(robot).length) ** 2)
    psi = [q[0]]
    for angle, turn in zip(q[1:], turns[1:], strict=True):
        psi.append(angle + turn * psi[-1])
    np.testing.assert_allclose(c[part.angles], np.ravel([np.cos(psi), np.sin(psi)], order="F"), atol=1e-12)
    np.testing.assert_allclose(c[part.travel], travel, atol=1e-12)
    np.testing.assert_allclose(c[part.lever], jacobian.T @ travel / scale_of(robot).length, atol=1e-12)
    np.testing.assert_allclose(c[part.velocities], dq / units.velocity)
    np.testing.assert_allclose(c[part.accelerations], ddq / units.acceleration)
    np.testing.assert_allclose(c[part.feedforward], feedforward / limit)


@pytest.mark.slow
def test_the_margins_of_a_robot_are_the_elastic_observers():
    policies = LearnedObserverPolicy(estimate_network(3, 3), PLANAR, PERIOD), ElasticObserverPolicy(PLANAR, PERIOD)
    own, base = (policy_margins(one, PLANAR, PERIOD)["spectral_radius"]["nominal"] for one in policies)
    assert own == base
    with pytest.raises(ValueError, match="the network is for 6 joints and a tip in 3 axes, the arm has 3 and 3"):
        LearnedObserverPolicy(estimate_network(6, 3), PLANAR, PERIOD)
