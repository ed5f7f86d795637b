"""Bounds on the torques omitted by the linear equation of the deviation in one period, channel by channel.

On the tube |S ξ| <= ρ their bounds are

    links    |d| + |M - M_k| ρ_q̈ + |R_q - G_k| ρ_q + |R_q̇ - D_k| ρ_q̇     M, R_q, R_q̇ at every point of the tube (balls),
             and for each uncertain mass the same with its R_p, and |r_p ξ|, see `LinkRemainder`,
    joints   Δk ρ_φ + Δb ρ_φ̇                                            products of uncertain constants,
    motors   ΔI ρ_θ̈ + Δf ρ_θ̇ and the friction, see `friction_bounds`,
    tip      the force with an arbitrary course in time,

and the nonlinear parts of the uncertain constants' torques along the centre. These torques are

    stiffness, damping     -Δk φ, -Δb φ̇ within the joint: opposite on motor and link,
    inertia, viscosity     -ΔI θ̈, -Δf θ̇ on the motor,
    dry friction           Δμ times the friction of the centre, where its motor slips,
    mass, payload, force   -Δp R_p on the links.

A constant keeps its value, so its column of the zonotope is driven by the signal with one fixed factor in [-1, 1].
A motor whose velocity is bounded separately (`Plan.MONOTONE`) has no such signal: its channel is the velocity, and the
bound includes the torques of the constants (`Friction.driving`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import arb

from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.proof.tip._defects import Forces, PeriodMotion, Signal, TipForces, link_torque
from fuzzyarm.proof.tip.enclosures import ROUND_UP, SLACK, Jet, middle_of, radius_of
from fuzzyarm.proof.tip.friction_bounds import Friction, Plan
from fuzzyarm.proof.tip.plant import BallPlant

__all__ = ["ConstantForces", "LinkRemainder"]

_REFINED = 3  # refinements of `LinkRemainder.bound` by the products of the masses
_NO_FORCE = TipForces((), (), np.zeros((0, 0)), np.zeros(0))


def _link_slopes(physics: Physics, at: Any, force: Sequence[Any], arm: Any) -> list[list[list[Any]]]:
    """Return M [kg m²], ∂R/∂q [N m/rad] and ∂R/∂q̇ [N m s/rad], nested lists (2, 2) of balls.

    `at` holds angles [rad], velocities [rad/s] and accelerations [rad/s²] of the links, in balls.
    """
    n = physics.joints
    motion = [[Jet.variable(x, k * n + i) for i, x in enumerate(part)] for k, part in enumerate(at)]
    torques = link_torque(physics, motion, force, arm)
    angle, velocity, mass = ([[t.slope(k * n + i) for i in range(n)] for t in torques] for k in range(3))
    return [mass, angle, velocity]


class _Linearised:
    """The torques R of the links for one set of constants, linearised at the middle of a period."""

    def __init__(self, motion: PeriodMotion, force: TipForces, plant: BallPlant, arm: Any) -> None:
        """Linearise R; `arm` has as balls the constants of the set's middle, or their change due to one mass."""
        self._motion, self._force, self._plant, self._arm = motion, force, plant, arm
        middles, push = [[signal[0] for signal in kind] for kind in motion.links], [part[0] for part in force.middle]
        slopes = _link_slopes(plant.physics, middles, push, arm)
        # M_k [kg m²], G_k [N m/rad] and D_k [N m s/rad], (2, 2) each
        mass, angle, velocity = (np.array([[middle_of(x) for x in row] for row in part]) for part in slopes)
        self.at = mass, angle, velocity

    def left_out(self, tube: np.ndarray) -> np.ndarray:
        """Bound |M - M_k| ρ_q̈ + |R_q - G_k| ρ_q + |R_q̇ - D_k| ρ_q̇ (2,) [N m] on a tube ρ (18,), for all tip forces."""
        at, joints = self._plant.layout.rows, self._plant.physics.joints
        rows = at.link, at.d_link, at.link_acceleration
        boxes = [
            [x + arb(0.0, r) for x, r in zip(along, tube[of].tolist(), strict=True)]
            for along, of in zip(self._motion.link_ranges, rows, strict=True)
        ]
        push = [s.range() + arb(0.0, r) for s, r in zip(self._force.middle, self._force.radii, strict=True)]
        slopes, total = _link_slopes(self._plant.physics, boxes, push, self._arm), np.zeros(joints)
        for part, middle, of in zip(slopes, self.at, (rows[2], rows[0], rows[1]), strict=True):
            pairs = zip(itertools.chain(*part), middle.ravel().tolist(), strict=True)
            total += np.array([radius_of(x, c) for x, c in pairs]).reshape(joints, joints) @ tube[of]
        return total * ROUND_UP


