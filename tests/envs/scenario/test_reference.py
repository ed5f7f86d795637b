"""Joint references: inverse kinematics, time law, limits, and the paper's peak torques."""

import itertools
import math
import re

import numpy as np
import pytest
from support.differences import PATHS, central_difference

from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics, tip_jacobian, tip_position
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.paths import Circle, Line
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference, joint_angles, quintic_time_law

ARMS = {"equal links": ArmParameters(), "unequal links": ArmParameters(length=(0.5, 0.45))}
GRID = np.linspace(0.0, 1.5, 1501)


@pytest.fixture(params=itertools.product(PATHS, (1, -1), ARMS), ids=str)
def reference(request):
    path, elbow_sign, arm = request.param
    return JointReference(PATHS[path], elbow_sign=elbow_sign, parameters=ARMS[arm])


def peak_torques(reference):
    """Return max |Γ| of (5), rigid arm: Γ = (M_b + I_a) q̈ + C q̇ + g + f_v q̇ + F(q̇) sign q̇ [N m]."""
    arm, (q, dq, ddq) = reference.parameters, reference.sample(GRID)
    coulomb, static = np.array(arm.coulomb_friction), np.array(arm.static_friction)
    friction = stribeck_magnitude(dq, DryFriction(coulomb, static, arm.stribeck_velocity)) * np.sign(dq)
    motor = np.array(arm.motor_inertia) * ddq + np.array(arm.viscous_friction) * dq + friction
    return np.abs(rigid_inverse_dynamics(q, dq, ddq, arm_constants(arm)) + motor).max(axis=0)


