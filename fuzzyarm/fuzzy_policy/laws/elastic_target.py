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
from numba.extending import register_jitable

from fuzzyarm.common.checks import real
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import starts
from fuzzyarm.envs.physics.compiled import kernel_for, without_kernels
from fuzzyarm.envs.physics.elementwise import select, sign
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import BLOCK, in_block, in_list, places, reader, record_type, size, writer
from fuzzyarm.fuzzy_policy.blocks import into_block, out_of_block
from fuzzyarm.fuzzy_policy.known_arm import Drives, constants_of, drives_in, drives_of

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
def _block_of(physics: Physics) -> Any:
    """Return the record of what a block of lanes holds: the arguments of `advance`, and τ_d."""
    PerJoint = physics.PerJoint
    Motion = record_type("Motion", q=PerJoint, dq=PerJoint, ddq=PerJoint)
    Past = record_type("Past", started=Any, latest=PerJoint, second=PerJoint, third=PerJoint, smooth=PerJoint)
    fields = {"wanted": Motion, "memory": Past, "target": Motion, "feedforward": PerJoint, "torque": PerJoint}
    return record_type("TargetBlock", **fields)


@functools.cache
def _advance_of(physics: Physics) -> Any:
    """Return the compiled `ElasticTarget.advance` for arms with these equations."""
    joints, inverse_dynamics, PerJoint = physics.joints, physics.inverse_dynamics, physics.PerJoint
    Block, reference = _block_of(physics), starts(physics.joints).q_reference
    at, rows, arm_in = places(Block), size(Block), reader(physics.Arm, in_list)
    wanted, memory, target, feedforward = at.wanted.q[0], at.memory.started, at.target.q[0], at.feedforward[0]
    read_wanted = reader(type(at.wanted), in_block, at.wanted)
    write_torque = writer(PerJoint, in_block, at.torque)
    lead = _lead_of(physics)

    @kernel_for(physics.digest)
    def advance(
        observation: np.ndarray,
        past: np.ndarray,
        motion: np.ndarray,
        ahead_torque: np.ndarray,
        constants: np.ndarray,
        drives: np.ndarray,
        period: float,
        friction: float,
        ahead: float,
    ) -> None:
        """See `ElasticTarget`; `friction` is 1 or 0, `ahead` the share of a period that u_ff is extrapolated."""
        arm, drive, block = arm_in(constants, 0), drives_in(drives), np.empty(rows * BLOCK)
        for first in range(0, len(observation), BLOCK):
            lanes = min(BLOCK, len(observation) - first)
            into_block(observation[:, reference:], first, lanes, block, wanted)
            into_block(past, first, lanes, block, memory)
            for lane in range(lanes):
                now = read_wanted(block, lane)
                write_torque(block, lane, inverse_dynamics(now.q, now.dq, now.ddq, arm))
            for joint in range(joints):
                lead(block, lanes, joint, drive, period, friction, ahead)
            for lane in range(lanes):
                block[memory * BLOCK + lane] = 1.0
            out_of_block(block, memory, past, first, lanes)
            out_of_block(block, target, motion, first, lanes)
            out_of_block(block, feedforward, ahead_torque, first, lanes)

    return advance


@functools.cache
def _lead_of(physics: Physics) -> Any:
    """Return the compiled function that fills a joint's target and feedforward in a block and advances its memory."""
    at = places(_block_of(physics))
    started, latest_at, second_at, third_at, smooth_at = (
        BLOCK * first for first in (at.memory.started, *(part[0] for part in at.memory[1:]))
    )
    q_at, dq_at, ddq_at = (BLOCK * part[0] for part in at.wanted)
    theta_at, dtheta_at, ddtheta_at = (BLOCK * part[0] for part in at.target)
    feedforward_at, torque_at = BLOCK * at.feedforward[0], BLOCK * at.torque[0]

    @register_jitable(forceinline=True)
    def lead(
        block: np.ndarray, lanes: int, joint: int, drive: Drives, period: float, friction: float, ahead: float
    ) -> None:
        inertia, viscous = drive.motor_inertia[joint], drive.viscous_friction[joint]
        k, b = drive.stiffness[joint], drive.damping[joint] / drive.stiffness[joint]
        dry = drive.coulomb_friction[joint], drive.static_friction[joint], drive.stribeck_velocity[joint]
        for lane in range(lanes):
            place = joint * BLOCK + lane
            begins, now = block[started + lane] == 0.0, block[torque_at + place]
            latest = select(begins, now, block[latest_at + place])
            second = select(begins, now, block[second_at + place])
            third = select(begins, now, block[third_at + place])
            # Backward differences of third order for τ̇_d and of second order for τ̈_d.
            rate = (11.0 * now - 18.0 * latest + 9.0 * second - 2.0 * third) / (6.0 * period)
            curvature = (2.0 * now - 5.0 * latest + 4.0 * second - third) / (period * period)
            velocity = block[dq_at + place] + (rate - b * curvature) / k
            acceleration = block[ddq_at + place] + curvature / k
            smooth = inertia * acceleration + viscous * velocity + now
            before = select(begins, smooth, block[smooth_at + place])
            middle = velocity + ahead * period * acceleration
            slip = stribeck_magnitude(middle, *dry) * sign(middle)
            block[feedforward_at + place] = smooth + ahead * (smooth - before) + friction * slip
            block[theta_at + place] = block[q_at + place] + (now - b * (rate - b * curvature)) / k
            block[dtheta_at + place], block[ddtheta_at + place] = velocity, acceleration
            block[latest_at + place], block[second_at + place], block[third_at + place] = now, latest, second
            block[smooth_at + place] = smooth

    return lead
