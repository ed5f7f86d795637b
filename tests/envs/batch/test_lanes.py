"""Lanes of a batch against each lane alone, bit for bit: whatever the batch, threads, restarts and copies."""

import copy
import dataclasses
import json
import pickle
import subprocess
import sys

import numpy as np
import pytest

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import SCALARS, VECTORS
from fuzzyarm.envs.batch.tables import distinct
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle, Line
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import Termination

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


def lanes_of(which, threads=1, randomisation=ALL_VARY):
    """These of the hundred lanes, their episodes not begun."""
    own = [SCENARIOS[k] for k in which]
    arms = [ARMS[k] for k in which]
    return Lanes(
        arms, own, len(which), control_period=PERIOD, substeps=SUBSTEPS, randomisation=randomisation, threads=threads
    )


def rollout(which, threads=1, steps=STEPS):
    """Results by lane (steps + 1, lanes, 38): observation, vectors and scalars of the start and every step."""
    lanes = lanes_of(which, threads)
    results = [lanes.reset([int(k) + 7 for k in which], initial=STARTS[which])]
    results += [lanes.step(np.ascontiguousarray(TORQUES[k, which])) for k in range(steps)]
    lanes.close()
    return np.array([by_lane(result) for result in results])


def by_lane(results):
    """Rows (lanes, 38) of results as they come."""
    observations, vectors, scalars = results
    return np.hstack([observations, vectors.T, scalars.T])


def started(count=8, **options):
    """Lanes whose episodes have begun."""
    lanes = lanes_of(np.arange(count), **options)
    lanes.reset(range(count))
    for torque in TORQUES[:5, :count]:
        lanes.step(torque.copy())
    return lanes


@pytest.fixture(scope="module")
def alone():
    """Each of the hundred lanes by itself."""
    return np.concatenate([rollout(np.array([k])) for k in range(MOST)], axis=1)


# --- lanes of a batch --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", [1, 31, 32, 33, 100])
def test_each_lane_of_a_batch_is_the_lane_alone_bit_for_bit(count, threads, alone):
    assert np.array_equal(rollout(np.arange(count), threads), alone[:, :count])


def test_a_lanes_neighbours_and_place_do_not_matter(alone):
    which = np.random.default_rng(3).permutation(MOST)[:70]
    assert np.array_equal(rollout(which, threads=2), alone[:, which])


def test_the_lanes_compared_are_of_every_kind(alone):
    """Different arms, noise and references; lanes that stay, that leave by angle, and that blow up; all finite."""
    reasons = np.unique(alone[:, :, 28 + REASON])
    assert {0.0, 1.0, 3.0} <= set(reasons.tolist()) and np.isfinite(alone).all()
    assert len(np.unique(alone[-1, :, :4], axis=0)) == MOST
    assert alone[1:, :, 28 + SCALARS.index("torque_clipped")].any()
    assert alone[1:, 1, 10 + 2 * VECTORS.index("external_force")].all()


def single(lane):
    """Rows of the lane's episode in the single environment, to its end."""
    disturbance, reference = SCENARIOS[lane]
    env = FuzzyArmEnv(disturbance=disturbance, parameters=ARMS[lane], control_period=PERIOD, randomisation=ALL_VARY)
    options = {} if np.isnan(STARTS[lane, 0]) else {"initial_state": STARTS[lane]}
    if reference is not None:
        options["reference"] = reference
    observation, info = env.reset(seed=lane + 7, options=options)
    rows, (reward, terminated, truncated) = [], (info["reward_tracking"], not info["in_domain"], False)
    for torque in [*TORQUES[:, lane], None]:
        reason = next(reason for reason in Termination if reason.text == info.get("reason", ""))
        vectors = [info[name] for name in VECTORS]
        scalars = [info[name] for name in SCALARS[:6]] + [reward, info["torque_clipped"], truncated, reason]
        rows.append(np.concatenate([observation, *vectors, scalars]))
        if torque is None or terminated or truncated:
            return np.array(rows)
        observation, reward, terminated, truncated, info = env.step(torque)
    raise AssertionError


@pytest.mark.parametrize("lane", range(36))
def test_the_single_environment_is_the_lane_bit_for_bit(lane, alone, monkeypatch):
    monkeypatch.setattr("fuzzyarm.envs.fuzzy_arm.fastest_rate", lambda arms, drawn: 0.0)  # lanes that blow up, too
    rows = single(lane)
    assert np.array_equal(rows, alone[: len(rows), lane])
    assert len(rows) == STEPS + 1 or rows[-1, -1] > 0.0


