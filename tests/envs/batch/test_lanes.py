"""Lanes of a batch against each lane alone, bit for bit: whatever the batch, threads, restarts and copies."""

import copy
import dataclasses
import json
import pickle
import subprocess
import sys

import numpy as np
import pytest
from support.results import identical

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import SCALARS, VECTORS
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle, Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.numbers.machine import WIDE

TABLE_1 = ArmParameters()
LIMIT = np.array(TABLE_1.torque_limit)
PERIOD, SUBSTEPS, STEPS, MOST = 1e-3, 5, 25, 100
FAMILY = tuple(JointReference(Line((0.4, 0.5), (0.45, 0.4 + 0.02 * k)), duration=0.1) for k in range(4))
ALL_VARY = DomainRandomisation(
    mass=(0.8, 1.2), dry_friction=(0.5, 1.5), payload=(0.0, 5.0), force=(0.0, 1.0), references=FAMILY
)
NOISY = Disturbance(
    tip_force=CASES["machining"].disturbance.tip_force, encoder_noise=EncoderNoise(position=1e-4, velocity=1e-2)
)
DISTURBANCES = (
    Disturbance(),
    NOISY,
    Disturbance(payload=Payload(3.0, at="link"), encoder_noise=EncoderNoise(velocity=0.1)),
    Disturbance(torque_bias=TorqueBias((5.0, -5.0), start=0.01)),
)
REASON = SCALARS.index("reason")


def plants():
    """Arms of one size and different weights, springs and limits; the third is far too stiff for the sub-step."""
    rng, arms = np.random.default_rng(0), []
    for number in range(MOST):
        fields = {
            name: tuple(x * rng.uniform(0.7, 1.4) for x in getattr(TABLE_1, name))
            for name in ("mass", "stiffness", "damping", "motor_inertia", "torque_limit")
        }
        if number == 2:
            fields["stiffness"] = (1e12, 1e12)
        arms.append(dataclasses.replace(TABLE_1, **fields))
    return arms


def scenarios():
    """Four disturbances by five references, or a drawn one."""
    references = (
        JointReference(),
        *(JointReference(Circle(radius=0.02 + 0.005 * k), duration=0.2) for k in range(4)),
        None,
    )
    return [(DISTURBANCES[k % 4], references[k % 6]) for k in range(MOST)]


def starts():
    """Every third lane on its reference, the others anywhere; a quarter of the motors at rest."""
    rng = np.random.default_rng(1)
    states = rng.uniform(-1.0, 1.0, (MOST, 8)) * [2, 2, 0, 0, 1, 1, 1, 1]
    states[:, 2:4] = states[:, :2] + 1e-3 * rng.uniform(-1.0, 1.0, (MOST, 2))
    states[::4, 4:6] = 0.0
    states[::3] = np.nan
    states[4, :4], states[4, 4:] = 3.14, 14.0  # leaves the box at once
    return states


ARMS, SCENARIOS, STARTS = plants(), scenarios(), starts()
TORQUES = np.random.default_rng(2).normal(size=(STEPS, MOST, 2)) * 0.4 * LIMIT


def lanes_of(which, randomisation=ALL_VARY):
    """These of the hundred lanes, their episodes not begun."""
    own, arms = [SCENARIOS[k] for k in which], [ARMS[k] for k in which]
    return Lanes(arms, own, len(which), control_period=PERIOD, substeps=SUBSTEPS, randomisation=randomisation)


def rollout(which, steps=STEPS):
    """Results by lane (steps + 1, lanes, 38): observation, vectors and scalars of the start and every step."""
    lanes = lanes_of(which)
    results = [lanes.reset([int(k) + 7 for k in which], initial=STARTS[which])]
    results += [lanes.step(np.ascontiguousarray(TORQUES[k, which])) for k in range(steps)]
    return np.array([by_lane(result) for result in results])


def by_lane(results):
    """Rows (lanes, 38) of results as they come."""
    observations, vectors, scalars = results
    return np.hstack([observations, vectors.T, scalars.T])


def started(count=8):
    """Lanes whose episodes have begun."""
    lanes = lanes_of(np.arange(count))
    lanes.reset(range(count))
    for torque in TORQUES[:5, :count]:
        lanes.step(torque.copy())
    return lanes


