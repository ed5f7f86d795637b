"""Robots as data: what is refused and how, files, digests, payloads, and models with an overlay."""

import dataclasses
import importlib.resources
import re
import sys

import mujoco
import numpy as np
import pytest
from support.robots import DRIVE, ROBOTS

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics._robot_models import read_robot
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.envs.physics.joint import Joint, Link
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots

BALL = ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
LINK = Link(1.0, (0.0, 0.0, 0.1), BALL)
JOINT = Joint("elbow", (0.0, 0.0, 0.0), UPRIGHT, (0.0, 0.0, 1.0), LINK, DRIVE, (-1.0, 1.0), 2.0)


def moments(*values):
    return tuple(tuple(row) for row in np.diag(values).tolist())


WRONG = [
    (JOINT, {"axis": (0.0, 0.0, 2.0)}, "joint 'elbow': axis = .* has length 2; it must be a unit vector"),
    (JOINT, {"rotation": moments(1.0, 1.0, -1.0)}, "joint 'elbow': rotation = .* is not a rotation"),
    (JOINT, {"angle_range": (1.0, 1.0)}, "joint 'elbow': angle_range = .* is empty"),
    (JOINT, {"velocity_limit": 0.0}, r"joint 'elbow': velocity_limit = 0.0 rad/s is out of range; allowed: \(0,"),
    (JOINT, {"link": None}, "joint 'elbow': link = None must be a"),
    (JOINT, {"name": "two\nlines"}, "name = .* must be one line of text"),
    (LINK, {"mass": 0.0}, r"mass = 0.0 kg is out of range; allowed: \(0,"),
    (LINK, {"inertia": moments(0.1, 0.1, -0.1)}, "inertia has the principal moment -0.1 .* allowed: above 0"),
    (LINK, {"inertia": moments(0.1, 0.1, 0.3)}, "the last of which is above the sum of the others"),
    (LINK, {"inertia": ((0.1, 0.01, 0.0), *BALL[1:])}, "is not symmetric"),
    (DRIVE, {"motor_inertia": 0.0}, "motor_inertia = 0.0 kg m\\^2: .* rotor's inertia times the gear ratio squared"),
    (DRIVE, {"static_friction": 0.5}, "static_friction = 0.5 N m is below coulomb_friction"),
]


