"""``FuzzyArmLearn-v0``: spaces, reward, ends, and that a lane of a batch is the single environment."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.bundles import answering, bundle
from support.results import identical

from fuzzyarm import ArmParameters, load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Line
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnEnv, FuzzyArmLearnVectorEnv, tracking_reward

ID = "fuzzyarm:FuzzyArmLearn-v0"
PAPER = {"case": "nominal"}  # nothing is drawn, and made quickly


@pytest.mark.parametrize(
    "arguments", [{}, {"history": 3, "preview": (1, 5)}, {"robot": "planar-3r", "case": "nominal"}]
)
def test_gymnasium_finds_nothing_wrong(arguments):
    env = gym.make(ID, **arguments).unwrapped
    check_env(env, skip_render_check=True)
    n = env.action_space.shape[0]
    size = n * (5 + 2 * 3 + 1 + 3 * 2) if "history" in arguments else 5 * n
    assert env.observation_space.shape == (size,) and env.observation_space.dtype == np.float32


def test_stable_baselines3_finds_nothing_wrong():
    from stable_baselines3.common.env_checker import check_env as check

    check(FuzzyArmLearnEnv())


@pytest.mark.parametrize("mode", ["SameStep", "NextStep", "Disabled"])
def test_a_lane_is_the_single_environment_with_its_seed(mode):
    rng, arguments, lanes = np.random.default_rng(0), {"history": 2, "preview": (1, 5)}, 4
    envs = gym.make_vec(ID, num_envs=lanes, vectorization_mode="vector_entry_point", autoreset_mode=mode, **arguments)
    singles = [FuzzyArmLearnEnv(**arguments) for _ in range(lanes)]
    batch, _ = envs.reset(seed=5)
    alone = [env.reset(seed=5 + k)[0] for k, env in enumerate(singles)]
    over, ends = np.zeros(lanes, dtype=bool), 0
    for _ in range(250):
        np.testing.assert_array_equal(batch, alone)
        actions = rng.uniform(-0.5, 0.5, (lanes, 2))
        batch, reward, terminated, truncated, info = envs.step(actions)
        for k, env in enumerate(singles):
            if over[k]:  # in NextStep this step has begun an episode
                over[k], alone[k] = False, env.reset()[0]
                assert (reward[k], terminated[k], truncated[k]) == (0.0, False, False)
                continue
            alone[k], earned, *ended, one = env.step(actions[k])
            assert (reward[k], terminated[k], truncated[k]) == (earned, *ended)
            if not any(ended):
                assert info["tip_error"][k] == one["tip_error"]
                continue
            ends += 1
            last = info["final_info"] if mode == "SameStep" else info
            assert last["tip_error"][k] == one["tip_error"] and last["reason"][k] == one["reason"]
            if mode == "SameStep":
                np.testing.assert_array_equal(info["final_obs"][k], alone[k])
                alone[k], begun = env.reset()
                assert info["tip_error"][k] == begun["tip_error"]
            over[k] = mode == "NextStep"
        if mode == "Disabled" and (mask := terminated | truncated).any():
            batch, _ = envs.reset(options={"reset_mask": mask})
            for k in np.flatnonzero(mask):
                alone[k] = singles[k].reset()[0]
    assert ends > lanes


def test_observation_reward_and_torque_are_what_the_page_says():
    """With the plant at rest beside a circle, against the arm itself held for as long."""
    env, arm = FuzzyArmLearnEnv(**PAPER), FuzzyArmEnv(control_period=2e-3)
    start = {"initial_state": np.array([-0.3, 1.2, -0.3, 1.2, 0.0, 0.0, 0.0, 0.0])}
    env.reset(seed=0, options=start)
    arm.reset(options=start)
    action = np.array([0.1, -0.2])
    seen, reward, *_ = env.step(action)
    o, *_, info = arm.step(np.array([500.0, 250.0]) * action)
    e, de = o[4:6] - o[:2], o[6:8] - o[2:4]
    expected = [*np.arcsinh(e / 1e-3) / 3, *np.arcsinh(de / 0.02) / 3, *o[4:6], *o[6:8] / 5.0, *o[8:] / 50.0]
    np.testing.assert_allclose(seen, np.clip(expected, -10, 10), rtol=1e-6)
    assert info["tip_error"] > 0.2 and reward == 0.0
    assert tracking_reward(np.array([0.0, 0.2])).tolist() == pytest.approx([1.0, 0.0], abs=1e-12)


def test_a_tip_is_rewarded_until_it_is_lost():
    env = FuzzyArmLearnEnv(**PAPER, early_end=0.01)
    env.reset(seed=0)
    for _ in range(300):
        _, reward, terminated, truncated, info = env.step(np.ones(2))
        if terminated or truncated:
            break
        assert reward == pytest.approx(1.0 - np.log1p(info["tip_error"] / 1e-4) / np.log1p(0.01 / 1e-4))
    assert terminated and reward == 0.0 and info["tip_error"] > 0.01
    assert info["reason"] == "the tip lost its reference"
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(2))


def test_seeds_draw_other_starts_and_references_and_repeat_themselves():
    envs = FuzzyArmLearnVectorEnv(32)
    first, info = envs.reset(seed=0)
    assert len(np.unique(info["drawn_reference"])) > 10 and len(np.unique(info["drawn_angle"][:, 0])) == 32
    np.testing.assert_array_equal(envs.reset(seed=0)[0], first)
    assert not np.array_equal(envs.reset(seed=32)[0], first)


def test_a_state_goes_on_bit_for_bit_and_not_in_other_lanes():
    one, two, rng = *(FuzzyArmLearnVectorEnv(3, history=2) for _ in range(2)), np.random.default_rng(1)
    one.reset(seed=0)
    actions = rng.uniform(-0.3, 0.3, (60, 3, 2))
    for action in actions[:30]:
        one.step(action)
    state = one.get_state()
    two.set_state(state)
    for action in actions[30:]:
        assert identical(one.step(action)[:4], two.step(action)[:4])
    with pytest.raises(ValueError, match="other plants, scenarios, randomisation or control periods, or to another"):
        FuzzyArmLearnVectorEnv(3, "payload", history=2).set_state(state)
    with pytest.raises(ValueError, match="must be an array"):
        FuzzyArmLearnVectorEnv(2, history=2).set_state(state)


RESIDUAL = ActionDefinition((0.01, 0.02), base="fuzzy-4-tip", smoothing_time=0.03)


@pytest.mark.parametrize("shipped", [bundle(), bundle(RESIDUAL, elastic_target=True)], ids=["torques", "residual"])
def test_training_and_the_shipped_policy_see_and_do_the_same(shipped):
    """The network in the training's arms and the bundle in the plain ones: the same episodes, through their ends."""
    features, action = shipped.features, shipped.action
    base = action.base and load_policy(action.base, control_period=2e-3, allow_unproven=True)
    arguments = {
        "disturbance": Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3)),
        "reference": JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.05),
        "randomisation": "plants",
    }
    training = FuzzyArmLearnVectorEnv(5, features=features, action=action, early_end=4.0, **arguments)
    plain = gym.make_vec("FuzzyArm-v0", num_envs=5, control_period=2e-3, **arguments)
    policy = LearnedPolicy(shipped, 2e-3, base=base)
    (seen, _), (observation, _) = training.reset(seed=3), plain.reset(seed=3)
    state, starts, ends, network = None, np.ones(5, dtype=bool), 0, answering(shipped.network)
    for _ in range(60):
        answer = network(seen.astype(float))
        seen, _, *ended, info = training.step(answer)
        torque, state = policy.predict(observation, state, starts)
        observation, _, *expected, other = plain.step(torque)
        assert np.array_equal(ended, expected)
        np.testing.assert_allclose(info["torque"], other["torque"], rtol=1e-4, atol=1e-3)  # features in float32
        starts = ended[0] | ended[1]
        for lane in np.flatnonzero(starts):
            ends += 1
            np.testing.assert_allclose(info["final_obs"][lane][4:6], other["final_obs"][lane][4:6], rtol=1e-6)
            assert not seen[lane, 10:14].any()  # nothing is remembered of the episode that ended
    assert ends == 10 and np.ptp(torque) > 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"history": -1}, "history = -1"),
        ({"preview": (0,)}, "preview: entry = 0"),
        ({"early_end": 0.0}, "early_end = 0"),
        ({"num_envs": 2}, "make_vec"),
        ({"case": "storm"}, "storm"),
        ({"render_mode": "human"}, "render_mode"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmLearnEnv(**{"case": "nominal", **arguments})


@pytest.mark.parametrize("action", [np.zeros(3), np.array([np.nan, 0.0]), np.array(["a", "b"])])
def test_wrong_actions_are_refused(action):
    env = FuzzyArmLearnEnv(parameters=ArmParameters(), **PAPER)
    env.reset(seed=0)
    with pytest.raises((TypeError, ValueError)):
        env.step(action)