@pytest.fixture(scope="module")
def alone():
    """Each of the hundred lanes by itself."""
    return np.concatenate([rollout(np.array([k])) for k in range(MOST)], axis=1)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 100])
def test_each_lane_of_a_batch_is_the_lane_alone_bit_for_bit(count, alone):
    which = np.random.default_rng(3).permutation(MOST)[:count]
    assert np.array_equal(rollout(which), alone[:, which])


def test_the_lanes_compared_are_of_every_kind(alone):
    """Different arms, noise and references; lanes that stay, that leave by angle, and that blow up; all finite."""
    assert {0.0, 1.0, 3.0} <= set(alone[:, :, 28 + REASON].ravel().tolist()) and np.isfinite(alone).all()
    assert len(np.unique(alone[-1, :, :4], axis=0)) == MOST
    assert alone[1:, 1, 10 + 2 * VECTORS.index("external_force")].all()


def test_a_reset_with_a_reference_that_does_not_fit_changes_nothing():
    lanes, undisturbed = started(), started()
    longer = dataclasses.replace(TABLE_1, length=(0.6, 0.5))
    with pytest.raises(ValueError, match="links of"):
        lanes.reset(range(8), [(NOISY, JointReference(parameters=longer))])
    for torque in TORQUES[5:8, :8]:
        assert all(map(np.array_equal, lanes.step(torque.copy()), undisturbed.step(torque.copy())))
    narrow = dataclasses.replace(TABLE_1, joint_limit=(0.5, 3.0))
    given = [(NOISY, JointReference())], 2
    with pytest.raises(ValueError, match=r"reference angle reaches .*allows \(0\.5, 3\.0\) rad"):
        Lanes([TABLE_1, narrow], *given, control_period=PERIOD, substeps=5, randomisation=DomainRandomisation())


def test_lanes_with_the_same_scenario_share_its_table():
    one, other, drawn = (NOISY, JointReference()), (Disturbance(), FAMILY[0]), (NOISY, None)
    for own, rows in (([one], 1501), ([one] * 9, 1501), ([one, other, one] * 3, 1501 + 101), ([drawn] * 9, 4 * 101)):
        lanes = Lanes([TABLE_1], own, 9, control_period=PERIOD, substeps=SUBSTEPS, randomisation=ALL_VARY)
        lanes.reset(range(9))
        assert lanes._assigned.tables.table.shape == (rows, 19)
        for lane in range(9):
            wanted = own[lane % len(own)][1] or FAMILY[int(lanes.drawn[-1, lane])]
            assert lanes.schedule(lane)[0] is wanted


def continued(env, torques):
    """What the environment gives from here on, over the end of its episode."""
    results = []
    for torque in torques:
        results.append(env.step(torque))
        if results[-1][2] or results[-1][3]:
            results.append(env.reset())
    return results


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)
@pytest.mark.parametrize("options", [{}, {"reference": FAMILY[1]}, {"case": "payload"}])
def test_a_copy_in_the_middle_of_an_episode_goes_on_bit_for_bit(duplicate, options):
    env = FuzzyArmEnv(disturbance=NOISY, randomisation=ALL_VARY)
    env.reset(seed=1, options=options)
    for torque in TORQUES[:5, 0]:
        env.step(torque)
    twin = duplicate(env)
    assert twin.reference == env.reference
    torques = np.tile(0.2 * TORQUES[:, 1], (6, 1))
    assert identical(continued(env, torques), continued(twin, torques))


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
    made = FuzzyArmEnv(disturbance=NOISY), FuzzyArmVectorEnv(WIDE + 1, disturbance=NOISY)
    for env in made:
        env.reset(seed=0)
    done = subprocess.run([sys.executable, "-c", ELSEWHERE], input=pickle.dumps(made), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    given = [np.full(env.action_space.shape, torque) for env in made for torque in ([80.0, 20.0], [-1.25, 0.5])]
    expected = [made[k // 2].step(torque)[0].tolist() for k, torque in enumerate(given)]
    assert [json.loads(line) for line in done.stdout.splitlines()] == expected
