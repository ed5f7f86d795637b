"""Every constant of the arm: Table 1, the range of each field, and exact files."""

import math
import re

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
ALLOWED = {
    "length": "(0, 1e+12] m",
    "mass": "(0, 1e+12] kg",
    "inertia": "[0, 1e+12] kg m^2",
    "mass_center": "(0, 1e+12] m",
    "viscous_friction": "[0, 1e+12] N m s/rad",
    "gravity": "[0, 1e+12] m/s^2",
    "motor_inertia": "(0, 1e+12] kg m^2",
    "stiffness": "(0, 1e+12] N m/rad",
    "damping": "[0, 1e+12] N m s/rad",
    "static_friction": "[0, 1e+12] N m",
    "coulomb_friction": "[0, 1e+12] N m",
    "stribeck_velocity": "(0, 1e+12] rad/s",
    "torque_limit": "(0, 1e+12] N m",
    "joint_limit": "(0, 3.14159] rad",
    "velocity_limit": "(0, 1e+12] rad/s",
}
SCALARS = ("gravity", "stribeck_velocity")


def bad_numbers(name):
    """Numbers outside of the range of a field; zero is inside where it is closed."""
    yield from (math.nan, -math.inf, -5e-324, 1e13, 10**400, "1.0", True, None)
    if ALLOWED[name].startswith("("):
        yield 0.0
    if name == "joint_limit":
        yield math.nextafter(math.pi, 4.0)


def bad_values(name):
    good = getattr(ArmParameters(), name)
    if name in SCALARS:
        return [*bad_numbers(name), (1.0, 1.0)]
    pairs = [pair for value in bad_numbers(name) for pair in ((value, good[1]), (good[0], value))]
    return [*pairs, (), (*good, good[0]), good[0], "ab", None]


def test_default_is_table_1():
    assert list(ArmParameters().to_dict()) == list(ALLOWED)
    assert {name: getattr(ArmParameters(), name) for name in TABLE_1} == TABLE_1
    arm = ArmParameters(length=[1, 2], gravity=0)
    assert repr(arm.length) == "(1.0, 2.0)" and hash(arm) == hash(ArmParameters(length=(1.0, 2.0), gravity=0.0))
    still = {
        name: (0.0, 0.0) for name in ALLOWED if ALLOWED[name].startswith("[") and name not in ("gravity", "inertia")
    }
    assert ArmParameters(**still).static_friction == (0.0, 0.0)


@pytest.mark.parametrize("name", ALLOWED)
def test_bad_value_is_named_with_its_range(name):
    for value in bad_values(name):
        with pytest.raises(ValueError) as caught:
            ArmParameters(**{name: value})
        message = str(caught.value)
        assert re.match(rf"{name}(\[[01]\])? = ", message), value
        assert message.endswith(f"allowed: {ALLOWED[name]}"), value


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
        name: value * factor if name in SCALARS else tuple(factor * x for x in value)
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
        ("mass = [1.0\n", r"arm\.toml is not a TOML file"),
        ("mass = [1.0, -2.0]\n", "mass.* = .* out of range; allowed: .0, 1e\\+12. kg"),
        ("mass = [nan, 2.0]\n", "mass.* = nan kg is out of range"),
    ],
)
def test_bad_file_is_named(tmp_path, text, message):
    path = tmp_path / "arm.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        ArmParameters.from_toml(path)
    assert str(path) in str(caught.value)
