"""``FuzzyArm-v0`` from a user's view: the Gymnasium contract, seeds, info, reward, episode ends and messages."""

import dataclasses
import hashlib
import re
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleAction

import fuzzyarm  # noqa: F401  registers FuzzyArm-v0
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics, tip_position
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line
from fuzzyarm.envs.scenario.reference import JointReference

TABLE_1 = ArmParameters()
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-4, velocity=1e-2))
OTHER_PATH = JointReference(path=Line((0.4, 0.5), (0.55, 0.45)), duration=0.5)
SHAPES = {
    "time": (),
    "tip": (2,),
    "tip_reference": (2,),
    "tip_error": (),
    "circularity_error": (),
    "circularity_error_motor": (),
    "q_link": (2,),
    "dq_link": (2,),
    "q_motor": (2,),
    "dq_motor": (2,),
    "torque": (2,),
    "friction_torque": (2,),
    "external_force": (2,),
    "in_domain": (),
    "torque_clipped": (),
    "reward_tracking": (),
    "reward_effort": (),
}


def computed_torque(observation):
    """Rigid inverse dynamics with the motors' inertia, plus a stiff PD on the motor side."""
    q, dq, q_d, dq_d, ddq_d = observation.reshape(5, 2)
    ddq = ddq_d + 400.0 * (q_d - q) + 40.0 * (dq_d - dq)
    return rigid_inverse_dynamics(q, dq, ddq, arm_constants(TABLE_1)) + np.array(TABLE_1.motor_inertia) * ddq


def follow(env, steps=10_000, **reset):
    """Yield (observation, reward, terminated, truncated, info) under computed torque, at most `steps` of them."""
    observation, _ = env.reset(**reset)
    for _ in range(steps):
        result = env.step(computed_torque(observation))
        yield result
        if result[2] or result[3]:
            return
        observation = result[0]


def play(env, torques, **reset):
    """Yield the results of open-loop torques, the reset's first in the same form, until the episode ends."""
    observation, info = env.reset(**reset)
    yield observation, 0.0, False, False, info
    for torque in torques:
        result = env.step(torque)
        yield result
        if result[2] or result[3]:
            return


def random_torques(seed, steps=400, scale=1.0):
    """Torques anywhere in the action space."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, 2)) * scale * np.array(TABLE_1.torque_limit)


def digest(env, seed):
    """sha256 of every observation and reward of an episode."""
    sha = hashlib.sha256()
    for observation, reward, *_ in play(env, random_torques(0, scale=0.3), seed=seed):
        sha.update(observation.tobytes() + np.float64(reward).tobytes())
    return sha.hexdigest()


def python(code):
    """Standard output of a fresh interpreter under the same strict warnings."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def same(first, second):
    """Whether two infos hold the same keys and the same numbers, bit for bit."""
    return first.keys() == second.keys() and all(np.array_equal(first[key], second[key]) for key in first)


@pytest.fixture(scope="module")
def tracked():
    """The whole nominal episode under computed torque."""
    return list(follow(FuzzyArmEnv(), seed=0))


# --- the contract ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_gymnasium_checker_only_recommends_normalised_actions(case, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.warns(UserWarning, match="symmetric and normalized space") as caught:
        check_env(gym.make("FuzzyArm-v0", case=case).unwrapped)
    assert [str(warning.message) for warning in caught[1:]] == []


def test_stable_baselines_checker_has_one_wish_and_rescaled_actions_grant_it():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with pytest.warns(UserWarning, match="symmetric and normalized Box action space") as caught:
        checker.check_env(FuzzyArmEnv())
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(RescaleAction(gym.make("FuzzyArm-v0"), -1, 1))  # -1.0 makes Gymnasium warn of a cast


def test_rescaled_actions_reach_the_torque_limits_without_clipping():
    env = RescaleAction(gym.make("FuzzyArm-v0"), -1, 1)
    *_, info = list(play(env, np.array([[1.0, -1.0]], np.float32)))[-1]
    assert info["torque"] == pytest.approx([500.0, -250.0], rel=1e-6) and not info["torque_clipped"]


