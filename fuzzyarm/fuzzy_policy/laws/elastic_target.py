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

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.checks import real
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import arm_constants, arm_in, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters

__all__ = ["MEMORY_SIZE", "TARGET", "TARGET_SIZE", "ElasticTarget"]


class _Memory(NamedTuple):
    """What a lane remembers from one sample to the next, or where it lies in the memory's array.

    Attributes:
        started: 1 once there has been a sample, else 0.
        latest: τ_d of the last sample [N m].
        second: τ_d of the sample before that.
        third: τ_d of the sample before that.
        smooth: u_ff of the last sample, less its friction [N m].
    """

    started: Any
    latest: Any
    second: Any
    third: Any
    smooth: Any


_PARTS = _Memory(*consecutive(1, JOINTS, JOINTS, JOINTS, JOINTS))

MEMORY_SIZE = _PARTS.smooth.stop
"""Numbers that a lane remembers."""


class _Target(NamedTuple):
    """Where the parts of a target lie: θ_d [rad], θ̇_d [rad/s] and θ̈_d [rad/s²]."""

    q: slice
    dq: slice
    ddq: slice


TARGET = _Target(*consecutive(JOINTS, JOINTS, JOINTS))
"""Where θ_d, θ̇_d and θ̈_d lie in a target (lanes, `TARGET_SIZE`); `REFERENCE` of the observation has the same order."""

TARGET_SIZE: int = TARGET.ddq.stop
"""How many numbers a target has."""


class ElasticTarget:
    """θ_d, its derivatives and u_ff, sample by sample; the equations are in the module's docstring."""

    def __init__(
        self, parameters: ArmParameters, control_period: float, *, friction: bool = True, average: bool = True
    ) -> None:
        """Keep the arm and the control period.

        Args:
            parameters: the arm, as the controller knows it.
            control_period: T [s].
            friction: whether u_ff holds the dry friction.
            average: whether u_ff is that of the middle of the coming hold rather than that of its start.

        Raises:
            TypeError: the control period is no number.
            ValueError: the control period is not positive.
        """
        period = real("control_period", control_period, "s", above=0.0)
        self._arguments = (np.array(arm_constants(parameters)), period, float(friction), 0.5 * float(average))

    def advance(self, observation: np.ndarray, memory: np.ndarray, target: np.ndarray, feedforward: np.ndarray) -> None:
        """Fill target and feedforward and advance the memory, in place.

        Args:
            observation: (lanes, 10), of which the reference (q_d, q̇_d, q̈_d) is read.
            memory: (lanes, `MEMORY_SIZE`), zeros when an episode begins, which means that the arm was at rest before.
            target: (lanes, 6), becomes θ_d [rad], θ̇_d [rad/s], θ̈_d [rad/s²].
            feedforward: (lanes, 2), becomes u_ff [N m], not clipped.
        """
        _advance(observation, memory, target, feedforward, *self._arguments)


@kernel
def _advance(
    observation: np.ndarray,
    memory: np.ndarray,
    target: np.ndarray,
    feedforward: np.ndarray,
    constants: np.ndarray,
    period: float,
    friction: float,
    ahead: float,
) -> None:
    """See `ElasticTarget`; `friction` is 1 or 0, `ahead` the share of a period that u_ff is extrapolated."""
    arm = arm_in(constants, 0)
    stiffness, damping = (arm.stiffness1, arm.stiffness2), (arm.damping1, arm.damping2)
    inertia, viscous = (arm.motor_inertia1, arm.motor_inertia2), (arm.viscous1, arm.viscous2)
    coulomb, static = (arm.coulomb1, arm.coulomb2), (arm.static1, arm.static2)
    o, past = observed(observation), _remembered(memory)
    theta, dtheta, ddtheta = target[:, TARGET.q], target[:, TARGET.dq], target[:, TARGET.ddq]
    for lane in range(len(observation)):
        q1, q2, dq1, dq2 = (
            o.q_reference[lane, 0], o.q_reference[lane, 1], o.dq_reference[lane, 0], o.dq_reference[lane, 1]
        )  # fmt: skip
        ddq1, ddq2 = o.ddq_reference[lane, 0], o.ddq_reference[lane, 1]
        m11, m12, m22 = mass_matrix(np.cos(q2), arm)
        coriolis1, coriolis2 = coriolis_torque(np.sin(q2), dq1, dq2, arm)
        gravity1, gravity2 = gravity_torque(np.sin(q1), np.sin(q1 + q2), arm)
        torque = (
            m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1,
            m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2,
        )
        begins = past.started[lane, 0] == 0.0
        past.started[lane, 0] = 1.0
        for joint in range(JOINTS):
            now = torque[joint]
            if begins:
                past.latest[lane, joint] = past.second[lane, joint] = past.third[lane, joint] = now
            latest, second, third = past.latest[lane, joint], past.second[lane, joint], past.third[lane, joint]
            # Backward differences of third order for τ̇_d and of second order for τ̈_d.
            rate = (11.0 * now - 18.0 * latest + 9.0 * second - 2.0 * third) / (6.0 * period)
            curvature = (2.0 * now - 5.0 * latest + 4.0 * second - third) / (period * period)
            past.latest[lane, joint], past.second[lane, joint], past.third[lane, joint] = now, latest, second
            k, b = stiffness[joint], damping[joint] / stiffness[joint]
            velocity = o.dq_reference[lane, joint] + (rate - b * curvature) / k
            acceleration = o.ddq_reference[lane, joint] + curvature / k
            theta[lane, joint] = o.q_reference[lane, joint] + (now - b * (rate - b * curvature)) / k
            dtheta[lane, joint], ddtheta[lane, joint] = velocity, acceleration
            smooth = inertia[joint] * acceleration + viscous[joint] * velocity + now
            before = smooth if begins else past.smooth[lane, joint]
            past.smooth[lane, joint] = smooth
            middle = velocity + ahead * period * acceleration
            slip = stribeck_magnitude(middle, coulomb[joint], static[joint], arm.stribeck_velocity) * np.sign(middle)
            feedforward[lane, joint] = smooth + ahead * (smooth - before) + friction * slip


@register_jitable
def _remembered(memory: np.ndarray) -> _Memory:
    """Return the parts of memories (lanes, `MEMORY_SIZE`) as views of them."""
    return _Memory(
        memory[:, _PARTS.started],
        memory[:, _PARTS.latest],
        memory[:, _PARTS.second],
        memory[:, _PARTS.third],
        memory[:, _PARTS.smooth],
    )
