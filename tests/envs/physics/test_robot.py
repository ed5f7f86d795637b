"""Robots as data: what is refused, files, digests, payloads, and models, kept as MuJoCo has them or completed."""

import dataclasses
import importlib.resources
import re
import sys

import mujoco
import numpy as np
import pytest
from support.robots import DRIVE, ROBOTS

from fuzzyarm.cli import main
from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics._robot_models import read_robot
from fuzzyarm.envs.physics.equations import chosen_arm
from fuzzyarm.envs.physics.from_model import Lacking, completed, typical
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


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("inertia = [[0.01, 0, 0], [0, 0.11, 0], [0, 0, 0.11]]", "", "'joint2': .*missing required field `inertia`"),
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
STILL = SECOND.replace('velocity="2"', 'velocity="0"').replace("</joint>", '<!-- <limit velocity="9"/> --></joint>')
MASSLESS = '<link name="d"/>' + SECOND + URDF_JOINT.format("j3", "revolute", "c", "d", "")


def files(folder, body, head="", joints=("j1", "j2")):
    links = "".join(map(URDF_LINK.format, "abc")) + URDF_JOINT.format("j1", "revolute", "a", "b", "")
    (folder / "arm.urdf").write_text(f'<robot name="arm">{links}{body}</robot>', encoding="utf-8")
    robot, tip = folder / "robot.toml", "" if "tip" in head else 'tip = "c"\n'
    robot.write_text(f'model = "arm.urdf"\n{tip}{head}\n{"".join(map(OVERLAY.format, joints))}', encoding="utf-8")
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
    option = '<mujoco><option gravity="0 0 -3.7"/></mujoco><transmission name="t"/>'
    assert read_robot(files(tmp_path, SECOND + option)).gravity == (0.0, 0.0, -3.7)


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
        (STILL, "", ("j1", "j2"), r"joint 'j2': the model has no velocity_limit; add velocity_limit to"),
    ],
)
def test_what_is_no_chain_of_revolute_joints_is_refused_in_one_line(tmp_path, body, head, joints, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_robot(files(tmp_path, body, head, joints))
    assert "\n" not in str(caught.value) and "robot.toml" in str(caught.value)


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


MODEL = """<mujoco model="m"><compiler angle="radian" {compiler}/>{option}<asset><mesh name="shell" file="none.stl"/>
<material name="grey" rgba=".5 .5 .5 1"/></asset><worldbody><geom type="plane" size="1 1 1"/>
<body name="l1" pos="0 0 0.2" euler="0.3 0 0.1"><inertial pos="0.1 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>
<geom type="box" size="0.1 0.1 0.2" material="grey" group="3"/><joint name="j1" axis="0 0 1" range="-3 3"
 actuatorfrcrange="-100 100" armature="0.3" damping="0.2" frictionloss="0.7"/>
<body name="l2" pos="0.3 0 0" euler="0 1 0.4" {body}>{link}
<joint name="j2" axis="0 1 0" range="-2 3" armature="0.2" {joint} actuatorfrcrange="{torques}"/><site name="s2"/>
<body name="hand" pos="0 0.1 0.2" {hand}><inertial pos="0.1 0 0" mass="0.5" diaginertia="2e-3 3e-3 4e-3"/>
<geom size="0.05" mass="0.4"/><joint name="grip" type="slide" axis="1 0 0"/></body>
</body></body></worldbody>{more}</mujoco>"""
GEOMS = """<geom type="capsule" fromto="0 0 0 0 0.1 -.4" size=".03" mass="3"/>
<geom type="sphere" size="0.05" pos="0.1 0 0" density="500" group="4"/><geom type="mesh" mesh="shell" mass="0"/>"""
INERTIAL = '<inertial pos="0.1 0 0" mass="2" diaginertia="0.02 0.03 0.04"/>'
FLEX = '<flex name="f" dim="1" body="l1 l2" vertex="0 0 0 0 0 0" element="0 1"/>'
MODEL_OVERLAY = """model = "m.xml"\ntip = "s2"\nfixed = ["grip"]
[joints.j1]\nstiffness = 1e4\ndamping = 5\nvelocity_limit = 3
[joints.j2]\nstiffness = 1e4\ndamping = 5\nvelocity_limit = 3\n"""


def model(**parts):
    empty = dict.fromkeys(("compiler", "option", "body", "joint", "hand", "more"), "")
    return MODEL.format(**empty | {"link": INERTIAL, "torques": "-50 50"} | parts)


def read(folder, text, overlay=MODEL_OVERLAY):
    (folder / "m.xml").write_text(text, encoding="utf-8")
    (folder / "m.toml").write_text(overlay, encoding="utf-8")
    return read_robot(folder / "m.toml")


def seen_by_mujoco(text, q):
    """Return mass matrix, torques of gravity, and frictions of the two joints, the hand held still."""
    without_mesh = text.replace('<geom type="mesh" mesh="shell" mass="0"/>', "")
    compiled = mujoco.MjModel.from_xml_string(without_mesh.replace('<mesh name="shell" file="none.stl"/>', ""))
    data, whole = mujoco.MjData(compiled), np.zeros((compiled.nv, compiled.nv))
    data.qpos[:2] = q
    mujoco.mj_forward(compiled, data)
    mujoco.mj_fullM(compiled, data, whole)
    frictions = [np.ravel(compiled.dof_damping)[:2], compiled.dof_frictionloss[:2], compiled.jnt_actfrcrange[:2, 1]]
    return whole[:2, :2], data.qfrc_bias[:2], frictions


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"link": GEOMS, "compiler": 'inertiagrouprange="0 3"'},
        {"link": INERTIAL + GEOMS, "compiler": 'inertiafromgeom="true"'},
        {"link": INERTIAL + GEOMS},
        {"compiler": 'balanceinertia="true"', "link": INERTIAL.replace("0.04", "0.09")},
        {"compiler": 'boundmass="2.5" boundinertia="0.05"'},
        {"option": '<option gravity="0.5 0 -1.62" wind="1 0 0" magnetic="1 0 0" integrator="RK4"/>'},
        {"option": '<option><flag gravity="disable" contact="disable"/></option>'},
        {"joint": 'pos="0.1 0 0.2" damping="0.4" frictionloss="0.2"', "torques": "-7 7"},
        {"more": '<sensor><jointpos joint="j1"/></sensor><keyframe><key qpos="1 1 0"/></keyframe>'},
        {
            "more": '<tendon><fixed name="t" stiffness="3"><joint joint="grip" coef="1"/></fixed></tendon>'
            '<actuator><motor tendon="t"/><position joint="grip" kp="9"/></actuator>'
        },
    ],
)
def test_what_a_model_says_is_what_mujoco_computes(tmp_path, parts):
    text, rng = model(**parts), np.random.default_rng(5)
    robot = read(tmp_path, text)
    for q in rng.uniform(-2.0, 2.0, (3, 2)):
        mass, gravity, frictions = seen_by_mujoco(text, q)
        rotors = np.diag(robot.drive("motor_inertia"))
        np.testing.assert_allclose(rigid_body.mass_matrix(robot, q) + rotors, mass, atol=1e-9)
        np.testing.assert_allclose(rigid_body.gravity(robot, q), gravity, atol=1e-8)
    for name, theirs in zip(("viscous_friction", "coulomb_friction", "torque_limit"), frictions, strict=True):
        np.testing.assert_array_equal(robot.drive(name), theirs)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"joint": 'stiffness="300" springref="0.5"'}, "stiffness of joint 'j2' is not simulated: remove it"),
        ({"option": '<default><joint stiffness="5"/></default>'}, "stiffness of joint 'j1'.*stiffness of joint 'j2'"),
        ({"joint": 'springdamper="0.2 1.5"'}, "springdamper of joint 'j2'"),
        ({"joint": 'ref="0.1"'}, "joint 'j2' has ref = 0.1"),
        ({"joint": 'damping="1 0 2"'}, r"its damping is a polynomial; add viscous_friction to \[joints.j2\]"),
        ({"torques": "-10 50"}, r"its torques, -10 to 50 N m, are not the same .*; add torque_limit to \[joints.j2\]"),
        ({"body": 'gravcomp="1"'}, "gravcomp of link 'l2'"),
        ({"link": '<geom type="mesh" mesh="shell"/>'}, "'l2' is defined by a mesh.*an <inertial> element"),
        ({"compiler": 'settotalmass="3"'}, "compiler settotalmass"),
        ({"option": '<option density="1.2"/>'}, "option density"),
        ({"option": '<option><flag damper="disable"/></option>'}, "the flag that disables damper"),
        ({"more": '<tendon><fixed name="t"><joint joint="j1" coef="1"/></fixed></tendon>'}, "tendon 't'"),
        ({"more": f"<deformable>{FLEX}</deformable>"}, "flex is not simulated"),
        ({"more": '<equality><joint joint1="j1" joint2="j2"/></equality>'}, "joint 'j1' mimics 'j2'"),
        ({"more": '<equality><weld body1="hand"/></equality>'}, "closes the chain"),
        ({"more": '<actuator><position name="a" joint="j2" kp="9"/></actuator>'}, "law and limits of its actuator 'a'"),
        ({"more": '<actuator><motor name="a" joint="j2" gear="9"/></actuator>'}, r"add torque_limit to \[joints.j2\]"),
        ({"more": '<actuator><motor name="a" site="s2"/></actuator>'}, "actuator 'a' is not simulated"),
        ({"more": '<actuator><motor name="a" joint="j2" armature="9"/></actuator>'}, "armature or damping of actuator"),
    ],
)
def test_what_has_no_equation_is_refused_by_name(tmp_path, parts, message):
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path, model(**parts))
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(tmp_path / "m.toml"))


