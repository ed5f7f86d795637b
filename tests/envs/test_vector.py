"""The batched environment: each lane equals the single environment, its threads, what it returns and refuses."""

import copy
import dataclasses
import functools
import gc
import multiprocessing
import re
import subprocess
import sys
import threading

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from slow_twins import slow_but
from support.batches import LEAVING, LONGER, NOISY, SHORT, batch, loop, torques
from support.randomisation import ROBUST
from support.results import assert_identical, identical

from fuzzyarm import load_policy
from fuzzyarm.envs.batch.workers import LANES_PER_THREAD
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import Termination
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.bench.run import _memory_per_lane

TABLE_1 = ArmParameters()
STILL = np.array([0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0])
RANDOM = {"disturbance": NOISY, "randomisation": ROBUST}


def played(envs, actions, **reset):
    return [envs.reset(**reset), *(envs.step(action) for action in actions)]


class Given(gym.Wrapper):
    """A single environment with options of its own for the first reset."""

    def __init__(self, env, options):
        super().__init__(env)
        self.given = options

    def reset(self, *, seed=None, options=None):
        given, self.given = self.given, None
        return self.env.reset(seed=seed, options=given)


SETTINGS = {
    "machining, plants": {"case": "machining", "randomisation": "plants"},
    "noise and force, robust": {
        "disturbance": dataclasses.replace(NOISY, tip_force=ConstantForce((30.0, 9.0))),
        "randomisation": ROBUST,
    },
    "coarse steps": {"case": "machining", "control_period": 2e-3, "substep": 1e-3},
}


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
    state, done, ends = None, None, np.zeros(2)
    for step, action in enumerate(wild):
        controlled, state = policy.predict(after[0], state=state, episode_start=done)
        action[:3] = controlled[:3]  # the other two lanes are thrown about
        before, after = envs.step(action), expected.step(action)
        assert_identical(before, after, step)
        assert before[0] in envs.observation_space
        done = after[2] | after[3]
        ends += [after[2].sum(), after[3].sum()]
    assert (ends >= [6, 3]).all()


PLANTS = [
    TABLE_1,
    dataclasses.replace(TABLE_1, mass=(12.0, 7.0), stiffness=(9e4, 1e4)),
    dataclasses.replace(TABLE_1, torque_limit=(300.0, 150.0), velocity_limit=(12.0, 14.0)),
    dataclasses.replace(TABLE_1, length=(0.6, 0.45), joint_limit=(3.0, 3.1)),
]
REFERENCES = [SHORT, JointReference(parameters=PLANTS[1]), LONGER, JointReference(duration=0.7, parameters=PLANTS[3])]
DISTURBANCES = [Disturbance(), NOISY, Disturbance(torque_bias=TorqueBias((5.0, 2.0))), NOISY]
STATES = [STILL, LEAVING, STILL + 0.1, 0.9 * LEAVING]
MACHINING = {"case": "machining"}
BY_LANE = {  # arguments, and options of the first reset
    "cases": ({"case": ["nominal", "machining", "payload", "machining"]}, {}),
    "plants with references": ({"parameters": PLANTS, "reference": REFERENCES, "disturbance": DISTURBANCES}, {}),
    "plants of a randomisation": (
        {
            "parameters": [TABLE_1, TABLE_1, PLANTS[1], PLANTS[3]],
            "randomisation": "plants",
            "case": ["payload"] * 4,
            "reference": [SHORT, LONGER, SHORT, dataclasses.replace(SHORT, parameters=PLANTS[3])],
        },
        {},
    ),
    "some references": ({"parameters": PLANTS, "reference": [SHORT, None, None, None]}, {}),
    "loads": (MACHINING | {"reference": [SHORT, LONGER] * 2}, {"case": ["payload", "nominal", "machining", "payload"]}),
    "starts": (MACHINING | {"randomisation": "plants"}, {"disturbance": DISTURBANCES, "initial_state": STATES}),
    "references": (MACHINING | {"randomisation": ROBUST}, {"reference": [LONGER, SHORT] * 2, "case": ["payload"] * 4}),
}


@pytest.mark.parametrize(("arguments", "options"), BY_LANE.values(), ids=BY_LANE)
def test_what_differs_by_lane_equals_single_environments_and_options_end_with_the_episode(arguments, options):
    """The single environments are made, and first reset, with what is given for their lanes."""
    envs, lanes = batch(4, **arguments), []
    for lane in range(4):
        own = {name: value[lane] if isinstance(value, list) else value for name, value in arguments.items()}
        env = gym.make("FuzzyArm-v0", **own)
        env.action_space, env.observation_space = envs.single_action_space, envs.single_observation_space
        env = Given(env, {name: value[lane] for name, value in options.items()})
        lanes.append(functools.partial(lambda env: env, env))
    expected = SyncVectorEnv(lanes, autoreset_mode=AutoresetMode.SAME_STEP)
    assert_identical(envs.reset(seed=5, options=options), expected.reset(seed=5))
    ends = np.zeros(4, dtype=int)
    for step, action in enumerate(torques(3, 230, 4, scale=0.9)):
        results = envs.step(action)
        assert_identical(results, expected.step(action), step)
        ends += results[2] | results[3]
    assert ends.min() > 0


