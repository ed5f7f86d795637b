"""What the adaptive observer estimates beside the arm's state: load, constants of the arm, lateness.

    p = (f_t, F, m_p, k, β, φ, μ, ι, w, d)

The load is a force f_t along the reference's tip velocity, a free force F at the tip and a payload m_p there. k, β, φ,
μ and ι are factors, one for each joint, of stiffness, damping, dry friction, link mass and inertia, and motor inertia.
w is a torque that acts beside that of each motor, and d the time from a command to the motors, in control periods.

The constants of the equations of motion are affine in (m_p, k, β, φ, μ, ι): a = a_0 + S (p - p_0).
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import Point
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights, unit_force

__all__ = [
    "BELIEF",
    "BELIEFS",
    "CAUTIOUS",
    "FACTORS",
    "FORCES",
    "SPACE",
    "Belief",
    "affine_constants",
    "allowed",
    "first_guess",
    "first_spread",
    "walks",
]

SPACE = len(Point._fields)
"""Components of a force at the tip."""


class Belief(NamedTuple):
    """The parts of p, or where they lie in an array; the letters are those of the module's docstring.

    Attributes:
        travel_force: f_t [N].
        force: F [N].
        payload: m_p [kg].
        stiffness: k.
        damping: β.
        friction: φ.
        mass: μ.
        motor_inertia: ι.
        offset: w [N m].
        lateness: d [control periods].
    """

    travel_force: Any
    force: Any
    payload: Any
    stiffness: Any
    damping: Any
    friction: Any
    mass: Any
    motor_inertia: Any
    offset: Any
    lateness: Any


BELIEF = Belief(*consecutive(1, SPACE, 1, *[JOINTS] * 6, 1))
"""Where the parts of p lie."""
BELIEFS: int = BELIEF.lateness.stop
"""How many numbers p has."""
FORCES: int = BELIEF.force.stop
"""How many of them are forces; they come first."""
FACTORS = ("stiffness", "damping", "friction", "mass", "motor_inertia")
"""The parts that are factors of the known arm."""
CAUTIOUS = (*FACTORS, "lateness")
"""The parts that learn only from what the noise of the sensors does not explain."""

# The fields of `ArmParameters` that a factor multiplies.
_FIELDS = {
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "friction": ("static_friction", "coulomb_friction"),
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
}
_LARGEST_FORCE = 4.0  # in unit forces
_LARGEST_OFFSET = 0.2  # share of the torque limit
_LIGHTEST, _HEAVIEST = -0.1, 2.0  # payload, in masses of the links; below zero: links lighter than known
_FACTOR_RANGE = {
    "stiffness": (0.5, 1.9),
    "damping": (0.0, 3.0),
    "friction": (0.0, 3.0),
    "mass": (0.5, 1.9),
    "motor_inertia": (0.5, 1.9),
}


def first_guess() -> np.ndarray:
    """Return p_0: no load, the known arm, no lateness."""
    guess = np.zeros(BELIEFS)
    for name in _FIELDS:
        guess[getattr(BELIEF, name)] = 1.0
    return guess


def first_spread(parameters: ArmParameters, weights: AdaptiveWeights) -> np.ndarray:
    """Return the standard deviations of p when an episode begins."""
    force = weights.first_force * unit_force(parameters)
    return _filled(
        Belief(
            force,
            force,
            weights.first_payload * sum(parameters.mass),
            weights.first_stiffness,
            weights.first_damping,
            weights.first_friction,
            weights.first_inertia,
            weights.first_inertia,
            weights.first_offset * np.array(parameters.torque_limit),
            weights.first_lateness,
        )
    )


def walks(parameters: ArmParameters, weights: AdaptiveWeights) -> np.ndarray:
    """Return how fast each number of p walks, in its unit per √s."""
    force, still = unit_force(parameters), dict.fromkeys(_FIELDS, 0.0)
    return _filled(
        Belief(weights.travel_walk * force, weights.force_walk * force, 0.0, **still, offset=0.0, lateness=0.0)
    )


def allowed(parameters: ArmParameters, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest p; `longest` is the highest lateness [control periods]."""
    force, mass = _LARGEST_FORCE * unit_force(parameters), sum(parameters.mass)
    torque = _LARGEST_OFFSET * np.array(parameters.torque_limit)
    low, high = ({name: ends[side] for name, ends in _FACTOR_RANGE.items()} for side in range(2))
    return (
        _filled(Belief(-force, -force, _LIGHTEST * mass, **low, offset=-torque, lateness=0.0)),
        _filled(Belief(force, force, _HEAVIEST * mass, **high, offset=torque, lateness=longest)),
    )


def affine_constants(parameters: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return a_0, the constants of `Arm`, and S (constants, numbers of p)."""
    base = np.array(arm_constants(parameters))
    slopes = np.zeros((len(base), BELIEFS))
    slopes[:, BELIEF.payload] = (np.array(arm_constants(parameters, Payload(1.0))) - base)[:, np.newaxis]
    for name, fields in _FIELDS.items():
        for joint in range(JOINTS):
            doubled = dataclasses.replace(
                parameters,
                **{field: _doubled(getattr(parameters, field), joint) for field in fields},  # type: ignore[arg-type]
            )
            slopes[:, getattr(BELIEF, name).start + joint] = np.array(arm_constants(doubled)) - base
    return base, slopes


def _doubled(values: tuple[float, ...], joint: int) -> tuple[float, ...]:
    return tuple(2.0 * value if j == joint else value for j, value in enumerate(values))


def _filled(parts: Belief) -> np.ndarray:
    """Return an array with these numbers, each repeated over its part."""
    array = np.empty(BELIEFS)
    for where, value in zip(BELIEF, parts, strict=True):
        array[where] = value
    return array