def test_registered_name_reaches_the_env_and_its_arguments():
    env = gym.make("FuzzyArm-v0", case="payload", control_period=2e-3)
    assert isinstance(env.unwrapped, FuzzyArmEnv) and env.unwrapped.control_period == 2e-3
    assert env.spec is not None and env.spec.max_episode_steps == 750  # when the reference ends


@pytest.mark.parametrize("make", [FuzzyArmEnv, lambda case: gym.make("FuzzyArm-v0", case=case)], ids=["class", "make"])
def test_unknown_case_names_the_choices(make):
    with pytest.raises(ValueError, match="unknown case 'drilling'; choose from: nominal, machining, payload"):
        make(case="drilling")


@pytest.mark.slow
def test_module_prefix_registers_without_an_import():
    code = "import gymnasium; print(gymnasium.make('fuzzyarm:FuzzyArm-v0', case='machining').reset(seed=0)[0].shape)"
    assert python(code) == "(10,)"


@pytest.mark.slow
def test_making_and_stepping_loads_nothing_heavy():
    # Of SciPy, this project needs `interpolate`, and only for splines.
    heavy = "cvxpy clarabel torch matplotlib pygame scipy.interpolate scipy.optimize stable_baselines3 rich"
    code = (
        "import sys, gymnasium, fuzzyarm; assert 'llvmlite' not in sys.modules; "
        "env = gymnasium.make('FuzzyArm-v0'); env.reset(seed=0); env.step(env.action_space.sample()); env.close(); "
        f"print([name for name in {heavy.split()} if name in sys.modules])"
    )
    assert python(code) == "[]"


def test_spaces_have_the_documented_bounds():
    env = FuzzyArmEnv()
    assert env.action_space.high.tolist() == [500.0, 250.0] and env.action_space.low.tolist() == [-500.0, -250.0]
    high = env.observation_space.high
    assert env.observation_space.shape == (10,) and env.observation_space.dtype == np.float64
    assert high[4:8].tolist() == [np.pi, np.pi, 15.0, 15.0] and np.array_equal(env.observation_space.low, -high)


# --- observation and info ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_every_observation_lies_in_its_space_to_the_end(seed):
    env = FuzzyArmEnv(disturbance=Disturbance(encoder_noise=EncoderNoise(position=3.0, velocity=100.0)))
    corner = np.sign(random_torques(seed, 1)) * TABLE_1.torque_limit
    *_, last = steps = list(play(env, np.repeat(corner, 3000, axis=0), seed=seed))
    assert last[2]  # full torque throws the arm out of the box
    assert all(step[0].dtype == np.float64 and env.observation_space.contains(step[0]) for step in steps)


def test_observation_is_the_motor_side_and_the_reference_at_the_same_instant(tracked):
    samples = np.hstack(JointReference().sample(np.array([step[-1]["time"] for step in tracked])))
    for (observation, *_, info), sample in zip(tracked, samples, strict=True):
        assert observation[:4].tolist() == [*info["q_motor"], *info["dq_motor"]]
        np.testing.assert_allclose(observation[4:], sample, rtol=0.0, atol=1e-12)


def test_info_has_the_documented_keys_and_shapes_at_reset_and_every_step():
    documented = re.findall(r"`(\w+)`", FuzzyArmEnv.__doc__.split("## Info")[1].split("## Arguments")[0])
    assert documented == list(SHAPES)
    for *_, info in play(FuzzyArmEnv(case="machining"), random_torques(0, 30), seed=0):
        assert {key: np.shape(value) for key, value in info.items()} == SHAPES


def test_info_holds_plain_python_where_it_is_no_array(tracked):
    types = {key: type(value) for key, value in tracked[-1][-1].items()}
    assert {key: kind for key, kind in types.items() if SHAPES[key] == () and kind not in (float, bool)} == {}
    assert [type(x) for x in tracked[-1][1:4]] == [float, bool, bool]


