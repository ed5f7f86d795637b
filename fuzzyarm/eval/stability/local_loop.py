"""The linear loop of a policy with the sampled arm, its spectral radius and the limits of its loop gain.

With the deviations x of the plant's states [rad, rad/s], s of the policy's memory and u of the torques [N m], one
control period is

    x⁺ = A x + B u_(k-d),    u = κ (D x + C s),    s⁺ = G x + F s,

where κ is a factor on the loop gain and d are extra samples of delay (0: the torque computed from the sample at t_k
acts from t_k). Between samples, d = m + 1/2, the torque changes in the middle of the period; with the map A_h, B_h of
half a period

    x⁺ = A_h (A_h x + B_h u_(k-m-1)) + B_h u_(k-m).

The spectral radius of the matrix of (x, s, u_(k-1), u_(k-2), ...), with ⌈d⌉ torques, is below 1 if and only if small
deviations decay.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from fuzzyarm.common.bisection import last_that_works
from fuzzyarm.common.checks import real

__all__ = ["GAIN_SPAN", "GainLimits", "LocalLoop", "gain_limits", "largest_radius"]

GAIN_SPAN = 100.0
"""A gain margin is searched from κ = 1 up to this factor and down to its inverse."""


_GAIN_RATIO = 1.1  # of that search
_GAIN_TOLERANCE = 1e-4  # of a gain margin, relative


class GainLimits(NamedTuple):
    """Factors on the loop gain below 1 and above 1 between which a loop is stable.

    Attributes:
        lower: 0 where there is no limit within `GAIN_SPAN`, nan if the loop is unstable with its own gain.
        upper: inf where there is no limit, nan likewise.
    """

    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class LocalLoop:
    """The loop of the module's equation at one posture; n plant states, r torques, m numbers of memory.

    Memory that the torque never reads is left out: an integral without a gain would add an eigenvalue of exactly 1,
    which says nothing about the arm. An integral that is fed back has its eigenvalues elsewhere.

    Attributes:
        plant: [A B], (n, n + r).
        half_plant: [A_h B_h], (n, n + r).
        law: [D C; G F], (r + m, n + m).
        equilibrium: plant state and whole memory, (n + m or more,).
        torque: at the equilibrium [N m], (r,).
    """

    plant: np.ndarray
    half_plant: np.ndarray
    law: np.ndarray
    equilibrium: np.ndarray
    torque: np.ndarray

    def matrix(self, loop_gain: float = 1.0, delay: float = 0.0) -> np.ndarray:
        """Return the map of (x, s, u_(k-1), u_(k-2), ...) over one control period, for κ = `loop_gain`, d = `delay`."""
        real("loop_gain", loop_gain, low=0.0)
        real("delay", delay, "samples", low=0.0)
        if not float(2.0 * delay).is_integer():
            raise ValueError(f"delay = {delay!r} is no multiple of half a sample; allowed: 0, 0.5, 1, 1.5, ...")
        n, columns = len(self.plant), self.law.shape[1]
        inputs = self.plant.shape[1] - n
        unit = np.eye(columns + math.ceil(delay) * inputs)
        law = self.law @ unit[:columns]
        torques = np.vstack([loop_gain * law[:inputs], unit[columns:]])  # newest first, the last one acts
        moved = unit[:n]
        if float(delay).is_integer():
            moved = self.plant @ np.vstack([moved, torques[-inputs:]])
        else:  # the last one for half a period, then the one before
            moved = self.half_plant @ np.vstack([moved, torques[-inputs:]])
            moved = self.half_plant @ np.vstack([moved, torques[-2 * inputs : -inputs]])
        return np.vstack([moved, law[inputs:], torques[:-inputs]])


def largest_radius(loops: Sequence[LocalLoop], loop_gain: float = 1.0, delay: float = 0.0) -> float:
    """Return max |λ| over loops, see `linearisation.spectral_radius`."""
    # One by one: where a learned law saturates, less of its memory is read, and the matrix is smaller.
    return max(float(np.abs(np.linalg.eigvals(loop.matrix(loop_gain, delay))).max()) for loop in loops)


def gain_limits(loops: Sequence[LocalLoop], delay: float = 0.0) -> GainLimits:
    """Return the loop gains between which every loop is stable, see `linearisation.gain_margin`."""

    def stable(loop_gain: float) -> bool:
        return largest_radius(loops, loop_gain, delay) < 1.0

    if not stable(1.0):
        return GainLimits(math.nan, math.nan)
    search = partial(last_that_works, stable, 1.0, resolution=_GAIN_TOLERANCE)
    lower = search(1.0 / _GAIN_RATIO, limit=1.0 / GAIN_SPAN)
    upper = search(_GAIN_RATIO, limit=GAIN_SPAN)
    return GainLimits(0.0 if lower is None else lower, math.inf if upper is None else upper)
