"""The control step: what it measures and rewards, and the lanes of a batch against each lane alone."""

import dataclasses

import numpy as np
import pytest

from fuzzyarm.envs.dynamics import Payload, State, arm_constants, joint_torque, rigid_inverse_dynamics, tip_position
from fuzzyarm.envs.friction import stribeck_magnitude
from fuzzyarm.envs.integrator import hold
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.envs.task import SLOTS, WIDTH, control_step, measure

TABLE_1 = ArmParameters()
STATIC = np.array(TABLE_1.static_friction)
LIMITS = np.array([*TABLE_1.joint_limit, *TABLE_1.velocity_limit, *TABLE_1.torque_limit])
RESTING = np.array([0.7, 0.9, 0.7, 0.9, 0.0, 0.0, 0.0, 0.0])
NOTHING = (0.0, 0.0)


def circle_target(state, distance=0.0):
    """A target with the tip of `state` `distance` beside the reference, on a circle with center (0.1, 0.2)."""
    tip = tip_position(state[2:4], TABLE_1.length)
    radius = np.hypot(tip[0] - 0.1, tip[1] - 0.2)
    return np.array([tip[0] + distance, tip[1], 1.0, 0.0, 0.1, 0.2, radius])


def measured(state, torque=NOTHING, bias=NOTHING, force=NOTHING, target=None, limits=LIMITS):
    """One lane through `measure`; returns the row of quantities."""
    state = np.array(state, float)
    target = circle_target(RESTING) if target is None else target
    columns = [
        np.array(x, float)[:, None] for x in (state, torque, bias, force, arm_constants(TABLE_1), limits, target)
    ]
    out = np.full((1, WIDTH), np.nan)
    measure(*columns, out)
    return out[0]


def batch(lanes, seed=0):
    """Different states, torques, biases, forces, arms, limits and references; a third of the motors at rest."""
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1.0, 1.0, (8, lanes)) * np.array([2, 2, 0, 0, 1, 1, 1, 1])[:, None]
    state[2:4] = state[:2] + 1e-3 * rng.uniform(-1.0, 1.0, (2, lanes))
    state[4:6, ::3] = 0.0
    torque, bias = (scale * rng.normal(size=(2, lanes)) for scale in (50.0, 5.0))
    force = 100.0 * rng.normal(size=(4, lanes))
    arms = [random_arm(rng) for _ in range(lanes)]
    limits = LIMITS[:, None] * rng.uniform(0.1, 1.0, (6, lanes))
    target = rng.uniform(-0.7, 0.7, (7, lanes))  # a radius below zero is no circle either
    return state, torque, bias, force, np.array(arms).T.copy(), limits, target


def random_arm(rng):
    """Constants of an arm with its masses, stiffness and friction scaled, and a payload."""
    scaled = {
        name: tuple(rng.uniform(0.7, 1.3) * x for x in getattr(TABLE_1, name))
        for name in ("length", "mass", "stiffness", "damping", "motor_inertia")
    }
    scaled["mass_center"] = tuple(0.5 * x for x in scaled["length"])
    return arm_constants(dataclasses.replace(TABLE_1, **scaled), Payload(float(rng.uniform(0.0, 5.0))))


def one_lane(arrays, lane):
    return [np.ascontiguousarray(x[:, lane : lane + 1]) for x in arrays]


def test_every_slot_has_its_own_place():
    taken = np.zeros(WIDTH, dtype=int)
    for slot in SLOTS:
        taken[slot] += 1
    assert (taken == 1).all()


def test_measure_writes_every_entry_and_leaves_its_arguments_alone():
    arrays, out = batch(5), np.full((5, WIDTH), np.nan)
    before = [x.copy() for x in arrays]
    measure(*arrays, out)
    assert np.isfinite(out).all()
    assert all(np.array_equal(x, y) for x, y in zip(arrays, before, strict=True))