def test_later_steps_do_not_touch_what_was_returned_before():
    env = FuzzyArmEnv(case="machining")
    kept, copies = [], []
    for observation, *_, info in play(env, random_torques(1, 20), seed=0):
        kept.append({**info, "observation": observation})
        copies.append({key: np.copy(value) for key, value in kept[-1].items()})
    env.reset()
    assert all(same(first, second) for first, second in zip(kept, copies, strict=True))


def test_writing_into_returned_arrays_does_not_reach_the_plant():
    env, untouched, torques = FuzzyArmEnv(), FuzzyArmEnv(), random_torques(1, 20)
    for (observation, *_, info), (expected, *_, true) in zip(play(env, torques), play(untouched, torques), strict=True):
        assert np.array_equal(observation, expected) and same(info, true)
        for array in (observation, *(value for value in info.values() if np.shape(value))):
            array[:] = np.nan


def test_tip_and_errors_follow_from_the_angles_in_info(tracked):
    center, radius = np.array(Circle().center), Circle().radius
    infos = [step[-1] for step in tracked]
    signal = {key: np.array([info[key] for info in infos]) for key in SHAPES}
    link_tip, motor_tip = (tip_position(signal[key], TABLE_1.length) for key in ("q_link", "q_motor"))
    reference_tip = JointReference().tip(signal["time"]).position
    expected = {
        "tip": link_tip,
        "tip_reference": reference_tip,
        "tip_error": np.linalg.norm(link_tip - reference_tip, axis=-1),
        "circularity_error": np.linalg.norm(link_tip - center, axis=-1) - radius,
        "circularity_error_motor": np.linalg.norm(motor_tip - center, axis=-1) - radius,
    }
    for key, value in expected.items():
        np.testing.assert_allclose(signal[key], value, rtol=0.0, atol=1e-13, err_msg=key)
    assert np.ptp(signal["circularity_error"] - signal["circularity_error_motor"]) > 1e-4  # the joints bend


def test_for_a_line_the_circularity_error_is_the_component_along_the_left_normal():
    direction = np.subtract(OTHER_PATH.path.end, OTHER_PATH.path.start)
    normal = np.array([-direction[1], direction[0]]) / np.linalg.norm(direction)
    for *_, info in follow(FuzzyArmEnv(reference=OTHER_PATH), steps=200):
        for key, angles in (("circularity_error", "q_link"), ("circularity_error_motor", "q_motor")):
            offset = tip_position(info[angles], TABLE_1.length) - info["tip_reference"]
            assert info[key] == pytest.approx(offset @ normal, abs=1e-13)


# --- start and reward --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_start_is_at_rest_on_the_reference_with_the_motors_holding_the_nominal_arm(case):
    observation, info = FuzzyArmEnv(case=case).reset()
    q = JointReference().sample(0.0).q
    gravity = rigid_inverse_dynamics(q, np.zeros(2), np.zeros(2), arm_constants(TABLE_1))  # no payload in it
    assert np.array_equal(info["q_link"], q) and np.array_equal(observation[4:6], q)
    np.testing.assert_allclose(info["q_motor"] - q, gravity / TABLE_1.stiffness, rtol=1e-12)
    assert not info["dq_link"].any() and not info["dq_motor"].any()
    assert info["time"] == 0.0 and info["tip_error"] < 1e-15 and info["in_domain"]
    assert not info["torque"].any() and not info["external_force"].any()


@pytest.mark.parametrize("torques", [random_torques(2, 200), random_torques(2, 200, scale=0.2)], ids=["full", "fifth"])
def test_reward_is_the_documented_formula(torques):
    for _, reward, *_, info in list(play(FuzzyArmEnv(case="machining"), torques))[1:]:
        effort = np.mean((info["torque"] / TABLE_1.torque_limit) ** 2)
        tracking = 1.0 / (1.0 + info["tip_error"] / 5e-3)
        assert info["reward_effort"] == pytest.approx(effort, rel=1e-12)
        assert info["reward_tracking"] == pytest.approx(tracking, rel=1e-12)
        assert reward == pytest.approx(tracking * (1.0 - 0.1 * effort), rel=1e-12)
        assert 0.0 < reward <= 1.0


