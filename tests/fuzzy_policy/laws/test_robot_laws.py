"""The fixed laws for robots of any number of joints: against plain NumPy, and on the elastic robot itself."""

import functools

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.rigid_body import gravity, inverse_dynamics, mass_matrix
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.kinematics import home_posture
from fuzzyarm.fuzzy_policy.known_arm import constants_of, drives_of
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget
from fuzzyarm.fuzzy_policy.laws.gain_schedule import corners_of, kept_joints, schedule_of

NAMES = ("planar-3r", "ur5")
POLICIES = ("computed-torque", "computed-torque-tip", "elastic-observer")


@functools.cache
def policy_of(policy, name):
    return load_policy(policy, robot=name)


@functools.cache
def tip_errors(policy, name):
    """Tip errors [mm] of the default motion."""
    env, law = gym.make("fuzzyarm:FuzzyArm-v0", robot=name), policy_of(policy, name)
    (observation, _), state, done, errors = env.reset(seed=0), None, False, []
    while not done:
        action, state = law.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        errors.append(1e3 * info["tip_error"])
        done = terminated or truncated
    assert truncated, info["reason"]
    return np.array(errors)


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


@pytest.mark.slow
@pytest.mark.parametrize("policy", POLICIES)
def test_a_batch_answers_as_each_lane_would_alone_bit_for_bit(policy):
    law, n = policy_of(policy, "ur5"), 6
    rng = np.random.default_rng(1)
    home = np.tile(home_posture(robot_named("ur5")), (5, 1))
    batch = np.hstack([home, np.zeros((5, n)), home, np.zeros((5, 2 * n))]) + 1e-4 * rng.normal(size=(5, 5 * n))
    _, states = law.predict(batch)
    actions, after = law.predict(batch, states)
    assert actions.shape == (5, n) and after.shape == (5, law.memory_size)
    for lane in range(5):
        action, following = law.predict(batch[lane], states[lane])
        assert action.tobytes() == actions[lane].tobytes() and following.tobytes() == after[lane].tobytes()


@pytest.mark.slow
def test_the_observer_rests_under_gravity_without_correction():
    robot, law = robot_named("ur5"), policy_of("elastic-observer", "ur5").without_dry_friction()
    q, still = np.array(home_posture(robot)), np.zeros(6)
    motors = q + gravity(robot, q) / robot.drive("stiffness")
    torque, state = law.predict(np.concatenate([motors, still, q, still, still]))
    np.testing.assert_allclose(torque, gravity(robot, q), rtol=0, atol=1e-8)
    x, load = law.estimate(state)
    np.testing.assert_allclose(x[:12], np.concatenate([motors, q]), atol=1e-12)
    np.testing.assert_allclose(load, 0.0, atol=1e-8)


def test_the_schedule_keeps_the_angles_that_the_mass_matrix_depends_on():
    assert kept_joints(robot_named("planar-3r")) == (1, 2)
    robot = robot_named("ur5")
    kept = kept_joints(robot)
    assert 0 not in kept and len(kept) == 2
    q = np.zeros(6)
    q[list(kept)] = 2.0 * np.pi * np.array([3.25, -1.5]) / 8
    corners = corners_of(q.tolist(), kept, False, 8)
    assert sum(weight for _, weight in corners) == pytest.approx(1.0)
    found = {divmod(int(place), 8): weight for place, weight in corners}
    assert found == pytest.approx({(3, 6): 0.375, (4, 6): 0.125, (3, 7): 0.375, (4, 7): 0.125})


def test_of_three_joints_in_a_plane_the_table_holds_the_mass_matrix_itself():
    robot = robot_named("planar-3r")
    schedule = schedule_of(robot)
    for k, (second, third) in enumerate((a, b) for a in range(8) for b in range(8)):
        q = np.array([0.7, 2 * np.pi * second / 8, 2 * np.pi * third / 8])
        np.testing.assert_allclose(schedule.inertia[k], mass_matrix(robot, q), atol=1e-12)


def test_constants_and_drives_are_those_of_the_robot():
    robot = robot_named("panda")
    assert drives_of(robot).shape == (7, 7)
    np.testing.assert_array_equal(drives_of(robot)[2], robot.drive("stiffness"))
    assert np.isfinite(constants_of(robot)).all()


@pytest.mark.parametrize(
    ("name", "robot", "error", "message"),
    [
        ("fuzzy-4", "ur5", ValueError, "was designed for the two-joint arm, not for ur5"),
        ("ppo-robust", "ur5", ValueError, "was trained on the arm of Table 1 and knows no other"),
        ("computed-torque", "scara", ValueError, "unknown robot 'scara'; choose from: cicese, manutec-r3"),
        ("computed-torque", 3, TypeError, "robot is int"),
    ],
)
def test_what_knows_no_robot_says_so(name, robot, error, message):
    with pytest.raises(error, match=message):
        load_policy(name, robot=robot)
