"""The control step: what it measures and rewards, and the lanes of a batch against each lane alone."""

import dataclasses
import functools

import numpy as np
import pytest
from support.two_joints import LAYOUT, Target, advance, assess, hold, named, state_of

from fuzzyarm.envs.batch.layout import SCALARS, VECTORS, Clock, by_rows, in_blocks
from fuzzyarm.envs.physics.dynamics import (
    Arm,
    Payload,
    arm_constants,
    joint_torque,
    rigid_inverse_dynamics,
    tip_position,
)
from fuzzyarm.envs.physics.equations import Limits
from fuzzyarm.envs.physics.friction import DryFriction, stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, filled, flat, size
from fuzzyarm.envs.task import clipped, finite
from fuzzyarm.numbers.machine import WIDE

limits_of, target_of = functools.partial(filled, Limits), functools.partial(filled, Target)
TABLE_1 = ArmParameters()
STATIC = np.array(TABLE_1.static_friction)
LIMITS = np.array([*TABLE_1.joint_limit, *TABLE_1.velocity_limit, *TABLE_1.torque_limit])
RESTING = np.array([0.7, 0.9, 0.7, 0.9, 0.0, 0.0, 0.0, 0.0])
NOTHING = (0.0, 0.0)
PERIOD, SUBSTEPS = 1e-3, 10


def measure(state, torque=NOTHING, bias=NOTHING, target=None, limits=LIMITS):
    """One arm of Table 1, measured."""
    target = circle_target(RESTING) if target is None else target
    known = limits_of(limits), target_of(target)
    return assess(state_of(state), PerJoint(*torque), PerJoint(*bias), arm_constants(TABLE_1), *known)


def circle_target(state, distance=0.0):
    """A target with the tip of `state` `distance` beside the reference, on a circle with center (0.1, 0.2)."""
    found = measure(state, target=np.zeros(7))
    radius = np.hypot(found.tip.x - 0.1, found.tip.y - 0.2)
    return np.array([found.tip.x + distance, found.tip.y, 1.0, 0.0, 0.1, 0.2, radius])


def random_arm(rng):
    """Constants of an arm with its masses, stiffness and friction scaled, and a payload."""
    scaled = {
        name: tuple(rng.uniform(0.7, 1.3) * x for x in getattr(TABLE_1, name))
        for name in ("length", "mass", "stiffness", "damping", "motor_inertia")
    }
    scaled["mass_center"] = tuple(0.5 * x for x in scaled["length"])
    return arm_constants(dataclasses.replace(TABLE_1, **scaled), Payload(float(rng.uniform(0.0, 5.0))))


def batch(lanes, seed=0):
    """Different states, torques, biases, forces, arms, limits and references; a third of the motors at rest."""
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1.0, 1.0, (8, lanes)) * np.array([2, 2, 0, 0, 1, 1, 1, 1])[:, None]
    state[2:4] = state[:2] + 1e-3 * rng.uniform(-1.0, 1.0, (2, lanes))
    state[4:6, ::3] = 0.0
    torque, bias = (scale * rng.normal(size=(2, lanes)) for scale in (50.0, 5.0))
    force = 100.0 * rng.normal(size=(4, lanes))
    arms = np.array([flat(random_arm(rng)) for _ in range(lanes)]).T.copy()
    limits = LIMITS[:, None] * rng.uniform(0.1, 1.0, (6, lanes))
    target = rng.uniform(-0.7, 0.7, (7, lanes))  # a radius below zero is no circle either
    return state, torque, bias, force, arms, limits, target


def lanes_of(state, torque, bias, force, arm, limits, target, rows=2):
    """The arguments of `advance` for lanes that hold the same torque, bias and force in every row of their table."""
    lanes = state.shape[1]
    values = np.concatenate([state, arm, limits, np.ones((1, lanes)), np.zeros((2, lanes))])
    reference = 0.01 * np.arange(6.0 * lanes).reshape(6, lanes)
    table = np.repeat(np.concatenate([reference, target, force, bias]).T, rows, axis=0)
    first = rows * np.arange(lanes)
    clock = np.stack([first, first, first + rows - 1, np.zeros(lanes, dtype=np.int64)])
    return in_blocks(values), clock, table, np.ascontiguousarray(torque.T)


def step(values, clock, table, action):
    """Advance every lane by one control step; returns observations, vectors and scalars by name."""
    observations, vectors, scalars = advance(values, clock, table, PERIOD, SUBSTEPS, action)
    return observations, named(vectors), dict(zip(SCALARS, scalars, strict=True))


