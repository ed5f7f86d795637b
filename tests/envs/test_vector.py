"""The batched environment: each lane equals the single environment, and what it returns and refuses."""

import copy
import dataclasses
import gc
import hashlib
import multiprocessing
import pickle
import re
import threading
import tracemalloc

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from slow_twins import slow_but
from support.randomisation import ROBUST
from support.results import assert_identical, identical

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.workers import LANES_PER_THREAD
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import Termination
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.numbers.machine import WIDE

TABLE_1 = ArmParameters()
LIMIT = np.array(TABLE_1.torque_limit)
NOISY = Disturbance(encoder_noise=EncoderNoise(position=1e-5, velocity=1e-3))
STILL = np.array([0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0])
LEAVING = np.r_[3.14, 0.0, 3.14, 0.0, 2.0, 0.0, 2.0, 0.0]  # out of the box within a few steps
SHORT = JointReference(path=Line((0.4, 0.5), (0.42, 0.5)), duration=0.05)  # 50 steps
LONGER = JointReference(path=Lemniscate((0.4, 0.5), 0.02), duration=0.1)
SAME_STEP = {"autoreset_mode": AutoresetMode.SAME_STEP}
RANDOM = {"disturbance": NOISY, "randomisation": ROBUST}
LONG = dataclasses.replace(TABLE_1, length=(0.6, 0.5))


def batch(num_envs, **arguments):
    """The environment under test, made as its users make it."""
    return gym.make_vec("FuzzyArm-v0", num_envs=num_envs, **arguments)


def loop(num_envs, **arguments):
    """What it must equal: Gymnasium's loop over single environments."""
    return gym.make_vec(
        "FuzzyArm-v0", num_envs=num_envs, vectorization_mode="sync", vector_kwargs=SAME_STEP, **arguments
    )


