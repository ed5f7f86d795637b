"""What can be read off the two-joint arm: the tip, the friction of the motors, torques of gravity and of motions.

Elementwise source, see `elementwise`.
"""

from __future__ import annotations

from typing import Any

from fuzzyarm.envs.physics.dynamics import (
    Arm,
    coriolis_torque,
    gravity_torque,
    joint_torque,
    mass_matrix,
    motors,
    tip_force_torque,
)
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import friction_torque
from fuzzyarm.envs.physics.records import PerJoint, Point

__all__ = [
    "gravity_at",
    "inverse_dynamics_at",
    "mass_matrix_at",
    "motor_friction",
    "tip_load",
    "tip_point",
    "tip_velocity",
]


def tip_point(angles: PerJoint, arm: Arm) -> Point:
    """Return the tip [m] of (26) at joint angles [rad]."""
    sin1, cos1 = sine_cosine(angles.joint1)
    sin12, cos12 = sine_cosine(angles.joint1 + angles.joint2)
    return Point(arm.length1 * cos1 + arm.length2 * cos12, arm.length1 * sin1 + arm.length2 * sin12)


def tip_velocity(angles: PerJoint, rates: PerJoint, arm: Arm) -> Point:
    """Return the velocity of the tip [m/s] at joint angles [rad] and their rates [rad/s]."""
    first, second = arm.length1 * rates.joint1, arm.length2 * (rates.joint1 + rates.joint2)
    (sin1, cos1), (sin12, cos12) = sine_cosine(angles.joint1), sine_cosine(angles.joint1 + angles.joint2)
    return Point(-sin1 * first - sin12 * second, cos1 * first + cos12 * second)


def tip_load(angles: PerJoint, force: Point, arm: Arm) -> PerJoint:
    """Return J(q)ᵀ F [N m] at joint angles [rad] for a force F [N] on the tip."""
    (sin1, cos1), (sin12, cos12) = sine_cosine(angles.joint1), sine_cosine(angles.joint1 + angles.joint2)
    load1, load2 = tip_force_torque(sin1, cos1, sin12, cos12, force.x, force.y, arm)
    return PerJoint(load1, load2)


def motor_friction(state: Any, torque: Any, bias: Any, arm: Any) -> Any:
    """Return Γ_f [N m] of the motors of any arm under their torques and the biases that act beside them [N m]."""
    joint = joint_torque(state, arm)
    return type(joint)(
        *(
            friction_torque(velocity, given + beside - load, own.dry_friction)
            for velocity, given, beside, load, own in zip(
                state.motor_velocity, torque, bias, joint, motors(arm, joint), strict=True
            )
        )
    )


def gravity_at(angles: PerJoint, arm: Arm) -> PerJoint:
    """Return g(q) [N m] at joint angles [rad]."""
    sin1, sin12 = sine_cosine(angles.joint1)[0], sine_cosine(angles.joint1 + angles.joint2)[0]
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
    return PerJoint(gravity1, gravity2)


def mass_matrix_at(angles: PerJoint, arm: Arm) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Return the rows of M(q) [kg m²] at joint angles [rad]."""
    m11, m12, m22 = mass_matrix(sine_cosine(angles.joint2)[1], arm)
    return (m11, m12), (m12, m22)


def inverse_dynamics_at(angles: PerJoint, rates: PerJoint, accelerations: PerJoint, arm: Arm) -> PerJoint:
    """Return M(q) q̈ + C(q, q̇) q̇ + g(q) [N m] for angles [rad], their rates [rad/s] and accelerations [rad/s²]."""
    sin1, sin12 = sine_cosine(angles.joint1)[0], sine_cosine(angles.joint1 + angles.joint2)[0]
    sin2, cos2 = sine_cosine(angles.joint2)
    m11, m12, m22 = mass_matrix(cos2, arm)
    coriolis1, coriolis2 = coriolis_torque(sin2, rates.joint1, rates.joint2, arm)
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
    ddq1, ddq2 = accelerations
    return PerJoint(m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1, m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2)
