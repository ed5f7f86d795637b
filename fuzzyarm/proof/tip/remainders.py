"""What the linear equation of the deviation leaves out in one period, as bounds of torques on its channels.

With the tube |S ξ| <= ρ during the period, the torques that are left out are bounded by

    links    |d| + |M - M_k| ρ_q̈ + |R_q - G_k| ρ_q + |R_q̇ - D_k| ρ_q̇     M, R_q, R_q̇ at every point of the tube (balls),
             and for each uncertain mass the same with its R_p, and |r_p ξ|, see `LinkRemainder`,
    joints   Δk ρ_φ + Δb ρ_φ̇                                            products of uncertain constants,
    motors   ΔI ρ_θ̈ + Δf ρ_θ̇ and the friction, see `friction`,
    tip      the force of any course,

and the parts of the uncertain constants' torques along the centre that are not linear in time. These torques are

    stiffness, damping     -Δk φ, -Δb φ̇ within the joint: opposite on motor and link,
    inertia, viscosity     -ΔI θ̈, -Δf θ̇ on the motor,
    dry friction           Δμ times the friction of the centre, where its motor slips,
    mass, payload, force   -Δp R_p on the links.

A constant keeps its value, so its column of the zonotope is driven by the signal with one factor in [-1, 1] for good.
A motor whose velocity is bounded by itself (`Plan.MONOTONE`) takes no signal: its channel stands for the velocity, and
that bound holds what the torques of the constants do (`Friction.driving`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from flint import arb

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Arm, tip_force_torque
from fuzzyarm.proof.tip.defects import (
    Forces,
    LinkMotion,
    PeriodMotion,
    Signal,
    TipForces,
    link_torque,
    rest_size,
    signal_range,
    signal_size,
)
from fuzzyarm.proof.tip.enclosures import ROUND_UP, SLACK, Jet, middle_of, radius_of
from fuzzyarm.proof.tip.friction import Friction, Plan
from fuzzyarm.proof.tip.plant import BallPlant
from fuzzyarm.proof.tip.transition import CHANNEL_COUNT, CHANNELS, OBSERVED, ROWS

__all__ = ["Drive", "LinkRemainder", "LinkSlopes", "lever_arms", "link_remainder", "tube_slopes"]

_REFINED = 3  # how often the products of the masses are bounded again
_NO_FORCE = TipForces(Forces([arb(0)], [arb(0)]), (0.0, 0.0), (1.0, 0.0), (0.0, 0.0))


class LinkSlopes(NamedTuple):
    """M, ∂R/∂q and ∂R/∂q̇ of the links, nested lists (2, 2) of balls."""

    mass: list[list[arb]]
    angle: list[list[arb]]
    velocity: list[list[arb]]


def _link_slopes(at: list[list[Any]], force: tuple[Any, Any], arm: Arm) -> LinkSlopes:
    """Return M [kg m²], ∂R/∂q [N m/rad] and ∂R/∂q̇ [N m s/rad] at angles, velocities and accelerations, pairs each."""
    angles, velocities, accelerations = at
    q = [Jet.variable(x, i) for i, x in enumerate(angles)]
    dq = [Jet.variable(x, JOINTS + i) for i, x in enumerate(velocities)]
    ddq = [Jet.variable(x, 2 * JOINTS + i) for i, x in enumerate(accelerations)]
    torques = link_torque(LinkMotion(q, dq, ddq), force, arm)
    parts = ([[t.slope(k * JOINTS + i) for i in range(JOINTS)] for t in torques] for k in range(3))
    angle, velocity, mass = parts
    return LinkSlopes(mass, angle, velocity)


def _at_middle(motion: PeriodMotion, force: Forces, arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M_k [kg m²], G_k [N m/rad] and D_k [N m s/rad] (2, 2) at the middle of the period, in floats."""
    at = [[signal[0] for signal in kind[JOINTS:]] for kind in (motion.angle, motion.velocity, motion.acceleration)]
    slopes = _link_slopes(at, (force.x[0], force.y[0]), arm)
    mass, angle, velocity = (np.array([[middle_of(x) for x in row] for row in part]) for part in slopes)
    return mass, angle, velocity