def torques(seed, steps, lanes, scale=1.0):
    """Torques anywhere in the action space, (steps, lanes, 2); their means last long enough to throw an arm out."""
    generator = np.random.default_rng(seed)
    signs = np.repeat(generator.choice([-1.0, 1.0], (steps // 300 + 1, lanes, 2)), 300, axis=0)[:steps]
    return signs * generator.uniform(0.5, 1.0, signs.shape) * scale * LIMIT


def lanes_of(info, count):
    """Info of a batch as one dictionary a lane, by its masks."""
    lanes = [{} for _ in range(count)]
    for key, values in info.items():
        if key.startswith("_"):
            continue
        rows = lanes_of(values, count) if isinstance(values, dict) else values
        for lane in np.flatnonzero(info[f"_{key}"]):
            lanes[lane][key] = rows[lane]
    return lanes


SETTINGS = {
    "machining, plants": {"case": "machining", "randomisation": "plants"},
    "noise and force, robust": {
        "disturbance": dataclasses.replace(NOISY, tip_force=ConstantForce((30.0, 9.0))),
        "randomisation": ROBUST,
    },
    "coarse steps": {"case": "machining", "control_period": 2e-3, "substep": 1e-3},
}


def digest(envs, actions, **reset):
    """sha256 of everything numeric that comes back, and the number of episodes that ended."""
    sha, ends = hashlib.sha256(), 0

    def add(value):
        if isinstance(value, dict):
            for key in sorted(value):
                add(value[key])
        elif value.dtype == object:
            sha.update(repr(value.tolist()).encode())
        else:
            sha.update(value.tobytes())

    def add_all(results):
        for result in results:
            add(result)

    add_all(envs.reset(**reset))
    for action in actions:
        results = envs.step(action)
        add_all(results)
        ends += int((results[2] | results[3]).sum())
    return sha.hexdigest(), ends


@pytest.mark.parametrize("setting", slow_but(["noise and force, robust", "coarse steps"], SETTINGS))
def test_a_batch_equals_gymnasiums_loop_over_single_environments(setting):
    lanes, seconds = 5, 0.65 if "robust" in setting else 1.56  # past the ends of the references
    envs, expected = batch(lanes, **SETTINGS[setting]), loop(lanes, **SETTINGS[setting])
    spaces = ("observation_space", "single_observation_space", "action_space", "single_action_space")
    assert all(getattr(envs, name) == getattr(expected, name) for name in spaces)
    steps = round(seconds / envs.control_period)
    policy, wild = load_policy("computed-torque", control_period=envs.control_period), torques(1, steps, lanes)
    before, after = envs.reset(seed=11), expected.reset(seed=11)
    assert_identical(before, after)
    state, done, ends = None, None, {"terminated": 0, "truncated": 0}
    for step, action in enumerate(wild):
        controlled, state = policy.predict(after[0], state=state, episode_start=done)
        action[:3] = controlled[:3]  # the other two lanes are thrown about
        before, after = envs.step(action), expected.step(action)
        assert_identical(before, after, step)
        assert before[0] in envs.observation_space
        done = after[2] | after[3]
        ends["terminated"] += after[2].sum()
        ends["truncated"] += after[3].sum()
    assert ends["terminated"] > 5 and ends["truncated"] >= 3


PLANTS = [
    TABLE_1,
    dataclasses.replace(TABLE_1, mass=(12.0, 7.0), stiffness=(9e4, 1e4)),
    dataclasses.replace(TABLE_1, torque_limit=(300.0, 150.0), velocity_limit=(12.0, 14.0)),
    dataclasses.replace(TABLE_1, length=(0.6, 0.45), joint_limit=(3.0, 3.1)),
]
REFERENCES = [SHORT, JointReference(parameters=PLANTS[1]), LONGER, JointReference(duration=0.7, parameters=PLANTS[3])]
DISTURBANCES = [Disturbance(), NOISY, Disturbance(torque_bias=TorqueBias((5.0, 2.0))), NOISY]
STATES = [STILL, LEAVING, STILL + 0.1, 0.9 * LEAVING]
BY_LANE = {
    "cases": {"case": ["nominal", "machining", "payload", "machining"]},
    "plants with references": {"parameters": PLANTS, "reference": REFERENCES, "disturbance": DISTURBANCES},
    "plants of a randomisation": {
        "parameters": [TABLE_1, TABLE_1, PLANTS[1], PLANTS[3]],
        "randomisation": "plants",
        "case": ("payload",) * 4,
        "reference": [SHORT, LONGER, SHORT, dataclasses.replace(SHORT, parameters=PLANTS[3])],
    },
    "some references": {"parameters": PLANTS, "reference": [SHORT, None, None, None]},
}


SHARED = str, JointReference, DomainRandomisation  # what all lanes of a batch have, not one of each


def singles_of(arguments):
    """Four single environments, each with what the arguments of a batch say for its lane."""
    by_lane = [
        {name: value if isinstance(value, SHARED) else value[lane] for name, value in arguments.items()}
        for lane in range(4)
    ]
    return [gym.make("FuzzyArm-v0", **lane) for lane in by_lane]


def check_lanes(envs, singles, seeds, options=None, steps=230):
    """Compare a batch with single environments stepped and reset one by one; return how often lanes ended."""
    lanes, ends = len(singles), np.zeros(len(singles), dtype=int)
    options = options or [None] * lanes
    joint = {name: [lane[name] for lane in options] for name in options[0]} if options[0] else None
    observation, info = envs.reset(seed=seeds, options=joint)
    starts = [env.reset(seed=seed, options=lane) for env, seed, lane in zip(singles, seeds, options, strict=True)]
    for lane, (first, start) in enumerate(starts):
        assert identical(observation[lane], first) and same_info(lanes_of(info, lanes)[lane], start)
    for step, action in enumerate(torques(3, steps, lanes, scale=0.9)):
        observation, reward, terminated, truncated, info = envs.step(action)
        by_lane = lanes_of(info, lanes)
        for lane, env in enumerate(singles):
            expected = env.step(action[lane])
            last, shown = observation[lane], by_lane[lane]
            if expected[2] or expected[3]:
                ends[lane] += 1
                last, ended = shown.pop("final_obs"), shown.pop("final_info")
                first, start = env.reset()
                assert identical(observation[lane], first) and same_info(shown, start), (lane, step)
                shown = ended
            assert identical(last, expected[0]) and same_info(shown, expected[4]), (lane, step)
            assert (reward[lane], terminated[lane], truncated[lane]) == expected[1:4], (lane, step)
    return ends


def same_info(shown, expected):
    """Whether a lane's info holds the single environment's keys and bits, its numbers as arrays' entries are."""
    if not (isinstance(expected, dict) and shown.keys() == expected.keys()):
        return False
    for key, value in expected.items():
        if not (same_info(shown[key], value) if isinstance(value, dict) else np.array_equal(shown[key], value)):
            return False
    return True


@pytest.mark.parametrize("arguments", BY_LANE.values(), ids=BY_LANE)
def test_arguments_that_differ_by_lane_equal_single_environments_made_with_them(arguments):
    ends = check_lanes(batch(4, **arguments), singles_of(arguments), [5, 6, 7, 8])
    assert ends.min() > 0


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        ({"reference": [SHORT, LONGER] * 2}, {"case": ["payload", "nominal", "machining", "payload"]}),
        ({"randomisation": "plants"}, {"disturbance": DISTURBANCES, "initial_state": STATES}),
        ({"randomisation": ROBUST}, {"reference": [LONGER, SHORT, LONGER, SHORT], "case": ["payload"] * 4}),
    ],
    ids=lambda given: " and ".join(given),
)
def test_options_that_differ_by_lane_equal_those_of_single_environments_and_end_with_the_episode(arguments, option):
    arguments = {"case": "machining", **arguments}
    by_lane = [{name: values[lane] for name, values in option.items()} for lane in range(4)]
    assert check_lanes(batch(4, **arguments), singles_of(arguments), [1, 2, 3, 4], by_lane).min() > 0


@pytest.mark.parametrize(
    "option",
    [
        {"disturbance": Disturbance(tip_force=ConstantForce((50.0, 0.0)))},
        {"initial_state": STILL.tolist(), "case": "machining", "reference": LONGER},
    ],
    ids=lambda option: " and ".join(option),
)
def test_an_option_for_all_lanes_equals_gymnasiums_loop_and_holds_for_one_episode(option):
    envs, expected = batch(3, reference=LONGER), loop(3, reference=LONGER)
    actions = torques(4, 110, 3, scale=0.5)
    for options in (None, option, None):
        assert_identical(envs.reset(seed=3, options=options), expected.reset(seed=3, options=options))
        for step, action in enumerate(actions):
            assert_identical(envs.step(action), expected.step(action), step)


def test_make_vec_gives_it_by_name_and_by_mode():
    for arguments in ({}, {"vectorization_mode": "vector_entry_point"}):
        envs = gym.make_vec("FuzzyArm-v0", num_envs=3, **arguments)
        assert type(envs) is FuzzyArmVectorEnv and isinstance(envs, VectorEnv)
        assert repr(envs) == "FuzzyArmVectorEnv(FuzzyArm-v0, num_envs=3)"
    assert gym.make_vec("FuzzyArm-v0").num_envs == 1 and FuzzyArmVectorEnv(np.int64(2)).num_envs == 2
    assert envs.metadata == {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
    with pytest.raises(NotImplementedError, match="render"):
        envs.render()


def test_results_have_the_types_of_the_spaces():
    envs = batch(3, reference=SHORT, disturbance=NOISY)
    envs.reset(seed=3)
    for _ in range(60):
        observation, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
        assert observation in envs.observation_space and observation.dtype == np.float64
        assert (reward.dtype, terminated.dtype, truncated.dtype) == (np.float64, np.bool_, np.bool_)
        assert all(last in envs.single_observation_space for last in info.get("final_obs", []) if last is not None)


def test_spaces_of_different_arms_hold_them_all():
    for first in range(4):
        envs = batch(4, parameters=PLANTS[first:] + PLANTS[:first])
        assert envs.single_action_space.high.tolist() == [500.0, 250.0]
        assert envs.single_observation_space.high[4:8].tolist() == [np.pi, np.pi, 15.0, 15.0]
        assert envs.reset(seed=0)[0] in envs.observation_space


def test_results_do_not_depend_on_the_threads():
    lanes = 3 * LANES_PER_THREAD + 5
    actions = torques(5, 60, lanes)
    results = [digest(batch(lanes, threads=threads, **RANDOM), actions, seed=1) for threads in (1, 2, 5)]
    assert set(results) == {results[0]} and results[0][1] > 0


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_threads_survive_a_fork():
    lanes = 3 * LANES_PER_THREAD
    envs, actions = batch(lanes, threads=3), torques(1, 10, lanes)
    envs.reset(seed=0)
    for action in actions[:5]:
        envs.step(action)

    def goes_on():
        return [hashlib.sha256(envs.step(action)[0].tobytes()).hexdigest() for action in actions[5:]]

    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=lambda: sender.send(goes_on()))
    child.start()
    try:
        assert receiver.poll(60), "the forked process waits for threads it has not"
        assert receiver.recv() == goes_on()
        child.join(60)
        assert child.exitcode == 0
    finally:
        child.kill()
        envs.close()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda envs: pickle.loads(pickle.dumps(envs))])
