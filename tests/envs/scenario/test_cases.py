"""The loads of the paper's cases for any arm: the same largest share of a motor's torque limit, to two digits."""

import dataclasses

import numpy as np
import pytest
from support.robots import with_drives

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import tip_jacobian
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario import cases
from fuzzyarm.envs.scenario.cases import Case, case_for, find_case, with_loads
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance

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
