"""The fixed laws for robots of any number of joints: against plain NumPy, and on the elastic robot itself."""

import functools

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics, mass_matrix
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.kinematics import home_posture
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget
from fuzzyarm.fuzzy_policy.laws.gain_schedule import schedule_of

NAMES = ("planar-3r", "ur5")
POLICIES = ("computed-torque", "computed-torque-tip", "elastic-observer")


@functools.cache
def policy_of(policy, name):
    return load_policy(policy, robot=name)


@functools.cache
def tip_errors(policy, name):
    """Tip errors [mm] of the default motion."""
    run = record_rollout(FuzzyArmEnv(robot=name), policy_of(policy, name), policy_name=policy, case="", seed=0)
    assert run.completed
    return 1e3 * run.tip_error


@pytest.mark.parametrize("name", slow_but(["planar-3r"], NAMES))
def test_computed_torque_is_its_equation(name):
    robot, policy = robot_named(name), policy_of("computed-torque", name)
    n, w = len(robot), policy.bandwidth
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, dq, dq_d, ddq_d = np.array(home_posture(robot)), *rng.normal(scale=0.3, size=(3, n))
        q_d, integral = q + 1e-4 * rng.normal(size=n), 1e-6 * rng.normal(size=n)
        wanted = ddq_d - 3 * w * (dq - dq_d) - 3 * w**2 * (q - q_d) - w**3 * integral
        torque = inverse_dynamics(robot, q, dq, wanted)
        torque += robot.drive("motor_inertia") * wanted + robot.drive("viscous_friction") * dq
        action, state = policy.predict(np.concatenate([q, dq, q_d, dq_d, ddq_d]), integral)
        limit = robot.drive("torque_limit")
        np.testing.assert_allclose(action, np.clip(torque, -limit, limit), rtol=1e-10, atol=1e-9)
        held = (np.abs(torque) > limit) & (np.sign(q - q_d) == -np.sign(torque))
        np.testing.assert_allclose(state, np.where(held, integral, integral + 1e-3 * (q - q_d)), rtol=1e-12)


@pytest.mark.parametrize("name", slow_but(["planar-3r"], NAMES))
def test_the_elastic_target_is_the_exact_reference(name):
    robot = robot_named(name)
    reference = default_reference(robot)
    n, target = len(robot), ElasticTarget(robot, 1e-3)
    t = np.arange(0.0, 0.3, 1e-3)
    observations = np.hstack([np.full((len(t), 2 * n), np.nan), *reference.sample(t)])
    memory, found, torque = np.zeros((1, target.memory_size)), np.zeros((len(t), 3 * n)), np.zeros((1, n))
    for k in range(len(t)):
        target.advance(observations[k : k + 1], memory, found[k : k + 1], torque)
    late = t > 0.02
    exact = np.hstack(ElasticReference(reference).sample(t[late]))
    np.testing.assert_allclose(found[late, :n], exact[:, :n], rtol=0, atol=1e-7)
    np.testing.assert_allclose(found[late, n : 2 * n], exact[:, n : 2 * n], rtol=0, atol=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_compensation_and_the_observer_bring_the_tip_onto_the_path(name):
    plain, tip, observed = (tip_errors(policy, name) for policy in POLICIES)
    assert plain.max() > 0.3
    assert tip.max() < 0.1 * plain.max()
    assert observed.max() < 0.2 * plain.max()


def test_of_three_joints_in_a_plane_the_table_holds_the_mass_matrix_itself():
    robot = robot_named("planar-3r")
    schedule = schedule_of(robot)
    for k, (second, third) in enumerate((a, b) for a in range(8) for b in range(8)):
        q = np.array([0.7, 2 * np.pi * second / 8, 2 * np.pi * third / 8])
        np.testing.assert_allclose(schedule.inertia[k], mass_matrix(robot, q), atol=1e-12)
