"""The motion of each arm along a path with a name: the paper's for two joints, from home for the others."""

import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but
from support.robots import with_drives

from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.kinematics import home_posture, reach, velocity_limits
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.robot_reference import TipReference

SHORT = dataclasses.replace(ArmParameters(), length=(0.5, 0.4), mass_center=(0.25, 0.2), stiffness=(8e3, 5e3))


def shares(reference, arm):
    """The largest shares of the speed and torque limits that a motion takes of the rigid arm."""
    robot = robot_of(arm)
    q, dq, ddq = reference.sample(np.linspace(0.0, reference.duration, 800))
    torque = inverse_dynamics(robot, q, dq, ddq) + robot.drive("motor_inertia") * ddq
    return np.max(np.abs(dq) / velocity_limits(robot)), np.max(np.abs(torque) / robot.drive("torque_limit"))


def test_the_papers_arm_keeps_the_papers_motion_bit_for_bit():
    t = np.linspace(0.0, 1.5, 301)
    for mine, paper in zip(default_reference(ArmParameters()).sample(t), JointReference().sample(t), strict=True):
        np.testing.assert_array_equal(mine, paper)
    for mine, paper in zip(default_reference(robot_named("paper")).sample(t), JointReference().sample(t), strict=True):
        np.testing.assert_allclose(mine, paper, rtol=0, atol=1e-10)


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
    assert max(shares(reference, robot)) <= 0.5
    if reference.duration > 1.5:
        shorter = dataclasses.replace(reference, duration=reference.duration - 0.1)
        assert max(shares(shorter, robot)) > 0.5


@pytest.mark.slow
def test_a_robot_that_cannot_hold_itself_says_so():
    with pytest.raises(ValueError, match=r"ur5 cannot follow a circle .* % of the torque limit of elbow"):
        default_reference(with_drives(robot_named("ur5"), torque_limit=8.0))


def test_two_joints_with_other_frames_get_a_circle_from_home():
    robot = Robot.of(ArmParameters(length=(0.3, 0.2), mass_center=(0.15, 0.1)))
    reference = default_reference(robot)  # the paper's circle is out of its reach
    assert isinstance(reference, TipReference)
    np.testing.assert_allclose(reference.sample(0.0).q, home_posture(robot), atol=1e-12)


@pytest.mark.parametrize(
    "name", ["circle", "lemniscate", *(pytest.param(name, marks=pytest.mark.slow) for name in ("line", "square"))]
)
def test_an_arm_too_short_for_the_papers_circle_follows_every_path_within_half_of_its_limits(name):
    reference = default_reference(SHORT, name)
    assert isinstance(reference, JointReference) and reference.duration >= 1.5
    assert max(shares(reference, SHORT)) <= 0.501
    tip = reference.tip(np.linspace(0.0, reference.duration, 200)).position
    assert np.ptp(tip, axis=0).max() > 0.1 and np.hypot(*tip.T).max() < sum(SHORT.length)
    if name == "circle":
        center, radius = reference.circle
        np.testing.assert_allclose(np.linalg.norm(tip - center, axis=1), radius, rtol=1e-12)
        assert radius == pytest.approx(0.2 * sum(SHORT.length))


def test_weak_motors_take_longer_for_the_same_path():
    weak = dataclasses.replace(ArmParameters(), torque_limit=(320.0, 110.0))
    slower, paper = default_reference(weak, "lemniscate"), default_reference(ArmParameters(), "lemniscate")
    assert slower.path == paper.path and slower.duration > paper.duration
    assert max(shares(slower, weak)) <= 0.501
    assert default_reference(weak).duration == 1.5  # the paper's circle stays the paper's
