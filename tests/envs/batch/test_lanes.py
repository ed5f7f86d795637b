"""Lanes: a lane is the lane alone, tables are shared, copies and states go on bit for bit or are refused as a whole."""

import copy
import dataclasses
import functools
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
from support.randomisation import EVERYTHING, NOISY, ROBUST, SHORT
from support.results import identical
from support.two_joints import LAYOUT

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import CLOCK
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import columns
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.numbers.machine import WIDE

TABLE_1 = ArmParameters()


def torques(steps, *shape):
    return np.random.default_rng(2).normal(size=(steps, *shape, 2)) * 0.4 * TABLE_1.torque_limit


def test_a_lane_is_the_lane_alone_also_beside_one_that_blows_up(monkeypatch):
    monkeypatch.setattr("fuzzyarm.envs.vector.fastest_rate", lambda arms, drawn: 0.0)
    lanes = 2 * WIDE + 3
    arms = [TABLE_1] * lanes
    arms[2] = dataclasses.replace(TABLE_1, stiffness=(1e12, 1e12))  # far too stiff for the sub-step
    setting = {"disturbance": NOISY, "randomisation": ROBUST}
    together, blown = gym.make_vec("FuzzyArm-v0", num_envs=lanes, parameters=arms, **setting), 0
    shown = (0, 1, 2, WIDE - 1, WIDE, lanes - 1)
    alone = {k: gym.make_vec("FuzzyArm-v0", num_envs=1, parameters=arms[k], **setting) for k in shown}
    before, _ = together.reset(seed=100)
    assert all(identical(env.reset(seed=100 + lane)[0][0], before[lane]) for lane, env in alone.items())
    for action in torques(40, lanes):
        observation, reward, terminated, _, info = together.step(action)
        blown += terminated[2] and info["final_info"]["reason"][2] == "the state is not finite"
        for lane, env in alone.items():
            one = env.step(action[lane : lane + 1])
            assert identical(one[0][0], observation[lane]) and one[1][0] == reward[lane]
    assert blown > 0


def test_a_reset_with_a_reference_that_does_not_fit_changes_nothing():
    made = functools.partial(Lanes, control_period=1e-3, substeps=5, randomisation=EVERYTHING)
    lanes, undisturbed = (made([TABLE_1], [(NOISY, None)], 8) for _ in range(2))
    longer, narrow = dataclasses.replace(TABLE_1, length=(0.6, 0.5)), dataclasses.replace(TABLE_1, joint_limit=(0.5, 3))
    for one in (lanes, undisturbed):
        one.reset(range(8))
    with pytest.raises(ValueError, match="links of"):
        lanes.reset(range(8), [(NOISY, JointReference(parameters=longer))])
    for torque in torques(3, 8):
        assert all(map(np.array_equal, lanes.step(torque.copy()), undisturbed.step(torque.copy())))
    with pytest.raises(ValueError, match=r"the joint angle of the reference reaches .*allows \(0\.5, 3\.0\) rad"):
        made([TABLE_1, narrow], [(NOISY, JointReference())], 2)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("options", [{"reference": SHORT[1]}, {"case": "payload"}])
@pytest.mark.parametrize("lanes", [(), (2 * WIDE,)], ids=["one", "batch"])
def test_a_copy_in_the_middle_of_an_episode_goes_on_bit_for_bit(lanes, options, duplicate):
    made = functools.partial(FuzzyArmVectorEnv, *lanes, threads=2) if lanes else FuzzyArmEnv
    env, ends = made(disturbance=NOISY, randomisation=EVERYTHING), 0
    env.reset(seed=1, options=options)
    for torque in torques(5, *lanes):
        env.step(torque)
    twin = duplicate(env)
    for torque in 0.2 * torques(320, *lanes):
        results = env.step(torque)
        assert identical(twin.step(torque), results)
        if not lanes and (results[2] or results[3]):
            assert twin.reference == env.reference and identical(twin.reset(), env.reset())
        ends += np.sum(results[2] | results[3])
    assert ends > 0 and identical(twin.reset(), env.reset())
    assert not lanes or not twin.reset()[1]["_tip"].flags.writeable  # the mask that all keys share


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [(), (WIDE + 1,)], ids=["one", "batch"])
def test_copies_go_on_in_another_process(lanes):
    """There the machine code is made, or read from disk."""
    env = (FuzzyArmVectorEnv if lanes else FuzzyArmEnv)(*lanes, disturbance=NOISY)
    env.reset(seed=0)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as elsewhere:
        for torque in torques(2, *lanes):
            assert identical(elsewhere.submit(env.step, torque).result(), env.step(torque))