def test_forward_kinematics_returns_the_path(reference):
    q = reference.sample(GRID).q
    expected = reference.path.points(quintic_time_law(GRID, 1.5)[0])[0]
    np.testing.assert_allclose(tip_position(q, reference.parameters.length), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(reference.tip(GRID).position, expected, rtol=0, atol=1e-15)
    assert (np.sign(q[:, 1]) == reference.elbow_sign).all()


def test_derivatives_match_central_differences(reference):
    t = np.random.default_rng(0).uniform(0.01, 1.49, 200)
    _, dq, ddq = reference.sample(t)
    np.testing.assert_allclose(central_difference(lambda x: reference.sample(x).q, t), dq, rtol=0, atol=2e-6)
    np.testing.assert_allclose(central_difference(lambda x: reference.sample(x).dq, t), ddq, rtol=0, atol=5e-5)
    np.testing.assert_allclose(
        central_difference(lambda x: reference.tip(x).position, t), reference.tip(t).velocity, rtol=0, atol=1e-7
    )


def test_joint_velocity_gives_the_tip_velocity_and_starts_and_ends_at_rest(reference):
    q, dq, _ = whole = reference.sample(GRID)
    velocity = np.einsum("tij,tj->ti", tip_jacobian(q, reference.parameters.length), dq)
    np.testing.assert_allclose(velocity, reference.tip(GRID).velocity, rtol=0, atol=1e-12)
    at_rest = reference.sample([-1.0, 0.0, 1.5, 7.0])
    assert not at_rest.dq.any() and not at_rest.ddq.any()
    np.testing.assert_array_equal(at_rest.q[[0, 3]], at_rest.q[[1, 2]])
    for one, many, grid in zip(reference.sample(GRID[380]), whole, reference.sample(GRID.reshape(19, 79)), strict=True):
        np.testing.assert_allclose(one, many[380], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(grid, many.reshape(19, 79, 2))


def test_quintic_time_law_is_the_printed_polynomial_and_rests_outside():
    x = np.linspace(0.0, 1.0, 101)
    s, ds, dds = quintic_time_law(2.0 * x, 2.0)
    polynomial = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    np.testing.assert_allclose(s, polynomial(x), atol=1e-14)
    np.testing.assert_allclose(ds, polynomial.deriv()(x) / 2.0, atol=1e-13)
    np.testing.assert_allclose(dds, polynomial.deriv(2)(x) / 4.0, atol=1e-13)
    np.testing.assert_array_equal(quintic_time_law([-0.1, 2.1], 2.0), [[0, 1], [0, 0], [0, 0]])


def test_the_papers_speed_and_peak_torques_identify_start_angle_direction_and_elbow():
    default, matches = JointReference(), []
    assert round(np.linalg.norm(default.tip(GRID).velocity, axis=-1).max(), 4) == 1.5708
    np.testing.assert_allclose(peak_torques(default), [228.0, 46.7], rtol=0, atol=0.05)
    q2 = default.sample(GRID).q[:, 1]
    assert (round(q2.min(), 2), round(q2.max(), 2)) == (0.71, 2.00)
    for k, turns, elbow_sign in itertools.product(range(8), (1.0, -1.0), (1, -1)):
        reference = JointReference(Circle(start_angle=k * math.pi / 4, turns=turns), elbow_sign=elbow_sign)
        if np.round(peak_torques(reference)).tolist() == [228.0, 47.0]:
            matches.append((k, turns, elbow_sign))
    assert matches == [(2, -1.0, 1)]


def test_unreachable_path_names_the_first_point_its_distance_and_the_ring():
    message = r"t = 0 s: point \(0.9, 0.5\) m is 1.02956 m from the base; .* reaches 0 to 1 m .* margin of 0.05 rad"
    with pytest.raises(ValueError, match=message):
        JointReference(Circle(center=(0.9, 0.3)))
    x = 0.5 + 0.9 * quintic_time_law(np.linspace(0.0, 1.5, CHECKED_INSTANTS), 1.5)[0]
    first = x[x >= math.cos(0.05 / 2.0)][0]
    with pytest.raises(ValueError, match=rf"t = 0\.79\d* s: point \({first:.6g}, 0\) m is {first:.6g} m"):
        JointReference(Line((0.5, 0.0), (1.4, 0.0)))
    with pytest.raises(ValueError, match=r"t = 0\.7\d* s: point \(0\.02\d*, 0\) m is 0\.02\d* m from the base"):
        JointReference(Line((0.5, 0.0), (-0.5, 0.0)))
    angles = joint_angles(np.array([[0.0, 1.01], [0.0, 0.03], [0.0, 0.5]]), (0.5, 0.42), 1)
    np.testing.assert_array_equal(np.isnan(angles).any(axis=-1), [True, True, False])


@pytest.mark.parametrize("length", [(0.5, 0.5), (0.5, 0.42), (0.3, 0.6)])
def test_the_ring_ends_at_the_margin_to_the_singular_configurations(length):
    arm = ArmParameters(length=length, mass_center=(0.15, 0.15), velocity_limit=(1e3, 1e3))
    for bend, inwards in ((0.05, 1e-6), (math.pi - 0.05, -1e-6)):
        edge = np.linalg.norm(tip_position(np.array([0.0, bend]), length))
        good, bad = ((0.0, edge - inwards), (0.0, edge + inwards))
        JointReference(Line(good, (0.0, 0.5)), parameters=arm)
        with pytest.raises(ValueError, match="leaves the reach"):
            JointReference(Line(bad, (0.0, 0.5)), parameters=arm)


def test_joint_limits_name_joint_value_and_limit():
    beyond_pi = Circle(center=(-0.345, -0.491))
    with pytest.raises(ValueError, match=r"joint1 leaves .* is 3\.\d* rad there.* \[-3.14159, 3.14159\] .*joint_l"):
        JointReference(beyond_pi)
    JointReference(beyond_pi, elbow_sign=-1)
    arm = ArmParameters(joint_limit=(math.pi, 1.9))
    with pytest.raises(ValueError, match=r"joint2 leaves .* limit; allowed: \[-1.9, 1.9\] rad.*joint_limit"):
        JointReference(parameters=arm)


def test_velocity_limit_names_joint_value_limit_and_the_duration_that_helps():
    with pytest.raises(ValueError, match=r"joint2 turns at -?2\d\.\d* rad/s .* \[-15, 15\] rad/s") as error:
        JointReference(duration=0.3)
    needed = float(re.search(r"to (\S+) s or more", str(error.value)).group(1))
    JointReference(duration=needed)
    with pytest.raises(ValueError, match=r"Raise duration"):
        JointReference(duration=needed - 0.002)


class Own:
    """A path of the user's own that is none."""

    def __init__(self, *given):
        self.given = given

    def points(self, s):
        return tuple(one(s) for one in self.given)


BAD = [
    ({"duration": 0.0}, r"duration = 0\.0.*; allowed: \[1e-06, 1e\+06\] s"),
    ({"elbow_sign": 0}, r"elbow_sign = 0 is out of range; allowed: 1 \(q2 > 0\) or -1"),
    ({"path": "circle"}, r"path = 'circle' must have a method points\(s\)"),
    ({"path": Own(np.copy, np.copy, np.copy)}, "returned p of shape"),
    ({"path": Own(list, lambda s: [1.0, [2.0]], list)}, r"needed: three NumPy arrays p, dp/ds, d²p/ds²"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_a_bad_argument_is_named(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        JointReference(**arguments)
