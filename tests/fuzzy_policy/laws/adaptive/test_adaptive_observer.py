"""The adaptive observer on the environment: tip errors, beliefs against the truth, lateness, divergence, passes."""

import dataclasses
import itertools

import gymnasium as gym
import numpy as np
import pytest
from support.policies import remembered

from fuzzyarm import ArmParameters, load_policy, robot_named, run_episode
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.records import flat
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.episodes.rollout import record_passes
from fuzzyarm.fuzzy_policy.laws.adaptive._passes import _Smoother, _steadiest
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, AdaptiveWeights, ArmFunctions
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import numbers_at
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.adaptive.regulator import _gain_share, _largest_radius, adaptive_weights_for
from fuzzyarm.fuzzy_policy.laws.observer_gains import softened

ARM = ArmParameters()
POLICY = AdaptiveObserverPolicy()
MEMORY = POLICY.memory


def follow(policy, disturbances, steps=1499, state=None, late=0, **arguments):
    """Tip errors [mm] (steps, lanes) and the state after the last sample; commands `late` periods late."""
    envs = gym.make_vec("FuzzyArm-v0", num_envs=len(disturbances), disturbance=disturbances, **arguments)
    (observation, _), errors, sent = envs.reset(seed=0), [], []
    for _ in range(steps):
        torque, state = policy.predict(observation, state)
        sent.append(torque)
        observation, _, terminated, _, info = envs.step(sent[max(len(sent) - 1 - late, 0)])
        assert not terminated.any()
        errors.append(1e3 * info["tip_error"])
    return np.array(errors), state


def test_tip_errors_of_the_papers_cases_and_noise_that_teaches_the_constants_nothing():
    cases = [Disturbance(), Disturbance(tip_force=MachiningForce()), Disturbance(payload=Payload(5.0))]
    noise = EncoderNoise(position=1e-5, velocity=1e-3)
    errors, state = follow(POLICY, cases + [dataclasses.replace(case, encoder_noise=noise) for case in cases])
    rms, largest = np.sqrt(np.mean(errors**2, axis=0)), errors.max(axis=0)
    assert np.all(largest[:3] < (0.003, 2.0, 1.4))
    assert np.all(rms[[1, 2, 4, 5]] < (0.25, 0.20, 0.30, 0.20))
    assert errors[100:, 3].max() < 0.06  # noise moves little where there is no load
    for name, values in POLICY.beliefs(state).factors.items():
        np.testing.assert_allclose(values[3], 1.0, atol=0.1, err_msg=name)


def test_it_finds_force_and_stiffness():
    push = Disturbance(tip_force=ConstantForce((60.0, -40.0), 0.2))
    softer = dataclasses.replace(ARM, stiffness=(0.85 * ARM.stiffness[0], 1.15 * ARM.stiffness[1]))
    exciting = Disturbance(tip_force=ConstantForce((150.0, 100.0), 0.2))  # without a load little bends
    _, state = follow(POLICY, [push, exciting], 900, parameters=[ARM, softer])
    beliefs = POLICY.beliefs(state)
    np.testing.assert_allclose(beliefs.force[0], (60.0, -40.0), atol=10.0)
    stiffness, deviation = beliefs.factors["stiffness"][1], beliefs.factors_deviation["stiffness"][1]
    assert stiffness[0] == pytest.approx(0.85, abs=0.05) and stiffness[1] > 1.0
    assert np.all(np.abs(stiffness - (0.85, 1.15)) < 2.5 * deviation)
    assert np.all(np.abs(beliefs.force[0] - (60.0, -40.0)) < 3.0 * beliefs.force_deviation[0])
    assert not beliefs.diverged.any()


def test_it_finds_what_a_payload_asks_of_the_joints():
    """A payload, a force, the links' masses and an offset share a load: what they ask together is what is known."""
    state, functions = follow(POLICY, [Disturbance(payload=Payload(4.0))], 600)[1][0], ArmFunctions(two_joints())
    wanted, believed = state[MEMORY.references].reshape(-1, 3, 2)[0], np.empty(len(POLICY.settings.base))
    numbers_at(state[MEMORY.z][8:], POLICY.settings, believed)

    def torque(force, numbers):
        return np.array(functions.link_torque(*wanted, force, functions.constants_in(numbers)))

    light, heavy = (torque(np.zeros(2), np.array(flat(arm_constants(ARM, Payload(mass))))) for mass in (0.0, 4.0))
    beliefs = POLICY.beliefs(state)
    np.testing.assert_allclose(torque(beliefs.force, believed) - beliefs.offset, heavy, rtol=0.03)
    assert np.all(light < 0.7 * heavy)


