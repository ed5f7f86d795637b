"""Every constant of the arm: Table 1, the range of each field, exact files, and the table of what is not known."""

import dataclasses
import math

import numpy as np
import pytest

from fuzzyarm.envs.physics.equations import chosen_arm, corners_of, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.ranges import Ranges
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.physics.robot import robot_named

TABLE_1 = {
    "length": (0.5, 0.5),
    "mass": (15.0, 9.0),
    "inertia": (0.31, 0.19),
    "mass_center": (0.25, 0.25),
    "viscous_friction": (0.14, 0.14),
    "gravity": 9.81,
    "motor_inertia": (2.71, 0.50),
    "stiffness": (6.4e4, 1.2e4),
    "damping": (20.4, 3.8),
    "static_friction": (6.0, 3.0),
    "coulomb_friction": (4.0, 2.0),
    "stribeck_velocity": 0.1,
}
WRONG = [
    ({"length": (0.5, 0.0)}, r"length\[1\] = 0\.0 m is out of range; allowed: \(0, 1e\+12\] m"),
    (
        {"damping": (-5e-324, 1.0)},
        r"damping\[0\] = -5e-324 N m s/rad is out of range; allowed: \[0, 1e\+12\] N m s/rad",
    ),
    ({"joint_limit": (math.nextafter(math.pi, 4.0), 1.0)}, r"joint_limit\[0\] = .*; allowed: \(0, 3\.14159\] rad"),
    ({"gravity": math.nan}, r"gravity = nan m/s\^2 is out of range; allowed: \[0, 1e\+12\] m/s\^2"),
    ({"gravity": (1.0, 1.0)}, r"gravity = \(1\.0, 1\.0\) .*allowed: \[0, 1e\+12\] m/s\^2"),
    ({"mass": (1.0, 10**400)}, r"mass\[1\] = .* kg.*allowed: \(0, 1e\+12\] kg"),
    ({"mass": (1.0, 2.0, 3.0)}, r"mass = .*allowed: \(0, 1e\+12\] kg"),
    ({"inertia": (0.0, 0.0), "mass_center": (1e-5, 0.25)}, "mass matrix singular at q2 = 0"),
    ({"static_friction": (1.5, 6.0)}, r"static_friction\[0\] = 1.5 N m .* coulomb_friction\[0\]"),
    ({"static_friction": (6.0, 1.5)}, r"static_friction\[1\] = 1.5 N m .* coulomb_friction\[1\]"),
]


def test_default_is_table_1():
    assert {name: getattr(ArmParameters(), name) for name in TABLE_1} == TABLE_1
    arm = ArmParameters(length=[1, 2], gravity=0)
    assert repr(arm.length) == "(1.0, 2.0)" and hash(arm) == hash(ArmParameters(length=(1.0, 2.0), gravity=0.0))
    still = dict.fromkeys(("viscous_friction", "damping", "static_friction", "coulomb_friction"), (0.0, 0.0))
    assert ArmParameters(**still).static_friction == (0.0, 0.0)


@pytest.mark.parametrize(("changes", "message"), WRONG)
def test_bad_value_is_named_with_its_range_and_fields_that_do_not_fit_each_other(changes, message):
    with pytest.raises(ValueError, match=message):
        ArmParameters(**changes)


@pytest.mark.parametrize("factor", [1.0 / 3.0, 1e-9 / 7.0, 1e7 / 7.0])
def test_toml_round_trip_is_exact(factor, tmp_path):
    path, fixed = tmp_path / "arm.toml", {"length", "mass", "inertia", "mass_center", "joint_limit"}
    scaled = {name: (factor * np.array(value)).tolist() for name, value in ArmParameters().to_dict().items()}
    arm = ArmParameters(joint_limit=(1.0 / 3.0, 1e-300), **{name: scaled[name] for name in scaled.keys() - fixed})
    arm.write_toml(path)
    assert ArmParameters.from_toml(path) == arm == ArmParameters.from_dict(arm.to_dict())
    path.write_text("mass = [15, 14]\n")  # the rest is of Table 1
    assert ArmParameters.from_toml(path) == ArmParameters(mass=(15.0, 14.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("weight = 3.0\n", "unknown arm field weight; known: length, mass"),
        ("[arm]\nmass = [1, 2]\n", "unknown arm field arm"),
        ("mass = [1.0\n", r"arm\.toml cannot be read as TOML"),
        ("mass = [nan, 2.0]\n", "mass.* = nan kg is out of range"),
    ],
)
def test_bad_file_is_named(tmp_path, text, message):
    path = tmp_path / "arm.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        ArmParameters.from_toml(path)
    assert str(path) in str(caught.value)


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
        return np.diagonal(mass_matrix(robot_of(one), q), axis1=-2, axis2=-1) + one.drive("motor_inertia")

    for words, corner in corners.items():
        assert corner.drive("stiffness").tolist() == [pair["stiffness low" not in words] for pair in springs]
        assert not np.allclose(corner.drive("motor_inertia"), arm.drive("motor_inertia"), rtol=1e-4)
        np.testing.assert_allclose(diagonal(corner), diagonal(arm), rtol=1e-12)


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ("stiffness = [[1e4, 1e6]]", "stiffness needs one range for each of 2 joints, not 1"),
        ("stiffness = [[1e6, 1e4], [2e3, 1e5]]", r"stiffness\[0\] = .* must be a range \(low, high\)"),
        ("stiffness = [[0.0, 1e6], [2e3, 1e5]]", r"stiffness\[0\]\[0\] = 0.0 N m/rad is out of range"),
        ("stiffness = [[7e4, 9e4], [1, 2e4]]", r"ranges: stiffness\[0\] of the arm = 64000.0 N m/rad is out of range"),
        ("damping = [[1.0, 2.0], [1.0, 2.0]]", "unknown field damping; known: motor_inertia, stiffness"),
        (
            "motor_inertia = [[1, 9], [0.4, 0.6]]",
            r"ends of the ranges \(motor_inertia high\) is impossible: inertia",
        ),
    ],
)
def test_a_wrong_table_is_refused_by_every_reader(ranges, message, tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(f"[ranges]\n{ranges}\n")
    for reader in (ArmParameters.from_toml, lambda path: chosen_arm(path, None), corners_of):
        with pytest.raises(ValueError, match=message):
            reader(path)


def test_the_table_is_read_back_and_a_file_without_it_has_no_ends(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(ArmParameters().to_toml())
    assert corners_of(path) == corners_of("ur5") == corners_of(None) == corners_of(ArmParameters()) == {}
    path.write_text(ArmParameters().to_toml() + Ranges(((2.5, 2.9), (0.4, 0.6))).to_toml())
    assert list(corners_of(path)) == ["motor_inertia low", "motor_inertia high"]
    low = corners_of(path)["motor_inertia low"]
    assert low == dataclasses.replace(ArmParameters(), inertia=low.inertia, motor_inertia=(2.5, 0.4))
