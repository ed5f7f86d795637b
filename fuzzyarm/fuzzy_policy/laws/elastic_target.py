"""Where the motors must stand so that the tip is on the reference, from the observation alone.

The links need the torque τ_d = M_b(q_d) q̈_d + C(q_d, q̇_d) q̇_d + g(q_d); it bends the joints by δ = θ_d - q_d with

    B_t δ̇ + K_t δ = τ_d,    so, with b = B_t/K_t,    δ = (τ_d - b τ̇_d + b² τ̈_d - ...)/K_t.

τ_d follows from the reference in the observation; its derivatives are backward differences over the last three
control periods, so that a few past values of τ_d are all there is to remember. (`envs.scenario.elastic_reference`
solves the same equation exactly for a reference known beforehand.) The torque that goes with θ_d is the feedforward

    u_ff = I_a θ̈_d + f_v θ̇_d + F(θ̇_d) sign θ̇_d + τ_d,

by default at t_k + T/2 instead of t_k: the mean over the coming hold, extrapolated from the last two samples.

Any policy may use it, because it reads only the observation.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.physics.compiled import kernel_for, without_kernels
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import in_columns, in_list, reader
from fuzzyarm.fuzzy_policy.known_arm import constants_of, drives_in, drives_of

__all__ = ["ElasticTarget", "TargetParts", "memory_size", "target_parts"]


class _Memory(NamedTuple):
    """Where what a lane remembers from one sample to the next lies in the memory's array.

    Attributes:
        started: 1 once there has been a sample, else 0.
        latest: τ_d of the last sample [N m].
        second: τ_d of the sample before that.
        third: τ_d of the sample before that.
        smooth: u_ff of the last sample, less its friction [N m].
    """

    started: slice
    latest: slice
    second: slice
    third: slice
    smooth: slice


class TargetParts(NamedTuple):
    """Where the parts of a target lie: θ_d [rad], θ̇_d [rad/s] and θ̈_d [rad/s²]; `REFERENCE` has the same order."""

    q: slice
    dq: slice
    ddq: slice


def memory_size(joints: int) -> int:
    """Return how many numbers a lane remembers for an arm with n joints."""
    return int(_memory_parts(joints).smooth.stop)


def target_parts(joints: int) -> TargetParts:
    """Return where θ_d, θ̇_d and θ̈_d lie in a target (lanes, 3 n) of an arm with n joints."""
    return TargetParts(*consecutive(joints, joints, joints))


def _memory_parts(joints: int) -> _Memory:
    return _Memory(*consecutive(1, joints, joints, joints, joints))


class ElasticTarget:
    """θ_d, its derivatives and u_ff, sample by sample; the equations are in the module's docstring.

    Attributes:
        memory_size: numbers that a lane remembers.
        size: numbers of a target, 3 n.
    """

    def __init__(
        self, parameters: AnyArm, control_period: float, *, friction: bool = True, average: bool = True
    ) -> None:
        """Keep the arm and the control period.

        Args:
            parameters: the arm or the robot, as the controller knows it.
            control_period: T [s].
            friction: whether u_ff holds the dry friction.
            average: whether u_ff is that of the middle of the coming hold rather than that of its start.

        Raises:
            TypeError: the control period is no number.
            ValueError: the control period is not positive.
        """
        period, physics = real("control_period", control_period, "s", above=0.0), equations_of(parameters)
        self.memory_size, self.size = memory_size(physics.joints), target_parts(physics.joints).ddq.stop
        self._parameters = parameters
        arm = constants_of(parameters), drives_of(parameters)
        self._arguments = (*arm, period, float(friction), 0.5 * float(average))

    def advance(self, observation: np.ndarray, memory: np.ndarray, target: np.ndarray, feedforward: np.ndarray) -> None:
        """Fill target and feedforward and advance the memory, in place.

        Args:
            observation: (lanes, 5 n), of which the reference (q_d, q̇_d, q̈_d) is read.
            memory: (lanes, `memory_size`), zeros when an episode begins, which means that the arm was at rest before.
            target: (lanes, 3 n), becomes θ_d [rad], θ̇_d [rad/s], θ̈_d [rad/s²].
            feedforward: (lanes, n), becomes u_ff [N m], not clipped.
        """
        self._advance(observation, memory, target, feedforward, *self._arguments)

    @property
    def compiled(self) -> tuple[Any, tuple[Any, ...]]:
        """What `advance` calls, and what it gives it beside its own arguments; for compiled loops."""
        return self._advance, self._arguments

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the compiled function."""
        return without_kernels(self.__dict__)

    @functools.cached_property
    def _advance(self) -> Any:
        return _advance_of(equations_of(self._parameters))


