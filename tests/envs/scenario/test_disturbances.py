"""Each disturbance reaches the channel it names, at its size, onset and seed, and no other."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from support.two_joints import advance

from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES, find_case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise, MachiningForce, TorqueBias
from fuzzyarm.envs.scenario.paths import Circle, Line
from fuzzyarm.envs.scenario.reference import JointReference

STEPS, ONSET, END = 60, 20, 40  # control steps of 1 ms; a part acts from step ONSET up to, not including, step END
WINDOW = {"start": ONSET * 1e-3, "stop": END * 1e-3}
ACTING = np.arange(STEPS)[:, None] // ONSET == 1
TORQUES = np.array([110.0, 30.0]) + np.random.default_rng(0).normal(scale=20.0, size=(STEPS, 2))
NO_FORCES = np.zeros((STEPS, 2))
FORCE, BIAS, NOISE = (80.0, -120.0), (7.0, -4.0), EncoderNoise(position=2e-4, velocity=3e-2)
PARTS = {
    "tip_force": ConstantForce(FORCE, **WINDOW),
    "payload": Payload(3.0),
    "torque_bias": TorqueBias(BIAS, **WINDOW),
    "encoder_noise": NOISE,
}


def run(disturbance, seed=0):
    """Observations, states and signals of torques played open-loop: no effect returns through a controller."""
    env = FuzzyArmEnv(disturbance=disturbance)
    results = [env.reset(seed=seed), *(env.step(torque) for torque in TORQUES)]
    signal = {name: np.array([result[-1][name] for result in results]) for name in results[0][-1]}
    states = np.hstack([signal[name] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
    return SimpleNamespace(observations=np.array([result[0] for result in results]), states=states, signal=signal)


def plant(start, torques, forces=NO_FORCES, payload=None):
    states = [start]
    for torque, force in zip(torques, forces, strict=True):
        states.append(advance(states[-1], torque, 2e-4, 5, force, payload=payload))
    return np.array(states)


def sampled(disturbance, reference=None):
    return Schedule.build(reference or JointReference(), disturbance, 1e-3)


def encoder_noise(disturbance, steps, seed):
    """What is read (steps + 1, 4) of motors that dry friction keeps exactly at zero: the noise alone."""
    clamped = dataclasses.replace(ArmParameters(), static_friction=(1e6, 1e6), coulomb_friction=(1e6, 1e6))
    env = FuzzyArmEnv(disturbance=disturbance, parameters=clamped)
    results = [env.reset(seed=seed, options={"initial_state": np.zeros(8)})]
    results += [env.step((0.0, 0.0)) for _ in range(steps)]
    assert not any(result[-1][name].any() for result in results for name in ("q_motor", "dq_motor"))
    return np.array([result[0][:4] for result in results])


@pytest.fixture(scope="module")
def undisturbed():
    return run(Disturbance())


def test_tip_force_acts_on_the_plant_from_its_onset_to_its_end_at_its_size(undisturbed):
    assert np.array_equal(undisturbed.states, plant(undisturbed.states[0], TORQUES))
    assert not undisturbed.signal["external_force"].any()
    disturbed = run(Disturbance(tip_force=PARTS["tip_force"]))
    forces = ACTING * np.array(FORCE)
    assert np.array_equal(disturbed.signal["external_force"][1:], forces)
    assert np.array_equal(disturbed.states, plant(undisturbed.states[0], TORQUES, forces))
    assert np.array_equal(disturbed.signal["torque"][1:], TORQUES)
    assert (disturbed.states[ONSET + 1] != undisturbed.states[ONSET + 1]).all()


def test_loads_of_the_wrong_shape_never_reach_the_kernel():
    one_column = SimpleNamespace(at=lambda time, tip_velocity: np.ones((len(time), 1)))
    with pytest.raises(ValueError, match=r"tip_force\.at returned an array of shape \(12000, 1\).*\(12000, 2\)"):
        sampled(Disturbance(tip_force=one_column))
    with pytest.raises(ValueError, match=r"TorqueBias\.torque has 3 numbers; needed: 2, one for each joint"):
        sampled(Disturbance(torque_bias=TorqueBias((1.0, 2.0, 3.0))))
    with pytest.raises(ValueError, match=r"payload = 3\.0 must have an attribute mass and a method radius"):
        Disturbance(payload=3.0)


def test_machining_force_opposes_the_travel_with_a_half_sine_of_138_to_218_newton_and_fades_out_towards_rest():
    middles, reference = (np.arange(1500) + 0.5) * 1e-3, JointReference()
    velocity, lines = reference.tip(middles).velocity, sampled(CASES["machining"].disturbance, reference).forces
    speed, size = np.linalg.norm(velocity, axis=-1), np.linalg.norm(lines[:, :2], axis=-1)
    steady = speed >= 0.011  # past the step in which the fade ends
    assert steady.mean() > 0.9 and 217.99 < size.max() <= 218.0
    np.testing.assert_allclose(np.sum(lines[:, :2] * velocity, axis=-1)[steady], -(size * speed)[steady], rtol=1e-5)
    np.testing.assert_allclose(size[steady], 138.0 + 80.0 * np.sin(np.pi * middles[steady] / 1.5), rtol=1e-5)
    disturbed = run(CASES["machining"].disturbance)
    assert np.array_equal(disturbed.signal["external_force"][1:], lines[:STEPS, :2])
    assert np.array_equal(disturbed.states, plant(disturbed.states[0], TORQUES, lines[:STEPS]))
    speeds, force = np.linspace(0.0, 0.02, 201), MachiningForce()  # which fades out towards rest without a jump
    size = np.linalg.norm(force.at(np.zeros(201), speeds[:, None] * [0.6, 0.8]), axis=-1)
    np.testing.assert_allclose(size, 138.0 * np.minimum(speeds / 0.01, 1.0), atol=1e-9)
    assert not force.at(np.array([0.0, 0.75, 9.0]), np.zeros((3, 2))).any()


def test_force_lines_keep_the_impulse_and_the_trend_of_a_smooth_force():
    """Mean and change over each step against the exact integral of a quadratic, and its least-squares slope."""
    quadratic = SimpleNamespace(at=lambda time, _: np.stack([3.0 + 5e3 * time + 7e5 * time**2, 0.0 * time], axis=-1))
    lines = sampled(Disturbance(tip_force=quadratic)).forces
    begin, end = 1e-3 * np.arange(1500), 1e-3 * np.arange(1, 1501)
    mean = 3.0 + 2.5e3 * (begin + end) + 7e5 * (end**3 - begin**3) / 3e-3
    np.testing.assert_allclose(lines[:, 0], mean, rtol=1e-3, atol=0.01)
    np.testing.assert_allclose(lines[:, 2], (5e3 + 7e5 * (begin + end)) * 1e-3, rtol=1e-9)
    assert not lines[:, [1, 3]].any()


# A payload that this package does not know, with a mass and a radius: in the middle of link 2, where its center is.
HALF_WAY = SimpleNamespace(mass=5.0, radius=lambda parameters: 0.5 * parameters.length[1])


@pytest.mark.parametrize("payload", [Payload(5.0), Payload(5.0, at="link"), HALF_WAY], ids=["tip", "link", "own"])
def test_payload_changes_the_constants_of_the_plant_alone(undisturbed, payload):
    loaded = run(Disturbance(payload=payload))
    assert np.array_equal(loaded.states[0], undisturbed.states[0])  # the motors do not know the payload
    known = Payload(5.0, at="link") if payload is HALF_WAY else payload
    assert np.array_equal(loaded.states, plant(undisturbed.states[0], TORQUES, payload=known))
    assert not np.array_equal(loaded.states[1], undisturbed.states[1])
    assert not loaded.signal["external_force"].any()


def test_encoder_noise_has_the_set_deviation_and_is_white():
    white = encoder_noise(Disturbance(encoder_noise=NOISE), 1500, seed=1) / np.repeat(
        [NOISE.position, NOISE.velocity], 2
    )
    n = 1501
    assert white.shape == (n, 4)
    # Each bound is five standard deviations: of a chi-square with n degrees, of a mean, of a correlation.
    assert (np.abs(np.sum(white**2, axis=0) - n) < 5.0 * math.sqrt(2.0 * n)).all()
    assert (np.abs(white.mean(axis=0)) < 5.0 / math.sqrt(n)).all()
    between = white.T @ white / n
    assert (np.abs(between - np.diag(np.diag(between))) < 5.0 / math.sqrt(n)).all()
    assert (np.abs(white[1:].T @ white[:-1] / n) < 5.0 / math.sqrt(n)).all()


def test_all_parts_together_are_each_part_in_its_channel(undisturbed):
    everything = run(Disturbance(**PARTS), seed=3)
    noisy = run(Disturbance(encoder_noise=NOISE), seed=3)
    noise = noisy.observations - undisturbed.observations
    biased, forces = TORQUES + ACTING * np.array(BIAS), ACTING * np.array(FORCE)
    assert np.array_equal(everything.states, plant(undisturbed.states[0], biased, forces, PARTS["payload"]))
    for name in ("torque", "reward_effort"):  # the bias is beside what the motors are asked for
        assert np.array_equal(everything.signal[name], undisturbed.signal[name])
    assert np.array_equal(noisy.states, undisturbed.states) and noise[:, :4].all() and not noise[:, 4:].any()
    readings = everything.states[:, [0, 1, 4, 5]] + noise[:, :4]
    np.testing.assert_allclose(everything.observations[:, :4], readings, rtol=0.0, atol=1e-14)
    assert np.array_equal(everything.signal["external_force"][1:], forces)


def test_no_part_shifts_the_noise_of_the_same_seed_and_each_deviation_is_of_its_reading():
    alone = encoder_noise(Disturbance(encoder_noise=NOISE), STEPS, seed=3)
    assert np.array_equal(encoder_noise(Disturbance(**PARTS), STEPS, seed=3), alone)
    for own, readings in ((EncoderNoise(position=2e-4), [1, 1, 0, 0]), (EncoderNoise(velocity=3e-2), [0, 0, 1, 1])):
        assert np.array_equal(encoder_noise(Disturbance(encoder_noise=own), STEPS, seed=3), alone * readings)


def test_the_cases_are_the_papers():
    assert {name: case.disturbance for name, case in CASES.items()} == {
        "nominal": Disturbance(None, Payload(0.0), None, None),
        "machining": Disturbance(tip_force=MachiningForce(base=138.0, swing=80.0, duration=1.5)),
        "payload": Disturbance(payload=Payload(5.0, at="tip")),
    }
    assert [find_case(name) for name in CASES] == list(CASES.values())
    assert all(name == case.name and case.title for name, case in CASES.items())


def test_targets_carry_the_reference_tip_the_unit_normal_on_the_left_and_the_circle():
    reference = JointReference(path=Line((0.4, 0.5), (0.5, 0.4)))
    targets, times = sampled(Disturbance(), reference).targets, np.arange(1501) * 1e-3
    assert np.array_equal(targets[:, :2], reference.tip(times).position)
    np.testing.assert_allclose(targets[:, 2:4], np.full((1501, 2), math.sqrt(0.5)), rtol=1e-14)
    assert not targets[:, 4:].any()  # no circle
    circle = JointReference(path=Circle(center=(0.35, 0.6), radius=0.15))
    assert (sampled(Disturbance(), circle).targets[:, 4:] == [0.35, 0.6, 0.15]).all()


@pytest.mark.parametrize(("start", "first"), [(0.9996, 1000), (1.0004, 1000), (1.0006, 1001)])
def test_a_bias_holds_over_the_steps_whose_middle_it_covers(start, first):
    assert np.flatnonzero(sampled(Disturbance(torque_bias=TorqueBias(BIAS, start=start))).biases[:, 0])[0] == first


WRONG = [
    (MachiningForce, {"fade_speed": -0.1}, r"MachiningForce\.fade_speed = -0\.1 .*\[1e-12, 1e\+12\]"),
    (ConstantForce, {"force": (1.0,) * 4}, r"ConstantForce\.force = .* must be 2 to 3 real numbers"),
    (ConstantForce, {"force": FORCE, "start": 1.0, "stop": 1.0}, r"ConstantForce: .*stop = 1\.0.*0 <= start < stop"),
    (TorqueBias, {"torque": (1.0,) * 13}, r"TorqueBias\.torque = .* must be 1 to 12 real numbers"),
    (TorqueBias, {"torque": BIAS, "stop": math.nan}, r"TorqueBias: .*stop = nan.*0 <= start < stop"),
    (Payload, {"mass": 1.0, "at": "elbow"}, "payload at = 'elbow' .*choose from: tip, link"),
]


@pytest.mark.parametrize(("part", "values", "message"), WRONG)
def test_a_value_out_of_range_is_named_with_its_range(part, values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        part(**values)
