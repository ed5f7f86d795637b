"""The last link of a robot: Jacobian and drift against finite differences, rotation vectors against SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fuzzyarm.envs.physics.rigid_body import frames, gravity
from fuzzyarm.envs.physics.robot import robot_named, shipped_robots
from fuzzyarm.envs.scenario import kinematics
from fuzzyarm.envs.scenario.kinematics import angle_ranges, freedom, home_posture, jacobian, reach

every_robot = pytest.mark.parametrize("robot", [*map(robot_named, shipped_robots())], ids=shipped_robots())
STEP = 1e-6


def motions(robot, count=20):
    """Angles and velocities, (count, n) each."""
    generator = np.random.default_rng(1)
    low, high = angle_ranges(robot)
    return generator.uniform(low, high, (count, len(robot))), generator.normal(size=(count, len(robot)))


@every_robot
def test_the_last_link_turns_as_the_jacobian_says_within_reach(robot):
    q, dq = motions(robot)
    now, before, after = frames(robot, q), frames(robot, q - STEP * dq), frames(robot, q + STEP * dq)
    turned = kinematics._rotation_vector(after.rotation[:, -1] @ np.swapaxes(before.rotation[:, -1], -1, -2))
    rate = np.einsum("kij,kj->ki", jacobian(now), dq)
    np.testing.assert_allclose(turned / (2.0 * STEP), rate[:, 3:], atol=1e-8)
    np.testing.assert_allclose((after.tip - before.tip) / (2.0 * STEP), rate[:, :3], atol=1e-8)
    assert np.linalg.norm(now.tip - robot.arrays.position[0], axis=1).max() <= reach(robot)


@every_robot
def test_drift_is_the_rate_of_the_jacobian_times_the_velocity(robot):
    q, dq = motions(robot)
    rates = [np.einsum("kij,kj->ki", jacobian(frames(robot, q + sign * STEP * dq)), dq) for sign in (1, -1)]
    np.testing.assert_allclose(kinematics._drift(frames(robot, q), dq), (rates[0] - rates[1]) / (2.0 * STEP), atol=1e-7)


def test_rotation_vectors_are_those_of_scipy():
    vectors = np.random.default_rng(2).normal(size=(50, 3))
    vectors[0] = 0.0
    vectors[1] *= 1e-9
    found = kinematics._rotation_vector(Rotation.from_rotvec(vectors).as_matrix())
    np.testing.assert_allclose(found, vectors, atol=1e-12)


@pytest.mark.parametrize(("name", "moves", "turns"), [("paper", 2, 1), ("planar-3r", 2, 1), ("ur5", 3, 3)])
def test_planar_robots_are_found_out(name, moves, turns):
    can = freedom(robot_named(name))
    assert (len(can.motion), len(can.turning)) == (moves, turns)
    if moves == 2:
        np.testing.assert_array_equal(can.motion, np.eye(3)[:2])
        np.testing.assert_array_equal(can.turning, np.eye(3)[2:])


@every_robot
def test_the_home_posture_is_inside_the_ranges_and_can_be_held(robot):
    home, (low, high) = np.array(home_posture(robot)), angle_ranges(robot)
    assert ((low < home) & (home < high)).all()
    assert (np.abs(gravity(robot, home)) <= 0.5 * robot.drive("torque_limit")).all()