def test_it_finds_an_untold_lateness_and_stays_stable():
    errors, state = follow(POLICY, [Disturbance()], 700, late=2)
    assert POLICY.beliefs(state).lateness[0] == pytest.approx(2e-3, abs=5e-4)
    assert errors[300:].max() < 0.5


@pytest.mark.parametrize("taught", [0.0, 1.0])  # 1: after a pass
def test_the_gain_waits_then_grows_in_as_long_again(taught):
    policy = AdaptiveObserverPolicy(weights=AdaptiveWeights(first_gain=0.4, soft_start=0.02))
    memory, found = remembered(np.zeros(policy.memory.noise.stop), two_joints()), []
    memory.flags[FLAG.taught] = taught
    for memory.flags[FLAG.samples] in range(1, 101):
        found.append(_gain_share(memory, policy.settings))
    growing = np.concatenate([np.full(20, 0.4), np.linspace(0.4, 1.0, 21), np.ones(59)])
    np.testing.assert_allclose(found, np.maximum(growing, taught), rtol=1e-12)


def test_a_diverged_filter_says_so_and_the_certified_law_acts():
    policy, env = load_policy("adaptive-observer"), gym.make("FuzzyArm-v0")
    observation, info = env.reset(seed=0)
    _, broken = policy.predict(observation)
    assert not policy.beliefs(broken).diverged
    broken[20] = np.nan
    *_, last = itertools.islice(episodes(env, policy, (observation, info), memory=broken), 300)
    assert last.running and not last.ended
    assert policy.beliefs(last.memory).diverged and last.info["tip_error"] < 1e-3
    certified, kept = load_policy("fuzzy-4-tip"), last.memory[-policy.fallback.memory_size :]
    torque, _ = policy.predict(last.observation, last.memory)
    np.testing.assert_array_equal(certified.predict(last.observation, kept)[0], torque)


@pytest.mark.slow
def test_six_joints():
    """The UR5 under loads that nobody told: errors, beliefs, a second pass and the fallback, all of six joints."""
    robot = robot_named("ur5")
    adaptive = load_policy("adaptive-observer", robot=robot)
    for case in ("nominal", "machining", "payload"):
        run, other = (run_episode(one, case, robot=robot) for one in (adaptive, "elastic-observer"))
        assert run.completed and other.completed
        if case == "nominal":
            assert run.tip_error.max() < 2e-5
        else:
            assert 1.5 * run.tip_error.max() < other.tip_error.max()
        if case == "machining":
            error = np.linalg.norm(run.beliefs[1:, :3] - run.external_force[:-1], axis=1)
            assert np.median(error) < 0.3 * np.median(np.linalg.norm(run.external_force, axis=1))
    env = FuzzyArmEnv(robot=robot, case="machining")
    passes = record_passes(env, adaptive, 2, policy_name="adaptive-observer", case="machining", seed=0)
    assert passes[1].tip_error.max() < 0.8 * passes[0].tip_error.max()
    observation, _ = env.reset(seed=0)
    _, state = adaptive.predict(observation)
    state[adaptive.memory.z] = np.nan
    torque, state = adaptive.predict(observation, state)
    assert adaptive.beliefs(state).diverged and adaptive.beliefs(state).factors["mass"].shape == (6,)
    fallback, frozen = load_policy("computed-torque-tip", robot=robot), adaptive.without_dry_friction()
    np.testing.assert_array_equal(torque, fallback.predict(observation)[0])
    np.testing.assert_allclose(frozen.predict(observation)[0], torque, atol=0.2 * np.abs(torque).max())


def test_a_robot_whose_regulator_is_stable_has_the_weights_of_table_1():
    robot = robot_named("manutec-r3")
    assert adaptive_weights_for(ArmParameters(mass=(14.0, 8.0)), 1e-3) == AdaptiveWeights()
    assert _largest_radius(robot, 1e-3, AdaptiveWeights()) < 1.0
    assert adaptive_weights_for(robot, 1e-3) == AdaptiveWeights()