def tube_slopes(motion: PeriodMotion, tube: np.ndarray, force: TipForces, arm: Arm) -> LinkSlopes:
    """Return the slopes (2, 2) each [kg m², N m/rad, N m s/rad] on the tube (18,) around the centre, for every arm."""
    rows = ROWS.link, ROWS.d_link, ROWS.link_acceleration
    boxes = [
        [x + arb(0.0, r) for x, r in zip(along, tube[of].tolist(), strict=True)]
        for along, of in zip(motion.links, rows, strict=True)
    ]
    x, y = (signal_range(s) + arb(0.0, r) for s, r in zip(force.middle, force.radii, strict=True))
    return _link_slopes(boxes, (x, y), arm)


def link_remainder(slopes: LinkSlopes, at: tuple[np.ndarray, np.ndarray, np.ndarray], tube: np.ndarray) -> np.ndarray:
    """Return |M - M_k| ρ_q̈ + |R_q - G_k| ρ_q + |R_q̇ - D_k| ρ_q̇ (2,) [N m]."""
    total = np.zeros(JOINTS)
    for part, about, rows in zip(slopes, at, (ROWS.link_acceleration, ROWS.link, ROWS.d_link), strict=True):
        spread = np.array(
            [[radius_of(x, c) for x, c in zip(*row, strict=True)] for row in zip(part, about.tolist(), strict=True)]
        )
        total += spread @ tube[rows]
    return total * ROUND_UP


