"""Paths by name and by file: the paper's arm keeps the paper's, any other can follow what it is given."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import case_for, find_case, with_loads
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.envs.scenario.reference import JointReference

SHORT = dataclasses.replace(ArmParameters(), length=(0.5, 0.4), mass_center=(0.25, 0.2), stiffness=(8e3, 5e3))


def shares(reference, arm):
    """The largest shares of the speed and torque limits that a motion takes of the rigid arm."""
    robot = robot_of(arm)
    q, dq, ddq = reference.sample(np.linspace(0.0, reference.duration, 800))
    torque = inverse_dynamics(robot, q, dq, ddq) + robot.drive("motor_inertia") * ddq
    return np.abs(dq).max() / 15.0, np.max(np.abs(torque) / robot.drive("torque_limit"))


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


def test_points_of_a_file_are_followed(tmp_path):
    csv = tmp_path / "way.csv"
    csv.write_text("x,y\n0.4,0.5\n0.5,0.4\n0.5,0.6\n0.4,0.5\n", encoding="utf-8")
    given = GivenPath.read(csv)
    assert given == GivenPath(((0.4, 0.5), (0.5, 0.4), (0.5, 0.6)), closed=True)
    reference = given.reference(ArmParameters())
    assert reference.elbow_sign == 1 and max(shares(reference, ArmParameters())) <= 0.501
    tip = reference.tip(np.linspace(0.0, reference.duration, 4001)).position
    for point in given.points:
        assert np.linalg.norm(tip - point, axis=1).min() < 1e-3
    toml = tmp_path / "way.toml"
    toml.write_text("points = [[0.4, 0.5], [0.5, 0.4]]\nduration = 3.0\n", encoding="utf-8")
    assert GivenPath.read(toml).reference(SHORT).duration == 3.0


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "\n0.4,0.5\n0.5,x\n", "line 3, cell 2 is 'x'; needed: x,y or x,y,z in metres"),
        ("a.csv", "O.4,0.5\n0.5,0.4\n0.5,0.6\n", "line 1, cell 1 is 'O.4'"),
        ("a.csv", "x,0.5\n0.5,0.4\n0.5,0.6\n", "line 1, cell 1 is 'x'"),
        ("a.csv", "x;y\n0.4;0.5\n0.5;0.6\n", "line 1, cell 1 is 'x;y'"),
        ("a.csv", "x,y\n0.4,0.5\nx,y\n0.5,0.4\n", "line 3, cell 1 is 'x'"),
        ("a.csv", "0.4,nan\n0.5,0.4\n0.5,0.6\n", "line 1, cell 2 is 'nan'"),
        ("a.csv", "0.4,0_5\n0.5,0.4\n0.5,0.6\n", "line 1, cell 2 is '0_5'"),
        ("a.csv", "0.4\n0.5\n", "point 1 = .* must be 2 real numbers"),
        ("a.csv", "0.4,0.5\n", "1 point"),
        ("a.toml", "pts = [[0.4, 0.5]]\n", "unknown field pts; known: closed, duration, points"),
        ("a.toml", "points = [[0.4, 0.5], [0.5, 0.4]]\nduration = -1.0\n", "duration = -1.0 s is out of range"),
    ],
)
def test_a_bad_file_is_named(name, text, message, tmp_path):
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        GivenPath.read(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("points", "arm", "message"),
    [
        (
            ((1.5, 0.0), (0.5, 0.5)),
            ArmParameters(),
            r"--path: .* 1.5 m from .*: 0 to 1 m, the reach of the arm: .* 0.5 m",
        ),
        (
            ((0.5, -0.2), (0.0, 0.0), (0.5, 0.2)),
            ArmParameters(length=(0.5, 0.2), mass_center=(0.25, 0.1)),
            r"allowed: 0.3 to 0.7 m, the reach of the arm: move the points by 0.3 m",
        ),
        (((0.5, 0.0, 0.2), (2.0, 0.0, 0.0)), "ur5", r"--path: point \(2, 0, 0\) m is 2\.\d* m from the base"),
        (((0.5, 0.0), (0.5, 0.5)), "ur5", "the points have 2 coordinates; needed: x, y, z for ur5"),
    ],
)
def test_a_path_out_of_reach_says_by_how_much(points, arm, message):
    with pytest.raises(ValueError, match=message):
        GivenPath(points).reference(robot_named(arm) if arm == "ur5" else arm)
