"""The fastest rate of an arm, which limits the sub-step: elastic modes, dampers and viscous friction.

Around a posture q without dry friction, in the coordinates (θ, q) of motors and links, the arm is

    diag(I_a, M_b) ẍ + B ẋ + K x = 0,    K = Eᵀ K_t E,    B = Eᵀ B_t E + diag(F_v, 0),    E = (1, -1),

and the time step of `physics.integrator`, with two evaluations and a sub-step h, yields, with C = 1 - h B/2,

    C⁻¹ (x_{k+1} - 2 x_k + x_{k-1}) + h B (x_k - x_{k-1}) + h² K x_k = 0    (mass-normalised).

All three matrices are symmetric, so a root μ of a mode satisfies a scalar equation m (μ - 1)² + b (μ - 1) + k μ = 0
whose coefficients obey b <= m/2 and k <= h² ω² m if h β < 2. Every mode therefore decays if h ω < 2 and h β < 2, for

    ω² = λ_max(√K_t W √K_t),    β = λ_max(√B_t W √B_t) + max(F_v/I_a),    W = diag(1/I_a) + M_b(q)⁻¹.

Both ω and β grow with stiffness, damping and viscous friction and fall with every inertia and mass. So the worst corner
of a set of plants is known, and it has no payload. Dry friction adds no condition: stick is exact, and the slope of the
Stribeck curve adds no stiffness.
"""

import functools
import math
from collections.abc import Iterable

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.rigid_body import mass_matrix
from fuzzyarm.envs.scenario.kinematics import angle_ranges
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation

__all__ = ["fastest_rate"]

_POSTURES = 64
"""Postures drawn from the angle ranges, in addition to posture 0; the margin of `periods` covers all others."""


def fastest_rate(arms: Iterable[AnyArm], drawn: DomainRandomisation | None = None) -> float:
    """Return the largest max(ω, β) [rad/s], see the module, of these arms at the worst corner of the ranges `drawn`."""
    r = DomainRandomisation() if drawn is None else drawn
    corner = r.mass[0], r.motor_inertia[0], r.stiffness[1], r.damping[1], r.viscous_friction[1]
    return max(_rate(arm, *corner) for arm in {id(arm): arm for arm in arms}.values())


@functools.lru_cache(maxsize=256)
def _rate(
    arm: AnyArm, mass: float, motor_inertia: float, stiffness: float, damping: float, viscous_friction: float
) -> float:
    """Return the module's max(ω, β) [rad/s] for an arm's quantities times these factors; inf if M_b is singular."""
    robot = robot_of(arm)
    low, high = angle_ranges(robot)
    postures = np.random.default_rng(0).uniform(low, high, (_POSTURES, len(robot)))
    postures = np.concatenate([np.zeros((1, len(robot))), postures])
    rotor = motor_inertia * robot.drive("motor_inertia")
    with np.errstate(all="ignore"):
        try:
            inverse = np.diag(1.0 / rotor) + np.linalg.inv(mass * mass_matrix(robot, postures))
            omega, beta = (
                np.linalg.eigvalsh(np.sqrt(k)[:, np.newaxis] * inverse * np.sqrt(k)).max()
                for k in (stiffness * robot.drive("stiffness"), damping * robot.drive("damping"))
            )
        except np.linalg.LinAlgError:
            return math.inf
        rate = float(
            np.maximum(np.sqrt(omega), beta + np.max(viscous_friction * robot.drive("viscous_friction") / rotor))
        )
    return rate if math.isfinite(rate) else math.inf