def test_a_good_controller_earns_most_of_the_reward(tracked):
    rewards = np.array([step[1] for step in tracked])
    assert rewards.min() > 0.5 and rewards.max() < 1.0


# --- seeds -------------------------------------------------------------------------------------------------------


def test_the_same_seed_is_the_same_episode_bit_for_bit():
    env = FuzzyArmEnv(disturbance=NOISY)
    first = digest(env, 7)
    assert digest(env, 7) == first  # across reset
    assert digest(FuzzyArmEnv(disturbance=NOISY), 7) == first  # across environments
    assert digest(env, 8) != first


@pytest.mark.slow
def test_the_same_seed_is_the_same_episode_in_another_process():
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_fuzzy_arm as t; "
        "print(t.digest(t.FuzzyArmEnv(disturbance=t.NOISY), 7))"
    )
    assert python(code) == digest(FuzzyArmEnv(disturbance=NOISY), 7)


def test_episodes_after_one_seed_differ_but_their_sequence_is_reproducible():
    def starts():
        env = FuzzyArmEnv(disturbance=NOISY)
        return [env.reset(seed=seed)[0] for seed in (3, None, None)]

    first, again = starts(), starts()
    assert np.array_equal(first, again)
    assert len(np.unique(first, axis=0)) == 3


def test_without_noise_seeds_change_nothing():
    assert digest(FuzzyArmEnv(case="machining"), 1) == digest(FuzzyArmEnv(case="machining"), 2)


def test_no_global_generator_is_read_or_written():
    kept, digests = np.random.get_state(), []  # noqa: NPY002  the generator to leave alone
    for global_seed in (1, 2):
        np.random.seed(global_seed)  # noqa: NPY002
        before = np.random.get_state()  # noqa: NPY002
        digests.append(digest(FuzzyArmEnv(disturbance=NOISY), 0))
        assert all(map(np.array_equal, before, np.random.get_state()))  # noqa: NPY002
    np.random.set_state(kept)  # noqa: NPY002
    assert digests[0] == digests[1]