def test_the_overlay_comes_before_what_a_model_says_and_all_that_is_wrong_is_in_one_line(tmp_path):
    more = '<actuator><position name="a" joint="j2" kp="9"/></actuator>'
    text = model(more=more, torques="-10 50", joint='damping="1 0 2"', option='<option gravity="0 0 -1.62"/>')
    head, tail = MODEL_OVERLAY.split("[joints.j1]")
    given = f"{head}gravity = [0, 0, -9.81]\n[joints.j1]{tail}torque_limit = 20\nviscous_friction = 0.3\n"
    robot = read(tmp_path, text, given)
    assert robot.gravity == (0.0, 0.0, -9.81)
    assert robot.joints[1].drive.torque_limit == 20.0 and robot.joints[1].drive.viscous_friction == 0.3
    text = model(joint='stiffness="3"', body='gravcomp="1"').replace('armature="0.3"', "").replace('range="-3 3"', "")
    overlay = MODEL_OVERLAY.replace("velocity_limit = 3", "").replace("stiffness = 1e4", "static_friction = 9", 1)
    with pytest.raises(ValueError, match=r"gravcomp of link 'l2'.*stiffness of joint 'j2'") as caught:
        read(tmp_path, text, overlay)
    lacks = "motor_inertia, stiffness, stribeck_velocity, velocity_limit, angle_range"
    assert f"joint 'j1': the model has no {lacks}; add {lacks} to [joints.j1]" in str(caught.value)
    assert "joint 'j2': the model has no velocity_limit; add velocity_limit to [joints.j2]" in str(caught.value)


