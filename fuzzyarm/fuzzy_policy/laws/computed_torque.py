"""Computed torque on the rigid model, the classical alternative to the fuzzy policy.

    u = M(q) (q̈_d - 3ω ė - 3ω² e - ω³ x_I) + C(q, q̇) q̇ + g(q) + f_v q̇,      e = q_a - q_d,   x_I = ∫ e dt,

M with the motor inertias, measured on the motor side: on the rigid arm a triple pole at -ω. The law has the same
information, integral action and torque limits as the fuzzy policy.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_columns, in_list, reader
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.compiled_law import CompiledLaw, spread_of
from fuzzyarm.fuzzy_policy.known_arm import constants_of, drives_in, drives_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import estimate_parts, state_part
from fuzzyarm.fuzzy_policy.laws.sampled_margins import ONE_AT_A_TIME, LinearLaw, Place, places_of, worst_radius
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["BANDWIDTH", "ComputedTorquePolicy", "bandwidth_for", "linear_computed_torque"]

BANDWIDTH = 70.0
"""Default ω [rad/s] of a two-joint arm, and the largest one of a robot."""

STEP = 5.0  # rad/s


class ComputedTorquePolicy(Policy):
    """Computed torque with integral action; the law is in the module's docstring."""

    integral_at: int | None = 0

    def __init__(
        self,
        parameters: AnyArm | None = None,
        control_period: float = 1e-3,
        bandwidth: float | None = None,
    ) -> None:
        """Prepare the law.

        Args:
            parameters: the arm or the robot, as the controller knows it; default Table 1.
            control_period: T, time between two calls [s].
            bandwidth: ω [rad/s]; None for that of `bandwidth_for`.

        Raises:
            TypeError: a number is none.
            ValueError: the control period or the bandwidth is not positive.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        chosen = bandwidth_for(self.parameters, self.control_period) if bandwidth is None else bandwidth
        self.bandwidth = real("bandwidth", chosen, "rad/s", above=0.0)
        arm = constants_of(self.parameters), drives_of(self.parameters)
        self._arguments = (*arm, self.bandwidth, self.control_period)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        self._law(observation, memory, torque, *self._arguments)

    def compiled(self) -> CompiledLaw:
        """Return the law for compiled loops."""
        return CompiledLaw("computed_torque", spread_of(self._law), self._arguments)

    @functools.cached_property
    def _law(self) -> Any:
        return _law_of(equations_of(self.parameters))


@functools.lru_cache(maxsize=32)
def bandwidth_for(arm: AnyArm, control_period: float) -> float:
    """Return the default ω [rad/s] for an arm and a control period [s].

    That of the two-joint arm was chosen by ``python benchmarks/computed_torque_tuning.py``: the largest that stays
    stable with twice the loop gain and with one sample of delay. So it is for a robot, at random postures of its range:
    the largest of 70, 65, ..., 5 rad/s, and 5 rad/s if there is none.
    """
    if not isinstance(arm, Robot):
        return BANDWIDTH
    places, bandwidth = places_of(arm, control_period), BANDWIDTH
    while bandwidth > STEP and any(
        worst_radius(place, linear_computed_torque(place, bandwidth), ONE_AT_A_TIME) >= 1.0 for place in places
    ):
        bandwidth -= STEP
    return bandwidth


def linear_computed_torque(place: Place, bandwidth: float) -> LinearLaw:
    """Return the law of a bandwidth [rad/s] near rest, at a posture of a robot; its memory is x_I."""
    robot, joints = place.robot, len(place.robot)
    part, nothing = estimate_parts(joints), np.zeros((joints, state_part(joints).stop))
    inertia = place.inertia + np.diag(robot.drive("motor_inertia"))
    D, G = nothing.copy(), nothing.copy()
    D[:, part.q_motor] = -3.0 * bandwidth**2 * inertia
    D[:, part.dq_motor] = -3.0 * bandwidth * inertia + np.diag(robot.drive("viscous_friction"))
    G[:, part.q_motor] = place.control_period * np.eye(joints)
    return LinearLaw(D, -(bandwidth**3) * inertia, G, np.eye(joints))


@functools.cache
def _law_of(physics: Physics) -> Any:
    """Return the compiled law for arms with these equations."""
    joints, inverse_dynamics = physics.joints, physics.inverse_dynamics
    arm_in, per_joint = reader(physics.Arm, in_list), reader(physics.PerJoint, in_columns)

    @kernel_for(physics.digest)
    def computed_torque(
        observation: np.ndarray,
        integral: np.ndarray,
        torque: np.ndarray,
        constants: np.ndarray,
        drives: np.ndarray,
        bandwidth: float,
        period: float,
    ) -> None:
        """Evaluate the law for every lane and advance its integral."""
        arm, drive, o = arm_in(constants, 0), drives_in(drives), observed(observation)
        for lane in range(len(observation)):
            for joint in range(joints):
                error = o.q_motor[lane, joint] - o.q_reference[lane, joint]
                error_rate = o.dq_motor[lane, joint] - o.dq_reference[lane, joint]
                feedback = 3.0 * error_rate + bandwidth * (3.0 * error + bandwidth * integral[lane, joint])
                # The acceleration that is asked for stands where the torque will be.
                torque[lane, joint] = o.ddq_reference[lane, joint] - bandwidth * feedback
                integral[lane, joint] += period * error
            q, dq = per_joint(o.q_motor, lane), per_joint(o.dq_motor, lane)
            links = inverse_dynamics(q, dq, per_joint(torque, lane), arm)
            for joint in range(joints):
                motor = drive.motor_inertia[joint] * torque[lane, joint]
                torque[lane, joint] = links[joint] + motor + drive.viscous_friction[joint] * o.dq_motor[lane, joint]

    return computed_torque