def test_a_generator_of_the_users_own_seeds_the_episodes():
    """Gymnasium does not know the seed of a generator that replaces its own."""

    def starts(generator):
        env = FuzzyArmEnv(disturbance=NOISY)
        env.np_random = generator
        return [env.reset()[0] for _ in range(2)]

    first, again, other = (starts(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


# --- ends --------------------------------------------------------------------------------------------------------


def test_truncated_after_exactly_1500_steps(tracked):
    assert len(tracked) == 1500
    assert [step[2] for step in tracked] == [False] * 1500
    assert [step[3] for step in tracked] == [False] * 1499 + [True]
    assert tracked[-1][-1]["time"] == 1.5 and "reason" not in tracked[-1][-1]
    assert max(step[-1]["tip_error"] for step in tracked) < 5e-3


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
    *before, last = list(play(env, [torque] * 1000, options={"initial_state": state}))
    observation, reward, terminated, truncated, info = last
    q = np.abs([info["q_motor"], info["q_link"]]).max()
    dq = np.abs([info["dq_motor"], info["dq_link"]]).max()
    assert (terminated, truncated, info["in_domain"]) == (True, False, False)
    assert q > np.pi or dq > 15.0
    assert ("angle" in way) <= (q > np.pi) and ("velocity" in way) <= (dq > 15.0)
    left = "angle" if q > np.pi else "velocity"
    assert info["reason"] == f"a joint {left} left the domain (25)"
    assert info.keys() == {*SHAPES, "reason"} and reward > 0.0 and env.observation_space.contains(observation)
    assert all(step[-1]["in_domain"] and not step[2] and "reason" not in step[-1] for step in before)


def test_leaving_the_box_at_the_last_step_is_no_truncation():
    one_step = JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.1)
    env = FuzzyArmEnv(control_period=0.1, reference=one_step)
    assert list(play(env, [(0.0, 0.0)]))[-1][2:4] == (False, True)
    fast = {"initial_state": LEAVING["angle"][0]}
    assert list(play(env, [(0.0, 0.0)], options=fast))[-1][2:4] == (True, False)


def test_a_state_that_is_not_finite_terminates_with_finite_numbers():
    env = FuzzyArmEnv(case="machining")
    list(play(env, random_torques(0, 5)))
    too_fast = np.r_[STILL[:4], 1e200, 0.0, 1e200, 0.0]  # the Coriolis torque overflows
    env._lanes.values[0, :8, 0] = too_fast
    observation, reward, terminated, truncated, info = env.step([0.0, 0.0])
    assert (reward, terminated, truncated, info["in_domain"]) == (0.0, True, False, False)
    assert info["reason"] == "the state is not finite" and env.observation_space.contains(observation)


@pytest.fixture
def coarse(monkeypatch):
    """Environments that take the sub-step of a slow arm for every arm."""
    monkeypatch.setattr("fuzzyarm.envs.fuzzy_arm.fastest_rate", lambda arms, drawn: 0.0)


@pytest.mark.usefixtures("coarse")
def test_a_plant_that_blows_up_ends_on_its_last_finite_state():
    stiff = dataclasses.replace(TABLE_1, stiffness=(1e9, 1e9))  # far too stiff for the sub-step
    env = FuzzyArmEnv(parameters=stiff, case="machining", control_period=0.01)
    start, (observation, reward, terminated, _, info) = play(env, [(1.0, 2.0)])
    assert (terminated, reward, info["reason"]) == (True, 0.0, "the state is not finite")
    assert np.array_equal(observation[:4], start[0][:4]) and np.isfinite(observation).all()
    assert all(np.isfinite(value).all() for key, value in info.items() if key != "reason")
    assert info["torque"].tolist() == [1.0, 2.0] and info["external_force"].any() and info["time"] == 0.01


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("period", [2e-4, 1e-3, 2e-3, 0.01, 0.1])
@pytest.mark.parametrize("stiffness", [1e8, 1e10, 1e11, 1e12])
def test_however_far_a_plant_blows_up_what_it_returns_is_finite(stiffness, period):
    """Far too stiff for the sub-step: the state grows by powers of ten and passes 1e13, 1e70 or the largest float."""
    env = FuzzyArmEnv(parameters=dataclasses.replace(TABLE_1, stiffness=(stiffness, stiffness)), control_period=period)
    *_, (observation, reward, terminated, _, info) = play(env, [(100.0, 20.0)] * 100)
    assert terminated and info["reason"]
    assert 0.0 <= reward <= 1.0 and env.observation_space.contains(observation)
    assert all(np.isfinite(value).all() for key, value in info.items() if key != "reason")
    assert info["tip_error"] <= 2.0 * sum(TABLE_1.length)  # nowhere but within reach


@pytest.mark.parametrize("make", [FuzzyArmEnv, lambda: gym.make("FuzzyArm-v0")], ids=["class", "make"])
def test_step_before_reset_is_refused(make):
    with pytest.raises(ResetNeeded, match="reset"):
        make().step(np.zeros(2))


@pytest.mark.parametrize("end", ["terminated", "truncated"])
def test_step_after_the_end_is_refused_until_reset(end):
    env = FuzzyArmEnv(reference=dataclasses.replace(OTHER_PATH, duration=0.3), control_period=0.1)
    fast = {"initial_state": LEAVING["angle"][0]} if end == "terminated" else {}
    *_, last = list(play(env, np.zeros((3, 2)), options=fast))
    assert last[2:4] == (end == "terminated", end == "truncated")
    with pytest.raises(ResetNeeded, match=r"call env\.reset\(\) before env\.step\(\)"):
        env.step(np.zeros(2))
    env.reset()
    env.step(np.zeros(2))


def test_a_reset_that_raises_leaves_no_episode_to_step():
    env = FuzzyArmEnv()
    list(play(env, np.zeros((3, 2))))
    with pytest.raises(ValueError, match="initial_state"):
        env.reset(options={"initial_state": [0.0], "case": "payload"})
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2))


