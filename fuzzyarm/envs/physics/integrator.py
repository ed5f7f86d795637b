"""The time step of the two-joint arm: half drift, kick with exact stick, half drift; second order.

Over a sub-step h the positions move half-way, the accelerations are taken there, and the velocities jump:

    x_m = x + h/2 v,    v_m = v + h/2 a(x_m, v),    v' = v + h a(x_m, v_m),    x' = x_m + h/2 v'.

The configuration-dependent terms (sines, mass matrix, gravity, tip force) are computed once a sub-step, at x_m;
only the velocity-dependent ones are computed twice. The motors' velocities are advanced by `stick_slip`, so
stick is exact. The torque is held over the control step; the tip force is linear in it.
"""

from __future__ import annotations

from typing import Any

from fuzzyarm.envs.physics.dynamics import (
    Arm,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    solve_mass_matrix,
    tip_force_torque,
)
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import stick_slip, stribeck_magnitude
from fuzzyarm.envs.physics.records import PerJoint, Point, State
from fuzzyarm.numbers.functions import apart

__all__ = ["drifted", "kick", "kick_twice", "loaded_step", "step"]


def kick(
    start: State,
    middle: State,
    torque: PerJoint,
    outer: PerJoint,
    sin2: Any,
    cos2: Any,
    arm: Arm,
    duration: Any,
) -> tuple[PerJoint, PerJoint, PerJoint]:
    """Advance the velocities of `start` over `duration` with the accelerations at `middle`.

    Returns:
        The velocities of motors and links [rad/s], and the angles the motors travelled [rad].
    """
    joint1, joint2 = joint_torque(middle, arm)
    inverse1, inverse2 = 1.0 / arm.motor_inertia1, 1.0 / arm.motor_inertia2  # products cost less than quotients
    coriolis1, coriolis2 = coriolis_torque(sin2, middle.link_velocity.joint1, middle.link_velocity.joint2, arm)
    acceleration1, acceleration2 = solve_mass_matrix(
        cos2, joint1 + outer.joint1 - coriolis1, joint2 + outer.joint2 - coriolis2, arm
    )
    velocity1, velocity2 = middle.motor_velocity
    motor_velocity1, travelled1 = stick_slip(
        start.motor_velocity.joint1,
        (torque.joint1 - joint1 - arm.viscous1 * velocity1) * inverse1,
        stribeck_magnitude(velocity1, arm.dry_friction1) * inverse1,
        duration,
    )
    motor_velocity2, travelled2 = stick_slip(
        start.motor_velocity.joint2,
        (torque.joint2 - joint2 - arm.viscous2 * velocity2) * inverse2,
        stribeck_magnitude(velocity2, arm.dry_friction2) * inverse2,
        duration,
    )
    link_velocity1 = start.link_velocity.joint1 + duration * acceleration1
    link_velocity2 = start.link_velocity.joint2 + duration * acceleration2
    return (
        PerJoint(motor_velocity1, motor_velocity2),
        PerJoint(link_velocity1, link_velocity2),
        PerJoint(travelled1, travelled2),
    )


def kick_twice(
    start: State, middle: State, torque: PerJoint, outer: PerJoint, sin2: Any, cos2: Any, arm: Arm, h: Any
) -> State:
    """Return the state a sub-step h [s] after `start`, from the mid positions on; `middle` has the velocities of start.

    The accelerations are evaluated twice: with the old velocities over h/2, then with those over h. `torque` is that
    of the motors, `outer` all that acts on the links beside the joints and the velocities [N m].
    """
    half = 0.5 * h
    motor_velocity, link_velocity, _ = kick(start, middle, torque, outer, sin2, cos2, arm, half)
    middle = State(middle.motor, middle.link, motor_velocity, link_velocity)
    motor_velocity, link_velocity, travelled = kick(start, middle, torque, outer, sin2, cos2, arm, h)
    return State(
        PerJoint(start.motor.joint1 + travelled.joint1, start.motor.joint2 + travelled.joint2),
        drifted(middle.link, link_velocity, half),
        motor_velocity,
        link_velocity,
    )


def drifted(angle: PerJoint, velocity: PerJoint, duration: Any) -> PerJoint:
    """Return the angles [rad] after a duration [s] at constant velocities [rad/s]."""
    return PerJoint(angle.joint1 + duration * velocity.joint1, angle.joint2 + duration * velocity.joint2)


@apart
def step(state: State, torque: PerJoint, force: Point, arm: Arm, h: Any) -> State:
    """Advance the elastic arm by one sub-step h [s] under motor torques [N m] and a tip force [N]."""
    half = 0.5 * h
    motor, link = drifted(state.motor, state.motor_velocity, half), drifted(state.link, state.link_velocity, half)
    sin1, cos1 = sine_cosine(link.joint1)
    sin12, cos12 = sine_cosine(link.joint1 + link.joint2)
    sin2, cos2 = sin12 * cos1 - cos12 * sin1, cos12 * cos1 + sin12 * sin1
    force1, force2 = tip_force_torque(sin1, cos1, sin12, cos12, force.x, force.y, arm)
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
    outer = PerJoint(force1 - gravity1, force2 - gravity2)
    middle = State(motor, link, state.motor_velocity, state.link_velocity)
    after: State = kick_twice(state, middle, torque, outer, sin2, cos2, arm, h)
    return after


def loaded_step(state: State, torque: PerJoint, load: PerJoint, arm: Arm, h: Any) -> State:
    """Do what `step` does, with torques `load` [N m] on the links in place of a tip force."""
    half = 0.5 * h
    motor, link = drifted(state.motor, state.motor_velocity, half), drifted(state.link, state.link_velocity, half)
    sin1, cos1 = sine_cosine(link.joint1)
    sin2, cos2 = sine_cosine(link.joint2)
    gravity1, gravity2 = gravity_torque(sin1, sin1 * cos2 + cos1 * sin2, arm)
    outer = PerJoint(load.joint1 - gravity1, load.joint2 - gravity2)
    middle = State(motor, link, state.motor_velocity, state.link_velocity)
    after: State = kick_twice(state, middle, torque, outer, sin2, cos2, arm, h)
    return after
