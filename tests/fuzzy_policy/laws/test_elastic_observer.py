"""The observer policy: linear model and gains against other computations, estimates against the arm, tip errors."""

import dataclasses
import itertools

import gymnasium as gym
import numpy as np
import pytest
from support.plain import observer_law
from support.randomisation import ROBUST
from support.two_joints import hold

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, gravity_torque, mass_matrix, tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.stability._linearisation import largest_radius, linearise_path
from fuzzyarm.fuzzy_policy.laws._elastic_target import ElasticTarget
from fuzzyarm.fuzzy_policy.laws._gain_schedule import _GRID
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy, SmoothObserverPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, _sampled_arm, estimate_parts, gain_tables

ARM = ArmParameters()
SMOOTH = dataclasses.replace(ARM, static_friction=(0.0, 0.0), coulomb_friction=(0.0, 0.0))
LIGHT = ArmParameters(
    mass=(3.0, 1.5),
    inertia=(0.03, 0.01),
    mass_center=(0.14, 0.12),
    motor_inertia=(0.4, 0.1),
    stiffness=(5e3, 1.5e3),
    damping=(1.5, 0.5),
    static_friction=(1.0, 0.4),
    coulomb_friction=(0.7, 0.3),
    torque_limit=(60.0, 25.0),
)
PERIOD = 1e-3
STATE, LOAD = estimate_parts(2).state, estimate_parts(2).load
MEASURED = [0, 1, 4, 5]  # motor angles and velocities, of x
WEIGHTS = ObserverWeights()
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3))
WITHOUT_GAINS = ObserverWeights(link_angle=1e-6, link_velocity=1e-6, motor_torque=1e6)
POSTURE = np.array([0.4, 1.1])


def stiffer(factor):
    """Table 1 with both joints `factor` times as stiff."""
    return dataclasses.replace(ARM, stiffness=tuple(factor * np.array(ARM.stiffness)))


def move(states, torque, force, parameters, substeps=5):
    """The compiled plant over a control period: states (lanes, 8), torque and tip force (lanes, 2)."""
    moved, held, u = (np.transpose(x).copy() for x in (states, np.hstack([force, np.zeros_like(force)]), torque))
    arm = np.repeat(np.array(flat(arm_constants(parameters)))[:, np.newaxis], len(states), axis=1)
    hold(moved, u, held, arm, PERIOD / substeps, substeps)
    return moved.T


def inertia_at(cos2, parameters):
    """M_b at cos q2."""
    m11, m12, m22 = mass_matrix(cos2, arm_constants(parameters))
    return np.array([[m11, m12], [m12, m22]])


def tip_errors(envs, policy):
    """Tip errors [mm] of an episode, (steps, lanes)."""
    steps = list(episodes(envs, policy, envs.reset(seed=0)))
    assert steps[-1].completed.all()
    return np.array([1e3 * step.info["tip_error"] for step in steps])


def test_tip_errors():
    tasks = {name: (case.disturbance, ARM) for name, case in CASES.items()}
    tasks |= {"soft": (Disturbance(), stiffer(0.95)), "stiff": (Disturbance(), stiffer(1.05)), "noisy": (NOISY, ARM)}
    disturbances, arms = zip(*tasks.values(), strict=True)
    envs = gym.make_vec("FuzzyArm-v0", num_envs=len(tasks), disturbance=disturbances, parameters=arms)
    errors = dict(zip(tasks, tip_errors(envs, ElasticObserverPolicy()).T, strict=True))
    largest = {task: error.max() for task, error in errors.items()}
    assert largest["nominal"] < 0.01 and largest["noisy"] < 0.1
    assert 0.05 < largest["soft"] < 0.25 and 0.05 < largest["stiff"] < 0.25
    assert np.sqrt(np.mean(errors["machining"] ** 2)) < 2.2 and errors["machining"][100:1400].max() < 3.7
    assert np.sqrt(np.mean(errors["payload"] ** 2)) < 1.0


@pytest.mark.parametrize(
    ("plant", "payload", "loop"),
    [
        (ARM, None, {}),
        (ARM, None, {"loop_gain": 0.67, "delay": 1.0}),
        (ARM, None, {"loop_gain": 1.5, "delay": 1.0}),
        (stiffer(0.8), None, {}),
        pytest.param(stiffer(1.2), None, {}, marks=pytest.mark.slow),
        (ARM, Payload(5.0), {}),
    ],
)
def test_of_a_small_deviation_an_episode_leaves_a_hundredth(plant, payload, loop):
    """The constraint of the tuning, up to rounding."""
    assert largest_radius(linearise_path(ElasticObserverPolicy(), plant, PERIOD, payload), **loop) < 0.9971


