"""Robots completed from a model alone: the list of what it lacks, the order of numbers, and their sources."""

import pytest

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.from_model import Lacking, completed, typical
from fuzzyarm.envs.physics.robot import Robot, robot_named

pytest.importorskip("mujoco")

LINK = (
    '<inertial><origin xyz="0 0 -0.1"/><mass value="0.6"/>'
    '<inertia ixx=".005" iyy=".005" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial>'
)
JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="0 0 -0.3"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="8" effort="{}"/></joint>'
)
URDF = (
    '<robot name="two"><link name="base"/>'
    + JOINT.format("shoulder", "base", "upper", 150)
    + f'<link name="upper">{LINK}</link>'
    + JOINT.format("elbow", "upper", "fore", 14)
    + f'<link name="fore">{LINK}</link>'
    + '<joint name="end" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 -0.2"/></joint>'
    + '<link name="tool"/></robot>'
)


@pytest.fixture
def model(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "two.urdf"
    path.write_text(URDF)
    return path


def test_what_a_model_lacks_is_one_list(model):
    with pytest.raises(Lacking) as caught:
        completed(model, given={"elbow": {"stiffness": 100.0}})
    lines = str(caught.value).splitlines()
    assert lines[0] == "motor_inertia [kg m^2] of shoulder, elbow" and lines[1] == "stiffness [N m/rad] of shoulder"
    assert "tool" in lines[-1] and len(lines) == 6  # the rotors, springs with damping, friction twice, and the tip


def test_numbers_are_those_given_then_the_models_then_those_of_the_nearest_joint(model):
    """The wrists of the UR5 have 28 N m, twice the elbow's 14; its shoulder 150, as here."""
    robot = completed(model, "tool", {"elbow": {"stiffness": 100.0, "torque_limit": 14.0}}, like="ur5")
    shoulder, elbow = (joint.drive for joint in robot.joints)
    first, wrist = (robot_named("ur5").joints[k].drive for k in (0, 3))
    assert (shoulder.stiffness, shoulder.torque_limit) == (first.stiffness, 150.0)
    assert elbow.stiffness == 100.0 and elbow.motor_inertia == pytest.approx(0.5 * wrist.motor_inertia)
    assert any(text.startswith("elbow: ") and "times 0.5: motor_inertia" in text for text in robot.assumptions)


def test_a_command_writes_a_robot_that_reads_back(model, capsys):
    assert main(["robot", "two.urdf"]) == 1
    captured = capsys.readouterr()
    assert (
        "stiffness [N m/rad] of shoulder, elbow" in captured.out and "source: Rotors are not published" in captured.out
    )
    assert "Backlash is not modelled" in captured.out and "nothing was written" in captured.err
    words = ["robot", "two.urdf", "--tip", "tool", "--like", "ur5", "--set", "elbow.stiffness=90", "stiffness=80"]
    assert main(words) == 0 and main(words) == 2
    assert [joint.drive.stiffness for joint in Robot.from_toml(model.with_suffix(".toml")).joints] == [80.0, 90.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"given": {"knee": {"stiffness": 1.0}}}, "'knee' is not a moving joint of"),
        ({"like": "r2d2"}, "'r2d2' is unknown"),
        ({"tip": "nowhere", "like": "ur5"}, "'nowhere' is not a link or site"),
        ({"given": {"elbow": {"stiffness": -1.0}}, "like": "ur5"}, "stiffness = -1.0"),
    ],
)
def test_refusals(model, arguments, words):
    with pytest.raises(ValueError, match=words):
        completed(model, **{"tip": "tool"} | arguments)


def test_typical_values_have_a_source_each():
    for robot, values, sources in typical(("stiffness", "motor_inertia", "coulomb_friction", "angle_range")):
        assert sources and robot != "planar-3r" and set(values) == {"stiffness", "motor_inertia", "coulomb_friction"}
