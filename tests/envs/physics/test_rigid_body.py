"""The textbook functions of a robot: identities of mechanics, and MuJoCo and the paper's equations as oracles."""

import mujoco
import numpy as np
import pytest
from support.robots import ROBOTS, in_mujoco, potential_energy

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.dynamics import tip_jacobian as planar_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot

STEP = 1e-6


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


def motion(robot, count=5):
    return np.random.default_rng(1).uniform(-2.0, 2.0, (3, count, len(robot)))


def derivative(function, q):
    """Central differences along each joint, on a new last axis."""
    steps = STEP * np.eye(q.shape[-1])
    return np.stack([(function(q + step) - function(q - step)) / (2.0 * STEP) for step in steps], axis=-1)


def test_jacobian_and_gravity_are_gradients(robot):
    q = motion(robot)[0]
    tip = derivative(lambda at: rigid_body.frames(robot, at).tip, q)
    np.testing.assert_allclose(rigid_body.tip_jacobian(robot, q), tip, atol=1e-8)
    potential = derivative(lambda at: potential_energy(robot, at), q)
    np.testing.assert_allclose(rigid_body.gravity(robot, q), potential, atol=1e-6)


def test_mujoco_agrees(robot):
    with pytest.raises(ValueError, match=r"angles.* must have shape \(\.\.\., \d\).*\(9,\)"):
        rigid_body.frames(robot, np.zeros(9))
    model = in_mujoco(robot)
    data, mass = mujoco.MjData(model), np.empty((len(robot), len(robot)))
    for q, dq, ddq in np.moveaxis(motion(robot), 0, 1):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(rigid_body.inverse_dynamics(robot, q, dq, ddq), data.qfrc_inverse, atol=1e-10)
        np.testing.assert_allclose(rigid_body.frames(robot, q).tip, data.site("tip").xpos, atol=1e-10)
        mujoco.mj_fullM(model, data, mass)
        np.testing.assert_allclose(rigid_body.mass_matrix(robot, q), mass, atol=1e-10)


def test_the_two_joint_arm_has_the_equations_of_the_paper():
    parameters = ArmParameters(inertia=(0.5, 0.1))
    robot = Robot.of(parameters)
    q, dq, ddq = motion(robot)
    wanted = rigid_inverse_dynamics(q, dq, ddq, arm_constants(parameters))
    np.testing.assert_allclose(rigid_body.inverse_dynamics(robot, q, dq, ddq), wanted, atol=1e-12)
    planar = rigid_body.tip_jacobian(robot, q)[..., :2, :]
    np.testing.assert_allclose(planar, planar_jacobian(q, parameters.length), atol=1e-14)
