"""What the network of `learned-observer` sees: the unexplained z and the context c, each of order 1.

With the innovations ν_a and ν_o, y - ŷ⁻ of the adaptive and of the elastic observer, one number for each motor angle
and velocity, their torques u_a and u_o, and the load l = (forces, payload) of the beliefs p,

    z = (a(ν_a), b(ν_a), a(ν_o), b(ν_o), d̂/R, asinh((u_a - u_o)/(κ R)), the last ρ, asinh((l - l_0)/l_1)),
    a(ν) = asinh(ν/s),    b(ν) = asinh(ν/S) ν²/(s² + ν²),

with κ = `GAP_SHARE`, `FINE` units s, `COARSE` units S, and the `Units` R and l_1 of an arm: a(ν)
resolves what is small; b(ν) is linear in what is large and flat about zero. d̂ is what the elastic observer
believes to load the links. z vanishes where nothing is unexplained and the arm is on its target. From the observation
and the beliefs follows

    c = (cos and sin of θ_1 and θ_1 + θ_2, q̇_d, q̈_d, u_ff, directions of the joints, direction of travel e, Jᵀ e,
         what is believed of lateness and noise, m),

e = v/√(|v|² + v_0²) with the reference velocity v of the tip, and likewise of the joints. m = |v|²/(|v|² + v_1²) is 0
at rest and close to 1 in motion, with v_1 = 0.1 mm/s.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, Observation
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.learned_policy.functions import area_sine

__all__ = [
    "COARSE",
    "CONTEXT",
    "FINE",
    "GAP_SHARE",
    "MOTION",
    "QUIET",
    "UNEXPLAINED",
    "UNEXPLAINED_PARTS",
    "Scale",
    "UnexplainedParts",
    "Units",
    "scale_of",
    "see_beliefs",
    "see_context",
    "see_innovation",
    "see_unexplained",
    "units_of",
]

FINE = (5e-7, 2e-6, 1e-3, 4e-3)
"""Units s of the innovation of angles [rad] and velocities [rad/s]."""

COARSE = (1e-5, 4e-5, 2e-2, 8e-2)
"""Units S of what is large among them."""

GAP_SHARE = 0.05
"""Share of R that is the unit of u_a - u_o."""

QUIET = 1.0 / 600.0
"""Share of the torques R: for a load d̂ below it the elastic observer all but acts alone."""

_BEYOND = 1.2  # R over the torque limits
_FORCE, _MASS = 20.0, 1.0  # N and kg, l_1 of the arm of Table 1
_BELIEVED = JOINTS + 2  # numbers of l: the force along the direction of travel, the free force, the payload
_FASTEST, _JERKIEST = 3.0, 30.0  # units of q̇_d [rad/s] and of q̈_d [rad/s²]
_SLOW, _SLOW_TIP = 0.05, 0.02  # rad/s and m/s: below it a direction fades
_REST = 1e-4  # m/s, v_1
_NOISE, _NOISES = 1e-6, 3.0  # rad, unit of the noise that is read; e-fold of its asinh that counts as 1


class Scale(NamedTuple):
    """How large an arm is, in arms of Table 1: forces at its tip, masses, and lengths."""

    force: float
    mass: float
    length: float


def scale_of(arm: ArmParameters) -> Scale:
    """Return the scale of an arm: of the first motor's limit over the reach, of the links' mass, and of the reach."""
    paper = ArmParameters()
    forces, masses, lengths = zip(
        *((a.torque_limit[0] / sum(a.length), sum(a.mass), sum(a.length)) for a in (arm, paper)), strict=True
    )
    return Scale(forces[0] / forces[1], masses[0] / masses[1], lengths[0] / lengths[1])


class Units(NamedTuple):
    """What torques and loads are seen in.

    Attributes:
        torque: R, 1.2 of the torque limits [N m]: of loads and of residual torques, whose largest values it is.
        load: l_1 (4,), of the force along the direction of travel, of the free force [N] and of the payload [kg].
    """

    torque: Any
    load: Any


def units_of(arm: ArmParameters) -> Units:
    """Return the units for an arm."""
    scale = scale_of(arm)
    load = np.array([*[_FORCE * scale.force] * (_BELIEVED - 1), _MASS * scale.mass])
    return Units(_BEYOND * np.array(arm.torque_limit), load)


class UnexplainedParts(NamedTuple):
    """Where the parts of z lie, in the order of the module's equation."""

    fine: Any
    coarse: Any
    slow_fine: Any
    slow_coarse: Any
    load: Any
    gap: Any
    residual: Any
    belief: Any


UNEXPLAINED_PARTS = UnexplainedParts(*consecutive(*[2 * JOINTS] * 4, *[JOINTS] * 3, _BELIEVED))
"""Where they stand in z."""
UNEXPLAINED: int = UNEXPLAINED_PARTS.belief.stop
"""Numbers in z."""

