"""What any arm does by default: motions along named paths, and loads that take the same share of its motors."""

import dataclasses

import numpy as np
import pytest
from slow_twins import slow_but
from support.robots import with_drives

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario import cases
from fuzzyarm.envs.scenario.cases import Case, case_for, find_case, with_loads
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
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


PAPER = Robot.of(ArmParameters())


def largest_share(robot, force_of):
    """Largest share of a torque limit that a force (instants, 3) at the tip takes along the default reference."""
    reference = default_reference(robot)
    t = np.linspace(0.0, reference.duration, 201)
    jacobian = tip_jacobian(robot, reference.sample(t).q)
    torque = np.stack([j.T @ f for j, f in zip(jacobian, force_of(reference, t), strict=True)])
    return np.max(np.abs(torque) / robot.drive("torque_limit"))


@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_loads_take_the_share_of_the_motors_that_they_take_of_the_papers(name):
    robot = robot_named(name)

    def weight(of):
        mass = case_for("payload", of).disturbance.payload.mass
        return lambda reference, t: np.broadcast_to(mass * 9.81 * of.arrays.gravity / 9.81, (len(t), 3))

    assert largest_share(robot, weight(robot)) == pytest.approx(largest_share(PAPER, weight(PAPER)), rel=0.06)

    def push(of):
        force = dataclasses.replace(case_for("machining", of).disturbance.tip_force, duration=1e-9, swing=0.0)
        return lambda reference, t: force.at(t, reference.tip(t).velocity)

    assert largest_share(robot, push(robot)) == pytest.approx(largest_share(PAPER, push(PAPER)), rel=0.06)
    assert case_for("machining", robot).disturbance.tip_force.duration == default_reference(robot).duration


def test_titles_say_the_load_and_the_paper_and_ones_own_cases_keep_theirs(monkeypatch):
    robot = robot_named("planar-3r")
    mass = case_for("payload", robot).disturbance.payload.mass
    assert case_for("payload", robot).title == f"Case 3: {mass:g} kg payload" and mass < 5.0
    mine = Case("mine", "Mine", Disturbance(payload=Payload(3.0), tip_force=ConstantForce((1.0, 2.0, 3.0))))
    monkeypatch.setitem(cases.CASES, "mine", mine)
    assert case_for("nominal", robot) is find_case("nominal") and case_for("mine", robot) is mine
    for name in cases.PAPER_CASES:
        assert case_for(name, ArmParameters()) is find_case(name)
    with pytest.raises(ValueError, match="unknown case 'other'; choose from: nominal"):
        case_for("other", robot)


def test_the_references_of_a_robots_family_begin_and_end_at_home_within_the_motors():
    robot = robot_named("planar-3r")
    family = reference_family(robot, 4)
    assert family is reference_family(robot, 4) and len({reference.duration for reference in family}) == 4
    for reference in family:
        t = np.linspace(0.0, reference.duration, 300)
        motion = reference.sample(t)
        np.testing.assert_allclose(motion.q[[0, -1]], np.tile(family[0].sample(0.0).q, (2, 1)), atol=1e-12)
        speed = np.abs(motion.dq) / [joint.velocity_limit for joint in robot.joints]
        assert speed.max() <= 0.5 and speed.max() > 0.01


def test_a_robot_with_weak_motors_has_no_family():
    with pytest.raises(ValueError, match="too weak to move it about its home"):
        reference_family(with_drives(robot_named("planar-3r"), torque_limit=0.1), 2)


def test_loads_are_the_papers_for_its_lengths_and_limits_and_scaled_otherwise():
    stiff = dataclasses.replace(ArmParameters(), stiffness=(1e5, 5e4), mass=(12.0, 8.0))
    for name in ("machining", "payload"):
        assert case_for(name, stiff) is find_case(name)
    weak = dataclasses.replace(ArmParameters(), torque_limit=(250.0, 125.0))
    assert case_for("payload", weak).disturbance.payload.mass == pytest.approx(2.5, abs=0.06)
    force = case_for("machining", weak).disturbance.tip_force
    assert (force.base, force.base + force.swing) == pytest.approx((69.0, 109.0), abs=1.1)
    given = with_loads(find_case("payload"), payload=3.0)
    assert given.disturbance.payload.mass == 3.0 and given.title == "Case 3: 3 kg payload"
    force = with_loads(find_case("machining"), force=(10.0, 30.0), duration=2.0).disturbance.tip_force
    assert (force.base, force.swing, force.duration) == (10.0, 20.0, 2.0)