class LinkRemainder:
    """The torques on the links that their linear equation leaves out in one period.

    With R(·; p) = R + Σ π_p R_p, |π_p| <= 1, and r_p ξ = M_p δq̈ + R_p,q δq + R_p,q̇ δq̇ at the middle of the period,

        |n| <= E + Σ (E_p + |r_p ξ|),      E, E_p: what `link_remainder` leaves of R and of R_p on the tube.

    r_p ξ is a row that is observed like the others: what it has of links that turn against each other cancels in it,
    which it does not in |M_p| ρ_q̈ + |R_p,q| ρ_q + |R_p,q̇| ρ_q̇. The smaller of the two counts.
    """

    def __init__(self, motion: PeriodMotion, force: TipForces, plant: BallPlant) -> None:
        self._motion, self._force, self._arm = motion, force, plant.exact
        self.at = _at_middle(motion, force.middle, plant.exact)  # M_k, G_k and D_k
        arms = [parameter.arm for parameter in plant.parameters if parameter.kind in ("mass", "payload")]
        self._masses = [(arm, _at_middle(motion, _NO_FORCE.middle, arm)) for arm in arms if arm is not None]
        # r_p (2 masses, 6) over the rows `OBSERVED`
        self.products = np.vstack([np.zeros((0, len(OBSERVED))), *(np.hstack(at) for _, at in self._masses)])

    def bound(self, tube: np.ndarray, torques: np.ndarray, free: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Return a bound (2,) of |n| [N m] on a claimed tube ρ (18,), for the other torques w̄ (8,).

        All that is observed, then the `products`, is within free (18 + n,) + push (18 + n, 8) w̄.
        """
        fixed = link_remainder(tube_slopes(self._motion, tube, self._force, self._arm), self.at, tube)
        for arm, at in self._masses:
            fixed += link_remainder(tube_slopes(self._motion, tube, _NO_FORCE, arm), at, tube)
        sizes, count = np.abs(self.products), len(self.products)
        found = (fixed + _by_link(sizes @ tube[OBSERVED])) * ROUND_UP
        for _ in range(_REFINED if count else 0):
            acting = torques.copy()
            acting[CHANNELS.link] += found
            seen = free + push @ acting
            within = seen[-count:] + SLACK * sizes @ seen[OBSERVED]
            found = np.minimum(found, (fixed + _by_link(within)) * ROUND_UP)
        return np.asarray(found)


def _by_link(torques: np.ndarray) -> np.ndarray:
    """Return the sums (2,) over all masses of torques (2 masses,), those of each mass on both links."""
    return np.asarray(torques.reshape(-1, JOINTS).sum(axis=0))


def lever_arms(motion: PeriodMotion, direction: tuple[float, float], arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """Return Jᵀ d and Jᵀ d⊥ (2, 2) [m] at the middle of the period, and how far they are from it along the centre."""
    q1, q2 = (signal_range(s) for s in motion.angle[JOINTS:])
    m1, m2 = (s[0] for s in motion.angle[JOINTS:])
    lever, spread = np.zeros((JOINTS, 2)), np.zeros((JOINTS, 2))
    for axis in range(2):
        unit = direction if axis == 0 else (-direction[1], direction[0])
        for joint, (near, wide) in enumerate(zip(_lever(m1, m2, unit, arm), _lever(q1, q2, unit, arm), strict=True)):
            lever[joint, axis] = middle_of(near)
            spread[joint, axis] = radius_of(wide, lever[joint, axis])
    return lever, spread + SLACK * np.abs(lever).sum()


def _lever(q1: arb, q2: arb, unit: tuple[float, float], arm: Arm) -> tuple[arb, arb]:
    q12 = q1 + q2
    return tip_force_torque(q1.sin(), q1.cos(), q12.sin(), q12.cos(), *unit, arm)


class Drive(NamedTuple):
    """What the uncertain constants do during one period; torques [N m] and forces [N]."""

    # level, slope: a_0 and a_1 of each channel's signal for each constant, in floats (8, constants)
    level: np.ndarray
    slope: np.ndarray
    rest: np.ndarray  # bound of what these two leave, for all constants together (8,)
    motor: np.ndarray  # bound of the torques on each motor, those within the joints included (2,)

    @classmethod
    def of(cls, motion: PeriodMotion, force: Forces, plant: BallPlant) -> Drive:
        """Return what all constants do but the dry friction, which depends on how friction is bounded."""
        shape = CHANNEL_COUNT, len(plant.parameters)
        drive = cls(np.zeros(shape), np.zeros(shape), np.zeros(CHANNEL_COUNT), np.zeros(JOINTS))
        for index, parameter in enumerate(plant.parameters):
            joint, half = parameter.joint, arb(parameter.half)
            motor, within = CHANNELS.motor.start + joint, CHANNELS.joint.start + joint
            if parameter.kind == "stiffness":
                drive._add(index, within, half, motion.bending(joint))
            elif parameter.kind == "damping":
                drive._add(index, within, half, motion.bending_rate(joint))
            elif parameter.kind == "motor_inertia":
                drive._add(index, motor, -half, motion.acceleration[joint])
            elif parameter.kind == "viscous_friction":
                drive._add(index, motor, -half, motion.velocity[joint])
            elif parameter.arm is not None:
                factor = half if parameter.kind == "force" else arb(0)
                push = Forces(*([factor * a for a in signal] for signal in force))
                for i, torque in enumerate(motion.link_torques(push, parameter.arm)):
                    drive._add(index, CHANNELS.link.start + i, arb(-1), torque)
        return drive

    def with_friction(self, plant: BallPlant, frictions: list[Friction]) -> Drive:
        """Return all that the uncertain constants do, with the frictions of both motors."""
        drive = Drive(*(part.copy() for part in self))
        for index, parameter in enumerate(plant.parameters):
            torque = frictions[parameter.joint].torque() if parameter.kind == "dry_friction" else None
            if torque is not None:
                drive._add(index, CHANNELS.motor.start + parameter.joint, arb(parameter.half), torque)
        for channel, friction in enumerate(frictions, CHANNELS.motor.start):
            if friction.plan is Plan.MONOTONE:
                drive.level[channel], drive.slope[channel], drive.rest[channel] = 0.0, 0.0, 0.0
        return drive

    def _add(self, constant: int, channel: int, factor: arb, signal: Signal) -> None:
        """Add the torque of a constant, a factor times a signal: its column, what that leaves, and all of it."""
        torque = [factor * a for a in signal]
        a_0, a_1, *_ = [*torque, arb(0), arb(0)]
        level, slope = middle_of(a_0), middle_of(a_1)
        self.level[channel, constant], self.slope[channel, constant] = level, slope
        self.rest[channel] += rest_size(torque) + radius_of(a_0, level) + radius_of(a_1, slope)
        if channel not in range(CHANNEL_COUNT)[CHANNELS.link]:
            self.motor[channel % JOINTS] += signal_size(torque)
