"""Plain NumPy twins of compiled functions."""

import numpy as np
from scipy.interpolate import interp1d

from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import filled, flat
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.fuzzy_policy.laws._gain_schedule import _GRID


def hold_numpy(physics, state, torque, force, arm, h, substeps):
    """Return the new states (numbers of the state, lanes), with shapes and units of `hold_of`."""
    before, constants = filled(physics.State, state), filled(physics.Arm, arm)
    line = force[: physics.axes], force[physics.axes :]
    return np.stack(flat(held_of(physics)(before, physics.PerJoint(*torque), *line, constants, h, substeps)))


def observer_law(policy, seen, prediction, desired, feedforward):
    """Return the corrected estimate (10,) and the torque (2,) [N m] of an `ElasticObserverPolicy`, before its limits.

    Its prediction is (10,), its target θ_d, θ̇_d (4,) and u_ff (2,); the gains are interpolated over cos q2.
    """
    tables = policy.feedback, policy.observer
    feedback, gain = (interp1d(_GRID, table, axis=0)(np.cos(seen[1])) for table in tables)
    estimate = prediction + gain @ (seen[:4] - prediction[[0, 1, 4, 5]])
    unbent = desired[:2] - estimate[8:] / policy.parameters.stiffness
    error = estimate[:8] - np.concatenate([unbent, seen[4:6], desired[2:4], seen[6:8]])
    return estimate, feedforward - estimate[8:] - feedback @ error


def scheduled_torque(controller, q, dq, target, integral):
    """Return u (..., n) [N m] of a controller of the semidefinite form at q, dq and x_I (..., n)."""
    robot, (k_p, k_d, k_i) = controller.robot, controller.feedback
    q_d, dq_d, ddq_d = target
    wanted = k_p * (q - q_d) + k_d * (dq - dq_d) + k_i * integral
    feedback = (controller.inertia_at(q) @ wanted[..., np.newaxis])[..., 0]
    rotors = robot.drive("motor_inertia") * ddq_d + robot.drive("viscous_friction") * dq
    return np.asarray(inverse_dynamics(robot, q, dq, np.broadcast_to(ddq_d, q.shape)) + rotors - feedback)