# --- actions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("action", [0.0, [1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]], np.zeros((2, 1))])
def test_an_action_of_the_wrong_shape_is_named(action):
    env = FuzzyArmEnv()
    env.reset()
    with pytest.raises(ValueError, match=rf"action has shape {re.escape(str(np.shape(action)))}; it must be \(2,\)"):
        env.step(action)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_named_and_changes_nothing(value):
    env = FuzzyArmEnv()
    env.reset()
    with pytest.raises(
        ValueError, match=rf"action = \[1\.0, {value}\] N m is not finite; allowed: ±\[500\.0, 250\.0\]"
    ):
        env.step([1.0, value])
    assert np.array_equal(env.step([1.0, 2.0])[0], list(play(FuzzyArmEnv(), [[1.0, 2.0]]))[-1][0])


@pytest.mark.parametrize(
    ("action", "applied", "clipped"),
    [
        ([600.0, -1e9], [500.0, -250.0], True),
        ([-500.1, 3.0], [-500.0, 3.0], True),
        ([500.0, -250.0], [500.0, -250.0], False),
        ([1.0, -2.0], [1.0, -2.0], False),
    ],
)
def test_torques_beyond_the_limits_are_clipped_and_info_says_so(action, applied, clipped):
    *_, info = list(play(FuzzyArmEnv(), [action]))[-1]
    assert info["torque"].tolist() == applied and info["torque_clipped"] is clipped
    assert same({**info, "torque_clipped": False}, list(play(FuzzyArmEnv(), [applied]))[-1][-1])


@pytest.mark.parametrize("action", [[80, 20], (80.0, 20.0), np.array([80, 20]), np.array([80, 20], np.float32)])
def test_lists_integers_and_single_precision_are_torques(action):
    expected = list(play(FuzzyArmEnv(), [np.array([80.0, 20.0])]))[-1]
    assert same(list(play(FuzzyArmEnv(), [action]))[-1][-1], expected[-1])


def test_the_callers_action_array_is_left_alone():
    action = np.array([600.0, -20.0])
    list(play(FuzzyArmEnv(), [action] * 3))
    assert action.tolist() == [600.0, -20.0]


# --- time --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("period", "steps"), [(2e-3, 250), (5e-4, 1000), (7e-4, 715)])
def test_other_control_periods_end_with_the_reference(period, steps):
    results = list(follow(FuzzyArmEnv(control_period=period, reference=OTHER_PATH)))
    assert len(results) == steps and results[-1][3] and not results[-1][2]
    times = np.array([step[-1]["time"] for step in results])
    np.testing.assert_allclose(times, period * np.arange(1, steps + 1), rtol=1e-12)
    assert max(step[-1]["tip_error"] for step in results) < 5e-3


def test_a_torque_held_longer_is_the_same_motion():
    fine, coarse = (
        list(play(FuzzyArmEnv(control_period=p), np.full((n, 2), 90.0))) for p, n in ((1e-3, 20), (2e-3, 10))
    )
    for (*_, first), (*_, second) in zip(fine[::2], coarse, strict=True):
        for key in ("q_link", "dq_link", "q_motor", "dq_motor"):
            np.testing.assert_allclose(first[key], second[key], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("period", "substep"), [(1e-3, 3e-4), (1e-3, 6e-4), (2.5e-4, 1e-4)])
def test_a_period_that_is_no_multiple_names_both_numbers(period, substep):
    message = rf"control_period = {period:g} s is no multiple of substep = {substep:g} s; use substep = (\S+) s"
    with pytest.raises(ValueError, match=message) as caught:
        FuzzyArmEnv(control_period=period, substep=substep)
    proposed = float(re.search(message, str(caught.value)).group(1))
    assert proposed == pytest.approx(period / round(period / substep), rel=1e-5)


@pytest.mark.parametrize(
    ("period", "substep"),
    [(0.0, 1e-4), (-1e-3, 1e-4), (1e-3, 0.0), (1e-3, -1e-4), (1e-4, 1e-3), (0.2, 1e-4), (np.nan, 1e-4), (1e-3, np.inf)],
)
def test_nonsense_periods_are_named_with_the_range(period, substep):
    good = 1e-6 <= period <= 0.1
    given = f"substep = {substep!r} s is out of range; allowed: [{period / 1e4:g}, {period:g}] s"
    message = given if good else f"control_period = {period!r} s is out of range; allowed: [1e-06, 0.1] s"
    with pytest.raises(ValueError, match=re.escape(message)):
        FuzzyArmEnv(control_period=period, substep=substep)


