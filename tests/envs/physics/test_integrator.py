"""The sub-step, its friction and the reference solution: order two, energy, stick-slip, back ends, lanes of a batch."""

import dataclasses
import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from slow_twins import slow_but
from support.plain import hold_numpy
from support.two_joints import CONSERVATIVE, FRICTIONLESS, PHYSICS, SWINGING, TABLE_1, advance, energy, hold

from fuzzyarm.envs.physics import event_integrator
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, tip_position
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.physics.friction import DryFriction, friction_torque, stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.records import flat

HANGING, NO_LOAD = np.zeros(8), Payload()


def solve(state, torque, seconds, arm=TABLE_1, force=lambda _: (0.0, 0.0), **tolerances):
    return integrate(np.array(state, float), np.array(torque, float), force, arm, NO_LOAD, 0.0, seconds, **tolerances)


def in_pieces(start, torque, seconds, pieces, arm=TABLE_1, force=lambda _: (0.0, 0.0), payload=NO_LOAD):
    """The states of many short calls that make up one long one."""
    states, times = [np.array(start, float)], np.linspace(0.0, seconds, pieces + 1)
    for begin, end in itertools.pairwise(times):
        states.append(integrate(states[-1], np.array(torque), force, arm, payload, begin, end))
    return np.array(states)


def trajectory(state, arm, h, seconds, sample=1e-3):
    states = [state]
    for _ in range(round(seconds / sample)):
        states.append(advance(states[-1], (0.0, 0.0), h, round(sample / h), arm=arm))
    return np.array(states)


def order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def test_energy_drift_without_losses_is_small_and_of_second_order():
    steps = np.array([5e-4, 2.5e-4, 1.25e-4, 6.25e-5])
    levels = np.array([energy(trajectory(SWINGING, CONSERVATIVE, h, 0.75), CONSERVATIVE) for h in steps])
    drifts = np.abs(levels - levels[:, :1]).max(axis=1)
    assert drifts[-1] < 1e-5 * arm_constants(CONSERVATIVE).c4
    assert 1.8 < order(steps, drifts) < 2.3


@pytest.mark.parametrize("arm", [FRICTIONLESS, TABLE_1], ids=["joint damping", "friction and damping"])
def test_energy_never_rises_without_input(arm):
    levels = energy(trajectory(SWINGING, arm, 1e-4, 0.5, sample=1e-4), arm)
    assert np.diff(levels).max() < 1e-8 * (levels[0] - levels[-1])


def test_constant_force_and_torque_do_their_work():
    force, torque = np.array([30.0, -80.0]), np.array([40.0, -20.0])

    def missing(after):
        tips = [tip_position(state[2:4], CONSERVATIVE.length) for state in (SWINGING, after)]
        work = force @ (tips[1] - tips[0]) + torque @ (after[:2] - SWINGING[:2])
        assert abs(work) > 10.0
        return abs(energy(after, CONSERVATIVE) - energy(SWINGING, CONSERVATIVE) - work)

    assert missing(solve(SWINGING, torque, 0.2, arm=CONSERVATIVE, force=lambda _: force)) < 1e-9
    steps = np.array([5e-4, 2.5e-4, 1.25e-4])
    errors = [missing(advance(SWINGING, torque, h, round(0.2 / h), force, CONSERVATIVE)) for h in steps]
    assert errors[-1] < 1e-5
    assert 1.8 < order(steps, errors) < 2.4