BARE_LINK = """<link name="{}"><inertial><origin xyz="0 0 -0.1"/><mass value="0.6"/>
<inertia ixx=".005" iyy=".005" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
BARE_JOINT = """<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="0 0 -0.3"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="8" effort="{}"/></joint>"""
URDF = f"""<robot name="two"><link name="base"/>{BARE_LINK.format("upper")}{BARE_LINK.format("fore")}<link name="tool"/>
{BARE_JOINT.format("shoulder", "base", "upper", 150)}{BARE_JOINT.format("elbow", "upper", "fore", 14)}
<joint name="end" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 -0.2"/></joint></robot>"""


@pytest.fixture
def urdf(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.urdf").write_text(URDF)
    return tmp_path / "two.urdf"


def test_what_a_model_lacks_is_one_list_and_typical_values_have_a_source_each(urdf):
    with pytest.raises(Lacking) as caught:
        completed(urdf, given={"elbow": {"stiffness": 100.0}})
    lines = str(caught.value).splitlines()
    assert lines[0] == "motor_inertia [kg m^2] of shoulder, elbow" and lines[1] == "stiffness [N m/rad] of shoulder"
    assert "tool" in lines[-1] and len(lines) == 6  # the rotors, springs with damping, friction twice, and the tip
    for robot, values, sources in typical(("stiffness", "motor_inertia", "coulomb_friction", "angle_range")):
        assert sources and robot != "planar-3r" and set(values) == {"stiffness", "motor_inertia", "coulomb_friction"}


def test_numbers_are_those_given_then_the_models_then_those_of_the_nearest_joint(urdf):
    """The wrists of the UR5 have 28 N m, twice the elbow's 14; its shoulder 150, as here."""
    robot = completed(urdf, "tool", {"elbow": {"stiffness": 100.0, "torque_limit": 14.0}}, like="ur5")
    shoulder, elbow = (joint.drive for joint in robot.joints)
    first, wrist = (robot_named("ur5").joints[k].drive for k in (0, 3))
    assert (shoulder.stiffness, shoulder.torque_limit) == (first.stiffness, 150.0)
    assert elbow.stiffness == 100.0 and elbow.motor_inertia == pytest.approx(0.5 * wrist.motor_inertia)
    assert any(text.startswith("elbow: ") and "times 0.5: motor_inertia" in text for text in robot.assumptions)


def test_a_command_writes_a_robot_that_reads_back(urdf, capsys):
    assert main(["robot", "two.urdf"]) == 1
    out, err = capsys.readouterr()
    assert "stiffness [N m/rad] of shoulder, elbow" in out and "source: Rotors are not published" in out
    assert "Backlash is not modelled" in out and "nothing was written" in err
    words = ["robot", "two.urdf", "--tip", "tool", "--like", "ur5", "--set", "elbow.stiffness=90", "stiffness=80"]
    assert main(words) == 0 and main(words) == 2
    assert [joint.drive.stiffness for joint in Robot.from_toml(urdf.with_suffix(".toml")).joints] == [80.0, 90.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"given": {"knee": {"stiffness": 1.0}}}, "'knee' is not a moving joint of"),
        ({"like": "r2d2"}, "'r2d2' is unknown"),
        ({"tip": "nowhere", "like": "ur5"}, "'nowhere' is not a link or site"),
        ({"given": {"elbow": {"stiffness": -1.0}}, "like": "ur5"}, "stiffness = -1.0"),
    ],
)
def test_refusals(urdf, arguments, words):
    with pytest.raises(ValueError, match=words):
        completed(urdf, **{"tip": "tool"} | arguments)
