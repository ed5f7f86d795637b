"""``FuzzyArm-v0`` from a user's view: the Gymnasium contract, seeds, info, reward, episode ends and messages."""

import copy
import dataclasses
import re
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.wrappers import RescaleAction
from support.results import identical

from fuzzyarm import load_policy  # registers FuzzyArm-v0
from fuzzyarm.envs.batch.layout import VECTORS
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics, tip_position
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

TABLE_1 = ArmParameters()
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-4, velocity=1e-2))
OTHER_PATH = JointReference(path=Line((0.4, 0.5), (0.55, 0.45)), duration=0.5)
DOCUMENTED = re.findall(r"`(\w+)`", FuzzyArmEnv.__doc__.split("## Info")[1].split("## Arguments")[0])
SHAPES = {name: (2,) if name in VECTORS else () for name in DOCUMENTED}


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


@pytest.fixture(scope="module")
def tracked():
    """The whole nominal episode under computed torque."""
    return list(follow(FuzzyArmEnv(), seed=0))


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


@pytest.mark.parametrize("seed", range(2))
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


def test_info_has_the_documented_keys_shapes_and_types_at_reset_and_every_step():
    assert len(DOCUMENTED) == 17 and set(VECTORS) < set(DOCUMENTED)
    _, start = FuzzyArmEnv(case="machining").reset()
    assert start["time"] == 0.0 and start["tip_error"] < 1e-15 and start["in_domain"]
    assert not start["torque"].any() and not start["external_force"].any()
    for _, *results, info in play(FuzzyArmEnv(case="machining"), random_torques(0, 30), seed=0):
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


def test_truncated_after_exactly_1500_steps(tracked):
    assert [step[2] for step in tracked] == [False] * 1500
    assert [step[3] for step in tracked] == [False] * 1499 + [True]
    assert tracked[-1][-1]["time"] == 1.5 and "reason" not in tracked[-1][-1]
    assert max(step[-1]["tip_error"] for step in tracked) < 5e-3
    rewards = np.array([step[1] for step in tracked])
    assert rewards.min() > 0.5 and rewards.max() < 1.0  # of a good controller


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


BAD_ACTIONS = [
    ([[1.0, 2.0]], r"action has shape \(1, 2\); it must be \(2,\)"),
    (
        [1.0, np.nan],
        r"action = \[1\.0, nan\] N m is not finite; give finite torques \(clipped to ±\[500\.0, 250\.0\]",
    ),
]


@pytest.mark.parametrize(("action", "message"), BAD_ACTIONS)
def test_a_bad_action_is_named_and_changes_nothing(action, message):
    env = FuzzyArmEnv()
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.step(action)
    assert np.array_equal(env.step([1.0, 2.0])[0], list(play(FuzzyArmEnv(), [[1.0, 2.0]]))[-1][0])


@pytest.fixture
def coarse(monkeypatch):
    """Environments that take the sub-step of a slow arm for every arm."""
    monkeypatch.setattr("fuzzyarm.envs.fuzzy_arm.fastest_rate", lambda arms, drawn: 0.0)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(("stiffness", "period"), [(1e8, 0.1), (1e9, 0.01), (1e10, 1e-3), (1e11, 2e-3), (1e12, 2e-4)])
def test_however_far_a_plant_blows_up_it_ends_on_its_last_finite_state(stiffness, period):
    """Far too stiff for the sub-step: the state grows by powers of ten and passes 1e13, 1e70 or the largest float."""
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
    *_, last = list(play(env, np.zeros((1, 2)), options=fast))
    assert last[2:4] == (end == "terminated", end == "truncated")
    refused()
    env.reset()
    with pytest.raises(ValueError, match="initial_state"):
        env.reset(options={"initial_state": [0.0], "case": "payload"})
    refused()


@pytest.mark.parametrize(("period", "steps"), [(2e-3, 250), (5e-4, 1000), (7e-4, 715)])
def test_other_control_periods_end_with_the_reference(period, steps):
    results = list(follow(FuzzyArmEnv(control_period=np.float64(period), reference=OTHER_PATH)))
    assert len(results) == steps and results[-1][3] and not results[-1][2]
    times = np.array([step[-1]["time"] for step in results])
    np.testing.assert_allclose(times, period * np.arange(1, steps + 1), rtol=1e-12)
    assert max(step[-1]["tip_error"] for step in results) < 5e-3


def test_initial_state_is_taken_as_given_in_the_order_of_state():
    state = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    env = FuzzyArmEnv()
    observation, info = env.reset(options={"initial_state": state})
    names = ("q_motor", "q_link", "dq_motor", "dq_link")
    assert np.concatenate([info[name] for name in names]).tolist() == state.tolist()
    assert observation[:4].tolist() == [0.1, 0.2, 0.5, 0.6]
    env.step([100.0, 0.0])
    assert state[0] == 0.1  # the caller's array is left alone


SLOW = dataclasses.replace(TABLE_1, velocity_limit=(0.3, 15.0))
QUICK = JointReference(path=Lemniscate((0.5, 0.3), 1e-4), duration=5e-4)  # for the observation space
LONGER_LINKS = JointReference(parameters=dataclasses.replace(TABLE_1, length=(0.6, 0.5)))
BAD_ARGUMENTS = [
    ({"substep": 3e-4}, r"control_period = 0\.001 s is not a multiple of substep = .* use substep = 0\.000333333 s"),
    ({"control_period": 0.2}, r"control_period = 0\.2 s is out of range; allowed: \[1e-06, 0\.1\] s"),
    ({"control_period": 1e-4, "substep": 1e-3}, r"substep = 0\.001 s is out of range; allowed: \[1e-08, 0\.0001\] s"),
    ({"case": "drilling"}, "unknown case 'drilling'; choose from: nominal, machining, payload"),
    ({"case": "payload", "disturbance": NOISY}, "either case = 'payload' or a disturbance"),
    (
        {"parameters": SLOW, "reference": JointReference()},
        r"the joint velocity of the reference reaches .*allows \(0\.3, 15\.0\) rad/s",
    ),
    ({"reference": QUICK}, r"the joint acceleration of the reference reaches .*rad/s².*10000.*raise the duration"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_ARGUMENTS)
def test_a_bad_argument_is_named_with_what_is_allowed(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv(**arguments)


BAD_OPTIONS = [
    ({"wind": 1.0, "inital_state": STILL}, "unknown reset option inital_state, wind; known: initial_state, reference"),
    ({"reference": LONGER_LINKS}, r"links of \(0\.6, 0\.5\) m, but the plant has links of \(0\.5, 0\.5\) m"),
    *(
        ({"initial_state": state}, r"initial_state = .* must be 8 finite numbers.*3\.14.*15\.0")
        for state in (STILL[:7], np.full(8, np.nan), STILL - 3.7 * np.eye(8)[2], STILL + 15.1 * np.eye(8)[6])
    ),
]


@pytest.mark.parametrize(("options", "message"), BAD_OPTIONS)
def test_a_bad_option_is_named_with_what_is_allowed(options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmEnv().reset(options=options)


def test_reference_is_that_of_the_episode_under_way():
    env = FuzzyArmEnv()
    assert env.reference == JointReference()  # before the first episode
    for options, reference in (({"reference": OTHER_PATH}, OTHER_PATH), (None, JointReference())):
        env.reset(options=options)
        assert env.reference == reference


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


def test_a_reference_of_endless_periods_is_refused():
    with pytest.raises(ValueError, match="1000000000000 control periods of 1e-06 s; allowed: at most 1000000"):
        FuzzyArmEnv(control_period=1e-6, reference=JointReference(duration=1e6))
