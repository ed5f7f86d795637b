"""Policies: their laws against plain NumPy, the predict protocol, batches and threads, the integral at the limits."""

import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but
from support.policies import answers, loaded

from fuzzyarm import ArmParameters, load_policy, robot_named, run_episode
from fuzzyarm.envs.physics.equations import chosen_arm, robot_of
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics, mass_matrix
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.loop import TipErrors, episodes
from fuzzyarm.fuzzy_policy.laws._gain_schedule import schedule_of
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.ts_model import premises
from fuzzyarm.policies import NAMES

ARM = ArmParameters()


def observations(count):
    """Return observations near their reference, so that no torque is clipped."""
    rng = np.random.default_rng(0)
    q, dq, ddq = (rng.uniform(-largest, largest, (count, 2)) for largest in (3, 4, 5))
    return np.hstack([np.hstack([q, dq]) + 1e-3 * rng.normal(size=(count, 4)), q, dq, ddq])


def with_states(name, count):
    """A policy, a batch of observations, and its states after two calls."""
    policy, batch = loaded(name), observations(count)
    return policy, batch, answers(policy, (batch, batch + 1e-3))[1]


def read_only(array):
    return np.broadcast_to(array, array.shape)


def unaligned(array):
    moved = np.zeros(array.nbytes + 1, np.uint8)[1:].view(np.float64).reshape(array.shape)
    moved[:] = array
    return moved


def test_fuzzy_policy_is_the_law_of_the_file():
    """The law (12) with the consistent feedforward, vertex by vertex."""
    policy, integral = load_policy("fuzzy-4"), np.array([1e-4, -2e-4])
    model, gains = policy.controller.model, policy.controller.gains
    for o in observations(30):
        h, v = model.weights(premises(o[:2], o[2:4], model.parameters))
        error, u = np.concatenate([o[:4] - o[4:8], integral]), np.zeros(2)
        for i, A in enumerate(model.A_vertices):
            for k, E in enumerate(model.E_vertices):
                u += h[i] * v[k] * (gains[i, k] @ error - A[2:] @ o[4:8] + E[2:, 2:] @ o[8:])
        action, state = policy.predict(o, state=integral)
        np.testing.assert_allclose(action, u, rtol=1e-10, atol=1e-9)
        np.testing.assert_allclose(state, integral + 1e-3 * (o[:2] - o[4:6]), rtol=1e-12)


@pytest.mark.parametrize("name", slow_but(["paper", "planar-3r"], ["paper", "planar-3r", "ur5"]))
def test_computed_torque_linearises_the_rigid_arm(name):
    """On the rigid arm the error obeys ë + 3ω ė + 3ω² e + ω³ x_I = 0."""
    arm, rng = chosen_arm(name, None), np.random.default_rng(0)
    robot, policy = robot_of(arm), ComputedTorquePolicy(arm, bandwidth=40.0)
    n, w, limit = len(robot), policy.bandwidth, robot.drive("torque_limit")
    for _ in range(30):
        q, (dq, ddq_d), integral = rng.uniform(-3, 3, n), rng.normal(size=(2, n)), 1e-6 * rng.normal(size=n)
        q_d, dq_d = q + 1e-4 * rng.normal(size=n), dq + 1e-3 * rng.normal(size=n)
        e, de = q - q_d, dq - dq_d
        wanted = ddq_d - 3 * w * de - 3 * w**2 * e - w**3 * integral
        torque = inverse_dynamics(robot, q, dq, wanted)
        torque += robot.drive("motor_inertia") * wanted + robot.drive("viscous_friction") * dq
        action, state = policy.predict(np.concatenate([q, dq, q_d, dq_d, ddq_d]), integral)
        np.testing.assert_allclose(action, np.clip(torque, -limit, limit), rtol=1e-10, atol=1e-9)
        held = (np.abs(torque) > limit) & (np.sign(e) == -np.sign(torque))
        np.testing.assert_allclose(state, np.where(held, integral, integral + 1e-3 * e), rtol=1e-12)


