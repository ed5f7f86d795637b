"""What a control step measures: errors, domain, reasons to end and friction."""

import functools
import itertools

import numpy as np
import pytest
from support.two_joints import PHYSICS, Target, assess, state_of

from fuzzyarm.envs.physics.dynamics import arm_constants, joint_torque, tip_position
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, filled
from fuzzyarm.envs.task import Termination, finite, reason_of

limits_of, target_of = functools.partial(filled, PHYSICS.Limits), functools.partial(filled, Target)
TABLE_1 = ArmParameters()
STATIC = np.array(TABLE_1.static_friction)
LIMITS = np.array([*TABLE_1.joint_limit, *TABLE_1.velocity_limit, *TABLE_1.torque_limit])
RESTING = np.array([0.7, 0.9, 0.7, 0.9, 0.0, 0.0, 0.0, 0.0])
NOTHING = (0.0, 0.0)


def measure(state, torque=NOTHING, bias=NOTHING, target=(0.0,) * 7, limits=LIMITS):
    known = limits_of(limits), target_of(target)
    return assess(state_of(state), PerJoint(*torque), PerJoint(*bias), arm_constants(TABLE_1), *known)


@pytest.mark.parametrize(("name", "joints"), [("circularity_error", [2, 3]), ("circularity_error_motor", [0, 1])])
def test_errors_are_those_of_the_tip_and_of_the_tip_by_the_motors(name, joints):
    """Of a circle the distance to its center less the radius; else the component along the normal."""
    state, center, normal = np.random.default_rng(2).uniform(-1.0, 1.0, 8), [0.35, 0.65], np.array([0.6, 0.8])
    tip = tip_position(state[joints], TABLE_1.length)
    across = (tip - [0.3, 0.4]) @ normal
    for radius, error in ((0.2, np.linalg.norm(tip - center) - 0.2), (0.0, across), (-0.1, across)):
        found = measure(state, (1.0, 2.0), (3.0, 4.0), np.array([0.3, 0.4, *normal, *center, radius]))
        assert getattr(found, name) == pytest.approx(error, abs=1e-15)
    tip = tip_position(state[2:4], TABLE_1.length)
    np.testing.assert_allclose(found.tip, tip, rtol=0.0, atol=5e-16)
    assert found.tip_error == pytest.approx(np.linalg.norm(tip - [0.3, 0.4]), rel=1e-14)


@pytest.mark.parametrize("entry", range(8))
def test_the_domain_is_closed_and_every_state_entry_counts(entry):
    limits, state = np.array([1.0, 1.1, 2.0, 2.1, 500.0, 250.0]), np.zeros(8)
    border = limits[entry % 2] if entry < 4 else limits[2 + entry % 2]
    flags = ("angles_inside", "velocities_inside")
    flag, other = flags if entry < 4 else flags[::-1]
    for value, inside in ((border, 1.0), (-border, 1.0), (np.nextafter(border, 9.0), 0.0), (np.nan, 0.0)):
        state[entry] = value
        with np.errstate(invalid="ignore"):
            found = measure(state, limits=limits)
        assert (getattr(found, flag), getattr(found, other)) == (inside, 1.0)


def test_not_finite_comes_before_angle_and_angle_before_velocity():
    flags = np.array(list(itertools.product([0.0, 1.0], repeat=3)))  # not finite, beyond an angle, beyond a velocity
    expected = [Termination.NOT_FINITE] * 4 + [Termination.ANGLE] * 2 + [Termination.VELOCITY, Termination.NONE]
    assert reason_of(*flags.T).tolist() == [reason_of(*flag) for flag in flags] == expected


@pytest.mark.parametrize("entry", range(8))
def test_a_number_that_is_not_finite_or_beyond_measure_is_noticed_in_every_entry(entry):
    assert finite(state_of(RESTING)) == 1.0
    for value in (np.nan, -np.inf, 1e300, -1e13):
        state = RESTING.copy()
        for place in (entry, (entry + 1) % 8):  # nor do two such numbers make up for each other
            state[place] = value if place == entry else -value
            with np.errstate(invalid="ignore"):
                assert finite(state_of(state)) == 0.0


@pytest.mark.parametrize("share", [-1.0, -0.3, 0.0, 0.999, 1.0])
def test_friction_of_stuck_joints_balances_the_net_torque(share):
    state, bias = RESTING + np.r_[1e-3, -2e-3, np.zeros(6)], np.array([2.0, -1.0])
    spring = np.array(joint_torque(state_of(state), arm_constants(TABLE_1)))
    torque = spring - bias + share * STATIC
    reported = np.array(measure(state, torque, bias).friction_torque)
    assert np.array_equal(reported, -np.clip(torque + bias - spring, -STATIC, STATIC))
    np.testing.assert_allclose(reported, -share * STATIC, rtol=0.0, atol=1e-12)


def test_friction_of_slipping_joints_is_the_stribeck_curve_against_the_motion():
    assert measure(RESTING, (100.0, -100.0)).friction_torque == (-STATIC[0], STATIC[1])  # about to slip
    velocity = np.array([0.02, -0.3])
    found = measure(RESTING + np.r_[np.zeros(4), velocity, np.zeros(2)], (30.0, 30.0))
    coulomb, speed = np.array(TABLE_1.coulomb_friction), TABLE_1.stribeck_velocity
    expected = -stribeck_magnitude(velocity, DryFriction(coulomb, STATIC, speed)) * np.sign(velocity)
    np.testing.assert_allclose(found.friction_torque, expected, rtol=1e-15)
