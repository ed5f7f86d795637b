"""References of joints and motors: inverse kinematics, time law, limits, peak torques, and the arm's bending."""

import dataclasses
import itertools
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from slow_twins import slow_but
from support.differences import PATHS, central_difference
from support.two_joints import state_of

from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import (
    arm_constants,
    gravity_torque,
    rigid_inverse_dynamics,
    tip_jacobian,
    tip_position,
)
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Spline
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference, joint_angles, quintic_time_law
from fuzzyarm.envs.scenario.robot_reference import TipReference

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


def test_forward_kinematics_returns_the_path_and_its_velocity_from_rest_to_rest(reference):
    q, dq, _ = whole = reference.sample(GRID)
    expected = reference.path.points(quintic_time_law(GRID, 1.5)[0])[0]
    np.testing.assert_allclose(tip_position(q, reference.parameters.length), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(reference.tip(GRID).position, expected, rtol=0, atol=1e-15)
    assert (np.sign(q[:, 1]) == reference.elbow_sign).all()
    velocity = np.einsum("tij,tj->ti", tip_jacobian(q, reference.parameters.length), dq)
    np.testing.assert_allclose(velocity, reference.tip(GRID).velocity, rtol=0, atol=1e-12)
    at_rest = reference.sample([-1.0, 0.0, 1.5, 7.0])
    assert not at_rest.dq.any() and not at_rest.ddq.any()
    np.testing.assert_array_equal(at_rest.q[[0, 3]], at_rest.q[[1, 2]])
    np.testing.assert_allclose(reference.sample(GRID[380]), np.array(whole)[:, 380], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(reference.sample(GRID.reshape(19, 79)), np.reshape(whole, (3, 19, 79, 2)))


def test_derivatives_match_central_differences(reference):
    t = np.random.default_rng(0).uniform(0.01, 1.49, 200)
    _, dq, ddq = reference.sample(t)
    np.testing.assert_allclose(central_difference(lambda x: reference.sample(x).q, t), dq, rtol=0, atol=2e-6)
    np.testing.assert_allclose(central_difference(lambda x: reference.sample(x).dq, t), ddq, rtol=0, atol=5e-5)
    velocity = central_difference(lambda x: reference.tip(x).position, t)
    np.testing.assert_allclose(velocity, reference.tip(t).velocity, rtol=0, atol=1e-7)


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


def test_joint_and_velocity_limits_name_joint_value_limit_and_the_duration_that_helps():
    beyond_pi = Circle(center=(-0.345, -0.491))
    with pytest.raises(ValueError, match=r"joint1 leaves .* is 3\.\d* rad there.* \[-3.14159, 3.14159\] .*joint_l"):
        JointReference(beyond_pi)
    JointReference(beyond_pi, elbow_sign=-1)
    with pytest.raises(ValueError, match=r"joint2 leaves .* limit; allowed: \[-1.9, 1.9\] rad.*joint_limit"):
        JointReference(parameters=ArmParameters(joint_limit=(math.pi, 1.9)))
    with pytest.raises(ValueError, match=r"joint2 turns at -?2\d\.\d* rad/s .* \[-15, 15\] rad/s") as error:
        JointReference(duration=0.3)
    needed = float(re.search(r"to (\S+) s or more", str(error.value)).group(1))
    JointReference(duration=needed)
    with pytest.raises(ValueError, match=r"Raise duration"):
        JointReference(duration=needed - 0.002)


BAD = [
    ({"duration": 0.0}, r"duration = 0\.0.*; allowed: \[1e-06, 1e\+06\] s"),
    ({"elbow_sign": 0}, r"elbow_sign = 0 is out of range; allowed: 1 \(q2 > 0\) or -1"),
    ({"path": "circle"}, r"path = 'circle' must have a method points\(s\)"),
    ({"path": SimpleNamespace(points=lambda s: (s, s, s))}, "returned p of shape"),
    ({"path": SimpleNamespace(points=lambda s: ([s], [1.0, [2.0]], [s]))}, r"needed: three NumPy arrays p, dp/ds, d²p"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD)
def test_a_bad_argument_is_named(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        JointReference(**arguments)


ARM = ArmParameters()
SOFT = dataclasses.replace(ARM, stiffness=(2e4, 5e3), damping=(400.0, 100.0))  # time constants of 20 ms
STIFFLY_DAMPED = dataclasses.replace(ARM, damping=(20.4, 0.02))  # 0.3 ms and 2 µs
WAYPOINTS = ((0.4, 0.5), (0.5, 0.6), (0.6, 0.4), (0.5, 0.3))
REFERENCES = {
    "the paper's circle": JointReference(),
    "lemniscate": JointReference(Lemniscate((0.4, 0.5), 0.2), duration=2.0),
    "line": JointReference(Line((0.4, 0.5), (0.6, 0.4)), duration=0.8),
    "waypoints, other elbow": JointReference(Spline(WAYPOINTS), duration=1.2, elbow_sign=-1),
    "soft arm": JointReference(parameters=SOFT),
    "one joint hardly damped": JointReference(parameters=STIFFLY_DAMPED),
    "one joint undamped": JointReference(parameters=dataclasses.replace(ARM, damping=(0.0, 3.8))),
    "planar-3r": default_reference(robot_named("planar-3r")),
}


# The lemniscate and the line differ from the circle in the path alone, of which the springs know the joint angles.
@pytest.fixture(params=slow_but(REFERENCES.keys() - {"lemniscate", "line"}, REFERENCES), scope="module")
def elastic(request):
    return ElasticReference(REFERENCES[request.param])


def plant_of(reference):
    return reference.robot if isinstance(reference, TipReference) else robot_of(reference.parameters)


def test_the_link_equation_holds(elastic):
    """M q̈_d + C q̇_d + g = K_t (θ_d - q_d) + B_t (θ̇_d - q̇_d), to 1e-9 N m."""
    reference = elastic.reference
    t = np.concatenate([np.linspace(-0.05, reference.duration + 0.1, 300), reference.corners()])
    robot, links, motor = plant_of(reference), reference.sample(t), elastic.sample(t)
    given = robot.drive("stiffness") * (motor.q - links.q) + robot.drive("damping") * (motor.dq - links.dq)
    np.testing.assert_allclose(given, inverse_dynamics(robot, *links), rtol=0.0, atol=1e-9)
    assert np.abs(motor.q - links.q).max() > 1e-4 and 0.0 < elastic.box_use < 1.0


def test_velocities_and_accelerations_are_the_derivatives(elastic):
    """The integral of each over pieces between corners is the change of what it differentiates."""
    reference = elastic.reference
    after_corners = reference.corners()[:, np.newaxis] + np.logspace(-7, -2, 31)  # the joints settle in µs to ms
    ends = np.unique(np.r_[reference.corners(), after_corners.ravel(), np.linspace(0.0, reference.duration, 301)])
    nodes, weights = np.polynomial.legendre.leggauss(6)
    middle, half = 0.5 * (ends[:-1] + ends[1:]), 0.5 * np.diff(ends)
    inside = elastic.sample(middle[:, np.newaxis] + half[:, np.newaxis] * nodes)
    at_ends = elastic.sample(ends)

    def change(rate):
        return np.einsum("pnj,n,p->pj", rate, weights, half)

    np.testing.assert_allclose(change(inside.dq), np.diff(at_ends.q, axis=0), rtol=0.0, atol=1e-12)
    # Without damping θ̇_d jumps at corners: a piece that ends in one is left out.
    whole = ~np.isin(ends[1:], reference.corners()) | (plant_of(reference).drive("damping").min() > 0.0)
    assert whole.sum() > 300
    np.testing.assert_allclose(change(inside.ddq)[whole], np.diff(at_ends.dq, axis=0)[whole], rtol=0.0, atol=1e-8)


def test_the_elastic_arm_without_friction_follows_open_loop():
    """u = I_a θ̈_d + f_v θ̇_d + τ_d moves the tip along the circle with no feedback at all."""
    reference = JointReference()
    elastic, arm = ElasticReference(reference), arm_constants(ARM)
    inertia, viscous = np.array(ARM.motor_inertia), np.array(ARM.viscous_friction)
    # Finer at the start, where the joints settle within a millisecond.
    grid = np.unique(np.r_[np.logspace(-7, -2, 400), np.linspace(0.0, reference.duration, 1501)])
    motor = elastic.sample(grid)
    feedforward = make_interp_spline(grid, inertia * motor.ddq + viscous * motor.dq + elastic.torque(grid))

    def rates(t, x):
        joint = np.array(dynamics.joint_torque(state_of(x), arm))
        weight = dynamics.rigid_inverse_dynamics(x[2:4], x[6:], np.zeros(2), arm)
        link = dynamics.solve_mass_matrix(np.cos(x[3]), *(joint - weight), arm)
        return np.concatenate([x[4:], (feedforward(t) - joint - viscous * x[4:6]) / inertia, link])

    start, motor = reference.sample(0.0), elastic.sample(0.0)
    x0 = np.concatenate([motor.q, start.q, motor.dq, start.dq])
    asked = np.linspace(0.0, reference.duration, 61)
    found = solve_ivp(rates, (0.0, reference.duration), x0, method="DOP853", t_eval=asked, rtol=1e-10, atol=1e-12)
    tip = tip_position(found.y[2:4].T, ARM.length)
    np.testing.assert_allclose(tip, reference.tip(asked).position, rtol=0.0, atol=1e-8)
    assert np.abs(found.y[0:2] - found.y[2:4]).max() > 1e-3  # there was something to compensate


def test_at_rest_the_bending_is_static_and_shapes_follow_the_times():
    elastic = ElasticReference(JointReference())
    for t in (-1.0, 0.0, 5.0):
        motion, rest = elastic.sample(t), elastic.reference.sample(t)
        static = np.stack(gravity_torque(np.sin(rest.q[0]), np.sin(rest.q.sum()), arm_constants(ARM)))
        np.testing.assert_allclose(motion.q - rest.q, static / np.array(ARM.stiffness), rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(motion.dq, 0.0, atol=1e-12)
    t = np.linspace(0.0, 1.5, 501)
    many, grid = elastic.sample(t), elastic.sample(t[:6].reshape(2, 3))
    np.testing.assert_array_equal(grid.q, many.q[:6].reshape(2, 3, 2))
    np.testing.assert_array_equal(many.q[2], elastic.sample(t[2]).q)
    assert elastic.box_use == pytest.approx(max(np.abs(many.q).max() / np.pi, np.abs(many.dq).max() / 15.0), rel=1e-12)


@pytest.mark.parametrize(
    ("message", "duration", "change"),
    [
        ("theta_d2 = .* rad at t", 1.5, {"joint_limit": (3.0, 2.0055), "stiffness": (6.4e4, 2e3)}),
        ("dtheta_d2 = .* rad/s at t", 0.6, {"velocity_limit": (9.0, 11.5), "stiffness": (6.4e4, 1e3)}),
    ],
)
def test_leaving_the_box_is_refused(message, duration, change):
    """The links keep these limits; the motors, which are ahead by the bending, do not."""
    with pytest.raises(ValueError, match="^" + message + r".*allowed: \[-.*stiffen the joints"):
        ElasticReference(JointReference(duration=duration, parameters=dataclasses.replace(ARM, **change)))
