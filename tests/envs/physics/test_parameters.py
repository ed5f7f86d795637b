"""Every constant of the arm: Table 1, the range of each field, and exact files."""

import dataclasses
import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
PAIRS = tuple(name for name in ALLOWED if name not in SCALARS)


def bad_numbers(name):
    yield from (math.nan, math.inf, -math.inf, -1.0, -5e-324, 1e13, 10**400, "1.0", True, None, 1j)
    if ALLOWED[name].startswith("("):
        yield from (0.0, -0.0)
    if name == "joint_limit":
        yield math.nextafter(math.pi, 4.0)


def bad_values():
    for name in SCALARS:
        yield from ((name, value) for value in (*bad_numbers(name), (1.0, 1.0), [1.0]))
    for name in PAIRS:
        good = getattr(ArmParameters(), name)
        for value in bad_numbers(name):
            yield from ((name, (value, good[1])), (name, (good[0], value)))
        yield from ((name, value) for value in ((), (good[0],), (*good, good[0]), good[0], "ab", None, {1, 2}))


def test_the_fields_are_those_listed_here():
    assert [field.name for field in dataclasses.fields(ArmParameters)] == list(ALLOWED)


@pytest.mark.parametrize("name", TABLE_1)
def test_default_is_table_1(name):
    assert getattr(ArmParameters(), name) == TABLE_1[name]


@pytest.mark.parametrize("name", ALLOWED)
def test_bad_value_is_named_with_its_range(name):
    values = [value for field, value in bad_values() if field == name]
    assert len(values) > 4
    for value in values:
        with pytest.raises(ValueError) as caught:
            ArmParameters(**{name: value})
        message = str(caught.value)
        assert re.match(rf"{name}(\[[01]\])? = ", message), value
        assert message.endswith(f"allowed: {ALLOWED[name]}"), value


@pytest.mark.parametrize("name", [name for name in ALLOWED if ALLOWED[name].startswith("[")])
def test_zero_is_allowed_where_the_range_is_closed(name):
    zeros = {"static_friction": (0.0, 0.0), "coulomb_friction": (0.0, 0.0)} if "friction" in name else {}
    nothing = 0.0 if name in SCALARS else (0.0, 0.0)
    assert getattr(ArmParameters(**{**zeros, name: nothing}), name) == nothing


@pytest.mark.parametrize("joint", [0, 1])
def test_static_friction_below_coulomb_raises(joint):
    static = tuple(1.5 if j == joint else 6.0 for j in range(2))
    with pytest.raises(ValueError, match=rf"static_friction\[{joint}\] = 1.5 N m .* coulomb_friction\[{joint}\]"):
        ArmParameters(static_friction=static)


def test_singular_mass_matrix_raises():
    with pytest.raises(ValueError, match="mass matrix singular at q2 = 0"):
        ArmParameters(inertia=(0.0, 0.0), mass_center=(1e-5, 0.25))


@pytest.mark.parametrize("name", ALLOWED)
def test_frozen(name):
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(ArmParameters(), name, getattr(ArmParameters(), name))


def test_integers_and_lists_become_pairs_of_floats():
    arm = ArmParameters(length=[1, 2], gravity=10)
    assert arm.length == (1.0, 2.0) and arm.gravity == 10.0
    assert all(type(number) is float for number in (*arm.length, arm.gravity))
    assert hash(arm) == hash(ArmParameters(length=(1.0, 2.0), gravity=10.0))


def pairs(low, high=1e12):
    number = st.floats(low, high, exclude_min=low == 0.0, allow_nan=False, allow_infinity=False)
    return st.tuples(number, number)


@st.composite
def arms(draw):
    frictions = [sorted(draw(pairs(0.0))) for _ in range(2)]
    return ArmParameters(
        length=draw(pairs(0.3, 3.0)),
        mass=draw(pairs(0.1, 100.0)),
        inertia=draw(pairs(1e-3, 10.0)),
        mass_center=draw(pairs(0.1, 0.3)),
        gravity=draw(pairs(0.0))[0],
        coulomb_friction=(frictions[0][0], frictions[1][0]),
        static_friction=(frictions[0][1], frictions[1][1]),
        stribeck_velocity=draw(pairs(0.0))[0],
        joint_limit=draw(pairs(0.0, math.pi)),
        **{name: draw(pairs(0.0)) for name in ("viscous_friction", "stiffness", "damping", "motor_inertia")},
        **{name: draw(pairs(0.0)) for name in ("torque_limit", "velocity_limit")},
    )


@settings(deadline=None, max_examples=40)
@given(arm=arms())
def test_toml_round_trip_is_exact(arm, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "arm.toml"
    arm.write_toml(path)
    assert ArmParameters.from_toml(path) == arm
    assert ArmParameters.from_dict(arm.to_dict()) == arm


def test_toml_keeps_table_1_for_what_it_leaves_out(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text("mass = [15, 14]\n")
    assert ArmParameters.from_toml(path) == ArmParameters(mass=(15.0, 14.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("weight = 3.0\n", "unknown arm field weight; known: length, mass"),
        ("[arm]\nmass = [1, 2]\n", "unknown arm field arm"),
        ("mass = [1.0\n", "is not a TOML file"),
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


def test_file_that_is_not_text_is_named(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"arm\.toml is not a TOML file"):
        ArmParameters.from_toml(path)


def test_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        ArmParameters.from_toml(tmp_path / "none.toml")