# Arm, start, torque, tip force, time [s], and the signs that the velocity of each motor has on the way.
CASES = {
    "smooth": (FRICTIONLESS, SWINGING, (40.0, -20.0), (30.0, -80.0), 0.05, [{1.0}, {-1.0}]),
    "slip": (TABLE_1, np.r_[SWINGING[:4], 2.0, -2.0, 2.0, -2.0], (120.0, 10.0), (30.0, -80.0), 0.05, [{1.0}, {-1.0}]),
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
    steps, payload = round(seconds / 1e-3), Payload(2.0)
    states = in_pieces(state, torque, seconds, steps, arm, lambda _: force, payload)
    assert [set(signs) for signs in np.sign(states[1:, 4:6]).T.tolist()] == modes
    substeps = np.array([2, 4, 8, 16, 32])
    ends = [advance(state, torque, 1e-3 / n, n * steps, force, arm, payload) for n in substeps]
    errors = np.abs(ends - states[-1]).max(axis=1)
    assert 1.8 < order(1e-3 / substeps, errors) < 2.3 and errors[-1] < 1e-4


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


# Start, torque, time [s], and the modes (signs of the motor velocities) that each joint goes through.
EVENTS = {
    "slip to stick": ([0, 0, 0, 0, 0.01, -0.01, 0, 0], (0.0, 0.0), 8e-3, ([1, 0], [-1, 0])),
    "stick to slip": ([0, 0, 0, 0, 0, 0, 0.5, -0.5], (0.0, 0.0), 4e-3, ([0, 1], [0, -1])),
    "reversal": ([0, 0, 0, 0, 0.02, 0.05, 0, 0], (-50.0, -30.0), 4e-3, ([1, -1], [1, -1])),
    "many": ([0, 0, 0, 0, 0, 0, 0.05, -0.1], (0.0, 0.0), 8e-2, ([0, 1, 0, 1, 0], [0, -1, 0, 1, 0])),
}


@pytest.mark.parametrize("case", EVENTS)
def test_motors_go_through_the_expected_modes_as_with_tiny_substeps(case):
    start, torque, seconds, expected = EVENTS[case]
    signs = np.sign(in_pieces(start, torque, seconds, 200)[:, 4:6]).T
    assert tuple([s for k, s in enumerate(joint) if k == 0 or s != joint[k - 1]] for joint in signs) == expected
    reference = solve(start, torque, seconds)
    coarse, fine = (np.abs(advance(start, torque, h, round(seconds / h)) - reference).max() for h in (4e-6, 1e-6))
    assert fine < 1e-8 and coarse > 10.0 * fine  # converges with second order to the reference solution itself


@pytest.mark.parametrize("case", slow_but(set(EVENTS) - {"many"}, EVENTS))
def test_tolerances_steps_and_pieces_change_nothing(case, monkeypatch):
    start, torque, seconds, _ = EVENTS[case]
    default = solve(start, torque, seconds)
    half = solve(start, torque, seconds, rtol=0.5e-11, atol=0.5e-13)
    pieces = in_pieces(start, torque, seconds, 13)[-1]
    monkeypatch.setattr(event_integrator, "_MAX_STEP", 1e-5)
    short_steps = solve(start, torque, seconds)
    monkeypatch.setattr(event_integrator, "_MAX_STEP", 1e-2)  # the tolerances alone choose the steps
    free_steps = solve(start, torque, seconds)
    np.testing.assert_allclose([half, pieces, short_steps, free_steps], [default] * 4, rtol=0, atol=1e-10)


def test_coulomb_friction_takes_torque_times_path():
    arm = dataclasses.replace(CONSERVATIVE, static_friction=(6.0, 3.0), coulomb_friction=(6.0, 3.0))
    start = np.array([0, 0, 0, 0, 0.5, -0.5, 0, 0])
    after = solve(start, (0.0, 0.0), 2e-3, arm=arm)
    lost = np.dot((6.0, 3.0), np.abs(after[:2]))
    assert np.array_equal(np.sign(after[4:6]), [1.0, -1.0]) and lost > 1e-3
    assert energy(start, arm) - energy(after, arm) == pytest.approx(lost, abs=1e-11)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_static_torque_itself_holds_without_an_event_and_more_breaks_away(direction, monkeypatch):
    torque = direction * np.array(TABLE_1.static_friction)
    after = solve(HANGING, torque * (1.0 + 1e-9), 1e-3)
    assert (after[:2] * direction > 0.0).all() and (after[4:6] * direction > 0.0).all()
    monkeypatch.setattr(event_integrator, "_MAX_EVENTS", 0)
    assert np.array_equal(solve(HANGING, torque, 0.1), HANGING)
    assert np.array_equal(solve(HANGING, (0.0, 0.0), 0.1, arm=CONSERVATIVE), HANGING)


def test_failures_name_time_and_state(monkeypatch):
    for begin in (-1.0, 1e-4):
        with pytest.raises(RuntimeError, match=r"failed at t = .* s, in state \[.*step size"):
            solve(SWINGING, (0.0, 0.0), 1e-3, force=lambda t, begin=begin: (np.nan if t > begin else 0.0, 0.0))
    monkeypatch.setattr(event_integrator, "_MAX_EVENTS", 1)
    start, torque, seconds, _ = EVENTS["many"]
    with pytest.raises(RuntimeError, match=r"more than 1 times before t = .* s, in state \["):
        solve(start, torque, seconds)


COULOMB, STATIC, STRIBECK = 4.0, 6.0, 0.1
DRY = DryFriction(COULOMB, STATIC, STRIBECK)


def signed(largest):
    """Zero, or a number between 1e-9 and `largest` of either sign."""
    magnitude = st.floats(1e-9, largest)
    return st.one_of(st.just(0.0), magnitude, magnitude.map(lambda x: -x))


velocities, accelerations = signed(20.0), signed(1e3)
decelerations, durations = signed(1e3).map(abs), signed(1e-2).map(abs)


def exact_stick_slip(velocity, acceleration, deceleration, duration):
    """Solve v' in a - f Sgn(v) from event to event; returns velocity and displacement, both exact."""
    v, a, f, left = (Fraction(x) for x in (velocity, acceleration, deceleration, duration))
    moved = Fraction(0)
    if v:
        slope = a - f if v > 0 else a + f
        if (v + slope * left) * v >= 0:
            return v + slope * left, left * (v + slope * left / 2)
        stop = -v / slope
        moved, left = v * stop / 2, left - stop
    slope = max(abs(a) - f, Fraction(0)) * (1 if a > 0 else -1)
    return slope * left, moved + slope * left**2 / 2


def test_magnitude_falls_from_static_to_coulomb_and_is_even():
    assert [stribeck_magnitude(v, DRY) for v in (0.0, 1e3, np.inf)] == [STATIC, COULOMB, COULOMB]
    speed = np.linspace(0.0, 0.5, 200)
    magnitude = stribeck_magnitude(speed, DRY)
    assert (np.diff(magnitude) < 0.0).all()
    assert np.array_equal(magnitude, stribeck_magnitude(-speed, DRY))
    assert stribeck_magnitude(STRIBECK, DRY) == pytest.approx(COULOMB + (STATIC - COULOMB) / np.e)


@given(velocity=velocities, net=signed(50.0))
@example(velocity=1.0, net=STATIC)
@example(velocity=1.0, net=-STATIC)
def test_friction_torque_never_drives_and_at_rest_balances_up_to_the_static_one(velocity, net):
    if velocity:
        torque = friction_torque(velocity, net, DRY)
        assert torque * velocity < 0.0 and abs(torque) == stribeck_magnitude(velocity, DRY) <= STATIC
    assert friction_torque(0.0, net, DRY) == (-net if abs(net) <= STATIC else -np.copysign(STATIC, net))


@given(v=velocities, a=accelerations, f=decelerations, h=durations)
@example(v=1.0, a=-1.0, f=1.0, h=0.5)  # stops exactly at the end
@example(v=1.0, a=0.0, f=1e3, h=1e-2)  # stops and sticks
@example(v=1.0, a=-1e3, f=1.0, h=1e-2)  # reverses
@example(v=0.0, a=1.0, f=1.0, h=1e-2)  # just holds
@example(v=1e-31, a=2.0, f=1.0, h=1.0)
def test_stick_slip_is_the_exact_solution(v, a, f, h):
    velocity, moved = stick_slip(v, a, f, h)
    exact_velocity, exact_moved = exact_stick_slip(v, a, f, h)
    scale = abs(v) + h * (abs(a) + f)
    assert abs(velocity - float(exact_velocity)) <= 1e-14 * scale
    assert abs(moved - float(exact_moved)) <= 1e-14 * scale * h
    if v == 0.0 and abs(a) <= f:
        assert velocity == 0.0 and moved == 0.0
    assert stick_slip(-v, -a, f, h) == (-velocity, -moved)


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("joint", [0, 1])
def test_hanging_arm_sticks_bit_for_bit_up_to_the_static_torque_and_breaks_away_above(joint, direction):
    torque = direction * TABLE_1.static_friction[joint] * np.eye(2)[joint]
    for fraction in (1.0 - 1e-15, 1.0):
        assert np.array_equal(advance(np.zeros(8), fraction * torque, 1e-4, 1000), np.zeros(8))
    state = advance(np.zeros(8), (1.0 + 1e-9) * torque, 1e-4, 1)
    assert state[joint] * direction > 0.0 and state[4 + joint] * direction > 0.0