@functools.cache
def _advance_of(physics: Physics) -> Any:
    """Return the compiled `ElasticTarget.advance` for arms with these equations."""
    joints, inverse_dynamics = physics.joints, physics.inverse_dynamics
    started, latest_part, second_part, third_part, smooth_part = _memory_parts(joints)
    q_part, dq_part, ddq_part = target_parts(joints)
    arm_in, per_joint = reader(physics.Arm, in_list), reader(physics.PerJoint, in_columns)

    @kernel_for(physics.digest)
    def advance(
        observation: np.ndarray,
        memory: np.ndarray,
        target: np.ndarray,
        feedforward: np.ndarray,
        constants: np.ndarray,
        drives: np.ndarray,
        period: float,
        friction: float,
        ahead: float,
    ) -> None:
        """See `ElasticTarget`; `friction` is 1 or 0, `ahead` the share of a period that u_ff is extrapolated."""
        arm, drive, o = arm_in(constants, 0), drives_in(drives), observed(observation)
        past, second_past, third_past = memory[:, latest_part], memory[:, second_part], memory[:, third_part]
        past_smooth, begun = memory[:, smooth_part], memory[:, started]
        theta, dtheta, ddtheta = target[:, q_part], target[:, dq_part], target[:, ddq_part]
        for lane in range(len(observation)):
            q, dq, ddq = (
                per_joint(o.q_reference, lane), per_joint(o.dq_reference, lane), per_joint(o.ddq_reference, lane)
            )  # fmt: skip
            torque = inverse_dynamics(q, dq, ddq, arm)
            begins = begun[lane, 0] == 0.0
            begun[lane, 0] = 1.0
            for joint in range(joints):
                now = torque[joint]
                if begins:
                    past[lane, joint] = second_past[lane, joint] = third_past[lane, joint] = now
                latest, second, third = past[lane, joint], second_past[lane, joint], third_past[lane, joint]
                # Backward differences of third order for τ̇_d and of second order for τ̈_d.
                rate = (11.0 * now - 18.0 * latest + 9.0 * second - 2.0 * third) / (6.0 * period)
                curvature = (2.0 * now - 5.0 * latest + 4.0 * second - third) / (period * period)
                past[lane, joint], second_past[lane, joint], third_past[lane, joint] = now, latest, second
                k, b = drive.stiffness[joint], drive.damping[joint] / drive.stiffness[joint]
                velocity = o.dq_reference[lane, joint] + (rate - b * curvature) / k
                acceleration = o.ddq_reference[lane, joint] + curvature / k
                theta[lane, joint] = o.q_reference[lane, joint] + (now - b * (rate - b * curvature)) / k
                dtheta[lane, joint], ddtheta[lane, joint] = velocity, acceleration
                smooth = drive.motor_inertia[joint] * acceleration + drive.viscous_friction[joint] * velocity + now
                before = smooth if begins else past_smooth[lane, joint]
                past_smooth[lane, joint] = smooth
                middle = velocity + ahead * period * acceleration
                dry = drive.coulomb_friction[joint], drive.static_friction[joint], drive.stribeck_velocity[joint]
                slip = stribeck_magnitude(middle, *dry) * np.sign(middle)
                feedforward[lane, joint] = smooth + ahead * (smooth - before) + friction * slip

    return advance
