"""``FuzzyArm-v0`` from a user's view: the Gymnasium contract and tools, seeds, info, reward, ends and messages."""

import contextlib
import copy
import dataclasses
import re
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleAction
from support.batches import SHORT
from support.randomisation import ROBUST
from support.results import assert_identical, identical

from fuzzyarm import load_policy  # registers FuzzyArm-v0
from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload, tip_position
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Lemniscate, Line, Spline
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

TABLE_1 = ArmParameters()
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-4, velocity=1e-2))
OTHER_PATH = JointReference(path=Line((0.4, 0.5), (0.55, 0.45)), duration=0.5)
DOCUMENTED = re.findall(r"`(\w+)`", FuzzyArmEnv.__doc__.split("## Info")[1].split("## Arguments")[0])
SHAPES = {name: (2,) if name in VECTORS else () for name in DOCUMENTED}


def follow(env):
    policy, state, results = load_policy("computed-torque", control_period=env.control_period), None, []
    observation, _ = env.reset(seed=0)
    while not results or not any(results[-1][2:4]):
        torque, state = policy.predict(observation, state)
        results.append(env.step(torque))
        observation = results[-1][0]
    return results


def play(env, torques, **reset):
    """Yield the results of open-loop torques, the reset's first in the same form, until the episode ends."""
    observation, info = env.reset(**reset)
    yield observation, 0.0, False, False, info
    for torque in torques:
        yield (result := env.step(torque))
        if result[2] or result[3]:
            return


def random_torques(seed, steps=400, scale=1.0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, 2)) * scale * np.array(TABLE_1.torque_limit)


def test_stable_baselines_checker_has_one_wish_and_rescaled_actions_grant_it():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with pytest.warns(UserWarning, match="symmetric and normalized Box action space") as caught:
        checker.check_env(FuzzyArmEnv())
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(RescaleAction(gym.make("FuzzyArm-v0"), -1, 1))  # -1.0 makes Gymnasium warn of a cast


