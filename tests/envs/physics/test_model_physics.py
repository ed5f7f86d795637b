"""What URDF and MJCF models say of the motion is kept as MuJoCo has it, or refused by name."""

import mujoco
import numpy as np
import pytest

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics._robot_models import read_robot

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
OVERLAY = """model = "m.xml"\ntip = "s2"\nfixed = ["grip"]
[joints.j1]\nstiffness = 1e4\ndamping = 5\nvelocity_limit = 3
[joints.j2]\nstiffness = 1e4\ndamping = 5\nvelocity_limit = 3\n"""


def model(**parts):
    empty = dict.fromkeys(("compiler", "option", "body", "joint", "hand", "more"), "")
    return MODEL.format(**empty | {"link": INERTIAL, "torques": "-50 50"} | parts)


def read(folder, text, overlay=OVERLAY):
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
    head, tail = OVERLAY.split("[joints.j1]")
    given = f"{head}gravity = [0, 0, -9.81]\n[joints.j1]{tail}torque_limit = 20\nviscous_friction = 0.3\n"
    robot = read(tmp_path, text, given)
    assert robot.gravity == (0.0, 0.0, -9.81)
    assert robot.joints[1].drive.torque_limit == 20.0 and robot.joints[1].drive.viscous_friction == 0.3
    text = model(joint='stiffness="3"', body='gravcomp="1"').replace('armature="0.3"', "").replace('range="-3 3"', "")
    overlay = OVERLAY.replace("velocity_limit = 3", "").replace("stiffness = 1e4", "static_friction = 9", 1)
    with pytest.raises(ValueError, match=r"gravcomp of link 'l2'.*stiffness of joint 'j2'") as caught:
        read(tmp_path, text, overlay)
    lacks = "motor_inertia, stiffness, stribeck_velocity, velocity_limit, angle_range"
    assert f"joint 'j1': the model has no {lacks}; add {lacks} to [joints.j1]" in str(caught.value)
    assert "joint 'j2': the model has no velocity_limit; add velocity_limit to [joints.j2]" in str(caught.value)