_ANGLES, _VELOCITIES, _ACCELERATIONS, _FEEDFORWARD, _SIGNS, _TRAVEL, _LEVER, _TRUST, _MOTION = consecutive(
    2 * JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, 5, 1
)
MOTION: int = _MOTION.start
"""Where m stands in c."""
CONTEXT: int = _MOTION.stop
"""Numbers in c."""
_Z_FINE, _Z_COARSE, _Z_SLOW_FINE, _Z_SLOW_COARSE, _Z_LOAD, _Z_GAP, _Z_RESIDUAL, _Z_BELIEF = UNEXPLAINED_PARTS


@register_jitable
def _scaled(innovation: np.ndarray, fine: np.ndarray, coarse: np.ndarray) -> None:
    """Fill a(ν) and b(ν) from ν, each (2 n,)."""
    for k in range(2 * JOINTS):
        square = innovation[k] * innovation[k]
        fine[k] = area_sine(innovation[k] / FINE[k])
        coarse[k] = area_sine(innovation[k] / COARSE[k]) * (square / (square + FINE[k] * FINE[k]))


@register_jitable
def see_innovation(lane: int, o: Observation, m: Memory, innovation: np.ndarray, z: np.ndarray) -> None:
    """Fill the parts of z (`UNEXPLAINED`,) that are of ν_a, before that filter's correction; 0 as an episode begins.

    `innovation` (2 n,) [rad, rad/s] becomes ν_a.
    """
    begun = m.flags[FLAG.samples] > 0.0
    for i in range(JOINTS):
        innovation[i] = o.q_motor[lane, i] - m.z[i] if begun else 0.0
        innovation[JOINTS + i] = o.dq_motor[lane, i] - m.z[2 * JOINTS + i] if begun else 0.0
    _scaled(innovation, z[_Z_FINE], z[_Z_COARSE])


@register_jitable
def see_unexplained(
    innovation: np.ndarray, load: np.ndarray, gap: np.ndarray, residual: np.ndarray, units: Units, z: np.ndarray
) -> None:
    """Fill parts of z from ν_o (2 n,) [rad, rad/s], d̂ and u_a - u_o (n,) [N m] and the last ρ (n,)."""
    _scaled(innovation, z[_Z_SLOW_FINE], z[_Z_SLOW_COARSE])
    for i in range(JOINTS):
        z[_Z_LOAD][i] = load[i] / units.torque[i]
        z[_Z_GAP][i] = area_sine(gap[i] / (GAP_SHARE * units.torque[i]))
        z[_Z_RESIDUAL][i] = residual[i]


@register_jitable
def see_beliefs(m: Memory, s: Settings, units: Units, z: np.ndarray, c: np.ndarray) -> None:
    """Fill the parts of z and c that are of the corrected beliefs; 0 where the filter has diverged.

    In c these are lateness and its standard deviation [control periods], calm, surprise, and the noise that is read.
    """
    states, last, belief, trust = len(m.z) - len(s.guess), len(m.z) - 1, z[_Z_BELIEF], c[_TRUST]
    belief[:], trust[:] = 0.0, 0.0
    if m.flags[FLAG.lost] == 0.0:
        for k in range(len(units.load)):
            belief[k] = area_sine((m.z[states + k] - s.guess[k]) / units.load[k])
        deviation, noise = np.sqrt(max(m.P[last, last], 0.0)), np.sqrt(max(m.noise[0], m.noise[1]))
        calm, surprise = m.flags[FLAG.calm], area_sine(m.flags[FLAG.surprise])
        trust[0], trust[1], trust[2] = m.z[last], deviation, calm
        trust[3:][0], trust[3:][1] = surprise, area_sine(noise / _NOISE) / _NOISES


@register_jitable
def see_context(
    lane: int, o: Observation, feedforward: np.ndarray, limit: np.ndarray, length: np.ndarray, c: np.ndarray
) -> None:
    """Fill c (`CONTEXT`,) from the observation (10,) of a lane, u_ff (2,) [N m], its limit (2,) and L (2,) [m]."""
    q, dq, ddq = o.q_motor[lane], o.dq_reference[lane], o.ddq_reference[lane]
    turned = q[0] + q[1]
    (s1, c1), (s12, c12) = sine_cosine(q[0]), sine_cosine(turned)
    angles = c[_ANGLES]
    angles[0], angles[1] = c1, s1
    angles[2:][0], angles[2:][1] = c12, s12
    both = dq[0] + dq[1]
    travel, lever = c[_TRAVEL], c[_LEVER]
    x, y = -length[0] * s1 * dq[0] - length[1] * s12 * both, length[0] * c1 * dq[0] + length[1] * c12 * both
    square = x * x + y * y
    speed = np.sqrt(square + _SLOW_TIP * _SLOW_TIP)
    c[MOTION] = square / (square + _REST * _REST)
    travel[0], travel[1] = x / speed, y / speed
    lever[1] = length[1] * (c12 * travel[1] - s12 * travel[0])
    lever[0] = length[0] * (c1 * travel[1] - s1 * travel[0]) + lever[1]
    for i in range(JOINTS):
        c[_VELOCITIES][i], c[_ACCELERATIONS][i] = dq[i] / _FASTEST, ddq[i] / _JERKIEST
        c[_FEEDFORWARD][i] = feedforward[i] / limit[i]
        c[_SIGNS][i] = dq[i] / np.sqrt(dq[i] * dq[i] + _SLOW * _SLOW)
