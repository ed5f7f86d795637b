"""The reference solution: stick-slip events, energy, tolerances, and agreement with very small sub-steps."""

import dataclasses
import itertools

import numpy as np
import pytest
from slow_twins import slow_but
from support.two_joints import CONSERVATIVE, SWINGING, TABLE_1, advance, energy

from fuzzyarm.envs.physics import event_integrator
from fuzzyarm.envs.physics.dynamics import Payload, tip_position
from fuzzyarm.envs.physics.event_integrator import integrate

HANGING = np.zeros(8)


def no_force(_):
    return 0.0, 0.0


def solve(state, torque, seconds, arm=TABLE_1, force=no_force, **tolerances):
    return integrate(np.array(state, float), np.array(torque, float), force, arm, Payload(), 0.0, seconds, **tolerances)


# Start, torque, time [s], and the modes (signs of the motor velocities) that each joint goes through.
EVENTS = {
    "slip to stick": ([0, 0, 0, 0, 0.01, -0.01, 0, 0], (0.0, 0.0), 8e-3, ([1, 0], [-1, 0])),
    "stick to slip": ([0, 0, 0, 0, 0, 0, 0.5, -0.5], (0.0, 0.0), 4e-3, ([0, 1], [0, -1])),
    "reversal": ([0, 0, 0, 0, 0.02, 0.05, 0, 0], (-50.0, -30.0), 4e-3, ([1, -1], [1, -1])),
    "many": ([0, 0, 0, 0, 0, 0, 0.05, -0.1], (0.0, 0.0), 8e-2, ([0, 1, 0, 1, 0], [0, -1, 0, 1, 0])),
}


def in_pieces(start, torque, seconds, pieces):
    """The states of many short calls that make up one long one."""
    states, times = [np.array(start, float)], np.linspace(0.0, seconds, pieces + 1)
    for begin, end in itertools.pairwise(times):
        states.append(integrate(states[-1], np.array(torque), no_force, TABLE_1, Payload(), begin, end))
    return np.array(states)


@pytest.mark.parametrize("case", EVENTS)
def test_motors_go_through_the_expected_modes_as_with_tiny_substeps(case):
    start, torque, seconds, expected = EVENTS[case]
    signs = np.sign(in_pieces(start, torque, seconds, 200)[:, 4:6]).T
    assert tuple([s for k, s in enumerate(joint) if k == 0 or s != joint[k - 1]] for joint in signs) == expected
    reference = solve(start, torque, seconds)
    coarse, fine = (np.abs(advance(start, torque, h, round(seconds / h)) - reference).max() for h in (4e-6, 1e-6))
    assert fine < 1e-8
    assert coarse > 10.0 * fine  # converges with second order to the reference solution itself


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


def test_torque_and_tip_force_do_their_work():
    torque, force = np.array([40.0, -20.0]), np.array([30.0, -80.0])
    after = solve(SWINGING, torque, 0.2, arm=CONSERVATIVE, force=lambda _: force)
    tips = [tip_position(state[2:4], CONSERVATIVE.length) for state in (SWINGING, after)]
    work = torque @ (after[:2] - SWINGING[:2]) + force @ (tips[1] - tips[0])
    assert abs(work) > 10.0
    assert energy(after, CONSERVATIVE) - energy(SWINGING, CONSERVATIVE) == pytest.approx(work, abs=1e-9)


def test_coulomb_friction_takes_torque_times_path():
    arm = dataclasses.replace(CONSERVATIVE, static_friction=(6.0, 3.0), coulomb_friction=(6.0, 3.0))
    start, torque = np.array([0, 0, 0, 0, 0.5, -0.5, 0, 0]), np.array([0.0, 0.0])
    after = solve(start, torque, 2e-3, arm=arm)
    assert np.array_equal(np.sign(after[4:6]), [1.0, -1.0])
    lost = np.dot((6.0, 3.0), np.abs(after[:2]))
    assert lost > 1e-3
    assert energy(start, arm) - energy(after, arm) == pytest.approx(lost, abs=1e-11)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_static_torque_itself_holds_without_an_event_and_more_breaks_away(direction, monkeypatch):
    torque = direction * np.array(TABLE_1.static_friction)
    after = solve(HANGING, torque * (1.0 + 1e-9), 1e-3)
    assert (after[:2] * direction > 0.0).all() and (after[4:6] * direction > 0.0).all()
    monkeypatch.setattr(event_integrator, "_MAX_EVENTS", 0)
    assert np.array_equal(solve(HANGING, torque, 0.1), HANGING)
    assert np.array_equal(solve(HANGING, (0.0, 0.0), 0.1, arm=CONSERVATIVE), HANGING)


def test_too_many_events_name_time_and_state(monkeypatch):
    monkeypatch.setattr(event_integrator, "_MAX_EVENTS", 1)
    start, torque, seconds, _ = EVENTS["many"]
    with pytest.raises(RuntimeError, match=r"more than 1 times before t = .* s, in state \["):
        solve(start, torque, seconds)


@pytest.mark.parametrize("begin", [-1.0, 1e-4])
def test_solver_failure_names_time_and_state(begin):
    with pytest.raises(RuntimeError, match=r"failed at t = .* s, in state \[.*step size"):
        solve(SWINGING, (0.0, 0.0), 1e-3, force=lambda t: (np.nan, 0.0) if t > begin else (0.0, 0.0))
