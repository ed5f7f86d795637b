"""The torque that the links need, from the equations of `envs.physics.dynamics`, for any number type.

    R(q, q̇, q̈, F) = M(q) q̈ + C(q, q̇) q̇ + g(q) - J(q)ᵀ F;        the joints provide it: K φ + B φ̇ = R,  φ = θ - q.

R is linear in q̈ and in the constants of the arm. On balls, jets and power series it is the same text that the
environment compiles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from fuzzyarm.envs.physics.dynamics import Arm, coriolis_torque, gravity_torque, mass_matrix, tip_force_torque
from fuzzyarm.envs.physics.elementwise import sine_cosine

__all__ = ["LinkMotion", "link_torque"]


class LinkMotion(NamedTuple):
    """Angles [rad], velocities [rad/s] and accelerations [rad/s²] of the links, pairs of any number type."""

    angle: Any
    velocity: Any
    acceleration: Any


def link_torque(motion: LinkMotion, force: Any, arm: Arm) -> tuple[Any, Any]:
    """Return R [N m] for a motion of the links and a tip force (x, y) [N]."""
    (q1, q2), (dq1, dq2), (ddq1, ddq2) = motion
    (sin1, cos1), (sin2, cos2), (sin12, cos12) = sine_cosine(q1), sine_cosine(q2), sine_cosine(q1 + q2)
    m11, m12, m22 = mass_matrix(cos2, arm)
    coriolis1, coriolis2 = coriolis_torque(sin2, dq1, dq2, arm)
    gravity1, gravity2 = gravity_torque(sin1, sin12, arm)
    force1, force2 = tip_force_torque(sin1, cos1, sin12, cos12, force[0], force[1], arm)
    return (
        m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1 - force1,
        m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2 - force2,
    )