# --- the layout of the results -----------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", [1, 5, 64])
def test_every_result_has_its_own_place(lanes):
    observations, vectors, scalars = LAYOUT.split(np.arange(LAYOUT.size(lanes)), lanes)
    places = np.concatenate([part.ravel() for part in (observations, *LAYOUT.each(vectors), scalars)])
    assert len(set(places)) == len(places) == 38 * lanes
    assert lanes == 1 or np.diff(scalars[:, 0])[0] // 8 % 2 == 1  # an odd number of lines of the cache
    assert len({*VECTORS, *SCALARS}) == len(VECTORS) + len(SCALARS)


def test_advance_writes_every_entry_and_leaves_table_and_action_alone():
    values, clock, table, action = lanes_of(*batch(5))
    kept = [values[:, 8:].copy(), clock[1:].copy(), table.copy(), action.copy()]
    observations, vectors, scalars = step(values, clock, table, action)
    assert np.isfinite(observations).all()
    assert all(np.isfinite(part).all() for part in (*vectors.values(), *scalars.values()))
    assert all(map(np.array_equal, kept[1:], [clock[1:], table, action]))
    assert np.array_equal(kept[0], values[:, 8:], equal_nan=True)  # nan where there is no lane
    assert np.array_equal(clock[0], kept[1][0] + 1)
    assert values.shape[1] == size(LAYOUT.Lane) and len(clock) == size(Clock)


def test_each_result_is_reported_under_its_name():
    """Every quantity that is simply passed on, from distinct numbers."""
    state, torque, bias, force, arm, limits, target = batch(5)
    values, clock, table, action = lanes_of(state, torque, bias, force, arm, 10.0 * limits, target)
    factors = values[0, 35, :5] = np.linspace(0.5, 1.5, 5)
    observations, vectors, scalars = step(values, clock, table, action)
    after = values[0, :8, :5].T
    assert np.array_equal(vectors["q_motor"], after[:, :2]) and np.array_equal(vectors["q_link"], after[:, 2:4])
    assert np.array_equal(vectors["dq_motor"], after[:, 4:6]) and np.array_equal(vectors["dq_link"], after[:, 6:])
    assert np.array_equal(vectors["tip_reference"], target[:2].T)
    assert np.array_equal(vectors["torque"], torque.T)  # the controller's, without the bias
    assert np.array_equal(vectors["external_force"], (factors * force[:2]).T)
    assert np.array_equal(observations, np.hstack([after[:, [0, 1, 4, 5]], table[::2, :6]]))
    assert (scalars["time"] == PERIOD).all() and (scalars["truncated"] == 1.0).all()


# --- what is measured --------------------------------------------------------------------------------------------


def test_measured_tip_and_error_are_the_plants():
    rng = np.random.default_rng(1)
    state, target = rng.uniform(-1.0, 1.0, 8), rng.uniform(0.2, 0.5, 7)
    found, tip = measure(state, (1.0, 2.0), (3.0, 4.0), target), tip_position(state[2:4], TABLE_1.length)
    np.testing.assert_allclose(found.tip, tip, rtol=0.0, atol=5e-16)
    assert found.tip_error == pytest.approx(np.linalg.norm(tip - target[:2]), rel=1e-14)


@pytest.mark.parametrize(
    ("name", "angles"), [("circularity_error", slice(2, 4)), ("circularity_error_motor", slice(2))]
)
def test_circularity_error_is_the_distance_to_the_center_less_the_radius(name, angles):
    state, target = np.random.default_rng(2).uniform(-1.0, 1.0, 8), np.array([0.3, 0.4, 0.6, 0.8, 0.35, 0.65, 0.2])
    distance = np.linalg.norm(tip_position(state[angles], TABLE_1.length) - target[4:6])
    assert getattr(measure(state, target=target), name) == pytest.approx(distance - 0.2, abs=1e-15)


@pytest.mark.parametrize(
    ("name", "angles"), [("circularity_error", slice(2, 4)), ("circularity_error_motor", slice(2))]
)
@pytest.mark.parametrize("radius", [0.0, -0.1])
def test_without_a_circle_it_is_the_component_along_the_normal(name, angles, radius):
    state, target = np.random.default_rng(2).uniform(-1.0, 1.0, 8), np.array([0.3, 0.4, 0.6, 0.8, 9.0, 9.0, radius])
    component = (tip_position(state[angles], TABLE_1.length) - target[:2]) @ target[2:4]
    assert getattr(measure(state, target=target), name) == pytest.approx(component, abs=1e-15)


