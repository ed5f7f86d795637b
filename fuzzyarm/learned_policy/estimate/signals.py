"""What the network of `learned-observer` sees: the unexplained z and the context c, each of order 1.

With the innovation ν = y - ŷ⁻ of the observer, one number for each motor angle and velocity, and the torques u_o of
this observer and u_q of the quick one,

    z = (asinh(ν/s), asinh(ν/S) ν²/(s² + ν²), d̂/R, asinh((u_q - u_o)/(a R)), the last ρ),

with a = `QUICK_SHARE`, `FINE` units s, `COARSE` units S and the torques R = `TORQUES`: the first part resolves what is
small; the second is linear in what is large and flat about zero, so that it does not bear on small deviations. d̂ is
what the observer believes to load the links. z vanishes where nothing is unexplained and the arm is on its target. From
the observation follows

    c = (cos and sin of θ_1 and θ_1 + θ_2, q̇_d, q̈_d, u_ff, directions of the joints, direction of travel e, Jᵀ e, m),

e = v/√(|v|² + v_0²) with the reference velocity v of the tip, and likewise of the joints. m = |v|²/(|v|² + v_1²) is 0
at rest and close to 1 in motion, with v_1 = 0.1 mm/s; the network acts in proportion to it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.observation import JOINTS, Observation
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.learned_policy.functions import area_sine

__all__ = [
    "COARSE",
    "CONTEXT",
    "FINE",
    "MOTION",
    "QUICK_SHARE",
    "QUIET",
    "TORQUES",
    "UNEXPLAINED",
    "UNEXPLAINED_PARTS",
    "UnexplainedParts",
    "see_context",
    "see_unexplained",
]

FINE = (5e-7, 2e-6, 1e-3, 4e-3)
"""Units s of the innovation of angles [rad] and velocities [rad/s]; about the median in the training."""

COARSE = (1e-5, 4e-5, 2e-2, 8e-2)
"""Units S, which one innovation in a hundred exceeds."""

TORQUES = (600.0, 300.0)
"""Units of loads and residual torques [N m]; the largest residual torque, beyond what the motors have."""

QUICK_SHARE = 0.05
"""Share of them that is the unit of u_q - u_o."""

QUIET = 1.0 / 600.0
"""Share of them: for a load d̂ below it the network is all but silent."""

_FASTEST, _JERKIEST = 3.0, 30.0  # units of q̇_d [rad/s] and of q̈_d [rad/s²]
_SLOW, _SLOW_TIP = 0.05, 0.02  # rad/s and m/s: below it a direction fades
_REST = 1e-4  # m/s, v_1


class UnexplainedParts(NamedTuple):
    """Where the parts of z lie."""

    fine: Any
    coarse: Any
    load: Any
    quick: Any
    residual: Any


UNEXPLAINED_PARTS = UnexplainedParts(*consecutive(2 * JOINTS, 2 * JOINTS, JOINTS, JOINTS, JOINTS))
"""Where they stand in z."""
UNEXPLAINED: int = UNEXPLAINED_PARTS.residual.stop
"""Numbers in z."""

_ANGLES, _VELOCITIES, _ACCELERATIONS, _FEEDFORWARD, _SIGNS, _TRAVEL, _LEVER, _MOTION = consecutive(
    2 * JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, JOINTS, 1
)
MOTION: int = _MOTION.start
"""Where m stands in c."""
CONTEXT: int = _MOTION.stop
"""Numbers in c."""
_Z_FINE, _Z_COARSE, _Z_LOAD, _Z_QUICK, _Z_RESIDUAL = UNEXPLAINED_PARTS


@register_jitable
def see_unexplained(
    innovation: np.ndarray, load: np.ndarray, gap: np.ndarray, residual: np.ndarray, z: np.ndarray
) -> None:
    """Fill z (`UNEXPLAINED`,) from ν (2 n,) [rad, rad/s], d̂ and u_q - u_o (n,) [N m] and the last ρ (n,)."""
    for k in range(2 * JOINTS):
        z[_Z_FINE][k] = area_sine(innovation[k] / FINE[k])
        square = innovation[k] * innovation[k]
        z[_Z_COARSE][k] = area_sine(innovation[k] / COARSE[k]) * (square / (square + FINE[k] * FINE[k]))
    for i in range(JOINTS):
        z[_Z_LOAD][i] = load[i] / TORQUES[i]
        z[_Z_QUICK][i] = area_sine(gap[i] / (QUICK_SHARE * TORQUES[i]))
        z[_Z_RESIDUAL][i] = residual[i]


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