@pytest.mark.slow
def test_making_and_stepping_loads_nothing_heavy():
    # Of SciPy, this project needs `interpolate`, and only for splines.
    heavy = "cvxpy clarabel torch matplotlib pygame scipy.interpolate scipy.optimize stable_baselines3 rich"
    code = (
        "import sys, gymnasium, fuzzyarm; assert 'llvmlite' not in sys.modules; "
        "made = gymnasium.make('FuzzyArm-v0'), gymnasium.make_vec('FuzzyArm-v0', num_envs=2); "
        "[(env.reset(seed=0), env.step(env.action_space.sample()), env.close()) for env in made]; "
        f"print([name for name in {heavy.split()} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_spaces_have_the_documented_bounds_and_another_arm_its_own():
    weak = dataclasses.replace(TABLE_1, torque_limit=(200.0, 80.0), velocity_limit=(10.0, 12.0))
    for arm, limits, speeds in ((TABLE_1, [500.0, 250.0], [15.0, 15.0]), (weak, [200.0, 80.0], [10.0, 12.0])):
        env = FuzzyArmEnv(parameters=arm)
        assert env.action_space.high.tolist() == limits and np.array_equal(env.action_space.low, -env.action_space.high)
        high = env.observation_space.high
        assert env.observation_space.shape == (10,) and env.observation_space.dtype == np.float64
        assert high[4:8].tolist() == [np.pi, np.pi, *speeds] and np.array_equal(env.observation_space.low, -high)
        *_, info = list(play(env, [(600.0, -1e9)]))[-1]
        assert info["torque"].tolist() == [limits[0], -limits[1]] and info["reward_effort"] == 1.0
        assert info["torque_clipped"]


def test_info_has_the_documented_keys_shapes_and_types_at_reset_and_every_step():
    assert len(DOCUMENTED) == 17 and set(VECTORS) < set(DOCUMENTED)
    _, start = FuzzyArmEnv(case="machining").reset()
    assert start["time"] == 0.0 and start["tip_error"] < 1e-15 and start["in_domain"]
    assert not start["torque"].any() and not start["external_force"].any()
    for observation, *results, info in play(FuzzyArmEnv(case="machining"), random_torques(0, 30), seed=0):
        assert observation.dtype == np.float64 and type(observation) is np.ndarray
        assert {key: np.shape(value) for key, value in info.items()} == SHAPES
        assert all(type(info[key]) in (float, bool) for key, shape in SHAPES.items() if shape == ())
        assert [type(value) for value in results] == [float, bool, bool]


def test_the_plant_shares_no_memory_with_what_it_returned():
    env, untouched, torques, kept, copies = FuzzyArmEnv(), FuzzyArmEnv(), random_torques(1, 20), [], []
    for (observation, *_, info), (expected, *_, true) in zip(play(env, torques), play(untouched, torques), strict=True):
        assert np.array_equal(observation, expected) and identical(info, true)
        for array in (observation, *(value for value in info.values() if np.shape(value))):
            array[:] = np.nan
        kept.append({**true, "observation": expected})
        copies.append(copy.deepcopy(kept[-1]))
    assert all(identical(first, second) for first, second in zip(kept, copies, strict=True))


def test_an_episode_has_1500_steps_whose_observations_and_errors_follow_from_angles_and_reference():
    tracked = follow(FuzzyArmEnv())
    assert [step[2] for step in tracked] == [False] * 1500
    assert [step[3] for step in tracked] == [False] * 1499 + [True]
    assert tracked[-1][-1]["time"] == 1.5 and "reason" not in tracked[-1][-1]
    rewards = np.array([step[1] for step in tracked])
    assert rewards.min() > 0.5 and rewards.max() < 1.0  # of a good controller
    signal = {key: np.array([step[-1][key] for step in tracked]) for key in SHAPES}
    observations, reference = np.array([step[0] for step in tracked]), JointReference()
    np.testing.assert_array_equal(observations[:, :4], np.hstack([signal["q_motor"], signal["dq_motor"]]))
    sample = np.hstack(reference.sample(signal["time"]))
    np.testing.assert_allclose(observations[:, 4:], sample, rtol=0.0, atol=1e-12)
    link_tip, motor_tip = (tip_position(signal[key], TABLE_1.length) for key in ("q_link", "q_motor"))
    reference_tip, circle = reference.tip(signal["time"]).position, reference.path
    expected = {
        "tip": link_tip,
        "tip_reference": reference_tip,
        "tip_error": np.linalg.norm(link_tip - reference_tip, axis=-1),
        "circularity_error": np.linalg.norm(link_tip - circle.center, axis=-1) - circle.radius,
        "circularity_error_motor": np.linalg.norm(motor_tip - circle.center, axis=-1) - circle.radius,
    }
    for key, value in expected.items():
        np.testing.assert_allclose(signal[key], value, rtol=0.0, atol=1e-13, err_msg=key)
    assert np.ptp(signal["circularity_error"] - signal["circularity_error_motor"]) > 1e-4  # the joints bend
    assert signal["tip_error"].max() < 5e-3


def test_reward_is_the_documented_formula():
    for _, reward, *_, info in list(play(FuzzyArmEnv(case="machining"), random_torques(2, 200, scale=0.2)))[1:]:
        effort = np.mean((info["torque"] / TABLE_1.torque_limit) ** 2)
        tracking = 1.0 / (1.0 + info["tip_error"] / 5e-3)
        assert info["reward_effort"] == pytest.approx(effort, rel=1e-12)
        assert info["reward_tracking"] == pytest.approx(tracking, rel=1e-12)
        assert reward == pytest.approx(tracking * (1.0 - 0.1 * effort), rel=1e-12)
        assert 0.0 < reward <= 1.0 and not info["torque_clipped"]


def starts(generator=None):
    """The starts of three episodes after one seed, or with a generator of the user's own."""
    env = FuzzyArmEnv(disturbance=NOISY)
    if generator is not None:
        env.np_random = generator  # whose seed Gymnasium does not know
    return [env.reset(seed=3 if k == 0 and generator is None else None)[0] for k in range(3)]


def test_episodes_follow_from_the_seed_alone_and_leave_the_global_generator_alone():
    kept, found = np.random.get_state(), []  # noqa: NPY002  the generator to leave alone
    for global_seed in (1, 2):
        np.random.seed(global_seed)  # noqa: NPY002
        before = np.random.get_state()  # noqa: NPY002
        batch = gym.make_vec("FuzzyArm-v0", num_envs=3, disturbance=NOISY)
        found.append([starts(), starts(np.random.default_rng(1)), batch.reset(seed=0)[0]])
        assert all(map(np.array_equal, before, np.random.get_state()))  # noqa: NPY002
    np.random.set_state(kept)  # noqa: NPY002
    assert all(map(np.array_equal, *found)) and len(np.unique(found[0][0], axis=0)) == 3
    assert not np.array_equal(found[0][1], starts(np.random.default_rng(2)))


STILL = np.array([0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0])
LEAVING = {
    "angle": (np.r_[3.14, 0.0, 3.14, 0.0, 2.0, 0.0, 2.0, 0.0], (0.0, 0.0)),
    "angle of joint 2": (np.r_[0.0, -3.14, 0.0, -3.14, 0.0, -2.0, 0.0, -2.0], (0.0, 0.0)),
    "velocity": (np.r_[STILL[:4], 14.99, 0.0, 14.99, 0.0], (500.0, 0.0)),
    "velocity of joint 2": (np.r_[STILL[:4], 0.0, -14.9, 0.0, -14.9], (0.0, -250.0)),
    "full torque from rest": (STILL, (500.0, -250.0)),
}


@pytest.mark.parametrize("way", LEAVING)
def test_leaving_the_joint_box_terminates_with_the_reason(way):
    state, torque = LEAVING[way]
    env = FuzzyArmEnv()
    *before, last = play(env, [torque] * 1000, options={"initial_state": state})
    observation, reward, terminated, truncated, info = last
    q, dq = (np.abs([info[f"{name}_motor"], info[f"{name}_link"]]).max() for name in ("q", "dq"))
    assert (terminated, truncated, info["in_domain"]) == (True, False, False)
    assert q > np.pi or dq > 15.0
    assert ("angle" in way) <= (q > np.pi) and ("velocity" in way) <= (dq > 15.0)
    assert info["reason"] == f"a joint {'angle' if q > np.pi else 'velocity'} left the domain (25)"
    assert info.keys() == {*SHAPES, "reason"} and reward > 0.0 and env.observation_space.contains(observation)
    assert all(step[-1]["in_domain"] and not step[2] and "reason" not in step[-1] for step in before)


def test_a_bad_action_is_named_and_changes_nothing():
    env = FuzzyArmEnv()
    env.reset()
    with pytest.raises(ValueError, match=r"action has shape \(1, 2\); it must be \(2,\)"):
        env.step([[1.0, 2.0]])
    message = r"action = \[1\.0, nan\] N m is not finite; give finite torques \(clipped to ±\[500\.0, 250\.0\]"
    with pytest.raises(ValueError, match=message):
        env.step([1.0, np.nan])
    assert np.array_equal(env.step([1.0, 2.0])[0], list(play(FuzzyArmEnv(), [[1.0, 2.0]]))[-1][0])


@pytest.mark.parametrize(("stiffness", "period"), [(1e8, 0.1), (1e9, 0.01), (1e10, 1e-3), (1e11, 2e-3), (1e12, 2e-4)])
def test_however_far_a_plant_blows_up_it_ends_on_its_last_finite_state(stiffness, period, monkeypatch):
    """Far too stiff for the sub-step: the state grows by powers of ten and passes 1e13, 1e70 or the largest float."""
    monkeypatch.setattr("fuzzyarm.envs.fuzzy_arm.fastest_rate", lambda arms, drawn: 0.0)
    env = FuzzyArmEnv(parameters=dataclasses.replace(TABLE_1, stiffness=(stiffness, stiffness)), control_period=period)
    *_, before, (observation, reward, terminated, _, info) = play(env, [(100.0, 20.0)] * 100)
    assert terminated and info["reason"] and info["torque"].tolist() == [100.0, 20.0]
    assert 0.0 <= reward <= 1.0 and env.observation_space.contains(observation)
    assert all(np.isfinite(value).all() for key, value in info.items() if key != "reason")
    assert info["tip_error"] <= 2.0 * sum(TABLE_1.length)  # nowhere but within reach
    if info["reason"] == "the state is not finite":
        assert reward == 0.0 and np.array_equal(observation[:4], before[0][:4])


@pytest.mark.parametrize("end", ["terminated", "truncated"])
def test_step_is_refused_before_a_reset_after_a_failed_one_and_after_the_end(end):
    last_step = dataclasses.replace(OTHER_PATH, duration=0.1)  # where both ends meet, the arm is terminated
    env = FuzzyArmEnv(reference=last_step, control_period=0.1)

    def refused():
        with pytest.raises(ResetNeeded, match=r"call env\.reset\(\) before env\.step\(\)"):
            env.step(np.zeros(2))

    refused()
    fast = {"initial_state": LEAVING["angle"][0]} if end == "terminated" else {}
    assert list(play(env, np.zeros((1, 2)), options=fast))[-1][2:4] == (end == "terminated", end == "truncated")
    refused()
    env.reset()
    with pytest.raises(ValueError, match="initial_state"):
        env.reset(options={"initial_state": [0.0], "case": "payload"})
    refused()


@pytest.mark.parametrize(("period", "steps"), [(2e-3, 250), (5e-4, 1000), (7e-4, 715)])
def test_other_control_periods_end_with_the_reference(period, steps):
    results = follow(FuzzyArmEnv(control_period=np.float64(period), reference=OTHER_PATH))
    assert len(results) == steps and results[-1][3] and not results[-1][2]
    times = np.array([step[-1]["time"] for step in results])
    np.testing.assert_allclose(times, period * np.arange(1, steps + 1), rtol=1e-12)
    assert max(step[-1]["tip_error"] for step in results) < 5e-3


def test_initial_state_and_reference_are_taken_as_given_for_the_episode():
    state, env = 0.1 * np.arange(1, 9), FuzzyArmEnv()
    assert env.reference == JointReference()  # before the first episode
    for options, reference in (({"reference": OTHER_PATH}, OTHER_PATH), (None, JointReference())):
        env.reset(options=options)
        assert env.reference == reference
    observation, info = env.reset(options={"initial_state": state})
    names = ("q_motor", "q_link", "dq_motor", "dq_link")
    assert np.concatenate([info[name] for name in names]).tolist() == state.tolist()
    assert observation[:4].tolist() == state[[0, 1, 4, 5]].tolist()
    env.step([100.0, 0.0])
    assert state[0] == 0.1  # the caller's array is left alone


SLOW_ARM = {"parameters": dataclasses.replace(TABLE_1, velocity_limit=(0.3, 15.0)), "reference": JointReference()}
ENDLESS = JointReference(duration=1e6)
QUICK = JointReference(path=Lemniscate((0.5, 0.3), 1e-4), duration=5e-4)  # for the observation space
LONGER_LINKS = JointReference(parameters=dataclasses.replace(TABLE_1, length=(0.6, 0.5)))
BAD_ARGUMENTS = [
    ({"substep": 3e-4}, r"control_period = 0\.001 s is not a multiple of substep = .* use substep = 0\.000333333 s"),
    ({"control_period": 0.2}, r"control_period = 0\.2 s is out of range; allowed: \[1e-06, 0\.1\] s"),
    ({"control_period": 1e-4, "substep": 1e-3}, r"substep = 0\.001 s is out of range; allowed: \[1e-08, 0\.0001\] s"),
    ({"case": "drilling"}, "unknown case 'drilling'; choose from: nominal, machining, payload"),
    ({"case": "payload", "disturbance": NOISY}, "either case = 'payload' or a disturbance"),
    (SLOW_ARM, r"the joint velocity of the reference reaches .*allows \(0\.3, 15\.0\) rad/s"),
    ({"reference": QUICK}, r"the joint acceleration of the reference reaches .*rad/s².*10000.*raise the duration"),
    ({"control_period": 1e-6, "reference": ENDLESS}, "1000000000000 control periods of 1e-06 s; .*: at most 1000000"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_ARGUMENTS)
def test_a_bad_argument_is_named_with_what_is_allowed(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv(**arguments)


BAD_STATES = STILL[:7], np.full(8, np.nan), STILL - 3.7 * np.eye(8)[2], STILL + 15.1 * np.eye(8)[6]
BAD_OPTIONS = [
    ({"wind": 1.0, "inital_state": STILL}, "unknown reset option inital_state, wind; known: initial_state, reference"),
    ({"reference": LONGER_LINKS}, r"links of \(0\.6, 0\.5\) m, but the plant has links of \(0\.5, 0\.5\) m"),
    *(({"initial_state": state}, r"_state = .* must be 8 finite numbers.*3\.14.*15\.0") for state in BAD_STATES),
]


@pytest.mark.parametrize(("options", "message"), BAD_OPTIONS)
def test_a_bad_option_is_named_with_what_is_allowed(options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv().reset(options=options)


HOSTILE = {
    "complex": (np.array([1 + 2j, 0]), "complex128"),
    "texts": (np.array(["1", "2"]), "<U1"),
    "dates": (np.array(["2020", "2021"], dtype="M8[ns]"), "datetime64"),
    "truth values": (np.array([True, False]), "bool"),
    "uneven": ([1.0, [2.0]], ""),
    "endless": (range(10**12), ""),
    "huge": (np.broadcast_to(np.float64(1.0), (10**10,)), ""),
}


@pytest.mark.parametrize(("given", "message"), HOSTILE.values(), ids=HOSTILE)
def test_what_is_no_array_of_numbers_is_refused_by_name(given, message):
    single, batch, policy = FuzzyArmEnv(), FuzzyArmVectorEnv(1), load_policy("fuzzy-1")
    single.reset(seed=0), batch.reset(seed=0)

    def fitting(*shape):
        return np.resize(given, shape) if message else given

    if message:
        with pytest.raises((TypeError, ValueError), match=f"^state.*{message}"):
            policy.predict(np.zeros(10), fitting(policy.memory_size))
    for name, use, value in (
        ("action", single.step, fitting(2)),
        ("action", batch.step, fitting(1, 2)),
        ("observation", policy.predict, fitting(10)),
        ("initial_state", lambda state: single.reset(options={"initial_state": state}), fitting(8)),
        ("initial_state", lambda state: batch.reset(options={"initial_state": state}), fitting(8)),
    ):
        with pytest.raises((TypeError, ValueError), match=f"^{name}.*{message}") as caught:
            use(value)
        assert "\n" not in str(caught.value)


LONG = JointReference(duration=1.6)


def steps_until_the_end(env, **reset):
    """The steps of an episode, and whether it was truncated; the torques hold the arm on its path."""
    env.reset(**reset)
    for step in range(1, 5000):
        lanes = env.unwrapped._lanes  # the reference itself is the state to be in: no policy is needed
        lanes.values[0, :8, 0] = [*np.tile(lanes.table[lanes.clock[0, 0], :2], 2), 0.0, 0.0, 0.0, 0.0]
        *_, terminated, truncated, _ = env.step(np.zeros(2))
        if terminated or truncated:
            return step, truncated
    raise AssertionError("the episode does not end")


@pytest.mark.parametrize(
    ("arguments", "steps"),
    [({}, 1500), ({"reference": SHORT}, 50), ({"case": "payload", "reference": LONG, "control_period": 5e-3}, 320)],
    ids=str,
)
def test_the_spec_states_the_steps_of_an_episode_and_no_wrapper_counts_them(arguments, steps):
    assert gym.spec("FuzzyArm-v0").max_episode_steps is None and FuzzyArmEnv().spec is None
    env = gym.make("FuzzyArm-v0", **arguments)
    assert type(env) is FuzzyArmEnv and env.spec.max_episode_steps == steps
    assert steps_until_the_end(env, seed=0) == (steps, True)
    again = gym.make(env.spec, max_episode_steps=-1)
    assert type(again) is FuzzyArmEnv and steps_until_the_end(gym.make(env.spec)) == (steps, True)
    assert steps_until_the_end(again, options={"reference": LONG}) == (round(1.6 / again.control_period), True)


def test_a_time_limit_of_the_users_own_truncates():
    made = gym.make("FuzzyArm-v0", max_episode_steps=100)
    assert made.spec.max_episode_steps == 100
    for env, steps in ((made, 100), (wrappers.TimeLimit(made.env, 5000), 1500)):
        assert isinstance(env, wrappers.TimeLimit) and steps_until_the_end(env) == (steps, True)
    batch = gym.make_vec("FuzzyArm-v0", num_envs=6, randomisation="robust")  # of drawn references, the longest counts
    batch.reset(seed=0)
    lengths = {batch.lanes.schedule(lane)[1].steps for lane in range(6)}
    assert len(lengths) > 1 and max(lengths) <= gym.make("FuzzyArm-v0", randomisation="robust").spec.max_episode_steps


@pytest.mark.slow
@pytest.mark.parametrize("period", [1e-3, 3e-3])
def test_a_video_of_each_step_shows_real_time(period, tmp_path):
    moviepy = pytest.importorskip("moviepy")
    reference = JointReference(duration=0.3, path=SHORT.path)
    made = gym.make("FuzzyArm-v0", render_mode="rgb_array", reference=reference, control_period=period)
    with contextlib.closing(wrappers.RecordVideo(made, str(tmp_path / "videos"))) as env:
        assert steps_until_the_end(env) == (round(0.3 / period), True)
    (file,) = (tmp_path / "videos").glob("*.mp4")
    with moviepy.VideoFileClip(str(file)) as video:
        assert video.duration == pytest.approx(0.3, rel=0.05)


@pytest.mark.slow
def test_every_twentieth_picture_gives_a_video_in_real_time(tmp_path, monkeypatch):
    moviepy = pytest.importorskip("moviepy")
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "tutorials" / "first-episode.md").read_text(encoding="utf-8")
    (loop,) = re.findall(r"```python\n([^`]*save_video[^`]*)```", page)
    exec(loop, {})
    with moviepy.VideoFileClip("videos/rl-video-episode-0.mp4") as video:
        assert video.duration == pytest.approx(1.5, rel=0.05) and video.fps == 50.0


@pytest.mark.parametrize("case", CASES)
def test_the_checker_of_gymnasium_has_no_wish_beyond_scaled_actions(case, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    said = []
    monkeypatch.setattr(gym.logger, "warn", lambda message, *args, **kwargs: said.append(message))
    check_env(gym.make("FuzzyArm-v0", case=case).unwrapped)
    assert len(said) == 1 and "symmetric and normalized" in said[0]
    said.clear()
    check_env(wrappers.RescaleAction(gym.make("FuzzyArm-v0"), np.float32(-1), np.float32(1)))
    assert [text for text in said if "different from the unwrapped version" not in text] == []


def test_seeds_of_any_size_and_numpys_integers():
    env, batch = (make("FuzzyArm-v0", randomisation=ROBUST) for make in (gym.make, gym.make_vec))
    for seed in (3, 2**31, np.int64(2**31), np.uint64(2**63), 2**70):
        observation, _ = env.reset(seed=int(seed))
        np.testing.assert_array_equal(env.reset(seed=seed)[0], observation)
        np.testing.assert_array_equal(batch.reset(seed=seed)[0][0], observation)
    for wrong in (-1, np.int64(-1), 1.0, "1"):
        with pytest.raises((gym.error.Error, TypeError, ValueError), match=r"[Ss]eed"):
            env.reset(seed=wrong)


LIGHT = ArmParameters(stiffness=(8e4, 1.6e4))
BENT = JointReference(Spline(((0.4, 0.5), (0.42, 0.52), (0.45, 0.5))), parameters=LIGHT)
LOADED = Disturbance(ConstantForce((0.0, 30.0), 0.1), Payload(2.0), encoder_noise=EncoderNoise(1e-5, 1e-3))


@pytest.mark.parametrize(
    "arguments",
    [
        {"robot": LIGHT},
        {"parameters": LIGHT, "reference": BENT},
        {"robot": robot_named("planar-3r").with_payload(0.5), "control_period": np.float64(2e-3)},
        {"disturbance": LOADED},
        {"randomisation": DomainRandomisation(payload=(0.0, 2.0), references=(SHORT, LONG)), "case": "machining"},
    ],
    ids=lambda arguments: "-".join(arguments),
)
def test_what_the_spec_writes_is_made_again(arguments):
    made = gym.make("FuzzyArm-v0", **arguments)
    again = gym.make(EnvSpec.from_json(made.spec.to_json()))
    assert again.spec.to_json() == made.spec.to_json()
    assert again.unwrapped.parameters == made.unwrapped.parameters
    assert identical(made.reset(seed=3), again.reset(seed=3))
    for _ in range(20):
        assert_identical(*(env.step(0.3 * env.action_space.high) for env in (made, again)))


def test_wrappers_and_batches_write_their_specs_too():
    wrapped = wrappers.ClipAction(gym.make("FuzzyArm-v0", parameters=LIGHT, max_episode_steps=9))
    again = gym.make(EnvSpec.from_json(wrapped.spec.to_json()))
    assert isinstance(again, wrappers.ClipAction) and again.unwrapped.parameters == LIGHT
    assert steps_until_the_end(again, seed=0) == (9, True)
    for mode, given in (("vector_entry_point", [LIGHT, ArmParameters()]), ("sync", LIGHT)):
        envs = gym.make_vec("FuzzyArm-v0", num_envs=2, vectorization_mode=mode, parameters=given)
        same = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
        assert type(same) is type(envs) and same.num_envs == 2
        np.testing.assert_array_equal(same.reset(seed=0)[0], envs.reset(seed=0)[0])


def test_what_cannot_be_made_again_is_not_written():
    Own = dataclasses.make_dataclass("Own", [], namespace={"at": lambda self, time, tip_velocity: 0.0})
    for argument, given in (("disturbance", Disturbance(tip_force=Own())), ("reference", object())):
        spec = gym.make("FuzzyArm-v0").spec
        spec.kwargs[argument] = given
        with pytest.raises(ValueError, match=r"(Own|object).* cannot be written as JSON: leave it out of the spec"):
            spec.to_json()


@pytest.mark.parametrize("name", ["physics.robot.os", "physics.robot.DIMENSIONS", "nowhere.Robot", "..cli.main", 3])
def test_data_name_records_of_the_package_alone(name):
    with pytest.raises(ValueError, match=rf"record = {name!r} does not name a data class"):
        gym.make("FuzzyArm-v0", robot={"record": name})