@pytest.fixture(scope="module", params=[1, 3])
def unmoved(request):
    """All lanes at the starts of their episodes; tests do not move them."""
    lanes = lanes_of(np.arange(MOST), request.param)
    lanes.reset(range(MOST))
    yield lanes
    lanes.close()


@pytest.mark.parametrize("lane", [0, 40, 99])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_one_torque_that_is_not_finite_moves_no_lane_and_names_its_own(unmoved, lane, value):
    lanes = unmoved
    values, clock = lanes.numbers(slice(None)), lanes.clock.copy()
    torque = TORQUES[0].copy()
    torque[lane] = (1.5, value)
    with pytest.raises(ValueError, match=rf"action \[1\.5, {value}\] N m of lane {lane} is not finite"):
        lanes.step(torque)
    assert np.array_equal(lanes.numbers(slice(None)), values) and np.array_equal(lanes.clock, clock)


def test_the_first_of_several_bad_lanes_is_named():
    lanes, torque = started(), TORQUES[0, :8].copy()
    torque[[3, 5], [1, 0]] = np.nan
    with pytest.raises(ValueError, match="of lane 3 is not finite"):
        lanes.step(torque)


def test_steps_after_the_threads_have_ended_begin_new_ones():
    lanes, other = (lanes_of(np.arange(MOST), threads) for threads in (3, 1))
    for one in (lanes, other):
        one.reset(range(MOST), initial=STARTS)
    for torque in TORQUES[:3]:
        assert all(map(np.array_equal, lanes.step(torque), other.step(torque)))
        lanes.close()


# --- restarts ----------------------------------------------------------------------------------------------------


def test_a_restart_of_some_lanes_leaves_the_others_alone():
    lanes, undisturbed = started(40), started(40)
    which = np.array([0, 3, 4, 31, 32, 39])
    others = np.setdiff1d(np.arange(40), which)
    lanes.restart(which)
    numbers, expected = (one.numbers(slice(None)) for one in (lanes, undisturbed))
    assert np.array_equal(numbers[:, others], expected[:, others])
    assert np.array_equal(lanes.clock[:, others], undisturbed.clock[:, others])
    assert np.array_equal(lanes.drawn[:, others], undisturbed.drawn[:, others])
    assert not np.any(np.all(numbers[:8, which] == expected[:8, which], axis=0))
    for torque in TORQUES[5:10, :40]:
        rows, expected = by_lane(lanes.step(torque.copy())), by_lane(undisturbed.step(torque.copy()))
        assert np.array_equal(rows[others], expected[others])


def test_a_restarted_lane_is_the_lane_alone_in_its_second_episode():
    lanes, which = started(40), np.array([5, 33])
    rows = [by_lane(lanes.restart(which))]
    rows += [by_lane(lanes.step(torque.copy()))[which] for torque in TORQUES[5:10, :40]]
    for place, lane in enumerate(which):
        single = lanes_of([lane])
        single.reset([int(lane)])
        expected = [by_lane(single.reset())]
        expected += [by_lane(single.step(torque[[lane]])) for torque in TORQUES[5:10]]
        assert np.array_equal(np.array(rows)[:, place], np.array(expected)[:, 0])


def test_each_lane_draws_by_its_own_count_of_episodes():
    """A lane's n-th episode after its seed is the same however often other lanes are reset."""
    busy, calm = started(4), started(4)
    for _ in range(3):
        busy.restart(np.array([0, 2]))
    for lanes in (busy, calm):
        lanes.restart(np.array([1]))
    assert np.array_equal(busy.drawn[:, 1], calm.drawn[:, 1])
    assert not np.array_equal(busy.drawn[:, 0], calm.drawn[:, 0])


def test_seeds_are_per_lane_and_none_lets_a_stream_go_on():
    lanes, first = lanes_of([1, 1, 1]), []
    first = by_lane(lanes.reset([5, 5, 6]))
    assert np.array_equal(first[0], first[1]) and not np.array_equal(first[1], first[2])
    second = by_lane(lanes.reset([5, None, None]))
    assert np.array_equal(second[0], first[0]) and not np.array_equal(second[1], first[1])
    third = by_lane(lanes.reset())
    assert np.array_equal(third[0], second[1])  # both the second episode since the seed 5


def test_lanes_nobody_seeded_differ():
    lanes = lanes_of([1] * 20)
    drawn = [by_lane(lanes.reset()), by_lane(lanes_of([1] * 20).reset())]
    assert len(np.unique(np.concatenate(drawn)[:, :4], axis=0)) == 40


