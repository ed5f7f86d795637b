"""The law of a controller of the form "semidefinite" in plain NumPy, for states in lanes.

    u = M̄(q) q̈_d + C(q, q̇) q̇ + f_v q̇ + g(q) - M̂(q) (k_p e + k_d ė + k_i x_I),      M̄ = M + R,

with e = q - q_d, ė = q̇ - q̇_d, x_I = ∫ e dt. On the rigid arm M̄(q) ë = -M̂(q) (k_p e + k_d ė + k_i x_I) + d. The speed
in the Coriolis torques is the measured one, so that they leave no term in the error's equation.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController

__all__ = ["scheduled_torque"]


def scheduled_torque(
    controller: ScheduledController,
    q: np.ndarray,
    dq: np.ndarray,
    target: tuple[np.ndarray, np.ndarray, np.ndarray],
    integral: np.ndarray,
) -> np.ndarray:
    """Return u (..., n) [N m].

    Args:
        controller: of a robot of n joints.
        q: angles (..., n) [rad].
        dq: q̇ (..., n) [rad/s].
        target: q_d [rad], q̇_d [rad/s] and q̈_d [rad/s²], each (n,) or (..., n).
        integral: x_I (..., n) [rad s].
    """
    robot, (k_p, k_d, k_i) = controller.robot, controller.feedback
    q_d, dq_d, ddq_d = target
    wanted = k_p * (q - q_d) + k_d * (dq - dq_d) + k_i * integral
    feedback = (controller.inertia_at(q) @ wanted[..., np.newaxis])[..., 0]
    rotors = robot.drive("motor_inertia") * ddq_d + robot.drive("viscous_friction") * dq
    return np.asarray(inverse_dynamics(robot, q, dq, np.broadcast_to(ddq_d, q.shape)) + rotors - feedback)
