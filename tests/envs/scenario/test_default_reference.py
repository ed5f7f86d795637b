"""The default motion of each robot: the paper's circle for two joints, a circle from home for the others."""

import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.kinematics import home_posture, reach, velocity_limits
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.robot_reference import TipReference


def test_the_papers_arm_keeps_the_papers_motion_bit_for_bit():
    t = np.linspace(0.0, 1.5, 301)
    for mine, paper in zip(default_reference(ArmParameters()).sample(t), JointReference().sample(t), strict=True):
        np.testing.assert_array_equal(mine, paper)
    for mine, paper in zip(default_reference(robot_named("paper")).sample(t), JointReference().sample(t), strict=True):
        np.testing.assert_allclose(mine, paper, rtol=0, atol=1e-10)


def use(reference):
    """The largest shares of velocity and torque limits on the rigid robot."""
    robot = reference.robot
    q, dq, ddq = reference.sample(np.linspace(0.0, reference.duration, 500))
    torque = inverse_dynamics(robot, q, dq, ddq) + robot.drive("motor_inertia") * ddq
    return np.max(np.abs(dq) / velocity_limits(robot)), np.max(np.abs(torque) / robot.drive("torque_limit"))


@pytest.mark.parametrize("name", slow_but(["planar-3r"], ["planar-3r", "ur5", "panda"]))
def test_the_circle_follows_its_rule(name):
    robot = robot_named(name)
    reference = default_reference(robot)
    np.testing.assert_allclose(reference.sample([0.0, reference.duration]).q, [home_posture(robot)] * 2, atol=1e-12)
    center, radius = reference.circle
    assert radius / reach(robot) == pytest.approx(0.2)
    lowest = reference.tip(0.0).position
    up = -robot.arrays.gravity / np.linalg.norm(robot.arrays.gravity)
    np.testing.assert_allclose(lowest, center - radius * up, atol=1e-12)
    assert max(use(reference)) <= 0.5
    if reference.duration > 1.5:
        shorter = dataclasses.replace(reference, duration=reference.duration - 0.1)
        assert max(use(shorter)) > 0.5


@pytest.mark.slow
def test_a_robot_that_cannot_hold_itself_says_so():
    robot = robot_named("ur5")
    weak = [
        dataclasses.replace(joint, drive=dataclasses.replace(joint.drive, torque_limit=8.0)) for joint in robot.joints
    ]
    with pytest.raises(ValueError, match=r"ur5 cannot follow a circle .* % of the torque limit of elbow"):
        default_reference(dataclasses.replace(robot, joints=tuple(weak)))


def test_two_joints_with_other_frames_get_a_circle_from_home():
    robot = Robot.of(ArmParameters(length=(0.3, 0.2), mass_center=(0.15, 0.1)))
    reference = default_reference(robot)  # the paper's circle is out of its reach
    assert isinstance(reference, TipReference)
    np.testing.assert_allclose(reference.sample(0.0).q, home_posture(robot), atol=1e-12)