@pytest.mark.parametrize("steps", [1, 5])
def test_scenarios_of_a_reset_hold_for_its_episodes_only(steps):
    lanes, plain = (lanes_of(np.arange(8)) for _ in range(2))
    own = plain.reset(range(8))
    other = [(Disturbance(payload=Payload(1.0)), JointReference(Circle(radius=0.05)))]
    lanes.reset(range(50, 58), other)
    assert all(lanes.schedule(k)[0] is other[0][1] for k in range(8))
    for torque in TORQUES[:steps, :8]:
        lanes.step(torque.copy())
    lanes.restart(np.array([2]))  # a lane that was reset automatically is back at its own scenario, the others are not
    assert lanes.schedule(2)[0] is plain.schedule(2)[0]
    assert all(lanes.schedule(k)[0] is other[0][1] for k in range(8) if k != 2)
    assert all(map(np.array_equal, lanes.reset(range(8)), own))


def test_a_reset_with_a_reference_that_does_not_fit_changes_nothing():
    lanes, undisturbed = started(), started()
    longer = dataclasses.replace(TABLE_1, length=(0.6, 0.5))
    with pytest.raises(ValueError, match="links of"):
        lanes.reset(range(8), [(NOISY, JointReference(parameters=longer))])
    for torque in TORQUES[5:8, :8]:
        assert all(map(np.array_equal, lanes.step(torque.copy()), undisturbed.step(torque.copy())))


# --- tables ------------------------------------------------------------------------------------------------------


def test_lanes_with_the_same_scenario_share_its_table():
    one, other = (NOISY, JointReference()), (Disturbance(), FAMILY[0])
    for own, rows in (([one], 1501), ([one] * 9, 1501), ([one, other, one] * 3, 1501 + 101)):
        lanes = Lanes(
            [TABLE_1],
            own,
            9,
            control_period=PERIOD,
            substeps=SUBSTEPS,
            randomisation=DomainRandomisation(mass=(0.9, 1.1)),
        )
        assert lanes._assigned.tables.table.shape == (rows, 19)
        assert [lanes.schedule(k)[0] for k in range(9)] == [own[k % len(own)][1] for k in range(9)]


def test_a_family_is_tabulated_once_per_disturbance():
    own = [(DISTURBANCES[k % 2], None) for k in range(20)]
    lanes = Lanes([TABLE_1], own, 20, control_period=PERIOD, substeps=SUBSTEPS, randomisation=ALL_VARY)
    assert lanes._assigned.tables.table.shape == (2 * 4 * 101, 19)
    lanes.reset(range(20))
    for lane in range(20):
        reference, episode = lanes.schedule(lane)
        assert reference is FAMILY[int(lanes.drawn[-1, lane])] and episode.disturbance is DISTURBANCES[lane % 2]


def test_distinct_items_are_told_apart_by_identity():
    same, equal = JointReference(), JointReference()
    kinds, place_of = distinct([same, equal, same, same], 4)
    assert kinds[0] is same and kinds[1] is equal and place_of.tolist() == [0, 1, 0, 0]
    kinds, place_of = distinct([same], 3)
    assert kinds == [same] and place_of.tolist() == [0, 0, 0]


def test_every_plant_of_a_shared_scenario_must_fit_it():
    narrow = dataclasses.replace(TABLE_1, joint_limit=(0.5, 3.0))
    for arms in ([TABLE_1, narrow], [narrow, TABLE_1]):
        with pytest.raises(ValueError, match=r"reference angle reaches .*allows \(0\.5, 3\.0\) rad"):
            Lanes(
                arms,
                [(NOISY, JointReference())],
                2,
                control_period=PERIOD,
                substeps=SUBSTEPS,
                randomisation=DomainRandomisation(),
            )


# --- the single environment --------------------------------------------------------------------------------------


def continued(env, torques):
    """What the environment gives from here on, over the end of its episode."""
    results = []
    for torque in torques:
        observation, reward, terminated, truncated, info = env.step(torque)
        signals = [info[name] for name in VECTORS] + list(info.get("randomisation", {}).values())
        results.append((observation, np.array([reward, terminated, truncated]), *signals))
        if terminated or truncated:
            results.append((env.reset()[0],))
    return results


