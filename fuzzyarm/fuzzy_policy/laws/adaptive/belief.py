"""What the adaptive observer estimates beside the arm's state: load, parameters of the arm, lateness.

    p = (f_t, F, m_p, k, φ, μ, ι, d)

The load is a force f_t along the reference's tip velocity, a free force F at the tip and a payload m_p there. k, φ, μ
and ι are factors, one for each joint, of stiffness, dry friction, link mass and inertia, and motor inertia. d is the
time from a command to the motors, in control periods.

The constants of the equations of motion are affine in (m_p, k, φ, μ, ι): a = a_0 + S (p - p_0).
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

__all__ = ["BELIEF", "BELIEFS", "Belief", "affine_constants", "allowed", "first_guess", "first_spread"]

SPACE = len(Point._fields)


class Belief(NamedTuple):
    """The parts of p, or where they lie in an array."""

    travel_force: Any
    force: Any
    payload: Any
    stiffness: Any
    damping: Any
    friction: Any
    mass: Any
    motor_inertia: Any
    lateness: Any


BELIEF = Belief(*consecutive(1, SPACE, 1, JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, 1))
BELIEFS = BELIEF.lateness.stop
_FACTORS = ("stiffness", "damping", "friction", "mass", "motor_inertia")
_FIELDS = {
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "friction": ("static_friction", "coulomb_friction"),
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
}


def first_guess() -> np.ndarray:
    """Return p_0 (13,): no load, the known arm, no lateness."""
    p = np.zeros(BELIEFS)
    for name in _FACTORS:
        p[getattr(BELIEF, name)] = 1.0
    return p


def first_spread(parameters: ArmParameters, weights: AdaptiveWeights) -> np.ndarray:
    """Return the standard deviations (13,) of p when an episode begins."""
    force, payload = weights.first_force * unit_force(parameters), weights.first_payload * sum(parameters.mass)
    parts = Belief(
        force,
        force,
        payload,
        weights.first_stiffness,
        weights.first_damping,
        weights.first_friction,
        weights.first_inertia,
        weights.first_inertia,
        weights.first_lateness,
    )
    return _filled(parts)


def allowed(parameters: ArmParameters, longest: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest p (13,)."""
    force, payload = 4.0 * unit_force(parameters), sum(parameters.mass)
    low = Belief(-force, -force, -0.1 * payload, 0.3, 0.0, 0.0, 0.5, 0.4, 0.0)
    high = Belief(force, force, 2.0 * payload, 3.0, 4.0, 4.0, 2.0, 2.5, float(longest))
    return _filled(low), _filled(high)


def affine_constants(parameters: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return a_0 (20,) and S (20, 13)."""
    base = np.array(arm_constants(parameters))
    slopes = np.zeros((len(base), BELIEFS))
    slopes[:, BELIEF.payload] = (np.array(arm_constants(parameters, Payload(1.0))) - base)[:, np.newaxis]
    for name in _FACTORS:
        for joint in range(JOINTS):
            slopes[:, getattr(BELIEF, name).start + joint] = _share(parameters, name, joint, base)
    return base, slopes


def _share(parameters: ArmParameters, name: str, joint: int, base: np.ndarray) -> np.ndarray:
    """Return the change of the constants when a factor of one joint goes from 1 to 2."""
    changed: dict[str, Any] = {}
    for field in _FIELDS[name]:
        values = list(getattr(parameters, field))
        values[joint] *= 2.0
        changed[field] = tuple(values)
    if name == "friction":
        pass
    return np.array(arm_constants(dataclasses.replace(parameters, **changed))) - base


def _filled(parts: Belief) -> np.ndarray:
    p = np.empty(BELIEFS)
    for where, value in zip(BELIEF, parts, strict=True):
        p[where] = value
    return p
