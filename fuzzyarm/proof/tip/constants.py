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
from fuzzyarm.proof.tip.defects import Forces, PeriodMotion, Signal, rest_size, signal_size
from fuzzyarm.proof.tip.enclosures import centre, radius_of
from fuzzyarm.proof.tip.friction import Friction, Plan
from fuzzyarm.proof.tip.plant import BallPlant, Parameter
from fuzzyarm.proof.tip.transition import CHANNELS, COUNT

__all__ = ["Drive", "constant_torques", "drive"]


class Drive(NamedTuple):
    """What the uncertain constants do during one period; torques [N m] and forces [N]."""

    # level, slope: a_0 and a_1 of each channel's signal for each constant, in floats (8, constants)
    level: np.ndarray
    slope: np.ndarray
    rest: np.ndarray  # bound of what these two leave, for all constants together (8,)
    motor: np.ndarray  # bound of the torques on each motor, those within the joints included (2,)


class _ConstantTorque(NamedTuple):
    """The torque of an uncertain constant on one channel: a_0, a_1, what they leave, and a bound of all of it."""

    constant: int
    channel: int
    level: float
    slope: float
    rest: float
    size: float


def constant_torques(motion: PeriodMotion, force: Forces, plant: BallPlant) -> list[_ConstantTorque]:
    """Return the torques of all constants but the dry friction's, which depends on how friction is bounded."""
    return [
        _linear_in_time(index, channel, signal)
        for index, parameter in enumerate(plant.parameters)
        for channel, signal in _signals(parameter, motion, force)
    ]


def drive(torques: list[_ConstantTorque], plant: BallPlant, frictions: list[Friction]) -> Drive:
    """Return what the uncertain constants do, from `constant_torques` and the frictions of both motors."""
    count, motors = len(plant.parameters), range(COUNT)[CHANNELS.motor]
    level, slope = np.zeros((COUNT, count)), np.zeros((COUNT, count))
    rest, motor = np.zeros(COUNT), np.zeros(JOINTS)
    for torque in [*torques, *_dry(plant, frictions)]:
        if torque.channel not in range(COUNT)[CHANNELS.link]:
            motor[torque.channel % JOINTS] += torque.size
        if torque.channel in motors and frictions[torque.channel].plan is Plan.MONOTONE:
            continue
        level[torque.channel, torque.constant] = torque.level
        slope[torque.channel, torque.constant] = torque.slope
        rest[torque.channel] += torque.rest
    return Drive(level, slope, rest, motor)


def _dry(plant: BallPlant, frictions: list[Friction]) -> list[_ConstantTorque]:
    """Return the torques of uncertain factors of the dry friction."""
    found = []
    for index, parameter in enumerate(plant.parameters):
        if parameter.kind == "dry_friction":
            torque = frictions[parameter.joint].torque()
            if torque is not None:
                channel = CHANNELS.motor.start + parameter.joint
                found.append(_linear_in_time(index, channel, _times(arb(parameter.half), torque)))
    return found


def _linear_in_time(constant: int, channel: int, signal: Signal) -> _ConstantTorque:
    a = [*signal, arb(0), arb(0)]
    level, slope = centre(a[0]), centre(a[1])
    rest = rest_size(signal) + radius_of(a[0], level) + radius_of(a[1], slope)
    return _ConstantTorque(constant, channel, level, slope, rest, signal_size(signal))


def _signals(parameter: Parameter, motion: PeriodMotion, force: Forces) -> list[tuple[int, Signal]]:
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
            return []
        case "force":
            push = Forces(_times(half, force.x), _times(half, force.y))
        case _:
            push = Forces([arb(0)], [arb(0)])
    assert parameter.arm is not None
    torques = motion.link_torques(push, parameter.arm)
    return [(CHANNELS.link.start + i, _times(arb(-1), signal)) for i, signal in enumerate(torques)]


def _times(factor: arb, signal: Signal) -> Signal:
    return [factor * a for a in signal]
