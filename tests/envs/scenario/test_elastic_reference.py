"""The motors' reference: the link equation, calculus, an independent solver, and the elastic arm run open loop."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from slow_twins import slow_but
from support.two_joints import state_of

from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import arm_constants, gravity_torque, tip_position
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.elastic_reference import ElasticReference
from fuzzyarm.envs.scenario.paths import Lemniscate, Line, Spline
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.robot_reference import TipReference

ARM = ArmParameters()
SOFT = dataclasses.replace(ARM, stiffness=(2e4, 5e3), damping=(400.0, 100.0))  # time constants of 20 ms
STIFFLY_DAMPED = dataclasses.replace(ARM, damping=(20.4, 0.02))  # 0.3 ms and 2 µs
UNDAMPED = dataclasses.replace(ARM, damping=(0.0, 3.8))
WAYPOINTS = ((0.4, 0.5), (0.5, 0.6), (0.6, 0.4), (0.5, 0.3))
REFERENCES = {
    "the paper's circle": JointReference(),
    "lemniscate": JointReference(Lemniscate((0.4, 0.5), 0.2), duration=2.0),
    "line": JointReference(Line((0.4, 0.5), (0.6, 0.4)), duration=0.8),
    "waypoints, other elbow": JointReference(Spline(WAYPOINTS), duration=1.2, elbow_sign=-1),
    "soft arm": JointReference(parameters=SOFT),
    "one joint hardly damped": JointReference(parameters=STIFFLY_DAMPED),
    "one joint undamped": JointReference(parameters=UNDAMPED),
    "planar-3r": default_reference(robot_named("planar-3r")),
}


# The lemniscate and the line differ from the circle in the path alone, of which the springs know the joint angles.
@pytest.fixture(params=slow_but(REFERENCES.keys() - {"lemniscate", "line"}, REFERENCES), scope="module")
def elastic(request):
    return ElasticReference(REFERENCES[request.param])


def instants(reference, count=300):
    """Times from before the start to after the end, corners among them."""
    inner = np.linspace(-0.05, reference.duration + 0.1, count)
    return np.sort(np.concatenate([inner, reference.corners()]))


def drives_of(reference, *names):
    """Numbers of the drives along a reference, of the two-joint arm or of a robot."""
    robot = reference.robot if isinstance(reference, TipReference) else robot_of(reference.parameters)
    return robot, *(robot.drive(name) for name in names)


def test_the_link_equation_holds(elastic):
    """M q̈_d + C q̇_d + g = K_t (θ_d - q_d) + B_t (θ̇_d - q̇_d), to 1e-9 N m."""
    t = instants(elastic.reference)
    links, motor = elastic.reference.sample(t), elastic.sample(t)
    robot, stiffness, damping = drives_of(elastic.reference, "stiffness", "damping")
    given = stiffness * (motor.q - links.q) + damping * (motor.dq - links.dq)
    np.testing.assert_allclose(given, inverse_dynamics(robot, *links), rtol=0.0, atol=1e-9)
    assert np.abs(motor.q - links.q).max() > 1e-4 and 0.0 < elastic.box_use < 1.0


def test_velocities_and_accelerations_are_the_derivatives(elastic):
    """The integral of each over pieces between corners is the change of what it differentiates."""
    reference = elastic.reference
    after_corners = reference.corners()[:, np.newaxis] + np.logspace(-7, -2, 31)  # the joints settle in µs to ms
    ends = np.concatenate([reference.corners(), after_corners.ravel(), np.linspace(0.0, reference.duration, 301)])
    ends = np.unique(ends)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    middle, half = 0.5 * (ends[:-1] + ends[1:]), 0.5 * np.diff(ends)
    inside = elastic.sample(middle[:, np.newaxis] + half[:, np.newaxis] * nodes)
    at_ends = elastic.sample(ends)

    def change(rate):
        return np.einsum("pnj,n,p->pj", rate, weights, half)

    np.testing.assert_allclose(change(inside.dq), np.diff(at_ends.q, axis=0), rtol=0.0, atol=1e-12)
    # Without damping θ̇_d jumps at corners: a piece that ends in one is left out.
    _, damping = drives_of(reference, "damping")
    whole = ~np.isin(ends[1:], reference.corners()) | (damping.min() > 0.0)
    assert whole.sum() > 300
    np.testing.assert_allclose(change(inside.ddq)[whole], np.diff(at_ends.dq, axis=0)[whole], rtol=0.0, atol=1e-8)


def test_the_elastic_arm_without_friction_follows_open_loop():
    """u = I_a θ̈_d + f_v θ̇_d + τ_d moves the tip along the circle with no feedback at all."""
    reference = JointReference()
    elastic, arm = ElasticReference(reference), arm_constants(ARM)
    inertia, viscous = np.array(ARM.motor_inertia), np.array(ARM.viscous_friction)

    # Finer at the start, where the joints settle within a millisecond.
    grid = np.unique(np.concatenate([np.logspace(-7, -2, 400), np.linspace(0.0, reference.duration, 1501)]))
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
    bending = found.y[0:2].T - found.y[2:4].T
    assert np.abs(bending).max() > 1e-3  # there was something to compensate


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
    share = max(np.abs(many.q).max() / np.pi, np.abs(many.dq).max() / 15.0)
    assert elastic.box_use == pytest.approx(share, rel=1e-12)


@pytest.mark.parametrize(
    ("message", "duration", "change"),
    [
        ("theta_d2 = .* rad at t", 1.5, {"joint_limit": (3.0, 2.0055), "stiffness": (6.4e4, 2e3)}),
        ("dtheta_d2 = .* rad/s at t", 0.6, {"velocity_limit": (9.0, 11.5), "stiffness": (6.4e4, 1e3)}),
    ],
)
def test_leaving_the_box_is_refused(message, duration, change):
    """The links keep these limits; the motors, which are ahead by the bending, do not."""
    reference = JointReference(duration=duration, parameters=dataclasses.replace(ARM, **change))
    with pytest.raises(ValueError, match="^" + message + r".*allowed: \[-.*stiffen the joints"):
        ElasticReference(reference)
