"""The arm in MuJoCo agrees with ours: matrices, motion, stick, and the accuracy at which speeds are compared."""

import functools
from types import SimpleNamespace

import mujoco
import mujoco_arm as peer
import numpy as np
import pytest
from mujoco.rollout import Rollout
from slow_twins import slow_but
from support.two_joints import state_of

from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.reference import JointReference

START = np.array([0.51, 0.82, 0.5, 0.8, 1.5, -2.0, 1.4, -1.8])
TORQUE = np.array([60.0, -25.0])
INTEGRATORS = tuple(peer.STICK_RATE)


RANGES = {"mass": (0.5, 20.0), "inertia": (0.01, 1.0), "viscous_friction": (0.1, 1.0), "motor_inertia": (0.1, 3.0)}
RANGES |= {"stiffness": (1e3, 1e5), "damping": (1.0, 30.0), "static_friction": (0.5, 5.0), "length": (0.2, 1.5)}


def random_case(seed):
    rng = np.random.default_rng(seed)
    drawn = {name: rng.uniform(*ends, 2) for name, ends in RANGES.items()}
    drawn |= {"coulomb_friction": drawn["static_friction"], "mass_center": drawn["length"] * rng.uniform(0.1, 1.0, 2)}
    pairs = {name: tuple(pair.tolist()) for name, pair in drawn.items()}
    parameters = ArmParameters(**pairs, gravity=float(rng.uniform(1.0, 20.0)))
    payload = Payload(float(rng.uniform(0.5, 8.0)), "tip" if seed % 2 else "link") if seed >= 2 else Payload()
    state = np.concatenate([rng.uniform(-np.pi, np.pi, 4), rng.uniform(-10.0, 10.0, 4)])
    return parameters, payload, state


def forward(parameters, payload, state):
    arm = peer.MujocoArm(parameters, peer.Method("Euler"), 1e-4, payload)
    arm.load(state)
    mujoco.mj_forward(arm.model, arm.data)
    return arm


def errors(method, substeps, parameters=peer.FRICTIONLESS, force=(0.0, 0.0), payload=None):
    """Largest difference of an angle to the event integrator after 30 ms, by time step."""
    exact = integrate(START, TORQUE, lambda _: force, parameters, payload or Payload(), 0.0, 30e-3)
    found = []
    for arm in (peer.MujocoArm(parameters, method, 1e-3 / n, payload) for n in substeps):
        state = START
        for _ in range(30):
            state = arm.advance(state, TORQUE, force=force)
        found.append(np.abs(state - exact)[:4].max())
    return np.array(found)


def order(method, substeps, **case):
    return -np.polyfit(np.log(substeps), np.log(errors(method, substeps, **case)), 1)[0]


@pytest.mark.parametrize("seed", range(1, 4))
def test_mass_coriolis_gravity_springs_dampers_and_viscous_friction_are_ours(seed):
    parameters, payload, state = random_case(seed)
    arm, constants = forward(parameters, payload, state), dynamics.arm_constants(parameters, payload)
    _, _, q1, q2, *_, dq1, dq2 = state
    theirs = np.zeros((4, 4))
    mujoco.mj_fullM(arm.model, arm.data, theirs)
    m11, m12, m22 = dynamics.mass_matrix(np.cos(q2), constants)
    ours = np.diag([*parameters.motor_inertia, m11, m22])
    ours[2, 3] = ours[3, 2] = m12
    np.testing.assert_allclose(peer.TO_HINGES.T @ theirs @ peer.TO_HINGES, ours, rtol=1e-9, atol=1e-10)
    gravity = dynamics.gravity_torque(np.sin(q1), np.sin(q1 + q2), constants)
    ours = np.concatenate([np.zeros(2), np.add(dynamics.coriolis_torque(np.sin(q2), dq1, dq2, constants), gravity)])
    np.testing.assert_allclose(arm.data.qfrc_bias @ peer.TO_HINGES, ours, rtol=1e-9, atol=1e-9 * np.abs(ours).max())
    between = np.array(dynamics.joint_torque(state_of(state), constants))
    ours = np.concatenate([-between - np.array(parameters.viscous_friction) * state[4:6], between])
    np.testing.assert_allclose(arm.data.qfrc_passive @ peer.TO_HINGES, ours, rtol=1e-9)