def test_on_the_reference_without_torque_the_reward_is_exactly_one():
    found = measure(RESTING)
    assert (found.reward_tracking, found.reward_effort, found.reward) == (1.0, 0.0, 1.0)


def test_the_tracking_reward_halves_at_five_millimetres():
    assert measure(RESTING, target=circle_target(RESTING, 0.005)).reward == pytest.approx(0.5, rel=1e-12)


def test_full_torque_costs_a_tenth_of_the_reward():
    found = measure(RESTING, (-500.0, 250.0))
    assert (found.reward_effort, found.reward) == (1.0, pytest.approx(0.9))


def test_the_bias_costs_no_reward():
    assert measure(RESTING, bias=(100.0, 100.0)).reward == 1.0


def test_the_reward_is_positive_and_falls_with_error_and_with_torque():
    errors, torques = np.geomspace(1e-6, 2.0, 30), np.linspace(0.0, 500.0, 30)
    by_error = [measure(RESTING, target=circle_target(RESTING, e)).reward for e in errors]
    by_torque = [measure(RESTING, (t, 0.0)).reward for t in torques]
    for rewards in (by_error, by_torque):
        assert (np.diff(rewards) < 0.0).all() and rewards[-1] > 0.0 and rewards[0] <= 1.0


# --- the domain --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", range(8))
def test_the_domain_is_closed_and_every_state_entry_counts(entry):
    limits, state = np.array([1.0, 1.1, 2.0, 2.1, 500.0, 250.0]), np.zeros(8)
    border = limits[entry % 2] if entry < 4 else limits[2 + entry % 2]
    flags = ("angles_inside", "velocities_inside")
    flag, other = flags if entry < 4 else flags[::-1]
    for value in (border, -border):
        state[entry] = value
        found = measure(state, limits=limits)
        assert (getattr(found, flag), getattr(found, other)) == (1.0, 1.0)
    for value in (np.nextafter(border, 9.0), -np.nextafter(border, 9.0), np.nan, np.inf, -np.inf):
        state[entry] = value
        with np.errstate(invalid="ignore"):
            found = measure(state, limits=limits)
        assert (getattr(found, flag), getattr(found, other)) == (0.0, 1.0)


@pytest.mark.parametrize(("entry", "reason"), [(k, 1.0 if k < 4 else 2.0) for k in range(8)])
def test_each_way_out_of_the_domain_is_told_by_its_number(entry, reason):
    limits, inside = np.array([1.0, 1.0, 1.0, 1.0, 500.0, 250.0]), np.zeros(8)
    state = inside.copy()
    state[entry] = 1.5
    lanes = np.stack([inside, state], axis=-1)
    constants = np.tile(np.array(flat(arm_constants(TABLE_1)))[:, None], 2)
    rows = lanes_of(lanes, *(np.zeros((n, 2)) for n in (2, 2, 4)), constants, np.tile(limits[:, None], 2), lanes[:7])
    values, clock, table, action = rows
    _, _, found = advance(values, clock, table, 1e-12, 1, action)  # too short a step to move
    scalars = dict(zip(SCALARS, found, strict=True))
    assert scalars["reason"].tolist() == [0.0, reason]
    assert scalars["truncated"].tolist() == [1.0, 0.0]  # the last row, but a lane that left is not truncated


@pytest.mark.parametrize("entry", range(8))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e13])
def test_a_number_that_is_not_finite_or_beyond_measure_is_noticed_in_every_entry(entry, value):
    state = RESTING.copy()
    assert finite(state_of(state)) == 1.0
    state[entry] = value
    with np.errstate(invalid="ignore"):
        assert finite(state_of(state)) == 0.0
        state[(entry + 1) % 8] = -value
        assert finite(state_of(state)) == 0.0  # nor do two such numbers make up for each other


def test_clipped_is_exact():
    torque = np.array([-501.0, -500.0, np.nextafter(-500.0, 0.0), -0.3, 0.0, 0.1, 500.0, np.nextafter(500.0, 501.0)])
    assert np.array_equal(clipped(torque, 500.0), np.clip(torque, -500.0, 500.0))


# --- friction ----------------------------------------------------------------------------------------------------


def friction(found):
    return np.array(found.friction_torque)


@pytest.mark.parametrize("share", [-1.0, -0.3, 0.0, 0.999, 1.0])
def test_friction_of_stuck_joints_balances_the_net_torque(share):
    state, bias = RESTING + np.r_[1e-3, -2e-3, np.zeros(6)], np.array([2.0, -1.0])
    spring = np.array(joint_torque(state_of(state), arm_constants(TABLE_1)))
    torque = spring - bias + share * STATIC
    net = torque + bias - spring
    reported = friction(measure(state, torque, bias))
    assert np.array_equal(reported, -np.clip(net, -STATIC, STATIC))
    np.testing.assert_allclose(reported, -share * STATIC, rtol=0.0, atol=1e-12)


