"""Lanes: a lane is the lane alone, bit for bit, tables are shared, and copies go on where the original was."""

import copy
import dataclasses
import functools
import json
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from support.randomisation import EVERYTHING, NOISY, ROBUST, SHORT
from support.results import identical

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
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
    before = together.reset(seed=100)[0]
    assert all(identical(env.reset(seed=100 + lane)[0][0], before[lane]) for lane, env in alone.items())
    for action in torques(40, lanes):
        observation, reward, terminated, _, info = together.step(action)
        blown += terminated[2] and info["final_info"]["reason"][2] == "the state is not finite"
        for lane, env in alone.items():
            one = env.step(action[lane : lane + 1])
            assert identical(one[0][0], observation[lane]) and one[1][0] == reward[lane]
    assert blown > 0


def made(arms, own, count):
    return Lanes(arms, own, count, control_period=1e-3, substeps=5, randomisation=EVERYTHING)


def test_a_reset_with_a_reference_that_does_not_fit_changes_nothing():
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


COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


@pytest.mark.parametrize("duplicate", COPIES.values(), ids=COPIES)
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


ELSEWHERE = """
import pickle, sys
import numpy as np
for env in pickle.loads(sys.stdin.buffer.read()):
    for torque in ([80.0, 20.0], [-1.25, 0.5]):
        print(env.step(np.full(env.action_space.shape, torque))[0].tolist())
"""


@pytest.mark.slow
def test_copies_go_on_in_another_process():
    """There the machine code is made, or read from disk."""
    envs = FuzzyArmEnv(disturbance=NOISY), FuzzyArmVectorEnv(WIDE + 1, disturbance=NOISY)
    for env in envs:
        env.reset(seed=0)
    done = subprocess.run([sys.executable, "-c", ELSEWHERE], input=pickle.dumps(envs), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    given = [np.full(env.action_space.shape, torque) for env in envs for torque in ([80.0, 20.0], [-1.25, 0.5])]
    expected = [envs[k // 2].step(torque)[0].tolist() for k, torque in enumerate(given)]
    assert [json.loads(line) for line in done.stdout.splitlines()] == expected
