"""Equations of motion, of two joints and of any robot: MuJoCo as an oracle, and identities of mechanics."""

import mujoco
import numpy as np
import pytest
from support.robots import ROBOTS, in_mujoco, potential_energy
from support.two_joints import state_of

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics.dynamics import (
    Payload,
    arm_constants,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    mass_matrix,
    rigid_inverse_dynamics,
    solve_mass_matrix,
    tip_force_torque,
    tip_jacobian,
    tip_position,
)
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot

STEP = 1e-6


def random_motion(rng):
    return rng.uniform(-np.pi, np.pi, 2), rng.uniform(-10.0, 10.0, 2), rng.uniform(-50.0, 50.0, 2)


def mujoco_at(model, q, dq, ddq):
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    mujoco.mj_fullM(model, data, mass)
    return data, mass


@pytest.mark.parametrize("seed", range(6))
def test_the_equations_of_two_joints_and_their_tip_are_mujocos(seed):
    rng = np.random.default_rng(seed)
    payload = Payload(float(rng.uniform(0.5, 8.0)), "tip" if seed % 2 else "link") if seed >= 2 else Payload()
    length = rng.uniform(0.2, 1.5, 2)
    arm = ArmParameters(
        length=tuple(length),
        mass=tuple(rng.uniform(0.5, 20.0, 2)),
        inertia=tuple(rng.uniform(0.01, 1.0, 2)),
        mass_center=tuple(length * rng.uniform(0.1, 1.6, 2)),  # of fits some lie beyond the link
        gravity=rng.uniform(1.0, 20.0),
    )
    model = in_mujoco(Robot.of(arm).with_payload(payload.mass, payload.at))
    constants = arm_constants(arm, payload)
    for _ in range(20):
        q, dq, ddq = random_motion(rng)
        (data, mass), jacobian = mujoco_at(model, q, dq, ddq), np.zeros((3, 2))
        m11, m12, m22 = mass_matrix(np.cos(q[1]), constants)
        np.testing.assert_allclose([[m11, m12], [m12, m22]], mass, rtol=1e-10, atol=1e-11)
        at_rest = mujoco_at(model, q, 0.0, 0.0)[0].qfrc_bias
        weight = np.array(gravity_torque(np.sin(q[0]), np.sin(q.sum()), constants))
        bias = coriolis_torque(np.sin(q[1]), dq[0], dq[1], constants) + weight
        torque = rigid_inverse_dynamics(q, dq, ddq, constants)
        for found, expected in ((bias, data.qfrc_bias), (weight, at_rest), (torque, data.qfrc_inverse)):
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
        mujoco.mj_jacSite(model, data, jacobian, None, 0)
        np.testing.assert_allclose(tip_position(q, arm.length), data.site_xpos[0, :2], rtol=0, atol=1e-12)
        np.testing.assert_allclose(tip_jacobian(q, arm.length), jacobian[:2], rtol=0, atol=1e-12)
        force, q12 = rng.uniform(-200.0, 200.0, 2), q.sum()
        pulled = tip_force_torque(np.sin(q[0]), np.cos(q[0]), np.sin(q12), np.cos(q12), *force, constants)
        np.testing.assert_allclose(pulled, jacobian[:2].T @ force, rtol=0, atol=1e-10)
        acceleration = solve_mass_matrix(np.cos(q[1]), *force, constants)
        np.testing.assert_allclose(mass @ acceleration, force, rtol=1e-9, atol=1e-9)


def test_joint_torque_is_a_spring_and_a_damper():
    state = state_of([0.3, -0.2, 0.1, 0.5, 1.0, 2.0, -3.0, 4.0])
    expected = (6.4e4 * (0.3 - 0.1) + 20.4 * (1.0 + 3.0), 1.2e4 * (-0.2 - 0.5) + 3.8 * (2.0 - 4.0))
    np.testing.assert_allclose(joint_torque(state, arm_constants(ArmParameters())), expected, rtol=1e-15)


def test_inverse_dynamics_and_mass_matrix_elementwise_are_those_of_arrays():
    arm, physics = arm_constants(ArmParameters(), Payload(2.0)), two_joints()
    q, dq, ddq = random_motion(np.random.default_rng(8))
    parts = (physics.PerJoint(*part.T) for part in (q, dq, ddq))
    expected = rigid_inverse_dynamics(q, dq, ddq, arm)
    np.testing.assert_allclose(np.stack(physics.inverse_dynamics(*parts, arm), axis=-1), expected, rtol=0.0, atol=1e-9)
    weight = np.stack(physics.gravity(physics.PerJoint(*q.T), arm), axis=-1)
    for column, unit in zip(np.array(physics.mass_matrix(physics.PerJoint(*q.T), arm)).T, np.eye(2), strict=True):
        torque = rigid_inverse_dynamics(q, np.zeros_like(q), unit, arm)
        np.testing.assert_allclose(column, torque - weight, rtol=0.0, atol=1e-9)


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


def motion(robot, count=5):
    return np.random.default_rng(1).uniform(-2.0, 2.0, (3, count, len(robot)))


def derivative(function, q):
    """Central differences along each joint, on a new last axis."""
    steps = STEP * np.eye(q.shape[-1])
    return np.stack([(function(q + step) - function(q - step)) / (2.0 * STEP) for step in steps], axis=-1)


def test_jacobian_and_gravity_of_a_robot_are_gradients(robot):
    q = motion(robot)[0]
    tip = derivative(lambda at: rigid_body.frames(robot, at).tip, q)
    np.testing.assert_allclose(rigid_body.tip_jacobian(robot, q), tip, atol=1e-8)
    potential = derivative(lambda at: potential_energy(robot, at), q)
    np.testing.assert_allclose(rigid_body.gravity(robot, q), potential, atol=1e-6)


def test_the_equations_of_a_robot_and_its_tip_are_mujocos(robot):
    with pytest.raises(ValueError, match=r"angles.* must have shape \(\.\.\., \d\).*\(9,\)"):
        rigid_body.frames(robot, np.zeros(9))
    for q, dq, ddq in np.moveaxis(motion(robot), 0, 1):
        data, mass = mujoco_at(in_mujoco(robot), q, dq, ddq)
        np.testing.assert_allclose(rigid_body.inverse_dynamics(robot, q, dq, ddq), data.qfrc_inverse, atol=1e-10)
        np.testing.assert_allclose(rigid_body.frames(robot, q).tip, data.site("tip").xpos, atol=1e-10)
        np.testing.assert_allclose(rigid_body.mass_matrix(robot, q), mass, atol=1e-10)


def test_a_robot_of_two_joints_has_the_equations_of_the_paper():
    parameters = ArmParameters(inertia=(0.5, 0.1))
    robot = Robot.of(parameters)
    q, dq, ddq = motion(robot)
    wanted = rigid_inverse_dynamics(q, dq, ddq, arm_constants(parameters))
    np.testing.assert_allclose(rigid_body.inverse_dynamics(robot, q, dq, ddq), wanted, atol=1e-12)
    planar = rigid_body.tip_jacobian(robot, q)[..., :2, :]
    np.testing.assert_allclose(planar, tip_jacobian(q, parameters.length), atol=1e-14)