def test_friction_at_rest_holds_no_more_than_the_static_torque():
    assert friction(measure(RESTING, (100.0, -100.0))).tolist() == [-STATIC[0], STATIC[1]]


def test_friction_of_slipping_joints_is_the_stribeck_curve_against_the_motion():
    velocity = np.array([0.02, -0.3])
    found = measure(RESTING + np.r_[np.zeros(4), velocity, np.zeros(2)], (30.0, 30.0))
    coulomb, speed = np.array(TABLE_1.coulomb_friction), TABLE_1.stribeck_velocity
    expected = -stribeck_magnitude(velocity, DryFriction(coulomb, STATIC, speed)) * np.sign(velocity)
    np.testing.assert_allclose(friction(found), expected, rtol=1e-15)


def test_an_arm_held_by_friction_stays_put_and_balanced():
    gravity = rigid_inverse_dynamics(RESTING[2:4], np.zeros(2), np.zeros(2), arm_constants(TABLE_1))
    state = (RESTING + np.r_[gravity / np.array(TABLE_1.stiffness), np.zeros(6)])[:, None]
    torque, zero = (gravity + [0.9, -0.9] * STATIC)[:, None], np.zeros((2, 1))
    arm, limits, target = (x[:, None] for x in (np.array(flat(arm_constants(TABLE_1))), LIMITS, circle_target(RESTING)))
    lane = lanes_of(state, torque, zero, np.zeros((4, 1)), arm, limits, target, rows=201)
    for _ in range(200):
        _, vectors, _ = step(*lane)
    assert np.array_equal(lane[0][0, 4:6, :1], zero)
    np.testing.assert_allclose(vectors["friction_torque"][0], [-0.9, 0.9] * STATIC, rtol=0.0, atol=1e-9)


# --- the step ----------------------------------------------------------------------------------------------------


def test_advance_is_hold_under_clipped_torque_and_bias_then_measured():
    state, torque, bias, force, arm, limits, target = batch(20)
    torque[:, 5:10] *= 20.0
    applied = np.clip(torque, -limits[4:], limits[4:])
    values, clock, table, action = lanes_of(state, torque, bias, force, arm, limits, target)
    _, vectors, scalars = step(values, clock, table, action)
    hold(state, applied + bias, force, arm, PERIOD / SUBSTEPS, SUBSTEPS)
    known = limits_of(limits), target_of(target)
    expected = assess(state_of(state), PerJoint(*applied), PerJoint(*bias), filled(Arm, arm), *known)
    assert np.array_equal(by_rows(values, 20)[:8], state) and np.array_equal(vectors["torque"], applied.T)
    assert np.array_equal(vectors["tip"], np.stack(expected.tip, axis=-1))
    assert np.array_equal(vectors["friction_torque"], friction(expected).T)
    for name in SCALARS[1:7]:
        assert np.array_equal(scalars[name], getattr(expected, name)), name
    assert np.array_equal(scalars["torque_clipped"], np.any(applied != torque, axis=0))
    assert 0 < scalars["torque_clipped"].sum() < 20
    inside = (expected.angles_inside == 1.0) & (expected.velocities_inside == 1.0)
    assert np.array_equal(scalars["reason"] == 0.0, inside) and 0 < inside.sum() < 20


def test_each_lane_is_the_lane_alone_bit_for_bit():
    lanes, arrays = 37, batch(37)
    together = lanes_of(*arrays, rows=21)
    alone = [lanes_of(*(np.ascontiguousarray(x[:, k : k + 1]) for x in arrays), rows=21) for k in range(lanes)]
    for lane in alone:
        lane[2][:, :6] = 0.0
    together[2][:, :6] = 0.0
    for _ in range(20):
        observations, vectors, scalars = step(*together)
        for k, lane in enumerate(alone):
            one_observation, one_vectors, one_scalars = step(*lane)
            assert np.array_equal(together[0][k // WIDE, :, k % WIDE], lane[0][0, :, 0])
            assert np.array_equal(observations[k], one_observation[0])
            assert all(np.array_equal(vectors[name][k], one_vectors[name][0]) for name in VECTORS)
            assert all(scalars[name][k] == one_scalars[name][0] for name in SCALARS)
    assert 0.0 < (scalars["reason"] == 0.0).mean() < 1.0  # the batch holds lanes inside and outside
