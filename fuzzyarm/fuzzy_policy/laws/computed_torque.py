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
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.compiled import kernel_for
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import BLOCK, in_block, in_list, places, reader, record_type, size, writer
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.blocks import into_block, out_of_block
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
    joints, inverse_dynamics, PerJoint = physics.joints, physics.inverse_dynamics, physics.PerJoint
    Seen = record_type("Seen", **dict.fromkeys(Observation._fields, PerJoint))
    Block = record_type("Block", seen=Seen, x_I=PerJoint, asked=PerJoint, torque=PerJoint)
    at, rows, arm_in = places(Block), size(Block), reader(physics.Arm, in_list)
    q, dq, q_d, dq_d, ddq_d, x_I, asked, torque_at = (BLOCK * part[0] for part in (*at.seen, *at[1:]))
    q_in, dq_in, asked_in = (reader(PerJoint, in_block, part) for part in (at.seen.q_motor, at.seen.dq_motor, at.asked))
    write_torque = writer(PerJoint, in_block, at.torque)

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
        arm, drive, block = arm_in(constants, 0), drives_in(drives), np.empty(rows * BLOCK)
        for first in range(0, len(observation), BLOCK):
            lanes = min(BLOCK, len(observation) - first)
            into_block(observation, first, lanes, block, q // BLOCK)
            into_block(integral, first, lanes, block, x_I // BLOCK)
            for joint in range(joints):
                for lane in range(lanes):
                    place = joint * BLOCK + lane
                    error, error_rate = block[q + place] - block[q_d + place], block[dq + place] - block[dq_d + place]
                    feedback = 3.0 * error_rate + bandwidth * (3.0 * error + bandwidth * block[x_I + place])
                    block[asked + place] = block[ddq_d + place] - bandwidth * feedback
                    block[x_I + place] += period * error
            for lane in range(lanes):
                links = inverse_dynamics(q_in(block, lane), dq_in(block, lane), asked_in(block, lane), arm)
                write_torque(block, lane, links)
            for joint in range(joints):
                inertia, viscous = drive.motor_inertia[joint], drive.viscous_friction[joint]
                for lane in range(lanes):
                    place = joint * BLOCK + lane
                    links_and_motor = block[torque_at + place] + inertia * block[asked + place]
                    block[torque_at + place] = links_and_motor + viscous * block[dq + place]
            out_of_block(block, x_I // BLOCK, integral, first, lanes)
            out_of_block(block, torque_at // BLOCK, torque, first, lanes)

    return computed_torque