def test_a_copy_goes_on_where_the_original_was(copied):
    lanes = 2 * WIDE
    envs = batch(lanes, threads=2, **RANDOM)
    actions = torques(2, 200, lanes)
    envs.reset(seed=0, options={"case": "payload"})
    for action in actions[:60]:
        envs.step(action)
    twin, ends = copied(envs), 0
    for step, action in enumerate(actions[60:]):
        results = envs.step(action)
        assert_identical(twin.step(action), results, step)
        ends += results[2].sum()
    assert_identical(twin.reset(), envs.reset())
    assert ends > 0 and not twin.reset()[1]["_tip"].flags.writeable  # the mask that all keys share


@pytest.mark.parametrize("end", ["close", "forget"])
def test_threads_end_with_the_environment(end):
    before = set(threading.enumerate())
    for lanes in (200, 2 * 2048):  # so many are worth waking a thread for a single step
        envs = batch(lanes, threads=2)
        envs.reset()
        envs.step(np.zeros((lanes, 2)))
        started = set(threading.enumerate()) - before
        assert bool(started) == (lanes > 200)
    if end == "close":
        envs.close()
        envs.close()
        assert envs.closed
    else:
        del envs
        gc.collect()
    for thread in started:
        thread.join(20)
    assert not any(thread.is_alive() for thread in started)


