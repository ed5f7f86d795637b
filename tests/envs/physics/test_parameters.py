"""Every constant of the arm: Table 1, the range of each field, and exact files."""

import math

import pytest

from fuzzyarm.envs.physics.parameters import ArmParameters

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
RANGES = [
    ("length", (0.5, 0.0), r"length\[1\] = 0\.0 m is out of range; allowed: \(0, 1e\+12\] m"),
    ("damping", (-5e-324, 1.0), r"damping\[0\] = -5e-324 N m s/rad is out of range; allowed: \[0, 1e\+12\] N m s/rad"),
    ("joint_limit", (math.nextafter(math.pi, 4.0), 1.0), r"joint_limit\[0\] = .*; allowed: \(0, 3\.14159\] rad"),
    ("gravity", math.nan, r"gravity = nan m/s\^2 is out of range; allowed: \[0, 1e\+12\] m/s\^2"),
    ("gravity", (1.0, 1.0), r"gravity = \(1\.0, 1\.0\) .*allowed: \[0, 1e\+12\] m/s\^2"),
    ("mass", (1.0, 10**400), r"mass\[1\] = .* kg.*allowed: \(0, 1e\+12\] kg"),
    ("mass", (1.0, 2.0, 3.0), r"mass = .*allowed: \(0, 1e\+12\] kg"),
]


def test_default_is_table_1():
    assert {name: getattr(ArmParameters(), name) for name in TABLE_1} == TABLE_1
    arm = ArmParameters(length=[1, 2], gravity=0)
    assert repr(arm.length) == "(1.0, 2.0)" and hash(arm) == hash(ArmParameters(length=(1.0, 2.0), gravity=0.0))
    still = dict.fromkeys(("viscous_friction", "damping", "static_friction", "coulomb_friction"), (0.0, 0.0))
    assert ArmParameters(**still).static_friction == (0.0, 0.0)


@pytest.mark.parametrize(("name", "value", "message"), RANGES)
def test_bad_value_is_named_with_its_range(name, value, message):
    with pytest.raises(ValueError, match=message):
        ArmParameters(**{name: value})


def test_fields_that_do_not_fit_each_other_raise():
    with pytest.raises(ValueError, match="mass matrix singular at q2 = 0"):
        ArmParameters(inertia=(0.0, 0.0), mass_center=(1e-5, 0.25))
    for joint in (0, 1):
        static = tuple(1.5 if j == joint else 6.0 for j in range(2))
        with pytest.raises(ValueError, match=rf"static_friction\[{joint}\] = 1.5 N m .* coulomb_friction\[{joint}\]"):
            ArmParameters(static_friction=static)


@pytest.mark.parametrize("factor", [1.0 / 3.0, 1e-9 / 7.0, 1e7 / 7.0])
def test_toml_round_trip_is_exact(factor, tmp_path):
    path, fixed = tmp_path / "arm.toml", ("length", "mass", "inertia", "mass_center", "joint_limit")
    scaled = {
        name: value * factor if isinstance(value, float) else tuple(factor * x for x in value)
        for name, value in ArmParameters().to_dict().items()
        if name not in fixed
    }
    arm = ArmParameters(joint_limit=(1.0 / 3.0, 1e-300), **scaled)
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
