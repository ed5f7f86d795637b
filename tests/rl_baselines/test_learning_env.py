"""The environment of the training equals that of the shipped policy, and its state is restored bit for bit."""

import gymnasium as gym
import numpy as np
import pytest
from slow_twins import slow_but

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.reference import JointReference

pytest.importorskip("stable_baselines3")
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.network import Network
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.case_evaluation import evaluate_cases
from fuzzyarm.rl_baselines.learning_env import LearningEnvs, learning_envs, sharpened_reward
from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

PERIOD = 0.002
SHORT = JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.05)
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3))


def configured(lanes, **values):
    """A configuration with so many arms."""
    return PPOConfig(lanes=lanes, batch_size=lanes, **values)


def bundle(config, seed=0):
    """A random policy for a configuration."""
    rng, size = np.random.default_rng(seed), config.features.size
    network = Network(
        mean=np.zeros(size),
        std=np.ones(size),
        clip=10.0,
        weights=(0.2 * rng.normal(size=(8, size)), 0.5 * rng.normal(size=(2, 8))),
        biases=(np.zeros(8), np.zeros(2)),
    )
    return PolicyBundle(config.features, config.action, network)


def base_of(config):
    """The base policy, for the training's control period."""
    return None if config.base == "none" else load_policy(config.base, control_period=PERIOD, allow_unproven=True)


def vector(lanes, **arguments):
    """Arms at the training's control period."""
    return gym.make_vec("FuzzyArm-v0", num_envs=lanes, control_period=PERIOD, **arguments)


CONFIGS = {
    "torques": configured(lanes=5),
    "residual": configured(lanes=5, base="fuzzy-4-tip", scale=(0.01, 0.02), elastic_target=True, smoothing_time=0.03),
    "observer": configured(
        lanes=5,
        base="elastic-observer",
        scale=(40.0, 20.0),
        gate=1.0,
        innovation_times=(0.004, 0.02),
        smoothing_time=0.01,
    ),
}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_training_and_the_shipped_policy_see_and_do_the_same(config):
    """The network in the training's arms and the bundle in the plain ones: the same episodes, through their ends."""
    arguments = {"disturbance": NOISY, "reference": SHORT, "randomisation": "plants"}
    training = LearningEnvs(StableBaselinesVecEnv(vector(5, **arguments)), config, base_of(config))
    made = bundle(config)
    policy, plain = LearnedPolicy(made, PERIOD, base=base_of(config)), vector(5, **arguments)
    training.seed(3)
    features, (observation, _) = training.reset(), plain.reset(seed=3)
    state, starts, ends = None, np.ones(5, dtype=bool), 0
    applied, keep = np.zeros((5, 2)), config.action.smoothing
    for _ in range(60):
        action = np.empty((5, 2))
        made.network.act(features, action)
        applied = keep * np.where(starts[:, np.newaxis], 0.0, applied) + (1.0 - keep) * action
        features, _, dones, infos = training.step(action)
        torque, state = policy.predict(observation, state, starts)
        observation, _, terminated, truncated, info = plain.step(torque)
        starts = terminated | truncated
        assert np.array_equal(starts, dones) and np.array_equal(features[:, 4:6], observation[:, 4:6])
        assert np.array_equal(training.venv.vector_info["torque"], info["torque"])
        error = np.where(dones, info["final_info"]["tip_error"] if dones.any() else 0.0, info["tip_error"])
        assert np.array_equal(training.tip_errors, error)  # of the episode that ended, not of the next one's beginning
        for lane in np.flatnonzero(dones):
            ends += 1
            last = infos[lane]["terminal_observation"]
            assert last.shape == (config.features.size,) and np.array_equal(last[4:6], info["final_obs"][lane][4:6])
            assert np.array_equal(last[14:16], applied[lane])  # the action before it
            assert not features[lane, 10:].any()  # nothing is remembered of the episode that ended
    assert ends == 10 and np.ptp(torque) > 1.0