def test_one_seed_seeds_lane_i_with_seed_plus_i():
    actions = torques(0, 20, 3)
    seeds = (5, np.int64(5), [5, 6, 7], (5, 6, 7), np.array([5, 6, 7]))
    digests = {digest(batch(3, **RANDOM), actions, seed=seed) for seed in seeds}
    assert len(digests) == 1
    assert digest(batch(3, **RANDOM), actions, seed=6) not in digests
    envs = batch(3)
    envs.reset(seed=5)
    assert envs.np_random_seed == 5
    unseeded = np.concatenate([batch(5, **RANDOM).reset()[0] for _ in range(3)])
    assert len(np.unique(unseeded[:, :4], axis=0)) == 15


def test_without_a_seed_the_streams_go_on_as_those_of_single_environments_do():
    envs, expected = batch(3, **RANDOM), loop(3, **RANDOM)
    starts = []
    for seed in (3, None, None, [None, 8, None], [4, None, 5], None):
        starts.append(envs.reset(seed=seed))
        assert_identical(starts[-1], expected.reset(seed=seed))
        for action in torques(1, 5, 3):
            assert_identical(envs.step(action), expected.step(action))
    assert len(np.unique([start[0][1] for start in starts], axis=0)) == len(starts)  # no episode of lane 1 twice


BAD_SEEDS = [
    (-1, r"seed = -1 is out of range; allowed: 0, 1, 2, \.\.\."),
    (True, "seed = True must be a whole number"),
    (range(4), "4 seeds for 3 lanes; give one, or one per lane"),
    ([1, 2, -3], r"lane 2: seed = -3 is out of range; allowed: 0, 1, 2, \.\.\."),
]


@pytest.mark.parametrize(("seed", "message"), BAD_SEEDS)
def test_a_bad_seed_is_named_and_the_streams_stay_where_they_were(seed, message):
    envs, untouched = batch(3, **RANDOM), batch(3, **RANDOM)
    assert_identical(envs.reset(seed=0), untouched.reset(seed=0))
    with pytest.raises((TypeError, ValueError), match=message):
        envs.reset(seed=seed)
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((3, 2)))
    assert_identical(envs.reset(), untouched.reset())