LANES = 3


@pytest.fixture
def envs():
    envs = FuzzyArmVectorEnv(LANES, randomisation=ROBUST)
    envs.reset(seed=5)
    for _ in range(20):
        envs.step(np.full((LANES, 2), 30.0))
    return envs


def changed(name, place, value):
    return lambda state: state[name].__setitem__(place, value)


BAD = [
    (changed("clock", (CLOCK.row, 1), 10**12), r"environment 1 is at row 1000000000000 of"),
    (changed("clock", (CLOCK.row, 0), -1), "environment 0 is at row -1 of"),
    (lambda state: state["clock"].__setitem__(CLOCK.row, state["clock"][CLOCK.last]), "at row [0-9]+ of"),
    (changed("clock", (CLOCK.first, 0), 1), "environment 0 is at row"),
    (changed("clock", (CLOCK.last, 2), 10**9), "environment 2 is at row"),
    (changed("clock", (CLOCK.key, 0), 7), "state"),
    (changed("drawn", (0, 0), 0.5), "does not match the random keys"),
    (changed("drawn", (-1, 0), 1e12), "does not match the random keys"),
    (changed("drawn", (-1, 0), np.nan), "not finite"),
    (changed("values", (0, 0), np.nan), "not finite"),
    (changed("values", (12, 0), 1.0), "does not match the random keys"),
    (lambda state: state.update(values=state["values"][:, :1]), "must be an array of float64"),
    (lambda state: state.update(clock=state["clock"].astype(float)), "must be an array of int64"),
    (lambda state: state.update(values=state["values"].astype(">f8")), "must be an array of float64"),
    (lambda state: state.update(drawn=state["drawn"].tolist()), "must be an array of float64"),
    (lambda state: state.pop("clock"), r"state\['clock'\] is None"),
    (lambda state: state.pop("made_of"), "other plants"),
    (lambda state: state.update(made_of=np.zeros(32, dtype=np.uint8)), "other plants"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_a_bad_state_is_refused_and_changes_nothing(envs, change, message):
    before, state = envs.get_state(), envs.get_state()
    change(state)
    with pytest.raises(ValueError, match=message):
        envs.set_state(state)
    with pytest.raises(TypeError, match="state = "):
        envs.set_state([state])
    assert identical(envs.get_state(), before)
    action = np.full((LANES, 2), -20.0)
    expected = envs.step(action)[0]
    envs.set_state(before)
    assert np.array_equal(envs.step(action)[0], expected)


def test_random_changes_are_refused_or_harmless(envs):
    tries, generator = 100, np.random.default_rng(0)
    good, own_state, refused = envs.get_state(), columns(LAYOUT.Lane).state, 0
    for _ in range(tries):
        state = {name: array.copy() for name, array in good.items()}
        name = generator.choice(["values", "clock", "drawn"])
        flat = state[name].reshape(-1).view(np.uint8)
        for place in generator.integers(0, len(flat), generator.integers(1, 4)):
            flat[place] ^= np.uint8(1 << generator.integers(8))
        try:
            envs.set_state(state)
        except ValueError:
            refused += 1
            continue
        same = [np.array_equal(state[key], good[key]) for key in ("clock", "drawn")]
        assert np.array_equal(state["values"][own_state.stop :], good["values"][own_state.stop :])
        assert all(same) or np.array_equal(state["clock"][CLOCK.first], good["clock"][CLOCK.first])
        for _ in range(3):
            envs.step(np.zeros((LANES, 2)))
    assert refused > tries / 2
