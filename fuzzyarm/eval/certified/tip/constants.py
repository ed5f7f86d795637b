"""The torques of the uncertain constants along the centre, each a signal on the channels of the linear equation.

    stiffness, damping     -Δk φ, -Δb φ̇ within the joint: opposite on motor and link,
    inertia, viscosity     -ΔI θ̈, -Δf θ̇ on the motor,
    dry friction           Δμ times the friction of the centre, where its motor slips,
    mass, payload, force   -Δp R_p on the links.

A constant keeps its value, so its column of the zonotope is driven by the signal with one factor in [-1, 1] for good.
A motor whose velocity is bounded by itself (`Plan.MONOTONE`) takes no signal: its channel stands for the velocity, and
that bound holds what the torques of the constants do (`Friction.driving`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from flint import arb

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.eval.certified.tip.defects import Forces, PeriodMotion, Signal, rest_size, signal_size
from fuzzyarm.eval.certified.tip.enclosures import centre, radius_of
from fuzzyarm.eval.certified.tip.friction import Friction, Plan
from fuzzyarm.eval.certified.tip.plant import BallPlant, Parameter
from fuzzyarm.eval.certified.tip.transition import CHANNELS, COUNT

__all__ = ["Drive", "drive"]


class Drive(NamedTuple):
    """What the uncertain constants do during one period.

    Attributes:
        level, slope: a_0 and a_1 of each channel's signal for each constant, in floats (8, constants).
        rest: bound of what these two leave, for all constants together (8,).
        motor: bound of the torques on each motor, those within the joints included (2,).
    """

    level: np.ndarray
    slope: np.ndarray
    rest: np.ndarray
    motor: np.ndarray


def drive(motion: PeriodMotion, force: Forces, plant: BallPlant, frictions: list[Friction]) -> Drive:
    """Return the torques of the uncertain constants in one period."""
    count = len(plant.parameters)
    level, slope = np.zeros((COUNT, count)), np.zeros((COUNT, count))
    rest, motor = np.zeros(COUNT), np.zeros(JOINTS)
    for index, parameter in enumerate(plant.parameters):
        for channel, signal in _signals(parameter, motion, force, frictions):
            if channel not in range(COUNT)[CHANNELS.link]:
                motor[channel % JOINTS] += signal_size(signal)
            if channel in range(COUNT)[CHANNELS.motor] and frictions[channel].plan is Plan.MONOTONE:
                continue
            a = [*signal, arb(0), arb(0)]
            level[channel, index], slope[channel, index] = centre(a[0]), centre(a[1])
            spread = radius_of(a[0], level[channel, index]) + radius_of(a[1], slope[channel, index])
            rest[channel] += rest_size(signal) + spread
    return Drive(level, slope, rest, motor)


def _signals(
    parameter: Parameter, motion: PeriodMotion, force: Forces, frictions: list[Friction]
) -> list[tuple[int, Signal]]:
    """Return the signals of one constant with their channels."""
    joint, half = parameter.joint, arb(parameter.half)
    motor, within = CHANNELS.motor.start + joint, CHANNELS.joint.start + joint
    match parameter.kind:
        case "stiffness":
            return [(within, _times(half, motion.bending(joint)))]
        case "damping":
            return [(within, _times(half, motion.bending_rate(joint)))]
        case "motor_inertia":
            return [(motor, _times(-half, motion.acceleration[joint]))]
        case "viscous_friction":
            return [(motor, _times(-half, motion.velocity[joint]))]
        case "dry_friction":
            torque = frictions[joint].torque()
            return [] if torque is None else [(motor, _times(half, torque))]
        case "force":
            push = Forces(_times(half, force.x), _times(half, force.y))
        case _:
            push = Forces([arb(0)], [arb(0)])
    assert parameter.arm is not None
    torques = motion.link_torques(push, parameter.arm)
    return [(CHANNELS.link.start + i, _times(arb(-1), signal)) for i, signal in enumerate(torques)]


def _times(factor: arb, signal: Signal) -> Signal:
    return [factor * a for a in signal]