def test_measured_quantities_are_the_plants():
    rng = np.random.default_rng(1)
    state, target = rng.uniform(-1.0, 1.0, 8), rng.uniform(0.2, 0.5, 7)
    row = measured(state, (1.0, 2.0), (3.0, 4.0), (5.0, 6.0), target)
    tip = tip_position(state[2:4], TABLE_1.length)
    np.testing.assert_allclose(row[SLOTS.tip], tip, rtol=1e-15)
    assert row[SLOTS.tip_error] == pytest.approx(np.linalg.norm(tip - target[:2]))
    assert row[SLOTS.tip_reference].tolist() == target[:2].tolist()
    assert row[SLOTS.motor].tolist() == state[[0, 1, 4, 5]].tolist()
    assert row[SLOTS.link].tolist() == state[[2, 3, 6, 7]].tolist()
    assert row[SLOTS.torque].tolist() == [1.0, 2.0]  # the controller's, without the bias
    assert row[SLOTS.external_force].tolist() == [5.0, 6.0]


@pytest.mark.parametrize(
    ("slot", "angles"), [("circularity_error", slice(2, 4)), ("circularity_error_motor", slice(2))]
)
def test_circularity_error_is_the_distance_to_the_center_less_the_radius(slot, angles):
    state, target = np.random.default_rng(2).uniform(-1.0, 1.0, 8), np.array([0.3, 0.4, 0.6, 0.8, 0.35, 0.65, 0.2])
    distance = np.linalg.norm(tip_position(state[angles], TABLE_1.length) - target[4:6])
    assert measured(state, target=target)[getattr(SLOTS, slot)] == pytest.approx(distance - 0.2, abs=1e-15)


@pytest.mark.parametrize(
    ("slot", "angles"), [("circularity_error", slice(2, 4)), ("circularity_error_motor", slice(2))]
)
def test_without_a_circle_it_is_the_component_along_the_normal(slot, angles):
    state, target = np.random.default_rng(2).uniform(-1.0, 1.0, 8), np.array([0.3, 0.4, 0.6, 0.8, 9.0, 9.0, 0.0])
    component = (tip_position(state[angles], TABLE_1.length) - target[:2]) @ target[2:4]
    assert measured(state, target=target)[getattr(SLOTS, slot)] == pytest.approx(component, abs=1e-15)


def test_on_the_reference_without_torque_the_reward_is_exactly_one():
    row = measured(RESTING)
    assert (row[SLOTS.reward_tracking], row[SLOTS.reward_effort], row[SLOTS.reward]) == (1.0, 0.0, 1.0)


def test_the_tracking_reward_halves_at_five_millimetres():
    assert measured(RESTING, target=circle_target(RESTING, 0.005))[SLOTS.reward] == pytest.approx(0.5, rel=1e-12)


def test_full_torque_costs_a_tenth_of_the_reward():
    row = measured(RESTING, (-500.0, 250.0))
    assert (row[SLOTS.reward_effort], row[SLOTS.reward]) == (1.0, pytest.approx(0.9))


def test_the_reward_is_positive_and_falls_with_error_and_with_torque():
    errors, torques = np.geomspace(1e-6, 2.0, 30), np.linspace(0.0, 500.0, 30)
    by_error = [measured(RESTING, target=circle_target(RESTING, e))[SLOTS.reward] for e in errors]
    by_torque = [measured(RESTING, (t, 0.0))[SLOTS.reward] for t in torques]
    for rewards in (by_error, by_torque):
        assert (np.diff(rewards) < 0.0).all() and rewards[-1] > 0.0 and rewards[0] <= 1.0


@pytest.mark.parametrize("entry", range(8))
def test_the_domain_is_closed_and_every_state_entry_counts(entry):
    limits, state = np.array([1.0, 1.1, 2.0, 2.1, 500.0, 250.0]), np.zeros(8)
    border = limits[entry % 2] if entry < 4 else limits[2 + entry % 2]
    for value in (border, -border):
        state[entry] = value
        assert measured(state, limits=limits)[SLOTS.in_domain] == 1.0
    for value in (np.nextafter(border, 9.0), -np.nextafter(border, 9.0), np.nan, np.inf, -np.inf):
        state[entry] = value
        assert measured(state, limits=limits)[SLOTS.in_domain] == 0.0


