"""What the adaptive observer needs of the arm: compiled functions on arrays with one number for each joint.

`hold` advances copies of the arm over some sub-steps. An arm of another kind is another module with these names; the
filter and the law take the number of joints from their arrays.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import arm_in, coriolis_torque, gravity_torque, mass_matrix, tip_force_torque
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.hold import force_line, hold_of
from fuzzyarm.envs.physics.records import size
from fuzzyarm.envs.physics.two_joints import two_joints

__all__ = ["FORCE_ROWS", "drive_constants", "dry_friction", "link_torque", "schedule", "tip_direction"]

FORCE_ROWS = size(force_line(two_joints().axes))
"""Numbers of a force that is linear in time: its mean, then its change."""
hold = hold_of(two_joints())
REST = 1e-9  # m/s; below, a tip has no direction of travel


@register_jitable
def link_torque(
    q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, force: np.ndarray, constants: np.ndarray, torque: np.ndarray
) -> None:
    """Fill `torque` (n,) with M q̈ + C q̇ + g - Jᵀ F [N m], the torque of the joints under a tip force F [N]."""
    arm = arm_in(constants, 0)
    (sin1, cos1), (sin12, cos12), (sin2, cos2) = sine_cosine(q[0]), sine_cosine(q[0] + q[1]), sine_cosine(q[1])
    m11, m12, m22 = mass_matrix(cos2, arm)
    coriolis = coriolis_torque(sin2, dq[0], dq[1], arm)
    gravity = gravity_torque(sin1, sin12, arm)
    outer = tip_force_torque(sin1, cos1, sin12, cos12, force[0], force[1], arm)
    torque[0] = m11 * ddq[0] + m12 * ddq[1] + coriolis[0] + gravity[0] - outer[0]
    torque[1] = m12 * ddq[0] + m22 * ddq[1] + coriolis[1] + gravity[1] - outer[1]


@register_jitable
def tip_direction(q: np.ndarray, dq: np.ndarray, constants: np.ndarray, direction: np.ndarray) -> None:
    """Fill `direction` (2,) with v/|v| of the tip at q (n,) [rad] and q̇ (n,) [rad/s], zeros at rest."""
    arm = arm_in(constants, 0)
    first, second = arm.length1 * dq[0], arm.length2 * (dq[0] + dq[1])
    (sin1, cos1), (sin12, cos12) = sine_cosine(q[0]), sine_cosine(q[0] + q[1])
    x, y = -sin1 * first - sin12 * second, cos1 * first + cos12 * second
    speed = np.sqrt(x * x + y * y)
    scale = 1.0 / speed if speed > REST else 0.0
    direction[0], direction[1] = x * scale, y * scale


@register_jitable
def drive_constants(constants: np.ndarray, joint: int) -> tuple[float, float, float, float]:
    """Return motor inertia [kg m²], viscous friction [N m s/rad], stiffness [N m/rad] and damping of a joint.

    `constants` (20,) are those of `Arm`.
    """
    arm = arm_in(constants, 0)
    if joint == 0:
        return arm.motor_inertia1, arm.viscous1, arm.stiffness1, arm.damping1
    return arm.motor_inertia2, arm.viscous2, arm.stiffness2, arm.damping2


@register_jitable
def dry_friction(velocity: float, constants: np.ndarray, joint: int) -> float:
    """Return the torque [N m] that overcomes dry friction at a velocity [rad/s], 0 at rest; `constants` (20,)."""
    arm = arm_in(constants, 0)
    coulomb, static = (arm.coulomb1, arm.static1) if joint == 0 else (arm.coulomb2, arm.static2)
    torque: float = stribeck_magnitude(velocity, coulomb, static, arm.stribeck_velocity) * np.sign(velocity)
    return torque


@register_jitable
def schedule(q: np.ndarray) -> float:
    """Return what the regulator is tabulated over, cos q2, for joint angles (n,) [rad]."""
    cosine: float
    _, cosine = sine_cosine(q[1])
    return cosine