@pytest.mark.parametrize("cos2", [-1.0, -0.3, 0.6, 1.0])
def test_the_sampled_arm_is_the_slope_of_the_compiled_plant(cos2):
    """Without gravity and dry friction, at rest; the load enters as the tip force that causes it."""
    plant = dataclasses.replace(SMOOTH, gravity=1e-9)
    q = np.array([0.4, np.arccos(cos2)])
    rest, steps = np.concatenate([q, q, np.zeros(8)]), np.repeat([1e-4, 1.0], [8, 4])  # rad, rad/s; N m, N
    points = rest + np.vstack([np.diag(steps), -np.diag(steps)])
    ahead, behind = np.split(move(points[:, :8], points[:, 8:10], points[:, 10:], plant, substeps=200), 2)
    slope = np.transpose(ahead - behind) / (2 * steps)
    A, B = _sampled_arm(plant, PERIOD, inertia_at(cos2, plant))
    expected = np.hstack([A[STATE, STATE], B[STATE], A[STATE, LOAD] @ tip_jacobian(q, plant.length).T])
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(slope / scale, expected / scale, atol=2e-6)
    np.testing.assert_array_equal(np.hstack([A[LOAD], B[LOAD]]), np.eye(12)[8:10])  # d stays


def test_gains_are_the_limits_of_the_riccati_recursions():
    """Dynamic programming backwards for K, the Kalman filter forwards for L."""
    limit, place = np.array(LIGHT.torque_limit), 2
    _, feedback, observer = gain_tables(LIGHT, PERIOD, WEIGHTS)
    A, B = _sampled_arm(LIGHT, PERIOD, inertia_at(_GRID[place], LIGHT))
    a, b, C = A[STATE, STATE], B[STATE], np.eye(10)[MEASURED]
    Q, R = np.zeros((8, 8)), np.diag(1 / limit**2)
    Q[2:4, 2:4], Q[6:8, 6:8] = np.eye(2) / WEIGHTS.link_angle**2, np.eye(2) / WEIGHTS.link_velocity**2
    P = Q.copy()
    for _ in range(3000):
        K = np.linalg.solve(R + b.T @ P @ b, b.T @ P @ a)
        P = Q + a.T @ P @ (a - b @ K)
    np.testing.assert_allclose(feedback[place], K, rtol=1e-7, atol=1e-9 * np.abs(K).max())
    noise = B @ np.diag((WEIGHTS.motor_torque * limit) ** 2 / PERIOD) @ B.T
    noise[8:, 8:] += np.diag((WEIGHTS.load_walk * limit) ** 2 * PERIOD)
    measured = np.diag([WEIGHTS.encoder_angle**2] * 2 + [WEIGHTS.encoder_velocity**2] * 2)
    P = noise.copy()
    for _ in range(3000):
        L = P @ C.T @ np.linalg.inv(C @ P @ C.T + measured)
        P = A @ (P - L @ C @ P) @ A.T + noise
    np.testing.assert_allclose(observer[place], L, rtol=1e-7, atol=1e-9 * np.abs(L).max())


def test_estimates_and_arm_settle_where_a_constant_force_and_the_reference_want_them():
    """d̂ = Jᵀ F, the links' estimate is the links, and the links are on the reference."""
    policy, force = ElasticObserverPolicy(SMOOTH), np.array([[60.0, -40.0]])
    gravity = np.array(gravity_torque(np.sin(POSTURE[0]), np.sin(POSTURE.sum()), arm_constants(ARM)))
    plant = np.concatenate([POSTURE + gravity / ARM.stiffness, POSTURE, np.zeros(4)])[np.newaxis]
    reference, state = np.concatenate([POSTURE, np.zeros(4)]), None
    for step in range(3000):
        torque, state = policy.predict(np.concatenate([plant[0, MEASURED], reference]), state)
        if step == 0:  # the arm rests under the nominal load, so there is no correction
            np.testing.assert_allclose(torque, gravity, rtol=1e-9)
        plant = move(plant, torque[np.newaxis], force, SMOOTH)
    arm, load = policy.estimate(state)
    np.testing.assert_allclose(load, tip_jacobian(POSTURE, ARM.length).T @ force[0], rtol=1e-6)
    np.testing.assert_allclose(arm, plant[0], atol=1e-9)
    np.testing.assert_allclose(plant[0, 2:4], POSTURE, atol=1e-9)