@pytest.mark.parametrize(
    ("period", "substep", "count"), [(1e-3, 1e-4, 10), (3e-4, 1e-4, 3), (0.1, 1e-4, 1000), (1e-3, 1e-3, 1)]
)
def test_multiples_are_found_despite_rounding(period, substep, count):
    assert whole_substeps(period, substep) == count


# --- reset options -----------------------------------------------------------------------------------------------

OPTIONS = {
    "initial_state": {"initial_state": STILL},
    "reference": {"reference": OTHER_PATH},
    "case": {"case": "payload"},
    "disturbance": {"disturbance": Disturbance(tip_force=ConstantForce((50.0, 0.0)))},
}
BY_ARGUMENT = {
    "reference": {"reference": OTHER_PATH},
    "case": {"disturbance": Disturbance(payload=Payload(5.0))},
    "disturbance": OPTIONS["disturbance"],
}


@pytest.mark.parametrize("option", OPTIONS)
def test_a_reset_option_holds_for_its_episode_only(option):
    env, torques = FuzzyArmEnv(case="machining"), random_torques(5, 10)
    default = [step[-1] for step in play(env, torques)]
    changed = [step[-1] for step in play(env, torques, options=OPTIONS[option])]
    after = [step[-1] for step in play(env, torques)]
    assert not any(map(same, changed[1:], default[1:])) and all(map(same, after, default))


@pytest.mark.parametrize("option", BY_ARGUMENT)
def test_a_reset_option_does_what_the_argument_does(option):
    torques = random_torques(5, 10)
    by_option = play(FuzzyArmEnv(), torques, options=OPTIONS[option])
    by_argument = play(FuzzyArmEnv(**BY_ARGUMENT[option]), torques)
    for first, second in zip(by_option, by_argument, strict=True):
        assert np.array_equal(first[0], second[0]) and same(first[-1], second[-1])


def test_initial_state_is_taken_as_given_in_the_order_of_state():
    state = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    env = FuzzyArmEnv()
    observation, info = env.reset(options={"initial_state": state})
    names = ("q_motor", "q_link", "dq_motor", "dq_link")
    assert np.concatenate([info[name] for name in names]).tolist() == state.tolist()
    assert observation[:4].tolist() == [0.1, 0.2, 0.5, 0.6]
    env.step([100.0, 0.0])
    assert state[0] == 0.1  # the caller's array is left alone


def test_a_reference_of_its_own_length_ends_the_episode():
    *_, last = follow(FuzzyArmEnv(), options={"reference": OTHER_PATH})
    assert last[3] and last[-1]["time"] == 0.5


def test_unknown_options_are_named_with_the_known_ones():
    message = "unknown reset option inital_state, wind; known: initial_state, reference, case, disturbance"
    with pytest.raises(ValueError, match=message):
        FuzzyArmEnv().reset(options={"wind": 1.0, "inital_state": STILL})


BAD_STATES = {
    "short": STILL[:7],
    "column": STILL[:, None],
    "nan": np.where(np.arange(8) == 3, np.nan, STILL),
    "angle": np.where(np.arange(8) == 2, -3.2, STILL),
    "velocity": np.where(np.arange(8) == 6, 15.1, STILL),
}


@pytest.mark.parametrize("state", BAD_STATES.values(), ids=BAD_STATES)
def test_a_bad_initial_state_is_refused_with_what_is_allowed(state):
    with pytest.raises(ValueError, match=r"initial_state = .* must be 8 finite numbers.*3\.14.*15\.0"):
        FuzzyArmEnv().reset(options={"initial_state": state})


