"""Paths by points of a file, which any arm follows or refuses by name."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.given_path import GivenPath

UNEVEN = ArmParameters(length=(0.5, 0.2), mass_center=(0.25, 0.1))
SHORT = dataclasses.replace(ArmParameters(), length=(0.5, 0.4), mass_center=(0.25, 0.2), stiffness=(8e3, 5e3))


def test_points_of_a_file_are_followed(tmp_path):
    csv = tmp_path / "way.csv"
    csv.write_text("x,y\n0.4,0.5\n0.5,0.4\n0.5,0.6\n0.4,0.5\n", encoding="utf-8")
    given = GivenPath.read(csv)
    assert given == GivenPath(((0.4, 0.5), (0.5, 0.4), (0.5, 0.6)), closed=True)
    reference = given.reference(ArmParameters())
    assert reference.elbow_sign == 1
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
        ("a.csv", "x;y\n0.4;0.5\n0.5;0.6\n", "line 1, cell 1 is 'x;y'"),
        ("a.csv", "x,y\n0.4,0.5\nx,y\n0.5,0.4\n", "line 3, cell 1 is 'x'"),
        ("a.csv", "0.4,nan\n0.5,0.4\n0.5,0.6\n", "line 1, cell 2 is 'nan'"),
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
        (((1.5, 0.0), (0.5, 0.5)), ArmParameters(), r"--path: .* 1.5 m from .*: 0 to 1 m, the reach of .*: .* 0.5 m"),
        (((0.5, -0.2), (0.0, 0.0), (0.5, 0.2)), UNEVEN, r"allowed: 0.3 to 0.7 m, the reach of .*: move .* by 0.3 m"),
        (((0.5, 0.0, 0.2), (2.0, 0.0, 0.0)), "ur5", r"--path: point \(2, 0, 0\) m is 2\.\d* m from the base"),
        (((0.5, 0.0), (0.5, 0.5)), "ur5", "the points have 2 coordinates; needed: x, y, z for ur5"),
    ],
)
def test_a_path_out_of_reach_says_by_how_much(points, arm, message):
    with pytest.raises(ValueError, match=message):
        GivenPath(points).reference(robot_named(arm) if arm == "ur5" else arm)