@pytest.mark.slow
def test_the_smallest_factor_with_a_stable_regulator_is_taken():
    robot = robot_named("ur5")
    chosen = adaptive_weights_for(robot, 1e-3)
    assert chosen.travel_walk == AdaptiveWeights().travel_walk and chosen.link_angle > AdaptiveWeights().link_angle
    assert chosen.first_gain == 1.0  # what is softened for good needs no soft start
    assert _largest_radius(robot, 1e-3, chosen) < 1.0 <= _largest_radius(robot, 1e-3, softened(chosen, 0.5))


PUSH = ConstantForce((0.0, 150.0), 0.1, 0.3)
LOADS = [Disturbance(tip_force=PUSH), Disturbance(payload=Payload(4.0)), Disturbance()]
SHORT = JointReference(duration=0.8, path=Circle(radius=0.06))


def run(repeated, state, reference=SHORT):
    """Tip errors [mm] (steps, lanes) of one pass, and the state after it."""
    return follow(repeated, LOADS, 799, state, reference=reference)


def test_the_first_pass_is_the_policy_itself_bit_for_bit():
    alone, of_passes = (follow(policy, LOADS, 20) for policy in (POLICY, POLICY.repeated()))
    np.testing.assert_array_equal(of_passes[0], alone[0])
    np.testing.assert_array_equal(of_passes[1].memory, alone[1])


@pytest.mark.slow
def test_errors_fall_from_pass_to_pass():
    largest = {}
    for name, repeated in (("own", POLICY.repeated()), ("iterative", load_policy("fuzzy-4-tip").repeated())):
        state, largest[name] = None, np.empty((3, len(LOADS)))
        for k in range(3):
            errors, state = run(repeated, state)
            largest[name][k], state = errors.max(axis=0), repeated.begin_pass(state)
    first, second, third = largest["own"]
    assert np.all(second[:2] < 0.45 * first[:2]) and np.all(third[:2] < 0.35 * first[:2])
    assert third[2] < 0.01  # without a load there is nothing to learn
    first, _, third = largest["iterative"]  # it brings the motors home and not the tip
    assert third[0] < first[0] and third[1] > 0.5


@pytest.mark.slow
def test_with_the_true_constants_the_true_force_explains_a_pass():
    repeated, payload = POLICY.repeated(), [load.payload.mass for load in LOADS]
    _, state = run(repeated, None)
    known = state.memory.copy()
    known[:, repeated._constants], known[:, repeated._payload] = POLICY.settings.guess, payload
    force = _Smoother(POLICY).force(state, np.ones(len(LOADS), dtype=bool), known)
    truth = np.zeros_like(force)
    truth[100:300, 0] = 0.0, 150.0
    away = np.r_[20:80, 130:270, 330:760]  # from the jumps of the force and from the ends
    assert np.abs(force - truth)[away].max() < 4.0
    found = POLICY.beliefs(repeated.begin_pass(state).memory).payload
    np.testing.assert_allclose(found, payload, atol=0.4)


def test_the_steadiest_force_varies_least_in_total():
    generator = np.random.default_rng(3)
    force, slope = generator.normal(size=(2, 60, 4, 2)).cumsum(axis=1)
    force[30:] += 20.0  # a jump counts once, however high it is

    def variation(x):
        return np.linalg.norm(np.diff(force + x * slope, axis=0), axis=2).sum(axis=0)

    found = _steadiest(force, slope)[:, np.newaxis]
    assert np.all(np.minimum(variation(found - 0.02), variation(found + 0.02)) > variation(found))


@pytest.mark.slow
def test_on_another_path_nothing_is_expected():
    repeated = POLICY.repeated()
    state = repeated.begin_pass(run(repeated, None)[1])
    errors, state = run(repeated, state, JointReference(duration=0.8, path=Circle(radius=0.05)))
    assert state.other_path.all() and errors.max() < 5.0
    fresh = repeated.begin_pass(state)
    assert np.all(fresh.expected == 0.0) and np.all(fresh.passes == 0)


def test_without_a_sample_there_is_no_pass_to_learn_from():
    for repeated in (POLICY.repeated(), load_policy("fuzzy-4-tip").repeated()):
        _, state = repeated.predict(np.zeros((3, 10)))
        with pytest.raises(ValueError, match="no pass to learn from"):
            repeated.begin_pass(repeated.begin_pass(state))
    assert load_policy("elastic-observer").repeated() is None