@pytest.mark.parametrize(("good", "change", "message"), WRONG)
def test_a_wrong_part_of_a_robot_is_named(good, change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(good, **change)


def test_cicese_has_the_identified_inertia_and_gravity():
    """M = [[2.351 + 0.168 c2, 0.102 + 0.084 c2], [., 0.102]] and g = 9.81 (3.921 s1 + 0.186 s12, 0.186 s12)."""
    robot, q = robot_named("cicese"), np.array([0.4, 0.7])
    rotors = np.diag(robot.drive("motor_inertia"))
    c2, s1, s12 = np.cos(q[1]), np.sin(q[0]), np.sin(q.sum())
    coupling = 0.102 + 0.084 * c2 - rotors[-1, -1]
    printed = [[2.351 + 0.168 * c2, coupling], [coupling, 0.102]]
    np.testing.assert_allclose(rigid_body.mass_matrix(robot, q) + rotors, printed, atol=1e-3)
    weight = 9.81 * np.array([3.921 * s1 + 0.186 * s12, 0.186 * s12])
    np.testing.assert_allclose(rigid_body.gravity(robot, q), weight, atol=0.01)


def test_manutec_r3_is_its_source_through_the_gears():
    robot, ratio = robot_named("manutec-r3"), np.array([210.0, 60.0])
    of_motor = {
        "motor_inertia": 0.0013 * ratio**2,
        "stiffness": [8.0, 58.0] * ratio**2,
        "damping": [0.01, 0.04] * ratio**2,
        "viscous_friction": [0.1 / 130.0, 0.2 / 130.0] * ratio**2,
        "coulomb_friction": [0.5, 0.7] * ratio,
        "torque_limit": 1.1616 * 9.0 * ratio,
    }
    for name, values in of_motor.items():
        np.testing.assert_allclose(robot.drive(name), values, rtol=1e-12)
    np.testing.assert_allclose([joint.velocity_limit for joint in robot.joints], 315.0 / ratio)
    mass, x = np.array([26.4, 28.7, 5.2, 0.5]), np.array([-0.034, 0.414, 0.6, 0.775])
    y, inertia = np.array([0.0, -0.155, -0.155, -0.105]), np.array([0.279, 1.67, 1.25, 0.0])
    link, total = robot.joints[-1].link, mass.sum()
    np.testing.assert_allclose([link.mass, *link.center], [total, mass @ x / total, mass @ y / total, 0.0], atol=1e-8)
    about_axis = link.inertia[-1][-1] + link.mass * np.dot(link.center, link.center)
    assert about_axis == pytest.approx(np.sum(inertia + mass * (x * x + y * y)), rel=1e-7)


def test_shipped_robots_state_sources_and_survive_their_text(tmp_path):
    assert shipped_robots() == ("cicese", "manutec-r3", "panda", "paper", "planar-3r", "ur5")
    two_joints = ArmParameters(length=(0.5, 0.4), stiffness=(8e3, 1 / 3e-4))
    for arm in (*(chosen_arm(name, None) for name in shipped_robots()), two_joints):
        (tmp_path / "robot.toml").write_text(arm.to_toml(), encoding="utf-8")
        assert chosen_arm(tmp_path / "robot.toml", None) == arm == chosen_arm(tmp_path, None)
    for name in shipped_robots():
        robot = robot_named(name)
        assert robot.name == name and robot.sources and robot.assumptions
        assert dataclasses.replace(robot, name="other", sources=()).digest == robot.digest
        assert dataclasses.replace(robot, tip=(0.25, 0.0, 1e-15)).digest != robot.digest
    assert robot_named("paper").digest == Robot.of(ArmParameters()).digest
    with pytest.raises(ValueError, match="robot = 'ur6' is unknown; choose from: cicese, manutec-r3, panda, paper"):
        robot_named("ur6")


def test_payload_adds_its_weight_and_inertia():
    robot, q = ROBOTS["skewed"], np.array([0.3, -0.4, 0.5, 0.6])
    loaded, jacobian = robot.with_payload(2.0), rigid_body.tip_jacobian(robot, q)
    added = rigid_body.mass_matrix(loaded, q) - rigid_body.mass_matrix(robot, q)
    np.testing.assert_allclose(added, 2.0 * jacobian.T @ jacobian, atol=1e-13)
    weight = rigid_body.gravity(loaded, q) - rigid_body.gravity(robot, q)
    np.testing.assert_allclose(weight, -2.0 * jacobian.T @ robot.gravity, atol=1e-12)


INERTIA = "inertia = [[0.01, 0, 0], [0, 0.11, 0], [0, 0, 0.11]]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (INERTIA, "", "'joint2': .*missing required field `inertia`"),
        ("motor_inertia = 0.58", "motor_inertia = 0.0", "joint 'joint2': motor_inertia = 0.0"),
        ("[[joints]]", "[[joints]]\ntype = 'prismatic'", "unknown field type"),
    ],
)
def test_errors_of_a_file_name_file_joint_and_field(tmp_path, old, new, message):
    folder, file = importlib.resources.files("fuzzyarm.envs.physics") / "robots", tmp_path / "robot.toml"
    text = (folder / "planar-3r.toml").read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"{re.escape(str(file))}: .*{message}") as caught:
        read_robot(file)
    assert "\n" not in str(caught.value)


URDF_LINK = """<link name="{}"><inertial><mass value="2"/><origin xyz="0 0 0.1"/>
<inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0.001" ixz="0" iyz="0"/></inertial></link>"""
URDF_JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>
<origin xyz="0 0 0.4" rpy="1.570796327 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="10" velocity="2"/><dynamics damping="0.5" friction="0.25"/>{}</joint>"""
OVERLAY = "[joints.{}]\nmotor_inertia = 0.2\nstiffness = 5000\ndamping = 2\n"
HAND = '<link name="hand"/>' + URDF_JOINT.format("wrist", "fixed", "c", "hand", "")
SECOND = URDF_JOINT.format("j2", "revolute", "b", "c", "")
MASSLESS = '<link name="d"/>' + SECOND + URDF_JOINT.format("j3", "revolute", "c", "d", "")


def files(folder, body, head="", joints=("j1", "j2")):
    """Write a model and its overlay, and return the path of the overlay."""
    links = "".join(map(URDF_LINK.format, "abc")) + URDF_JOINT.format("j1", "revolute", "a", "b", "")
    (folder / "arm.urdf").write_text(f'<robot name="arm">{links}{body}</robot>', encoding="utf-8")
    robot, tip = folder / "robot.toml", "" if "tip" in head else 'tip = "c"\n'
    drives = "".join(map(OVERLAY.format, joints))
    robot.write_text(f'model = "arm.urdf"\n{tip}{head}\n{drives}', encoding="utf-8")
    return robot