BAD_ARGUMENTS = [
    ({"num_envs": 0}, r"num_envs = 0 is out of range; allowed: 1 to 4194304"),
    ({"num_envs": 2.5}, r"num_envs = 2\.5 must be a whole number"),
    ({"threads": 0}, r"threads = 0 is out of range; allowed: 1 to 1024"),
    ({"threads": True}, "threads = True must be a whole number"),
    ({"render_mode": "rgb_array"}, r"render_mode = 'rgb_array': a batch draws nothing; use gymnasium\.make"),
    ({"case": "drilling"}, "^unknown case 'drilling'; choose from: nominal, machining, payload"),
    ({"case": ["nominal", "nominal", "drilling"]}, "^lane 2: unknown case 'drilling'; choose from: nominal, mach"),
    ({"case": ["nominal", "payload"]}, "case has 2 entries for 3 lanes; give one, or one per lane"),
    ({"disturbance": [NOISY, NOISY, 3]}, "^lane 2: disturbance = 3 must be a .*Disturbance"),
    (
        {"case": ["nominal", "payload", "nominal"], "disturbance": NOISY},
        "^lane 1: give either case = 'payload' or a disturbance, not both",
    ),
    ({"reference": [SHORT, Circle(), SHORT]}, "^lane 1: reference = Circle.* must be a .*[.]Ref"),
    ({"reference": SHORT, "randomisation": "robust"}, "either a reference or a randomisation that draws ref"),
    ({"reference": JointReference(parameters=LONG)}, r"links of \(0\.6, 0\.5\) m, the plant"),
    ({"parameters": [TABLE_1, None, TABLE_1]}, "^lane 1: parameters = None must be a .*ArmParameters"),
    ({"randomisation": "wild"}, "unknown randomisation 'wild'; choose from: nominal, plants, robust"),
    ({"substep": 3e-4}, r"control_period = 0\.001 s is no multiple of substep = 0\.0003 s"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_ARGUMENTS)
def test_a_bad_argument_is_named_with_its_lane_and_what_is_allowed(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmVectorEnv(**{"num_envs": 3, **arguments})


BAD_OPTIONS = [
    (
        {"wind": 1.0, "inital_state": STILL},
        "unknown reset option inital_state, wind; known: initial_state, reference, case, disturbance",
    ),
    ({"reset_mask": None}, "reset_mask is NoneType; it must be a numpy array of 3 booleans"),
    ({"reset_mask": np.array([1, 0, 0])}, "reset_mask is an array of int64; it must be a numpy"),
    ({"reset_mask": np.ones(2, dtype=bool)}, r"reset_mask has shape \(2,\); needed: \(3,\)"),
    ({"reset_mask": np.zeros(3, dtype=bool)}, "reset_mask names no lane; at least one"),
    ({"reset_mask": np.array([True, False, False]), "wind": 1.0}, "unknown reset option wind; known: "),
    ({"case": ["nominal", "drilling", "nominal"]}, "^lane 1: unknown case 'drilling'; choose from: nominal, mach"),
    ({"case": ["nominal"] * 4}, "case has 4 entries for 3 lanes; give one, or one per lane"),
    ({"case": "payload", "disturbance": NOISY}, "give either case = 'payload' or a disturbance, not both"),
    ({"reference": [SHORT, SHORT, None]}, "^lane 2: reference = None must be a .*[.]Reference"),
    ({"reference": JointReference(parameters=LONG)}, r"links of \(0\.6, 0\.5\) m, the plant"),
    ({"initial_state": np.tile(STILL, (2, 1))}, r"initial_state has shape \(2, 8\); allowed: \(8,\) or \(3, 8\)"),
    ({"initial_state": [STILL, STILL, 9.0 * STILL]}, r"^lane 2: initial_state = \[4\.5, .*8 finite.*3\.14.*15\.0"),
]


@pytest.mark.parametrize(("options", "message"), BAD_OPTIONS)
def test_a_bad_option_is_named_and_leaves_nothing_to_step(options, message):
    envs, untouched, actions = batch(3, disturbance=NOISY), batch(3, disturbance=NOISY), torques(0, 5, 3)
    with pytest.raises(ResetNeeded, match=r"call envs\.reset\(\) before envs\.step\(\)"):
        envs.step(actions[0])
    for made in (envs, untouched):
        made.reset(seed=0)
    with pytest.raises((TypeError, ValueError), match=message):
        envs.reset(options=options)
    with pytest.raises(ResetNeeded, match=r"call envs\.reset\(\) before envs\.step\(\)"):
        envs.step(actions[0])
    assert digest(envs, actions) == digest(untouched, actions)


@pytest.mark.parametrize("action", [np.zeros(2), np.zeros((4, 2)), np.zeros((3, 2, 1)), None])
def test_actions_of_the_wrong_shape_are_named(action):
    envs = batch(3)
    envs.reset()
    message = rf"actions have shape {re.escape(str(np.shape(action)))}; needed: \(3, 2\), motor torques \[N m\]"
    with pytest.raises(ValueError, match=message):
        envs.step(action)


@pytest.mark.parametrize(
    ("lanes", "bad", "threads", "value"),
    [(1, 0, 1, np.nan), (3, 2, 1, -np.inf), (2 * LANES_PER_THREAD, LANES_PER_THREAD + 1, 2, np.inf)],
)
def test_an_action_that_is_not_finite_names_its_lane_and_moves_none(lanes, bad, threads, value):
    envs, untouched = (batch(lanes, threads=threads, disturbance=NOISY) for _ in range(2))
    envs.reset(seed=0)
    untouched.reset(seed=0)
    good = torques(0, 3, lanes)
    wrong = good[0].copy()
    wrong[bad:, 1] = value
    given = rf"action \[{re.escape(str(wrong[bad, 0]))}, {value}\] N m of lane {bad} is not finite"
    with pytest.raises(ValueError, match=given + r"; allowed: ±\[500\.0, 250\.0\] N m"):
        envs.step(wrong)
    for action in good:
        assert_identical(envs.step(action), untouched.step(action))


FORMS = {
    "list": lambda a: a.tolist(),
    "float16": lambda a: a.astype(np.float16),
    "int32": lambda a: a.astype(np.int32),
    "big endian": lambda a: a.astype(">f8"),
    "columns": np.asfortranarray,
    "every other": lambda a: np.repeat(a, 2, axis=0)[::2],
    "backwards": lambda a: a[::-1].copy()[::-1],
    "read only": lambda a: np.broadcast_to(a, (2, *a.shape))[1],
    "misaligned": lambda a: np.frombuffer(b"x" + a.tobytes(), dtype=np.float64, offset=1).reshape(a.shape),
    "objects": lambda a: a.astype(object),
}


def test_actions_of_any_form_are_torques_of_a_batch_and_of_one_arm():
    whole = np.array([[80.0, 20.0], [-300.0, 7.0], [600.0, 1.0]])  # exact in every form
    for envs, given in ((batch(3), whole), (FuzzyArmEnv(), whole[0])):
        envs.reset(seed=0)
        expected = envs.step(given)
        for name, form in FORMS.items():
            envs.reset(seed=0)
            action = form(given)
            kept = copy.deepcopy(action)
            assert_identical(envs.step(action), expected, name)
            assert np.array_equal(action, kept)  # the caller's array is left alone


def test_torques_are_clipped_to_the_limits_of_each_lanes_arm_and_info_says_so():
    envs = batch(4, parameters=PLANTS)
    envs.reset()
    *_, info = envs.step([[400.0, -140.0], [600.0, 0.0], [400.0, -140.0], [0.0, -300.0]])
    assert info["torque"].tolist() == [[400.0, -140.0], [500.0, 0.0], [300.0, -140.0], [0.0, -250.0]]
    assert info["torque_clipped"].tolist() == [False, True, True, True]


def arrays_of(value):
    """Every array in a result."""
    if isinstance(value, dict | tuple):
        for entry in value.values() if isinstance(value, dict) else value:
            yield from arrays_of(entry)
    elif isinstance(value, np.ndarray):
        yield value
        if value.dtype == object:
            yield from (entry for entry in value if isinstance(entry, np.ndarray))


def test_the_plant_shares_no_memory_with_what_it_returned_or_was_given():
    envs, untouched, written = batch(3, **RANDOM), batch(3, **RANDOM), 0
    results, others = envs.reset(seed=0), untouched.reset(seed=0)
    kept, buffer = [others], np.empty((3, 2))
    copies = copy.deepcopy(kept)
    for action in torques(1, 250, 3):
        assert_identical(results, others)
        for array in arrays_of(results):
            if array.flags.writeable and array.dtype != object:
                array[:] = True if array.dtype == bool else np.nan
                written += 1
        buffer[:] = action
        results, others = envs.step(buffer), untouched.step(action)
        buffer[:] = np.nan
        kept.append(others)
        copies.append(copy.deepcopy(others))
    assert written > 250 * 20 and any("final_obs" in result[-1] for result in kept)
    for one, other in zip(kept, copies, strict=True):  # later steps did not touch them
        assert_identical(one, other)


def test_arrays_of_one_result_do_not_overlap():
    envs = batch(3, **RANDOM)
    envs.reset(seed=0)
    for action in torques(1, 250, 3):
        results = envs.step(action)
        if "final_obs" in results[-1]:
            break
    arrays = list({id(array): array for array in arrays_of(results) if array.dtype == float}.values())
    assert len(arrays) > 50
    for place, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[:place])


@pytest.mark.slow
def test_a_lane_needs_less_than_a_thousand_bytes():
    def taken(lanes):
        gc.collect()
        tracemalloc.start()
        try:
            envs = batch(lanes, randomisation="robust")
            envs.reset()
            envs.step(np.zeros((lanes, 2)))
            gc.collect()
            return tracemalloc.get_traced_memory()[0]
        finally:
            tracemalloc.stop()

    taken(3000)  # loads what is loaded once: the kernels for whole blocks, too
    per_lane = (taken(3000) - taken(1000)) / 2000
    assert 400 < per_lane < 1000  # 37 numbers of state and constants alone are 296


def test_a_long_run_of_random_torques_stays_finite_and_within_the_spaces():
    lanes, steps, ends = 500, 200, 0
    envs = batch(lanes, **RANDOM)
    envs.reset(seed=0)
    for action in torques(3, steps, lanes, scale=1.5):
        observation, reward, terminated, truncated, info = envs.step(action)
        ends += (terminated | truncated).sum()
        assert observation in envs.observation_space and ((reward >= 0.0) & (reward <= 1.0)).all()
        assert all(np.isfinite(info[key]).all() for key in ("tip", "q_link", "dq_link", "friction_torque", "tip_error"))
        assert info["in_domain"].all()  # of the current episodes: lanes that left the box have been reset
    assert ends > lanes / 2


def extreme_arms(count, seed=0, period=1e-3):
    """Arms with constants up to a million times larger or smaller than those of Table 1, as far as they are legal."""
    generator, arms = np.random.default_rng(seed), []
    fixed = ("length", "joint_limit", "velocity_limit", "gravity")  # so that the reference stays possible
    while len(arms) < count:
        values = {name: value for name, value in TABLE_1.to_dict().items() if name not in fixed}
        factor = 10.0 ** (generator.uniform(-6.0, 6.0, 20) * generator.integers(0, 2, 20))
        given = {
            name: tuple(np.atleast_1d(value) * f) for (name, value), f in zip(values.items(), factor, strict=False)
        }
        given["stribeck_velocity"] = given["stribeck_velocity"][0]
        given["mass_center"] = values["mass_center"]
        try:
            arm = dataclasses.replace(TABLE_1, **given)
            default_substeps(period, fastest_rate([arm]))
        except ValueError:
            continue  # a singular mass matrix, static friction below Coulomb's, or too fast for any sub-step
        arms.append(arm)
    return arms


HEAVY = DomainRandomisation(
    mass=(1.0, 100.0),
    motor_inertia=(1.0, 100.0),
    stiffness=(0.01, 100.0),
    damping=(0.0, 100.0),
    dry_friction=(0.0, 100.0),
    viscous_friction=(0.0, 100.0),
    payload=(0.0, 1000.0),
    force=(0.0, 100.0),
    angle=(-0.5, 0.5),
)
EXTREME = {"arms": {"parameters": extreme_arms(32)}, "heavy": {"randomisation": HEAVY}}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXTREME)
def test_extreme_arms_move_or_end_with_a_reason(name):
    lanes = 32
    envs, ends, moved = batch(lanes, case="machining", **EXTREME[name]), 0, np.zeros(lanes, dtype=bool)
    envs.reset(seed=0)
    for action in torques(3, 200, lanes):
        observation, reward, terminated, truncated, info = envs.step(action * envs.single_action_space.high / LIMIT)
        assert observation in envs.observation_space and np.isfinite(reward).all()
        assert all(np.isfinite(array).all() for array in arrays_of(info) if array.dtype == float)
        moved |= ~(terminated | truncated)
        if terminated.any():
            ends += terminated.sum()
            assert set(info["final_info"]["reason"][terminated]) <= {reason.text for reason in Termination if reason}
    assert moved.mean() > 0.2 and (ends > lanes or name == "heavy")
