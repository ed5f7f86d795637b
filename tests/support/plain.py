"""Plain NumPy twins of compiled functions."""

import numpy as np

from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import filled, flat
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics


def hold_numpy(physics, state, torque, force, arm, h, substeps):
    """Return the new states (numbers of the state, lanes), with shapes and units of `hold_of`."""
    before, constants = filled(physics.State, state), filled(physics.Arm, arm)
    after = held_of(physics)(
        before, physics.PerJoint(*torque), force[: physics.axes], force[physics.axes :], constants, h, substeps
    )
    return np.stack(flat(after))


def scheduled_torque(controller, q, dq, target, integral):
    """Return u (..., n) [N m] of a controller of the semidefinite form at q, dq and x_I (..., n)."""
    robot, (k_p, k_d, k_i) = controller.robot, controller.feedback
    q_d, dq_d, ddq_d = target
    wanted = k_p * (q - q_d) + k_d * (dq - dq_d) + k_i * integral
    feedback = (controller.inertia_at(q) @ wanted[..., np.newaxis])[..., 0]
    rotors = robot.drive("motor_inertia") * ddq_d + robot.drive("viscous_friction") * dq
    return np.asarray(inverse_dynamics(robot, q, dq, np.broadcast_to(ddq_d, q.shape)) + rotors - feedback)
