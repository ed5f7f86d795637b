"""What can be read off the state of the arm: angles and velocities by joint, the tip, the friction of the motors.

Elementwise source, see `elementwise`.
"""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import Arm, Plant, State, gravity_torque, joint_torque, lump
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import friction_torque
from fuzzyarm.envs.physics.records import PerJoint, Point

__all__ = [
    "at_rest",
    "link_angles",
    "link_velocities",
    "motor_angles",
    "motor_friction",
    "motor_velocities",
    "static_deflection",
    "tip_point",
]


@register_jitable(forceinline=True)
def motor_angles(state: State) -> PerJoint:
    """Return q_a [rad]."""
    return PerJoint(state.motor1, state.motor2)


@register_jitable(forceinline=True)
def link_angles(state: State) -> PerJoint:
    """Return q_b [rad]."""
    return PerJoint(state.link1, state.link2)


@register_jitable(forceinline=True)
def motor_velocities(state: State) -> PerJoint:
    """Return q̇_a [rad/s]."""
    return PerJoint(state.motor_velocity1, state.motor_velocity2)


@register_jitable(forceinline=True)
def link_velocities(state: State) -> PerJoint:
    """Return q̇_b [rad/s]."""
    return PerJoint(state.link_velocity1, state.link_velocity2)


@register_jitable(forceinline=True)
def tip_point(angles: PerJoint, arm: Arm) -> Point:
    """Return the tip [m] of (26) at joint angles [rad]."""
    sin1, cos1 = sine_cosine(angles.joint1)
    sin12, cos12 = sine_cosine(angles.joint1 + angles.joint2)
    return Point(arm.length1 * cos1 + arm.length2 * cos12, arm.length1 * sin1 + arm.length2 * sin12)


@register_jitable(forceinline=True)
def motor_friction(state: State, torque: PerJoint, bias: PerJoint, arm: Arm) -> PerJoint:
    """Return Γ_f [N m] of the motors under their torques and the biases that act beside them [N m]."""
    joint1, joint2 = joint_torque(state, arm)
    net1, net2 = torque.joint1 + bias.joint1 - joint1, torque.joint2 + bias.joint2 - joint2
    return PerJoint(
        friction_torque(state.motor_velocity1, net1, arm.coulomb1, arm.static1, arm.stribeck_velocity),
        friction_torque(state.motor_velocity2, net2, arm.coulomb2, arm.static2, arm.stribeck_velocity),
    )


@register_jitable
def static_deflection(link: PerJoint, plant: Plant) -> PerJoint:
    """Return g(q_b)/k_t [rad], by which the motors lead the links q_b [rad] at rest, without a payload."""
    sin1, sin12 = sine_cosine(link.joint1)[0], sine_cosine(link.joint1 + link.joint2)[0]
    gravity1, gravity2 = gravity_torque(sin1, sin12, lump(plant))
    return PerJoint(gravity1 / plant.stiffness[0], gravity2 / plant.stiffness[1])


@register_jitable
def at_rest(link: PerJoint, deflection: PerJoint, zero: Any) -> State:
    """Return the state at rest with the links at these angles [rad] and the motors a deflection [rad] ahead.

    `zero` is the velocity 0 in the number type of the state.
    """
    motor1, motor2 = link.joint1 + deflection.joint1, link.joint2 + deflection.joint2
    return State(motor1, motor2, link.joint1, link.joint2, zero, zero, zero, zero)