# Of the fuzzy policies the largest, the default and the one of one rule: others differ in the number of rules alone.
OTHERS = ("fuzzy-16", "fuzzy-8", "fuzzy-2", "fuzzy-4-sampled")
ONE_OF_A_KIND = [name for name in (*NAMES, "smooth-observer") if not name.startswith(OTHERS)]
# Lanes of learned-observer are compared with single arms where its equations are tested.
QUICK = [name for name in ONE_OF_A_KIND if "32" not in name and name != "learned-observer"]


@pytest.mark.parametrize("name", slow_but(QUICK, ONE_OF_A_KIND))
class TestProtocol:
    def test_a_batch_equals_its_lanes_bit_for_bit(self, name):
        policy, batch, states = with_states(name, 40)
        actions, after = policy.predict(batch, state=states)
        for lane in range(0, 40, 3):
            action, state = policy.predict(batch[lane], state=states[lane])
            np.testing.assert_array_equal(action, actions[lane])
            np.testing.assert_array_equal(state, after[lane])

    @pytest.mark.parametrize("laid_out", [np.asfortranarray, read_only, unaligned])
    def test_the_layout_of_what_is_given_changes_nothing(self, name, laid_out):
        policy, batch, states = with_states(name, 3)
        before = batch.copy(), states.copy()
        found, wanted = policy.predict(laid_out(batch), state=laid_out(states)), policy.predict(batch, state=states)
        assert all(map(np.array_equal, found, wanted)) and all(map(np.array_equal, before, (batch, states)))

    def test_episode_start_resets_only_its_lanes(self, name):
        policy, batch, states = with_states(name, 3)
        actions, _ = policy.predict(batch, state=states, episode_start=np.array([False, True, False]))
        (fresh, _), (kept, _) = policy.predict(batch), policy.predict(batch, state=states)
        np.testing.assert_array_equal(actions[[0, 2]], kept[[0, 2]])
        np.testing.assert_array_equal(actions[1], fresh[1])
        assert not np.array_equal(fresh[1], kept[1])

    def test_torques_are_clipped_to_the_limits(self, name):
        policy = loaded(name)
        action, _ = policy.predict(np.array([3.0, -3.0, 0, 0, -3.0, 3.0, 0, 0, 0, 0]))
        if name in ("ppo-nominal", "ppo-robust"):  # their own scale is below the limits
            assert np.all(np.abs(action) <= [400.0, 180.0]) and np.any(action != 0.0)
        else:
            assert np.all(np.abs(action) == ARM.torque_limit)

    def test_wrong_shapes_are_named(self, name):
        policy = loaded(name)
        for shape in ((9,), (2, 11), (1, 2, 10), ()):
            with pytest.raises(ValueError, match=r"allowed: \(10,\), or \(n, 10\) for n observations"):
                policy.predict(np.zeros(shape))
        for lanes, message in ((2, "state has shape"), (3, "episode_start has shape")):
            with pytest.raises(ValueError, match=message):
                policy.predict(np.zeros((3, 10)), np.zeros((lanes, policy.memory_size)), np.ones(2, bool))

    def test_evaluate_policy_of_stable_baselines3_runs_it(self, name):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            from stable_baselines3.common.evaluation import evaluate_policy
            from stable_baselines3.common.monitor import Monitor
        short = JointReference(path=Line((0.4, 0.5), (0.45, 0.45)), duration=0.3)
        env = Monitor(gym.make("FuzzyArm-v0", reference=short))
        returns, lengths = evaluate_policy(loaded(name), env, n_eval_episodes=2, return_episode_rewards=True)
        assert lengths == [300, 300]
        assert returns[0] == returns[1] > 200.0


LIMIT = np.array(ARM.torque_limit)