LONG = dataclasses.replace(TABLE_1, length=(0.6, 0.5))
NARROW = dataclasses.replace(TABLE_1, joint_limit=(0.5, 3.0))
SLOW = dataclasses.replace(TABLE_1, velocity_limit=(0.3, 15.0))
BAD_REFERENCES = {
    "other lengths": (
        {},
        JointReference(parameters=LONG),
        r"links of \(0\.6, 0\.5\) m, the plant has \(0\.5, 0\.5\) m",
    ),
    "no reference": ({}, Circle(), r"reference = Circle.* must be a .*[.]Reference"),
    "narrow plant": ({"parameters": NARROW}, JointReference(), r"reference angle reaches .*allows \(0\.5, 3\.0\) rad"),
    "slow plant": (
        {"parameters": SLOW},
        JointReference(),
        r"reference velocity reaches .*allows \(0\.3, 15\.0\) rad/s",
    ),
}


@pytest.mark.parametrize(("arm", "reference", "message"), BAD_REFERENCES.values(), ids=BAD_REFERENCES)
def test_a_reference_for_another_arm_is_refused(arm, reference, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv(reference=reference, **arm)


def test_a_reference_for_another_arm_is_refused_at_reset():
    with pytest.raises(ValueError, match=BAD_REFERENCES["other lengths"][2]):
        FuzzyArmEnv().reset(options={"reference": JointReference(parameters=LONG)})


def test_a_reference_too_quick_for_the_observation_space_is_refused():
    # Velocities within 15 rad/s, accelerations far beyond 1e4 rad/s².
    quick = JointReference(path=Lemniscate((0.5, 0.3), 1e-4), duration=5e-4)
    with pytest.raises(ValueError, match=r"reference acceleration reaches .*rad/s².*10000.*raise its duration"):
        FuzzyArmEnv(reference=quick)


@pytest.mark.parametrize("given", [{"case": "payload", "disturbance": NOISY}, {"disturbance": "payload"}])
def test_a_case_and_a_disturbance_exclude_each_other_and_each_must_be_its_kind(given):
    message = "either case = 'payload' or a disturbance" if "case" in given else "disturbance = 'payload' must be a"
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv(**given)
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv().reset(options=given)


def test_reference_is_that_of_the_episode_under_way():
    env = FuzzyArmEnv()
    assert env.reference == JointReference()  # before the first episode
    env.reset(options={"reference": OTHER_PATH})
    assert env.reference is OTHER_PATH
    with pytest.raises(TypeError, match="must be a"):
        env.reset(options={"reference": Circle()})
    env.reset()
    assert env.reference == JointReference()


def test_unknown_render_mode_names_the_choices():
    with pytest.raises(ValueError, match="render_mode = 'ansi' is unknown; choose from: human, rgb_array"):
        FuzzyArmEnv(render_mode="ansi")


def test_another_arm_is_the_plant_and_sets_the_spaces():
    weak = dataclasses.replace(TABLE_1, torque_limit=(200.0, 80.0), velocity_limit=(10.0, 12.0))
    env = FuzzyArmEnv(parameters=weak)
    *_, info = list(play(env, [(450.0, -240.0)]))[-1]
    assert env.action_space.high.tolist() == [200.0, 80.0] and info["torque"].tolist() == [200.0, -80.0]
    assert env.observation_space.high[6:8].tolist() == [10.0, 12.0] and info["reward_effort"] == 1.0


class HalfWay:
    """A payload that this package does not know: in the middle of link 2."""

    mass = 2.0

    def radius(self, parameters):
        return 0.5 * parameters.length[1]


def test_a_payload_of_ones_own_needs_a_mass_and_a_radius_only():
    own, link = (FuzzyArmEnv(disturbance=Disturbance(payload=load)) for load in (HalfWay(), Payload(2.0, "link")))
    for env in (own, link):  # Table 1 has the mass center of link 2 in its middle
        env.reset()
    torque = np.array([60.0, 20.0])
    assert np.array_equal(own.step(torque)[0], link.step(torque)[0])
    assert not np.array_equal(own.step(torque)[0], FuzzyArmEnv().reset()[0])
    with pytest.raises(ValueError, match=r"payload = 3\.0 must have mass and radius"):
        Disturbance(payload=3.0)
