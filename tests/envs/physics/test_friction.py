"""Stribeck friction: its limits, exact stick, and `stick_slip` against exact rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.two_joints import TABLE_1, advance

from fuzzyarm.envs.physics.friction import DryFriction, friction_torque, stick_slip, stribeck_magnitude

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


@settings(deadline=None)
@given(velocity=velocities, net=signed(50.0))
def test_friction_torque_never_drives(velocity, net):
    torque = friction_torque(velocity, net, DRY)
    assert torque * velocity <= 0.0
    assert abs(torque) <= STATIC
    if velocity != 0.0:
        assert abs(torque) == stribeck_magnitude(velocity, DRY)


@settings(deadline=None)
@given(net=signed(50.0))
@example(net=STATIC)
@example(net=-STATIC)
def test_friction_at_rest_balances_the_net_torque_up_to_the_static_one(net):
    torque = friction_torque(0.0, net, DRY)
    assert torque == (-net if abs(net) <= STATIC else -np.copysign(STATIC, net))


@settings(deadline=None)
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