def test_spaces_of_different_arms_hold_them_all_and_torques_are_clipped_to_each_lanes_own_limits():
    for first in range(4):
        envs = batch(4, parameters=PLANTS[first:] + PLANTS[:first])
        assert envs.single_action_space.high.tolist() == [500.0, 250.0]
        assert envs.single_observation_space.high[4:8].tolist() == [np.pi, np.pi, 15.0, 15.0]
        assert envs.reset(seed=0)[0] in envs.observation_space
    envs = batch(4, parameters=PLANTS)
    envs.reset()
    *_, info = envs.step([[400.0, -140.0], [600.0, 0.0], [400.0, -140.0], [0.0, -300.0]])
    assert info["torque"].tolist() == [[400.0, -140.0], [500.0, 0.0], [300.0, -140.0], [0.0, -250.0]]
    assert info["torque_clipped"].tolist() == [False, True, True, True]


def test_results_do_not_depend_on_the_threads():
    lanes = 3 * LANES_PER_THREAD + 5
    actions = torques(5, 60, lanes)
    first, *others = (played(batch(lanes, threads=threads, **RANDOM), actions, seed=1) for threads in (1, 2, 5))
    assert all(identical(first, other) for other in others) and any(result[-3].any() for result in first[1:])


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_threads_survive_a_fork():
    lanes = 3 * LANES_PER_THREAD
    envs, actions = batch(lanes, threads=3), torques(1, 10, lanes)
    played(envs, actions[:5], seed=0)

    def goes_on():
        return [envs.step(action)[0] for action in actions[5:]]

    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=lambda: sender.send(goes_on()))
    child.start()
    try:
        assert receiver.poll(60), "the forked process waits for threads it has not"
        assert np.array_equal(receiver.recv(), goes_on())
        child.join(60)
        assert child.exitcode == 0
    finally:
        child.kill()
        envs.close()


@pytest.mark.parametrize("end", ["close", "forget"])
def test_threads_end_with_the_environment(end):
    before = set(threading.enumerate())
    for lanes in (200, 2 * 2048):  # so many are worth waking a thread for a single step
        envs = batch(lanes, threads=2)
        played(envs, np.zeros((1, lanes, 2)))
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


def test_a_step_does_not_wait_for_a_thread_that_is_busy():
    """The pool's only thread never comes: the calling thread does everything, once."""
    envs, alone = (batch(3 * LANES_PER_THREAD, threads=threads) for threads in (2, 1))
    first, second = torques(0, 2, envs.num_envs)
    for one in (envs, alone):
        played(one, [first], seed=0)
    released = threading.Event()
    busy = envs.lanes._workers._pool.submit(released.wait, 20)
    try:
        assert identical(envs.step(second), alone.step(second)) and not busy.done()
    finally:
        released.set()
        envs.close()


