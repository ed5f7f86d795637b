"""Equations of serial robots: equal to the textbook and to the hand-written ones, in every kind of number; the step."""

import numpy as np
import pytest
import torch
from slow_twins import slow_but
from support.robots import ROBOTS, kinetic_energy, potential_energy, with_drives, without_losses

from fuzzyarm.envs.physics import rigid_body
from fuzzyarm.envs.physics._serial import physics_of
from fuzzyarm.envs.physics.integrator import hold_of
from fuzzyarm.envs.physics.records import filled, flat
from fuzzyarm.envs.physics.robot import robot_named

LANES = 7


@pytest.fixture(params=slow_but(ROBOTS.keys() - {"panda"}, ROBOTS))
def robot(request):
    return ROBOTS[request.param]


def arm_of(robot, payload=0.0, place=0.0, tip_payload=0.0):
    physics = physics_of(robot)
    return physics.constants(physics.plant_of(robot), payload, place, tip_payload)


def drawn(robot, count=3, scale=2.0):
    physics, generator = physics_of(robot), np.random.default_rng(2)
    values = generator.uniform(-scale, scale, (count, len(robot), LANES))
    return [physics.PerJoint(*rows) for rows in values], values.swapaxes(-1, -2)


def test_readings_are_those_of_the_textbook_with_payloads(robot):
    physics, loaded = physics_of(robot), robot.with_payload(1.5, "link").with_payload(2.5)
    arm = arm_of(robot, 1.5, 0.0, 2.5)
    (angles, rates, accelerations), (q, dq, ddq) = drawn(robot)
    torque = np.stack(physics.inverse_dynamics(angles, rates, accelerations, arm), axis=-1)
    np.testing.assert_allclose(torque, rigid_body.inverse_dynamics(loaded, q, dq, ddq), atol=1e-10)
    weight = np.stack(physics.gravity(angles, arm), axis=-1)
    np.testing.assert_allclose(weight, rigid_body.gravity(loaded, q), atol=1e-10)
    mass = np.moveaxis(np.array(physics.mass_matrix(angles, arm)), -1, 0)
    np.testing.assert_allclose(mass, rigid_body.mass_matrix(loaded, q), atol=1e-10)
    tip = np.stack(physics.tip(angles, arm), axis=-1)
    np.testing.assert_allclose(tip, rigid_body.frames(loaded, q).tip[..., : physics.axes], atol=1e-13)
    jacobian = rigid_body.tip_jacobian(loaded, q)[..., : physics.axes, :]
    velocity = np.stack(physics.tip_velocity(angles, rates, arm), axis=-1)
    np.testing.assert_allclose(velocity, np.einsum("...ij,...j->...i", jacobian, dq), atol=1e-12)
    force = ddq[..., : physics.axes] if len(robot) >= physics.axes else np.repeat(ddq, physics.axes, axis=-1)
    load = np.stack(physics.tip_load(angles, physics.Point(*force.T), arm), axis=-1)
    np.testing.assert_allclose(load, np.einsum("...ji,...j->...i", jacobian, force[..., : physics.axes]), atol=1e-12)


def test_accelerations_of_a_step_solve_the_equation_of_motion(robot):
    robot = without_losses(robot)
    physics, arm, h = physics_of(robot), arm_of(robot), 1e-9
    (motor, link, rate), (_, q, dq) = drawn(robot)
    motor = physics.PerJoint(*(a + 1e-3 * b for a, b in zip(link, motor, strict=True)))
    force = np.random.default_rng(3).uniform(-50.0, 50.0, (physics.axes, LANES))
    state, still = physics.State(motor, link, rate, rate), physics.PerJoint(*np.zeros((len(robot), LANES)))
    after = physics.step(state, still, physics.Point(*force), arm, h)
    acceleration = (np.stack(after.link_velocity, axis=-1) - dq) / h
    spring = robot.drive("stiffness") * (np.stack(motor, axis=-1) - q)
    outer = np.einsum("kji,jk->ki", rigid_body.tip_jacobian(robot, q)[:, : physics.axes], force)
    torque = rigid_body.inverse_dynamics(robot, q, dq, acceleration)
    np.testing.assert_allclose(torque, spring + outer, atol=2e-4 * np.abs(torque).max())