@pytest.mark.parametrize("share", [-1.0, -0.3, 0.0, 0.999, 1.0])
def test_friction_of_stuck_joints_balances_the_net_torque(share):
    state, bias = RESTING + np.r_[1e-3, -2e-3, np.zeros(6)], np.array([2.0, -1.0])
    spring = np.array(joint_torque(State(*state), arm_constants(TABLE_1)))
    torque = spring - bias + share * STATIC
    net = torque + bias - spring
    reported = measured(state, torque, bias)[SLOTS.friction_torque]
    assert np.array_equal(reported, -np.clip(net, -STATIC, STATIC))
    np.testing.assert_allclose(reported, -share * STATIC, rtol=0.0, atol=1e-12)


def test_friction_at_rest_holds_no_more_than_the_static_torque():
    assert measured(RESTING, (100.0, -100.0))[SLOTS.friction_torque].tolist() == [-STATIC[0], STATIC[1]]


def test_friction_of_slipping_joints_is_the_stribeck_curve_against_the_motion():
    velocity = np.array([0.02, -0.3])
    row = measured(RESTING + np.r_[np.zeros(4), velocity, np.zeros(2)], (30.0, 30.0))
    coulomb, speed = np.array(TABLE_1.coulomb_friction), TABLE_1.stribeck_velocity
    expected = -stribeck_magnitude(velocity, coulomb, STATIC, speed) * np.sign(velocity)
    np.testing.assert_allclose(row[SLOTS.friction_torque], expected, rtol=1e-15)


def test_an_arm_held_by_friction_stays_put_and_balanced():
    gravity = rigid_inverse_dynamics(RESTING[2:4], np.zeros(2), np.zeros(2), arm_constants(TABLE_1))
    state = (RESTING + np.r_[gravity / np.array(TABLE_1.stiffness), np.zeros(6)])[:, None]
    torque, zero, out = (gravity + [0.9, -0.9] * STATIC)[:, None], np.zeros((2, 1)), np.empty((1, WIDTH))
    arm, limits, target = (x[:, None] for x in (np.array(arm_constants(TABLE_1)), LIMITS, circle_target(RESTING)))
    for _ in range(200):
        control_step(state, torque, zero, np.zeros((4, 1)), arm, limits, target, 1e-4, 10, out)
    assert np.array_equal(state[4:6], zero)
    np.testing.assert_allclose(out[0, SLOTS.friction_torque], [-0.9, 0.9] * STATIC, rtol=0.0, atol=1e-9)


def test_control_step_is_hold_under_torque_and_bias_then_measure():
    state, torque, bias, *rest = batch(20)
    stepped, out, expected = state.copy(), np.empty((20, WIDTH)), np.empty((20, WIDTH))
    control_step(stepped, torque, bias, *rest, 1e-4, 10, out)
    hold(state, torque + bias, rest[0], rest[1], 1e-4, 10)
    measure(state, torque, bias, *rest, expected)
    assert np.array_equal(stepped, state) and np.array_equal(out, expected)


def test_each_lane_is_the_lane_alone_bit_for_bit():
    lanes, together = 37, batch(37)
    alone = [one_lane(together, k) for k in range(lanes)]
    rows, row = np.empty((lanes, WIDTH)), np.empty((1, WIDTH))
    for _ in range(20):
        control_step(*together, 1e-4, 10, rows)
        for k, arrays in enumerate(alone):
            control_step(*arrays, 1e-4, 10, row)
            assert np.array_equal(together[0][:, k], arrays[0][:, 0]) and np.array_equal(rows[k], row[0])
    assert 0.0 < rows[:, SLOTS.in_domain].mean() < 1.0  # the batch holds lanes inside and outside