@pytest.mark.parametrize("name", ["fuzzy-4", "computed-torque", "fuzzy-4-tip", "computed-torque-tip"])
def test_the_integral_is_held_exactly_where_it_would_drive_a_torque_further_beyond_its_limit(name):
    policy, rng = load_policy(name), np.random.default_rng(1)
    seen, start = rng.uniform(-1.0, 1.0, (4000, 10)), np.zeros((4000, policy.memory_size))
    seen[:, 4:6] = seen[:, :2] - 0.3 * rng.uniform(-1.0, 1.0, (4000, 2))
    start[:, :2] = rng.normal(scale=0.02, size=(4000, 2))
    torque, state = policy.predict(seen, start)
    wanted, unlimited = np.empty_like(torque), start.copy()
    policy.act(seen, unlimited, wanted)
    change = unlimited[:, :2] - start[:, :2]
    held = (np.abs(wanted) > LIMIT) & (np.sign(change) == -np.sign(wanted))
    assert 100 < held.sum() < held.size - 100
    assert (np.abs(wanted) > LIMIT)[~held].sum() > 100  # beyond a limit, and the integral brings the torque back
    np.testing.assert_array_equal(state[:, :2], np.where(held, start[:, :2], unlimited[:, :2]))
    np.testing.assert_array_equal(state[:, 2:], unlimited[:, 2:])
    np.testing.assert_array_equal(torque, np.clip(wanted, -LIMIT, LIMIT))


def test_a_push_that_the_motors_cannot_hold_is_survived():
    """1000 N for 0.2 s: without the hold the integral winds up and the arm leaves its domain."""
    push = Disturbance(tip_force=ConstantForce((0.0, 1000.0), 0.4, 0.6))
    policy, free = load_policy("fuzzy-4"), load_policy("fuzzy-4")
    free.integral_at = None
    held, wound = (run_episode(one, disturbance=push) for one in (policy, free))
    assert held.completed and not wound.completed
    assert held.tip_error.max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar-3r", "ur5"])
def test_the_compensation_and_the_observer_bring_the_tip_onto_the_path(name):
    policies = ("computed-torque", "computed-torque-tip", "elastic-observer")
    runs = [run_episode(policy, robot=name) for policy in policies]
    assert all(run.completed for run in runs)
    plain, tip, observed = (run.tip_error.max() for run in runs)
    assert plain > 3e-4 and tip < 0.1 * plain and observed < 0.2 * plain


def test_of_three_joints_in_a_plane_the_table_holds_the_mass_matrix_itself():
    robot, turns = robot_named("planar-3r"), 2 * np.pi * np.arange(8) / 8
    postures = np.array([(0.7, second, third) for second in turns for third in turns])
    np.testing.assert_allclose(schedule_of(robot).inertia, mass_matrix(robot, postures), atol=1e-12)


STEPS, LANES = 200, 1024


def run(policy, rows):
    """Torques and memories of `command` along observations (steps, lanes, 10), as copies."""
    memory, found = np.zeros((rows.shape[1], policy.memory_size)), []
    for row in rows:
        torque = np.empty((len(row), 2))
        assert policy.command(row, memory, torque)
        found.append(np.concatenate([torque, memory], axis=1))
    return np.stack(found)


@pytest.mark.parametrize("name", ["fuzzy-4", "elastic-observer"])
def test_threads_and_batches_give_what_one_arm_gives(name):
    policy = load_policy(name)
    rows = np.random.default_rng(0).normal(0.0, 0.1, (STEPS, 24, 10))  # motions that no two threads share
    batch = run(policy, rows)
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # s; threads take turns within a call
    try:
        with ThreadPoolExecutor(8) as pool:
            alone = list(pool.map(lambda lane: run(policy, rows[:, lane : lane + 1]), range(24)))
    finally:
        sys.setswitchinterval(usual)
    assert np.array_equal(np.concatenate(alone, axis=1), batch)


@pytest.mark.parametrize("name", slow_but(["fuzzy-4"], ["fuzzy-4", "fuzzy-32", "computed-torque"]))
def test_a_thousand_different_arms_are_tracked_to_the_end(name):
    envs, errors = gym.make_vec("FuzzyArm-v0", num_envs=LANES, randomisation="plants"), TipErrors(LANES)
    observation, info = envs.reset(seed=0)
    assert len(np.unique(info["randomisation"]["mass"], axis=0)) == LANES
    for step in episodes(envs, load_policy(name, allow_unproven=True), (observation, info)):
        errors.add(step)
    assert errors.completed.all() and np.all(errors.steps == 1500)
    assert errors.largest.min() > 1e-3 and errors.largest.max() < 6e-3  # Table 1 itself: 4.2 to 4.6 mm
    assert step.memory.shape == np.unique(step.memory, axis=0).shape == (LANES, 2)  # an integral of its own for each