@pytest.mark.parametrize("distribution", slow_but(["nominal"], ["nominal", "robust"]))
def test_arms_left_and_taken_up_again_go_on_bit_for_bit(distribution):
    config = configured(
        lanes=4,
        distribution=distribution,
        circles=2,
        base="fuzzy-4-tip",
        scale=(0.4, 0.18),
        elastic_target=True,
        smoothing_time=0.004,
    )
    first, second = (learning_envs(config, base_of(config)) for _ in range(2))
    first.seed(7)
    first.reset()
    rng = np.random.default_rng(0)
    actions = np.repeat(rng.choice([-1.0, 1.0], (9, 4, 2)), 100, axis=0)
    for action in actions[:450]:
        first.step(action)
    state = first.get_state()
    ends = 0

    def onwards(envs):
        nonlocal ends
        shown = []
        for action in actions[450:]:
            features, rewards, dones, infos = envs.step(action)
            ends += int(dones.sum())
            lengths = [info["episode"]["l"] for info in infos if info]
            shown.append((features.tobytes(), rewards.tobytes(), dones.tobytes(), lengths, envs.tip_errors.tobytes()))
        return shown

    expected = onwards(first)
    second.set_state(state)
    assert onwards(second) == expected and ends >= 4
    first.set_state(state)  # the state was not touched, and an environment goes back too
    assert onwards(first) == expected


def test_a_state_of_other_arms_is_refused():
    envs = vector(2)
    with pytest.raises(gym.error.ResetNeeded, match=r"before envs\.get_state"):
        envs.get_state()
    envs.reset(seed=0)
    state = envs.get_state()
    softer = vector(2, parameters=ArmParameters(stiffness=(20000.0, 10000.0)))
    others = vector(3), vector(2, case="payload"), vector(2, reference=SHORT), vector(2, randomisation="plants"), softer
    for other in others:
        with pytest.raises(ValueError, match="other plants, scenarios, randomisation, periods or another number"):
            other.set_state(state)
    envs.reset(options={"case": "payload"})
    with pytest.raises(ValueError, match="lane 0 is in a scenario that reset options asked for"):
        envs.get_state()


def test_the_sharpened_reward_has_a_slope_everywhere():
    errors, effort = np.array([0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 2.0]), np.zeros(7)
    reward = sharpened_reward(errors, effort, 1e-3)
    assert reward[0] == 1.0 and np.all(np.diff(reward) < 0.0) and reward[-1] > 0.0
    assert reward[3] - reward[4] == pytest.approx(reward[4] - reward[5], rel=0.1)  # a decade is a decade
    assert sharpened_reward(errors, effort + 1.0, 1e-3) == pytest.approx(0.9 * reward)
    config = configured(lanes=2, tip_error_scale=1.0)
    envs = learning_envs(config, None)
    envs.seed(0)
    envs.reset()
    for _ in range(5):
        _, rewards, _, _ = envs.step(np.full((2, 2), 0.3))
    limits = envs.venv.envs.action_space.high[0]
    effort = 0.5 * ((120.0 / limits[0]) ** 2 + (54.0 / limits[1]) ** 2)
    assert rewards == pytest.approx(sharpened_reward(envs.tip_errors, np.full(2, effort), 1e-3), rel=1e-6)


def test_the_quick_evaluation_finds_what_fuzzyarm_evaluate_finds():
    from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate

    found = evaluate_cases(load_policy("fuzzy-4", allow_unproven=True))
    for row in evaluate(EvaluationConfig(policies=("fuzzy-4",))).rows:
        case = row["case"]
        assert found[f"{case}_max_mm"] == pytest.approx(row["tip_error_max_mm"], rel=1e-9)
        assert found[f"{case}_rms_mm"] == pytest.approx(row["tip_error_rms_mm"], rel=1e-9)
        assert found[f"{case}_share"] == 1.0


def test_the_quick_evaluation_of_an_episode_that_ends_early_is_of_that_episode_alone():
    class ThrowsTheFirst:
        """Fuzzy-4, but at full torque in Case 1."""

        control_period = 1e-3
        law = load_policy("fuzzy-4", allow_unproven=True)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            action, state = self.law.predict(observation, state, episode_start)
            action[0] = [500.0, 250.0]
            return action, state

    env, errors, terminated = gym.make("FuzzyArm-v0"), [], False
    env.reset(seed=0)
    while not terminated:
        _, _, terminated, _, info = env.step(np.array([500.0, 250.0]))
        errors.append(1e3 * info["tip_error"])
    found, untouched = evaluate_cases(ThrowsTheFirst()), evaluate_cases(ThrowsTheFirst.law)
    assert found["nominal_max_mm"] == pytest.approx(max(errors), rel=1e-12)
    assert found["nominal_rms_mm"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-12)
    assert found["nominal_share"] == pytest.approx(len(errors) / 1500, abs=1e-9)
    assert all(found[name] == untouched[name] for name in found if not name.startswith("nominal"))