def test_the_hidden_link_side_is_found_on_the_moving_arm():
    """From a wrong first estimate to the truth, friction and stick included."""
    env, policy = gym.make("FuzzyArm-v0"), ElasticObserverPolicy()
    _, info = env.reset()
    start = np.concatenate([info["q_motor"], info["q_link"] + [1e-3, -1e-3], np.zeros(4)])
    wrong = []
    for step in itertools.islice(episodes(env, policy, env.reset(options={"initial_state": start})), 1200):
        plant = np.concatenate([step.info[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
        wrong.append(np.abs(policy.estimate(step.memory)[0] - plant))
    assert wrong[0][2:4].min() > 2e-4
    assert np.max(wrong[-1][:4]) < 1e-9 and np.max(wrong[-1][4:]) < 1e-7


@pytest.mark.parametrize(("parameters", "period", "limit"), [(LIGHT, 1e-3, 0.02), (ARM, 2e-3, 0.1)])
def test_another_arm_and_another_period(parameters, period, limit):
    policy = ElasticObserverPolicy(parameters, period)
    envs = gym.make_vec("FuzzyArm-v0", num_envs=1, parameters=parameters, control_period=period)
    assert tip_errors(envs, policy).max() < limit
    assert largest_radius(linearise_path(policy, parameters, period)) < 1.0


def test_the_law_in_plain_numpy():
    """Correct and act, with gains interpolated lane by lane; different noisy arms, some way into their episodes."""
    calm = dataclasses.replace(ROBUST, references=(JointReference(), JointReference(duration=2.0)))
    envs = gym.make_vec("FuzzyArm-v0", num_envs=64, disturbance=NOISY, randomisation=calm)
    policy = ElasticObserverPolicy()
    *_, step = itertools.islice(episodes(envs, policy, envs.reset(seed=0)), 50)
    observations, states = step.observation, step.memory
    target, expected = np.empty((len(states), 6)), np.empty((len(states), 2))
    elastic = ElasticTarget(ARM, PERIOD)
    elastic.advance(observations, states[:, : elastic.memory_size].copy(), target, expected)
    prediction = np.hstack(policy.estimate(states))
    lanes = zip(observations, prediction, target, expected, strict=True)
    expected = np.array([observer_law(policy, *lane)[1] for lane in lanes])
    limit, (torque, _) = np.array(ARM.torque_limit), policy.predict(observations, states)
    assert np.mean(np.abs(expected) < limit) > 0.9
    np.testing.assert_allclose(torque, np.clip(expected, -limit, limit), rtol=1e-9, atol=1e-8)


def test_the_smooth_observer_predicts_without_stick_and_compensates_friction_by_the_reference():
    """From each memory: the torque of the observer of an arm without dry friction, and F(v) sign v; one estimate."""
    smooth, twin = SmoothObserverPolicy(), ElasticObserverPolicy().without_dry_friction()
    cases = [CASES[name].disturbance for name in ("payload", "nominal")]
    envs = gym.make_vec("FuzzyArm-v0", num_envs=2, disturbance=cases)
    (observation, _), state, seen = envs.reset(seed=0), None, 0
    for _ in range(700):
        own, after = smooth.predict(observation, state)
        other, of_twin = twin.predict(observation, state)
        velocity = observation[:, 6:8]
        moving = np.abs(velocity) > 0.1  # there the bending does not turn the motors' direction
        friction = (4.0 + 2.0 * np.exp(-((velocity / 0.1) ** 2))) * np.array([1.0, 0.5]) * np.sign(velocity)
        np.testing.assert_allclose((own - other)[moving], friction[moving], atol=0.3)
        one, other = np.hstack(smooth.estimate(after)), np.hstack(twin.estimate(of_twin))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
        seen += moving.sum()
        (observation, *_), state = envs.step(own), after
    assert seen > 1000


def test_what_is_out_of_range_is_refused():
    for made, message in (
        (lambda: ObserverWeights(link_angle=0.0), r"ObserverWeights\.link_angle = .* allowed: \[1e-06, 1e\+06\]"),
        (lambda: ObserverWeights(encoder_angle=True), r"ObserverWeights\.encoder_angle = True"),
        (lambda: ComputedTorquePolicy(bandwidth=-1.0), "bandwidth = -1"),
        (lambda: ElasticObserverPolicy(control_period=0.2), r"control_period = .* allowed"),
        (lambda: ElasticObserverPolicy(weights=WITHOUT_GAINS), r"no gains .* cos q2 = .* control_period = 0\.001 s"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            made()
