"""The sub-step: order two, energy, the two back ends and the lanes of a batch."""

import dataclasses

import numpy as np
import pytest
from support.plain import hold_numpy
from support.two_joints import CONSERVATIVE, FRICTIONLESS, PHYSICS, SWINGING, TABLE_1, advance, energy, hold

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, tip_position
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.records import flat


def trajectory(state, arm, h, seconds, sample=1e-3):
    """States at every `sample` of an arm left to itself."""
    states = [state]
    for _ in range(round(seconds / sample)):
        states.append(advance(states[-1], (0.0, 0.0), h, round(sample / h), arm=arm))
    return np.array(states)


def order(steps, errors):
    """Slope of log error over log step."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def test_energy_drift_without_losses_is_small_and_of_second_order():
    steps = np.array([5e-4, 2.5e-4, 1.25e-4, 6.25e-5])
    drifts = []
    for h in steps:
        levels = energy(trajectory(SWINGING, CONSERVATIVE, h, 0.75), CONSERVATIVE)
        drifts.append(np.abs(levels - levels[0]).max())
    swing = arm_constants(CONSERVATIVE).c4
    assert drifts[-1] < 1e-5 * swing
    assert 1.8 < order(steps, drifts) < 2.3


@pytest.mark.parametrize("arm", [FRICTIONLESS, TABLE_1], ids=["joint damping", "friction and damping"])
def test_energy_never_rises_without_input(arm):
    levels = energy(trajectory(SWINGING, arm, 1e-4, 0.5, sample=1e-4), arm)
    assert np.diff(levels).max() < 1e-8 * (levels[0] - levels[-1])


def test_constant_force_and_torque_do_their_work():
    force, torque = np.array([30.0, -80.0]), np.array([40.0, -20.0])
    steps, errors = np.array([5e-4, 2.5e-4, 1.25e-4]), []
    for h in steps:
        after = advance(SWINGING, torque, h, round(0.2 / h), force, CONSERVATIVE)
        tips = [tip_position(state[2:4], CONSERVATIVE.length) for state in (SWINGING, after)]
        work = force @ (tips[1] - tips[0]) + torque @ (after[:2] - SWINGING[:2])
        errors.append(abs(energy(after, CONSERVATIVE) - energy(SWINGING, CONSERVATIVE) - work))
    assert abs(work) > 10.0 and errors[-1] < 1e-6 * abs(work)
    assert 1.8 < order(steps, errors) < 2.4


# Arm, start, torque, tip force, time [s], and the signs that the velocity of each motor has on the way.
SLIPPING = np.r_[SWINGING[:4], 2.0, -2.0, 2.0, -2.0]
CASES = {
    "smooth": (FRICTIONLESS, SWINGING, (40.0, -20.0), (30.0, -80.0), 0.05, [{1.0}, {-1.0}]),
    "slip": (TABLE_1, SLIPPING, (120.0, 10.0), (30.0, -80.0), 0.05, [{1.0}, {-1.0}]),
    "stick": (
        TABLE_1,
        np.r_[np.full(4, 0.2), np.zeros(4)],
        (10.0, 0.0),
        (0.0, 0.0),
        0.2,
        [{1.0, 0.0, -1.0}, {0.0, -1.0}],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_second_order_against_the_event_integrator(case):
    arm, state, torque, force, seconds, modes = CASES[case]
    states, steps, payload = [state], round(seconds / 1e-3), Payload(2.0)
    for k in range(steps):
        states.append(integrate(states[-1], torque, lambda _: force, arm, payload, k * 1e-3, (k + 1) * 1e-3))
    assert [set(signs) for signs in np.sign(np.array(states)[1:, 4:6]).T.tolist()] == modes
    substeps = np.array([2, 4, 8, 16, 32])
    ends = [advance(state, torque, 1e-3 / n, n * steps, force, arm, payload) for n in substeps]
    errors = np.abs(np.array(ends) - states[-1]).max(axis=1)
    assert 1.8 < order(1e-3 / substeps, errors) < 2.3
    assert errors[-1] < 1e-4


def random_lanes(lanes, seed=0):
    """States, torques, forces and arms of a mixed batch; a third of the motors at rest."""
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1.0, 1.0, (8, lanes)) * np.array([2, 2, 0, 0, 1, 1, 1, 1])[:, None]
    state[2:4] = state[:2] + 1e-3 * rng.uniform(-1.0, 1.0, (2, lanes))
    state[4:6, ::3] = 0.0
    arms = []
    for _ in range(lanes):
        scale = {name: rng.uniform(0.7, 1.3) for name in ("mass", "stiffness", "damping", "static_friction")}
        arm = dataclasses.replace(TABLE_1, **{k: tuple(s * x for x in getattr(TABLE_1, k)) for k, s in scale.items()})
        arms.append(flat(arm_constants(arm, Payload(float(rng.uniform(0.0, 5.0))))))
    return state, rng.normal(size=(2, lanes)) * 50.0, rng.normal(size=(4, lanes)) * 100.0, np.array(arms).T.copy()


@pytest.mark.parametrize("lanes", [1, 31, 33, 200])
def test_machine_code_is_numpy_bit_for_bit_and_each_lane_the_lane_alone(lanes):
    state, torque, force, arms = random_lanes(lanes)
    before, expected = state.copy(), hold_numpy(PHYSICS, state, torque, force, arms, 1e-4, 10)
    assert np.array_equal(state, before)
    alone = state[:, -1:].copy()
    hold(alone, *(np.ascontiguousarray(x[:, -1:]) for x in (torque, force, arms)), 1e-4, 10)
    hold(state, torque, force, arms, 1e-4, 10)
    assert np.array_equal(state, expected) and np.array_equal(np.signbit(state), np.signbit(expected))
    assert np.array_equal(state[:, -1:], alone)
    with pytest.raises(ValueError, match="must have 4 float64 values per arm, stored in columns"):
        hold(state, torque, force[:2], arms, 1e-4, 10)


def test_the_force_is_the_line_through_the_step():
    """Sub-step j of n takes mean + ((j + 1/2)/n - 1/2) change: the same as n holds of one sub-step each."""
    state, torque, force, arms = random_lanes(5)
    expected, n = state.copy(), 4
    for j in range(n):
        constant = np.vstack([force[:2] + ((j + 0.5) / n - 0.5) * force[2:], np.zeros((2, 5))])
        hold(expected, torque, constant, arms, 1e-4, 1)
    hold(state, torque, force, arms, 1e-4, n)
    assert np.array_equal(state, expected)
