"""The table of what is not known of an arm: its ends have the same rigid arm, and a wrong table is refused."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm.envs.physics.equations import chosen_arm, corners_of, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.ranges import Ranges
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import robot_named

ROTORS, SPRINGS = ((2.5, 2.9), (0.4, 0.6)), ((1e4, 1e6), (2e3, 1e5))


@pytest.mark.parametrize("arm", [ArmParameters(), robot_named("planar-3r"), robot_named("manutec-r3")])
def test_the_ends_share_the_diagonal_of_the_rigid_mass_matrix(arm, tmp_path):
    rotors = tuple((0.999 * value, 1.002 * value) for value in arm.drive("motor_inertia").tolist())
    springs = tuple((0.1 * value, 10.0 * value) for value in arm.drive("stiffness").tolist())
    path = tmp_path / "arm.toml"
    path.write_text(arm.to_toml() + Ranges(rotors, springs).to_toml())
    assert chosen_arm(path, None) == arm
    corners = corners_of(path)
    assert list(corners) == [f"motor_inertia {a}, stiffness {b}" for a in ("low", "high") for b in ("low", "high")]
    assert corners == Ranges(rotors, springs).corners(arm)
    q = np.random.default_rng(0).normal(size=(20, len(robot_of(arm))))

    def diagonal(one):
        links = np.diagonal(mass_matrix(robot_of(one), q), axis1=-2, axis2=-1)
        return links + one.drive("motor_inertia")

    for words, corner in corners.items():
        end = 0 if "stiffness low" in words else 1
        assert corner.drive("stiffness").tolist() == [pair[end] for pair in springs]
        assert not np.allclose(corner.drive("motor_inertia"), arm.drive("motor_inertia"), rtol=1e-4)
        np.testing.assert_allclose(diagonal(corner), diagonal(arm), rtol=1e-12)


def test_a_file_without_the_table_has_no_ends(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(ArmParameters().to_toml())
    assert corners_of(path) == corners_of("ur5") == corners_of(None) == corners_of(ArmParameters()) == {}


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ("stiffness = [[1e4, 1e6]]", "stiffness needs one range for each of 2 joints, not 1"),
        ("stiffness = [[1e6, 1e4], [2e3, 1e5]]", r"stiffness\[0\] = .* must be a range \(low, high\)"),
        ("stiffness = [[0.0, 1e6], [2e3, 1e5]]", r"stiffness\[0\]\[0\] = 0.0 N m/rad is out of range"),
        (
            "stiffness = [[1e5, 1e6], [2e3, 1e5]]",
            r"ranges: stiffness\[0\] of the arm = 64000.0 N m/rad is out of range",
        ),
        ("damping = [[1.0, 2.0], [1.0, 2.0]]", "unknown field damping; known: motor_inertia, stiffness"),
        (
            "motor_inertia = [[1.0, 9.0], [0.4, 0.6]]",
            r"the arm at these ends is impossible \(motor_inertia high\): inertia",
        ),
    ],
)
def test_a_wrong_table_is_refused_by_every_reader(ranges, message, tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(f"[ranges]\n{ranges}\n")
    for reader in (ArmParameters.from_toml, lambda path: chosen_arm(path, None), corners_of):
        with pytest.raises(ValueError, match=message):
            reader(path)


def test_the_table_is_read_back(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(ArmParameters().to_toml() + Ranges(ROTORS).to_toml())
    assert list(corners_of(path)) == ["motor_inertia low", "motor_inertia high"]
    low = corners_of(path)["motor_inertia low"]
    assert low == dataclasses.replace(ArmParameters(), inertia=low.inertia, motor_inertia=(2.5, 0.4))