def test_numpy_machine_code_and_torch_agree_and_a_lane_is_the_single_arm_bit_for_bit():
    robot = robot_named("planar-3r")
    physics, generator = physics_of(robot), np.random.default_rng(1)
    hold = hold_of(physics)
    state = generator.uniform(-1.0, 1.0, (4 * len(robot), LANES))
    state[: len(robot)] = state[len(robot) : 2 * len(robot)]
    torque, force = generator.uniform(-20.0, 20.0, (3, LANES)), generator.uniform(-9.0, 9.0, (6, LANES))
    constants = np.repeat(np.array(flat(arm_of(robot)))[:, np.newaxis], LANES, axis=1)
    lanes, single = state.copy(), state[:, 3:4].copy()
    hold(lanes, torque, force, constants, 2e-4, 1)
    hold(single, *(given[:, 3:4].copy() for given in (torque, force, constants)), 2e-4, 1)
    np.testing.assert_array_equal(single, lanes[:, 3:4])
    for kind, close in ((np.array, 1e-15), (torch.tensor, 1e-13)):
        before, arm = filled(physics.State, map(kind, state)), filled(physics.Arm, map(kind, constants))
        given = physics.PerJoint(*map(kind, torque)), physics.Point(*map(kind, force[:3]))
        after = np.stack([np.asarray(row) for row in flat(physics.step(before, *given, arm, 2e-4))])
        np.testing.assert_allclose(after, lanes, atol=close, rtol=10.0 * close)


def swing(robot, h, seconds, velocity=1.0):
    """The states along a free motion, the springs unloaded at its start."""
    physics, arm = physics_of(robot), arm_of(robot)
    start = physics.PerJoint(*np.linspace(0.3, 0.9, len(robot)))
    rate = physics.PerJoint(*np.linspace(velocity, -velocity, len(robot)))
    still, no_force = physics.PerJoint(*[0.0] * len(robot)), physics.Point(*[0.0] * physics.axes)
    state = physics.State(start, start, rate, rate)
    for _ in range(round(seconds / h)):
        state = physics.step(state, still, no_force, arm, h)
        yield np.array(state)


@pytest.mark.parametrize("name", ["planar-3r", "skewed"])
def test_energy_is_kept_to_second_order_without_losses_and_the_step_has_order_two(name):
    robot = without_losses(ROBOTS[name])

    def drift(h):
        motor, link, motor_rate, rate = np.stack(list(swing(robot, h, 0.04)), axis=1)
        springs = 0.5 * (motor - link) ** 2 @ robot.drive("stiffness")
        motors = 0.5 * motor_rate**2 @ robot.drive("motor_inertia")
        return np.ptp(springs + motors + kinetic_energy(robot, link, rate) + potential_energy(robot, link))

    assert 3.0 < drift(4e-4) / drift(2e-4) < 5.5
    damped = with_drives(ROBOTS[name], static_friction=0.0, coulomb_friction=0.0)
    ends = [list(swing(damped, h, 0.012))[-1] for h in (4e-4, 2e-4, 5e-5)]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert 3.0 < errors[0] / errors[1] < 5.5


def test_a_motor_below_its_static_friction_sticks_exactly():
    robot = with_drives(robot_named("ur5"), static_friction=1000.0, coulomb_friction=900.0)
    for motor, _, motor_rate, _ in swing(robot, 2e-4, 0.01, velocity=0.0):
        assert (motor_rate == 0.0).all()
        np.testing.assert_array_equal(motor, np.linspace(0.3, 0.9, 6))


def test_robots_of_one_structure_share_their_equations():
    assert physics_of(robot_named("ur5").with_payload(0.0)) is physics_of(robot_named("ur5"))
