"""Where the motors must stand so that the tip is where it should be, from the observation alone.

The links need the torque τ_d = M_b(q_d) q̈_d + C(q_d, q̇_d) q̇_d + g(q_d); it bends the joints by δ = θ_d - q_d with

    B_t δ̇ + K_t δ = τ_d,    so, with b = B_t/K_t,    δ = (τ_d - b τ̇_d + b² τ̈_d - ...)/K_t.

τ_d follows from the reference in the observation; its derivatives are backward differences over the last three
control periods, which is all the memory this takes. (`envs.elastic_reference` solves the same equation exactly for a
reference known beforehand.) The torque that goes with θ_d is the feedforward

    u_ff = I_a θ̈_d + f_v θ̇_d + F(θ̇_d) sign θ̇_d + τ_d,

by default not that of t_k but that of t_k + T/2, the mean over the coming hold, extrapolated from the last two.

Any policy may use it: it reads the ten numbers that every policy sees, and nothing else.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.dynamics import Arm, arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.parameters import ArmParameters

MEMORY_SIZE = 9  # whether there was a sample before, τ_d of the last three samples, u_ff less friction of the last


class ElasticTarget:
    """θ_d, its derivatives and u_ff, sample by sample; see the module for the equations."""

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
            ValueError: the control period is not positive.
        """
        if not (math.isfinite(control_period) and control_period > 0.0):
            raise ValueError(f"control_period = {control_period!r} s is out of range; allowed: (0, inf) s")
        self._arguments = (arm_constants(parameters), control_period, float(friction), 0.5 * float(average))

    def advance(self, observation: np.ndarray, memory: np.ndarray, target: np.ndarray, feedforward: np.ndarray) -> None:
        """Fill target and feedforward and advance the memory, in place.

        Args:
            observation: (lanes, 10), of which the reference (q_d, q̇_d, q̈_d) is read.
            memory: (lanes, `MEMORY_SIZE`), zeros when an episode begins: the arm is taken to have been at rest.
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
    arm: Arm,
    period: float,
    friction: float,
    ahead: float,
) -> None:
    """See `ElasticTarget`; `friction` is 1 or 0, `ahead` the share of a period that u_ff is extrapolated."""
    stiffness, damping = (arm.stiffness1, arm.stiffness2), (arm.damping1, arm.damping2)
    inertia, viscous = (arm.motor_inertia1, arm.motor_inertia2), (arm.viscous1, arm.viscous2)
    coulomb, static = (arm.coulomb1, arm.coulomb2), (arm.static1, arm.static2)
    for lane in range(len(observation)):
        o, past = observation[lane], memory[lane]
        m11, m12, m22 = mass_matrix(np.cos(o[5]), arm)
        coriolis1, coriolis2 = coriolis_torque(np.sin(o[5]), o[6], o[7], arm)
        gravity1, gravity2 = gravity_torque(np.sin(o[4]), np.sin(o[4] + o[5]), arm)
        torque = (
            m11 * o[8] + m12 * o[9] + coriolis1 + gravity1,
            m12 * o[8] + m22 * o[9] + coriolis2 + gravity2,
        )
        begins = past[0] == 0.0
        past[0] = 1.0
        for joint in range(2):
            now = torque[joint]
            if begins:
                past[1 + joint] = past[3 + joint] = past[5 + joint] = now
            last, second, third = past[1 + joint], past[3 + joint], past[5 + joint]
            rate = (11.0 * now - 18.0 * last + 9.0 * second - 2.0 * third) / (6.0 * period)
            curvature = (2.0 * now - 5.0 * last + 4.0 * second - third) / (period * period)
            past[1 + joint], past[3 + joint], past[5 + joint] = now, last, second
            k, b = stiffness[joint], damping[joint] / stiffness[joint]
            angle = o[4 + joint] + (now - b * (rate - b * curvature)) / k
            velocity = o[6 + joint] + (rate - b * curvature) / k
            acceleration = o[8 + joint] + curvature / k
            target[lane, joint], target[lane, 2 + joint], target[lane, 4 + joint] = angle, velocity, acceleration
            smooth = inertia[joint] * acceleration + viscous[joint] * velocity + now
            before = smooth if begins else past[7 + joint]
            past[7 + joint] = smooth
            middle = velocity + ahead * period * acceleration
            slip = stribeck_magnitude(middle, coulomb[joint], static[joint], arm.stribeck_velocity) * np.sign(middle)
            feedforward[lane, joint] = smooth + ahead * (smooth - before) + friction * slip