@pytest.mark.parametrize("sign", [(1, 1), (-1, 1), (1, -1)])
def test_a_slipping_motor_feels_coulomb_friction_and_no_other_joint_does(sign):
    parameters, payload, state = random_case(3)
    state[:2], state[4:6] = state[2:4] + 1e-4, np.array(sign) * (2.0, 3.0)
    friction = forward(parameters, payload, state).data.qfrc_constraint @ peer.TO_HINGES
    expected = [*(-np.array(sign) * parameters.coulomb_friction), 0.0, 0.0]
    np.testing.assert_allclose(friction, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_motors_stick_below_coulomb_friction_and_slip_above(integrator):
    arm, moved = peer.MujocoArm(peer.COULOMB, peer.Method(integrator), 2e-4), []
    for share in (0.95, 1.05):
        state = np.zeros(8)
        for _ in range(50):
            state = arm.advance(state, share * np.array(peer.COULOMB.coulomb_friction))
        moved.append(np.abs(state[:2]))
    assert np.all(moved[0] < 1e-8) and np.all(moved[1] > 1e-6)


EULER = [(peer.Method(one, back), (10, 20, 40), 1) for one in INTEGRATORS[:3] for back in (False, True)]


@pytest.mark.parametrize(("method", "substeps", "expected"), [(peer.Method("RK4"), (2, 4, 8), 4), *EULER])
def test_without_friction_it_converges_to_the_event_integrator_with_its_order(method, substeps, expected):
    assert abs(order(method, substeps) - expected) < 0.1


@pytest.mark.parametrize("payload", [None, Payload(5.0, "tip"), Payload(5.0, "link")])
def test_a_payload_and_a_tip_force_are_ours(payload):
    assert errors(peer.Method("RK4"), (20,), payload=payload).item() < 1e-10
    # The torque of the force is held over a time step: order one.
    assert 0.9 < order(peer.Method("RK4"), (5, 10, 20), force=(120.0, -80.0), payload=payload) < 1.1


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_with_coulomb_friction_the_difference_shrinks(integrator):
    coarse, fine = errors(peer.Method(integrator), (5, 50), parameters=peer.COULOMB)
    assert fine < 0.2 * coarse and fine < 3e-5


exact_beginning = functools.cache(peer.exact_loop.__wrapped__)


@pytest.fixture
def beginning(monkeypatch):
    """Follow the first 0.9 s of the circle only, on which its largest errors are."""

    def reference(parameters):
        return SimpleNamespace(duration=0.9, sample=JointReference(parameters=parameters).sample)

    monkeypatch.setattr(peer, "JointReference", reference)
    monkeypatch.setattr(peer, "exact_loop", exact_beginning)


FAST = "Coulomb", "beginning"


@pytest.mark.parametrize("case", slow_but([FAST], [FAST, *((arm, None) for arm in peer.ARMS)]))
def test_the_peer_is_as_accurate_as_our_step_and_would_not_be_with_a_longer_one(case, request):
    arm, part = case
    if part:
        request.getfixturevalue(part)
    parameters, (method, timestep) = peer.ARMS[arm], peer.EQUAL_ACCURACY[arm]
    substeps = round(1e-3 / timestep)
    ours = peer.tip_error(peer.our_advance(parameters, peer.OURS), parameters)
    assert peer.tip_error(peer.MujocoArm(parameters, method, timestep).advance, parameters) <= ours
    for longer in [n for n in peer.SUBSTEPS if n < substeps][-1:]:
        assert peer.tip_error(peer.MujocoArm(parameters, method, 1e-3 / longer).advance, parameters) > ours


def test_reading_half_a_step_back_divides_the_tip_error_of_euler_by_ten(beginning):
    plain, back = (
        peer.tip_error(peer.MujocoArm(peer.COULOMB, peer.Method("Euler", back), 2e-4).advance, peer.COULOMB)
        for back in (False, True)
    )
    assert back < 0.1 * plain < 2e-6


def test_rollout_gets_the_motion_and_its_torques(beginning):
    arm = peer.MujocoArm(peer.COULOMB, peer.Method("Euler"), 2.5e-4)
    initial, control = peer.rollout_inputs(3, arm.substeps, peer.COULOMB)
    states, torques = peer.exact_loop(peer.COULOMB)
    with Rollout(nthread=0) as pool:
        recorded, _ = pool.rollout(
            arm.model, mujoco.MjData(arm.model), initial, control, control_spec=int(peer.TORQUES)
        )
    for lane, start in enumerate((0, (len(torques) - 10) // 2, len(torques) - 10)):
        state = states[start]
        for k in range(10):
            state = arm.advance(state, torques[start + k])
            row = recorded[lane, (k + 1) * arm.substeps - 1]
            theirs = np.concatenate([peer.FROM_HINGES @ row[1:5], peer.FROM_HINGES @ row[5:9]])
            np.testing.assert_allclose(theirs, state, rtol=0, atol=1e-11)


@pytest.mark.parametrize("threads", [1, 2])
def test_speed_is_counted_in_control_steps(threads, monkeypatch, beginning):
    """By a clock that gives the measurement three calls, each of 10 control steps of 5 lanes, in 0.75 s."""
    clock = iter([0.0, 0.25, 0.5, 0.75])
    monkeypatch.setattr(peer.time, "perf_counter", lambda: next(clock))
    assert peer.steps_per_second(5, threads, 5e-4, "implicitfast", 0.6) == 3 * 10 * 5 / 0.75