def test_urdf_with_an_overlay(tmp_path):
    robot = read_robot(files(tmp_path, SECOND + HAND, 'tip = "hand"'))
    first, second = robot.joints
    assert robot.name == "arm" and [joint.name for joint in robot.joints] == ["j1", "j2"]
    assert first.position == (0.0, 0.0, 0.4) and first.rotation == ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    assert second.drive.viscous_friction == 0.5 and second.drive.coulomb_friction == 0.25
    assert second.drive.torque_limit == 10.0 and second.angle_range == (-1.0, 2.0) and second.velocity_limit == 2.0
    np.testing.assert_allclose(second.link.inertia, [[0.02, 0.001, 0.0], [0.001, 0.03, 0.0], [0.0, 0.0, 0.02]])
    np.testing.assert_allclose(second.link.center, (0.0, 0.0, 0.1))
    np.testing.assert_allclose(robot.tip, (0.0, 0.0, 0.4))


@pytest.mark.parametrize(
    ("body", "head", "joints", "message"),
    [
        (SECOND + URDF_JOINT.format("j3", "revolute", "a", "c", ""), "", ("j1",), "makes a closed chain: .*line 8"),
        (URDF_JOINT.format("j2", "prismatic", "b", "c", ""), "", ("j1",), "joint 'j2' is prismatic; .*`fixed`"),
        (SECOND.replace("</joint>", '<mimic joint="j1"/></joint>'), "", ("j1",), "joint 'j2' mimics 'j1'; .*`fixed`"),
        (URDF_JOINT.format("j2", "revolute", "a", "c", ""), "", ("j1", "j2"), "'j2' does not follow joint 'j1'"),
        (MASSLESS, "", ("j1", "j2", "j3"), "joint 'j3' turns link 'd', which has no inertia: give the link an <iner"),
        (SECOND, "", ("j1",), r"joint 'j2': the robot file gives it no drive, .* add \[joints.j2\] to the robot file"),
        (SECOND, 'tip = "a"', ("j1", "j2"), "tip = 'a' does not move with the last joint, j2"),
        (SECOND, 'tip = "nowhere"', ("j1", "j2"), "tip = 'nowhere' is not a link or site"),
        (SECOND, 'fixed = ["j9"]', ("j1", "j2"), "`fixed` contains j9, but the joints of the model are: j1, j2"),
        ('<include file="/etc/passwd"/>', "", ("j1",), "the model's <include> refers to another file"),
    ],
)
def test_what_is_no_chain_of_revolute_joints_is_refused_in_one_line(tmp_path, body, head, joints, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_robot(files(tmp_path, body, head, joints))
    assert "\n" not in str(caught.value) and "robot.toml" in str(caught.value)


def test_gravity_of_a_urdf_is_read_and_a_speed_of_0_is_none(tmp_path):
    option = '<mujoco><option gravity="0 0 -3.7"/></mujoco><transmission name="t"/>'
    assert read_robot(files(tmp_path, SECOND + option)).gravity == (0.0, 0.0, -3.7)
    slow = SECOND.replace('velocity="2"', 'velocity="0"').replace("</joint>", '<!-- <limit velocity="9"/> --></joint>')
    with pytest.raises(ValueError, match=r"joint 'j2': the model has no velocity_limit; add velocity_limit to"):
        read_robot(files(tmp_path, slow))


@pytest.mark.parametrize("tag", ["turnGravityOff>true", "springStiffness>30", "dampingFactor> 0.01", "gravity>false"])
def test_physics_of_gazebo_is_refused(tmp_path, tag):
    gazebo, name = '<gazebo reference="b"><mu1>1</mu1>{}</gazebo>', tag.split(">")[0]
    with pytest.raises(ValueError, match=f"{name} of <gazebo> is not simulated"):
        read_robot(files(tmp_path, SECOND + gazebo.format(f"<{tag}</{name}>")))
    harmless = "<springStiffness>0.0</springStiffness><turnGravityOff>false</turnGravityOff><gravity>true</gravity>"
    read_robot(files(tmp_path, SECOND + gazebo.format(harmless)))


def test_the_working_folder_is_left_alone(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    before = mujoco.get_mju_user_warning()
    with pytest.raises(ValueError, match=r"'j2': the model has no angle_range;"):  # of which MuJoCo warns
        read_robot(files(tmp_path, SECOND.replace('lower="-1" upper="2"', 'lower="0" upper="0"')))
    with pytest.raises(ValueError, match="XML"):
        read_robot(files(tmp_path, "<nonsense>"))
    assert list((tmp_path / "here").iterdir()) == [] and mujoco.get_mju_user_warning() is before


def test_without_mujoco_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModuleNotFoundError, match=r"fuzzyarm\[robots\]"):
        read_robot(files(tmp_path, SECOND))