@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)
@pytest.mark.parametrize("randomisation", ["nominal", ALL_VARY])
@pytest.mark.parametrize("options", [{}, {"reference": FAMILY[1]}, {"case": "payload"}])
def test_a_copy_in_the_middle_of_an_episode_goes_on_bit_for_bit(duplicate, randomisation, options):
    env = FuzzyArmEnv(disturbance=NOISY, randomisation=randomisation)
    env.reset(seed=1, options=options)
    for torque in TORQUES[:5, 0]:
        env.step(torque)
    twin = duplicate(env)
    assert twin.reference == env.reference
    torques = np.tile(0.2 * TORQUES[:, 1], (6, 1))
    first, second = continued(env, torques), continued(twin, torques)
    assert [len(a) for a in first] == [len(b) for b in second]
    assert all(np.array_equal(x, y) for a, b in zip(first, second, strict=True) for x, y in zip(a, b, strict=True))


ELSEWHERE = """
import pickle, sys
import numpy as np
env = pickle.loads(sys.stdin.buffer.read())
for action in (np.array([80, 20]), np.array([80.5, 20.0], np.float32), np.array([-1.25, 0.5])):
    print(env.step(action)[0].tolist(), file=sys.stderr)
"""


@pytest.mark.slow
def test_a_copy_goes_on_in_another_process_whatever_its_first_action():
    """There the machine code is made, or read from disk."""
    env = FuzzyArmEnv(disturbance=NOISY)
    env.reset(seed=0)
    done = subprocess.run([sys.executable, "-c", ELSEWHERE], input=pickle.dumps(env), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    expected = [env.step(np.array(torque))[0].tolist() for torque in ([80.0, 20.0], [80.5, 20.0], [-1.25, 0.5])]
    assert [json.loads(line) for line in done.stderr.splitlines()] == expected


def test_a_copy_and_its_original_do_not_touch_each_other():
    env = FuzzyArmEnv(disturbance=NOISY)
    env.reset(seed=0)
    twin, expected = copy.deepcopy(env), copy.deepcopy(env)
    continued(env, TORQUES[:10, 0])
    env.reset(options={"case": "payload"})
    for first, second in zip(continued(twin, TORQUES[:5, 1]), continued(expected, TORQUES[:5, 1]), strict=True):
        assert all(map(np.array_equal, first, second))


def test_copies_of_a_batch_with_threads_go_on_bit_for_bit():
    lanes = started(MOST, threads=3)
    twin, copied = pickle.loads(pickle.dumps(lanes)), copy.deepcopy(lanes)
    for torque in TORQUES[5:8]:
        expected = lanes.step(torque.copy())
        assert all(map(np.array_equal, twin.step(torque.copy()), expected))
        assert all(map(np.array_equal, copied.step(torque.copy()), expected))
    for one in (lanes, twin, copied):
        one.close()


def read_only(torque):
    array = np.array(torque)
    array.flags.writeable = False
    return array


KINDS = {
    "list": list,
    "tuple": tuple,
    "single precision": lambda torque: np.array(torque, np.float32),
    "half precision": lambda torque: np.array(torque, np.float16),
    "integers": lambda torque: np.array(torque, np.int8),
    "big-endian": lambda torque: np.array(torque, ">f8"),
    "read-only": read_only,
    "every other": lambda torque: np.repeat(torque, 2)[::2],
    "backwards": lambda torque: np.array(torque[::-1])[::-1],
    "column of a table": lambda torque: np.array([torque, torque]).T[:, 0],
    "misaligned": lambda torque: np.frombuffer(b"x" + np.array(torque).tobytes(), dtype=np.float64, offset=1),
    "broadcast": lambda torque: np.broadcast_to(np.array(torque), (3, 2))[1],
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_action_is_a_torque(kind):
    torque = [80.0, 20.0]  # exact in every kind
    env, plain = FuzzyArmEnv(), FuzzyArmEnv()
    for one in (env, plain):
        one.reset()
    for _ in range(3):
        observation, reward, *_, info = env.step(KINDS[kind](torque))
        expected, true_reward, *_, true = plain.step(np.array(torque))
        assert np.array_equal(observation, expected) and reward == true_reward
        assert np.array_equal(info["torque"], true["torque"]) and info["torque"].tolist() == torque


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_every_kind_of_period_is_a_period(kind):
    period = 2.0**-9  # exact in either
    env, plain = FuzzyArmEnv(control_period=kind(period)), FuzzyArmEnv(control_period=period)
    for one in (env, plain):
        one.reset()
    for torque in TORQUES[:3, 0]:
        assert np.array_equal(env.step(torque)[0], plain.step(torque)[0])
