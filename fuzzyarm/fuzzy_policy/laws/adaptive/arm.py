"""What the adaptive observer needs of the two-joint arm beside its step: compiled, on arrays with one number per joint.

An arm with more joints is another module with these functions.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import arm_in, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.friction import stribeck_magnitude

__all__ = ["FORCE_ROWS", "gravity_of", "joint_parts", "link_torque", "tip_direction"]

FORCE_ROWS = 4


@register_jitable
def link_torque(q, dq, ddq, force, constants, torque):
    """Fill torque with M q̈ + C q̇ + g - Jᵀ F [N m]."""
    arm = arm_in(constants, 0)
    sin2, cos2 = np.sin(q[1]), np.cos(q[1])
    sin1, cos1 = np.sin(q[0]), np.cos(q[0])
    sin12, cos12 = sin1 * cos2 + cos1 * sin2, cos1 * cos2 - sin1 * sin2
    m11, m12, m22 = mass_matrix(cos2, arm)
    c1, c2 = coriolis_torque(sin2, dq[0], dq[1], arm)
    g1, g2 = gravity_torque(sin1, sin12, arm)
    second = arm.length2 * (cos12 * force[1] - sin12 * force[0])
    first = arm.length1 * (cos1 * force[1] - sin1 * force[0]) + second
    torque[0] = m11 * ddq[0] + m12 * ddq[1] + c1 + g1 - first
    torque[1] = m12 * ddq[0] + m22 * ddq[1] + c2 + g2 - second


@register_jitable
def tip_direction(q, dq, constants, direction):
    """Fill direction (2,) with v/|v| of the tip; zeros at rest."""
    arm = arm_in(constants, 0)
    along1, along12 = arm.length1 * dq[0], arm.length2 * (dq[0] + dq[1])
    x = -np.sin(q[0]) * along1 - np.sin(q[0] + q[1]) * along12
    y = np.cos(q[0]) * along1 + np.cos(q[0] + q[1]) * along12
    speed = np.sqrt(x * x + y * y)
    scale = 1.0 / speed if speed > 1e-9 else 0.0
    direction[0], direction[1] = x * scale, y * scale


@register_jitable
def joint_parts(constants):
    """Return motor inertia, viscous friction, stiffness, damping, static and Coulomb friction of each joint."""
    arm = arm_in(constants, 0)
    return (
        (arm.motor_inertia1, arm.motor_inertia2),
        (arm.viscous1, arm.viscous2),
        (arm.stiffness1, arm.stiffness2),
        (arm.damping1, arm.damping2),
        (arm.static1, arm.static2),
        (arm.coulomb1, arm.coulomb2),
        arm.stribeck_velocity,
    )
