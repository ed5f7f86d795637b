"""What can be read off the state of the two-joint arm: the tip, the friction of the motors, the torque of gravity.

Elementwise source, see `elementwise`.
"""

from __future__ import annotations

from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import Arm, gravity_torque, joint_torque
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import friction_torque
from fuzzyarm.envs.physics.records import PerJoint, Point, State

__all__ = ["gravity_at", "motor_friction", "tip_point"]


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
    velocity1, velocity2 = state.motor_velocity
    return PerJoint(
        friction_torque(velocity1, net1, arm.coulomb1, arm.static1, arm.stribeck_velocity),
        friction_torque(velocity2, net2, arm.coulomb2, arm.static2, arm.stribeck_velocity),
    )


@register_jitable
def gravity_at(angles: PerJoint, arm: Arm) -> PerJoint:
    """Return g(q) [N m] at joint angles [rad]."""
    sin1, sin12 = sine_cosine(angles.joint1)[0], sine_cosine(angles.joint1 + angles.joint2)[0]
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
    return PerJoint(gravity1, gravity2)