class LinkRemainder:
    """The torques n that the linear equation of the links omits, in one period.

    R is the links' torque, p an uncertain mass or the payload, and |δx| <= ρ_x. With R(·; p) = R + Σ π_p R_p,
    |π_p| <= 1, and r_p ξ = M_p δq̈ + R_p,q δq + R_p,q̇ δq̇ at the middle of the period,

        |n| <= E + Σ (E_p + |r_p ξ|),      E, E_p: `_Linearised.left_out` for R and for R_p on the tube.

    r_p ξ is bounded as an observed row of the linear equation, so that opposite motions of the links cancel; or by the
    sum of the bounds of its three terms on the tube, if this is smaller.
    """

    def __init__(self, motion: PeriodMotion, force: TipForces, plant: BallPlant) -> None:
        self._whole = _Linearised(motion, force, plant, plant.exact)
        self.at, self._layout = self._whole.at, plant.layout
        arms = [parameter.arm for parameter in plant.parameters if parameter.kind in ("mass", "payload")]
        self._masses = [_Linearised(motion, _NO_FORCE, plant, arm) for arm in arms if arm is not None]
        # r_p (2 masses, 6) over the rows `StateLayout.observed`
        self.products = np.vstack(
            [np.zeros((0, len(plant.layout.observed))), *(np.hstack(one.at) for one in self._masses)]
        )

    def bound(self, tube: np.ndarray, torques: np.ndarray, free: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Return bounds (2,) [N m] on the omitted torques n of the links, if the deviation is in the tube ρ (18,).

        `torques` (8,) bounds the remainders without n. With a bound w̄ (8,) on the remainders including n,
        |S ξ| <= free (18 + k,) + push (18 + k, 8) w̄. The last k entries of S ξ are the r_p ξ of the class.
        """
        fixed = self._whole.left_out(tube)
        for one in self._masses:
            fixed += one.left_out(tube)
        sizes, count, observed = np.abs(self.products), len(self.products), self._layout.observed
        found = (fixed + self._by_link(sizes @ tube[observed])) * ROUND_UP
        for _ in range(_REFINED if count else 0):
            acting = torques.copy()
            acting[self._layout.channels.link] += found
            seen = free + push @ acting
            within = seen[-count:] + SLACK * sizes @ seen[observed]
            found = np.minimum(found, (fixed + self._by_link(within)) * ROUND_UP)
        return np.asarray(found)

    def _by_link(self, torques: np.ndarray) -> np.ndarray:
        return np.asarray(torques.reshape(-1, self._layout.joints).sum(axis=0))


class ConstantForces(NamedTuple):
    """The torques [N m] along the centre due to the uncertain constants, during one period."""

    # level, slope: a_0 and a_1 of each channel's signal for each constant, in floats (8, constants)
    level: np.ndarray
    slope: np.ndarray
    rest: np.ndarray  # bound on the remainder of the signals, for all constants together (8,)
    motor: np.ndarray  # bound on the torques on each motor, including those within its joint (2,)

    @classmethod
    def of(cls, motion: PeriodMotion, force: Forces, plant: BallPlant) -> ConstantForces:
        """Return the torques due to all uncertain constants except dry friction, which depends on the plan."""
        channels, count, joints = plant.layout.channels, plant.layout.channel_count, plant.physics.joints
        shape = count, len(plant.parameters)
        drive = cls(np.zeros(shape), np.zeros(shape), np.zeros(count), np.zeros(joints))
        for index, parameter in enumerate(plant.parameters):
            joint, half = parameter.joint, arb(parameter.half)
            motor, within = channels.motor.start + joint, channels.joint.start + joint
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
                push = [factor * signal for signal in force]
                for i, torque in enumerate(motion.link_torques(push, parameter.arm)):
                    drive._add(index, channels.link.start + i, arb(-1), torque)
        return drive

    def with_friction(self, plant: BallPlant, frictions: list[Friction]) -> ConstantForces:
        """Return a copy with uncertain dry friction on motors of plan SLIP, and no torque on those of plan MONOTONE."""
        drive, channels = ConstantForces(*(part.copy() for part in self)), plant.layout.channels
        for index, parameter in enumerate(plant.parameters):
            torque = frictions[parameter.joint].torque() if parameter.kind == "dry_friction" else None
            if torque is not None:
                drive._add(index, channels.motor.start + parameter.joint, arb(parameter.half), torque)
        for channel, friction in enumerate(frictions, channels.motor.start):
            if friction.plan is Plan.MONOTONE:
                drive.level[channel], drive.slope[channel], drive.rest[channel] = 0.0, 0.0, 0.0
        return drive

    def _add(self, constant: int, channel: int, factor: arb, signal: Signal) -> None:
        """Store factor · signal as the torque due to one constant in one channel, given their indices."""
        torque = factor * signal
        level, slope = middle_of(torque[0]), middle_of(torque[1])
        self.level[channel, constant], self.slope[channel, constant] = level, slope
        self.rest[channel] += torque.bent() + radius_of(torque[0], level) + radius_of(torque[1], slope)
        kind, joint = divmod(channel, len(self.motor))
        if kind != 1:  # not the links
            self.motor[joint] += torque.size()