SEVERAL = """
import concurrent.futures, contextlib, time
import numpy as np
from gymnasium.error import ResetNeeded
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv

references = JointReference(duration=1.0), JointReference()
env = {make}
action = np.zeros(env.action_space.shape)
env.reset(seed=0)
end = time.monotonic() + 1.0

def use(number):
    generator = np.random.default_rng(number)
    while time.monotonic() < end:
        with contextlib.suppress(ResetNeeded, ValueError, IndexError, KeyError):
            if generator.random() < 0.02:
                env.reset(options={{"reference": references[0]}} if generator.random() < 0.5 else None)
            for _ in range(200):
                env.step(action)

with concurrent.futures.ThreadPoolExecutor(4) as pool:
    pool.map(use, range(4))
env = FuzzyArmEnv(control_period=0.1, substep=1e-3)
env.reset(seed=0)
for _ in range(40_000):
    env._ended = False  # as another thread may find it: the step stays at the end of the schedule
    last = env.step(np.zeros(2))[-1]["time"]
print(round(last, 9))
"""
KINDS = {
    "family": "FuzzyArmEnv(control_period=0.02, randomisation=DomainRandomisation(references=references))",
    "batch": "FuzzyArmVectorEnv(3, control_period=0.02)",
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_environment_used_by_several_threads_does_not_crash(kind):
    """It is for one thread: with several, results are wrong."""
    script = SEVERAL.format(make=KINDS[kind])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == "1.5\n"


def test_one_seed_seeds_lane_i_with_seed_plus_i():
    seeds = (5, np.int64(5), [5, 6, 7], (5, 6, 7), np.array([5, 6, 7]), 6)
    first, *others, another = (played(batch(3, **RANDOM), torques(0, 20, 3), seed=seed) for seed in seeds)
    assert all(identical(first, other) for other in others) and not identical(first, another)
    envs = batch(3)
    envs.reset(seed=5)
    assert envs.np_random_seed == 5
    unseeded = [batch(5, **RANDOM).reset()[0][:, :4] for _ in range(3)]
    assert len(np.unique(np.vstack(unseeded), axis=0)) == 15


BAD_ARGUMENTS = [
    *(({"autoreset_mode": mode}, "autoreset_mode.*NextStep.*SameStep.*Disabled") for mode in ("next-step", None, 1)),
    ({"render_mode": "human"}, r"render_mode = 'human': a vector environment cannot render; use gymnasium\.make"),
    ({"case": ["nominal", "nominal", "drilling"]}, "^environment 2: unknown case 'drilling'; choose from: nominal"),
    ({"case": ["nominal", "payload"]}, "case has 2 entries for 3 environments; give one, or one for each"),
    ({"disturbance": [NOISY, NOISY, 3]}, "^environment 2: disturbance = 3 must be a .*Disturbance"),
    ({"case": ["nominal", "payload", "nominal"], "disturbance": NOISY}, "^environment 1: give either case = 'pay"),
    ({"reference": [SHORT, Circle(), SHORT]}, "^environment 1: reference = Circle.* must be a .*[.]Ref"),
    ({"parameters": [TABLE_1, None, TABLE_1]}, "^environment 1: parameters = None must be a .*ArmParameters"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_ARGUMENTS)
def test_a_bad_argument_is_named_with_its_lane_and_what_is_allowed(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        FuzzyArmVectorEnv(**{"num_envs": 3, **arguments})


BAD_OPTIONS = [
    ({"reset_mask": None}, "reset_mask is NoneType; needed: a NumPy array of 3 booleans"),
    ({"reset_mask": np.array([1, 0, 0])}, "reset_mask is an array of int64; needed: a NumPy"),
    ({"reset_mask": np.ones(2, dtype=bool)}, r"reset_mask has shape \(2,\); needed: \(3,\)"),
    ({"reset_mask": np.zeros(3, dtype=bool)}, "reset_mask selects no environment; at least one"),
    ({"case": ["nominal", "drilling", "payload"]}, "^environment 1: unknown case 'drilling'; choose from: nominal"),
    ({"case": ["nominal"] * 4}, "case has 4 entries for 3 environments; give one, or one for each"),
    ({"reference": [SHORT, SHORT, None]}, "^environment 2: reference = None must be a .*[.]Reference"),
    ({"initial_state": np.tile(STILL, (2, 1))}, r"initial_state has shape \(2, 8\); allowed: \(8,\) or \(3, 8\)"),
    ({"initial_state": [STILL, STILL, 9 * STILL]}, r"^environment 2: initial_state = \[4\.5, .*8 finite.*3\.14.*15\.0"),
]
BAD_RESETS = [
    *(({"options": options}, message) for options, message in BAD_OPTIONS),
    ({"seed": True}, "seed = True must be a whole number"),
    ({"seed": range(4)}, "4 seeds were given for 3 environments; give one, or one for each"),
    ({"seed": [1, 2, -3]}, r"environment 2: seed = -3 is out of range; allowed: 0, 1, 2, \.\.\."),
]


@pytest.mark.parametrize(("given", "message"), BAD_RESETS)
def test_a_bad_reset_is_named_and_leaves_nothing_to_step_and_the_streams_where_they_were(given, message):
    envs, untouched, actions = batch(3, **RANDOM), batch(3, **RANDOM), torques(0, 5, 3)
    with pytest.raises(ResetNeeded, match=r"call envs\.reset\(\) before envs\.step\(\)"):
        envs.step(actions[0])
    for made in (envs, untouched):
        made.reset(seed=0)
    with pytest.raises((TypeError, ValueError), match=message):
        envs.reset(**given)
    with pytest.raises(ResetNeeded, match=r"call envs\.reset\(\) before envs\.step\(\)"):
        envs.step(actions[0])
    assert identical(played(envs, actions), played(untouched, actions))


@pytest.mark.parametrize(
    ("lanes", "bad", "threads", "value"),
    [(1, 0, 1, np.nan), (3, 2, 1, -np.inf), (2 * LANES_PER_THREAD, LANES_PER_THREAD + 1, 2, np.inf)],
)
def test_a_bad_action_is_named_with_its_lane_and_moves_none(lanes, bad, threads, value):
    envs, untouched = (batch(lanes, threads=threads, disturbance=NOISY) for _ in range(2))
    envs.reset(seed=0)
    untouched.reset(seed=0)
    good = torques(0, 3, lanes)
    wrong = good[0].copy()
    wrong[bad:, 1] = value
    given = rf"environment {bad}: action = \[{re.escape(str(wrong[bad, 0]))}, {value}\] N m is not finite"
    with pytest.raises(ValueError, match=given + r"; give finite torques \(clipped to ±\[500\.0, 250\.0\] N m"):
        envs.step(wrong)
    for shaped in (np.zeros(2), np.zeros((lanes + 1, 2)), None):
        with pytest.raises(ValueError, match=rf"actions have shape .*; needed: \({lanes}, 2\), motor torques \[N m\]"):
            envs.step(shaped)
    assert identical([envs.step(action) for action in good], [untouched.step(action) for action in good])


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


def arrays_of(value):
    if isinstance(value, np.ndarray):
        yield value
    if isinstance(value, dict | tuple) or (isinstance(value, np.ndarray) and value.dtype == object):
        for entry in value.values() if isinstance(value, dict) else value:
            yield from arrays_of(entry)


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
    for one, other in zip(kept, copies, strict=True):  # later steps did not touch them
        assert_identical(one, other)
    ended = next(result for result in kept if "final_obs" in result[-1])
    arrays = list({id(array): array for array in arrays_of(ended) if array.dtype == float}.values())
    assert written > 250 * 20 and len(arrays) > 50
    for place, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[:place])


def test_memory_of_results_that_nobody_holds_serves_again():
    twin, actions, copies, places = batch(40), torques(1, 12, 40), [], set()
    held = [result[0] for result in played(batch(40), actions, seed=0)[1:]]
    twin.reset(seed=0)
    for action in actions:
        observation = twin.step(action)[0]
        view = observation[2:].reshape(-1)  # keeps the memory as the array itself does
        del observation
        places.add(view.ctypes.data)
        copies.append(view.copy())
    assert np.array_equal([row[2:].reshape(-1) for row in held], copies)
    assert len({row.ctypes.data for row in held}) == len(held) and len(places) <= 3


class Push:
    """A force that its owner changes."""

    def at(self, time, tip_velocity):
        return np.full((len(time), 2), self.newtons)


def test_batches_share_tables_unless_something_in_them_can_change_and_a_lane_needs_less_than_a_thousand_bytes():
    force, observations = Push(), []
    for force.newtons in (0.0, 1e3):
        *_, last = played(batch(1, disturbance=Disturbance(tip_force=force)), np.zeros((1, 1, 2)), seed=0)
        observations.append(last[0])
    assert not identical(*observations)
    first, second, other = (batch(1, case=case).lanes.table for case in ("machining", "machining", "payload"))
    assert first is second is not other and not first.flags.writeable
    assert 400 < _memory_per_lane() < 1000  # 37 numbers of state and constants alone are 296


WILD = DomainRandomisation(
    **dict.fromkeys(("mass", "motor_inertia"), (0.01, 2.0)),
    **dict.fromkeys(("damping", "dry_friction", "viscous_friction", "force"), (0.0, 10.0)),
    stiffness=(0.01, 100.0),
    payload=(0.0, 100.0),
    angle=(-0.5, 0.5),
)


@pytest.mark.parametrize(
    ("lanes", "setting"),
    [
        (500, {"disturbance": Disturbance(encoder_noise=EncoderNoise(3.0, 100.0)), "randomisation": ROBUST}),
        pytest.param(32, {"case": "machining", "randomisation": WILD}, marks=pytest.mark.slow),
    ],
    ids=["noisy", "wild"],
)
def test_a_long_run_of_random_torques_stays_finite_and_within_the_spaces_or_ends_with_a_reason(lanes, setting):
    ends, moved, reasons = 0, np.zeros(lanes, dtype=bool), {reason.text for reason in Termination if reason}
    envs = batch(lanes, **setting)
    for observation, reward, terminated, truncated, info in played(envs, torques(3, 200, lanes, scale=1.5), seed=0)[1:]:
        assert observation in envs.observation_space and ((reward >= 0.0) & (reward <= 1.0)).all()
        assert all(np.isfinite(array).all() for array in arrays_of(info) if array.dtype == float)
        over = terminated | truncated
        ends, moved = ends + over.sum(), moved | ~over
        if terminated.any():
            assert set(info["final_info"]["reason"][terminated]) <= reasons
    assert moved.mean() > 0.2 and ends > lanes / 2
