"""What a policy answers at a sample, for all states of a zonotope at once: its torque, and what it remembers.

    (u, m⁺) = law(θ, θ̇, m; r_k),      m: the numbers that the policy carries from one sample to the next.

A law takes the deviations of (θ, θ̇, m) from a point as a zonotope, and gives those of (u, m⁺) from another point over
the same columns and some of its own: so what the torque and the memory have in common is kept. A law that is smooth is
the linear one, G, and what that leaves out,

    |law(x) - law(c) - G (x - c)| <= |∂law - G| |x - c|,      ∂law at every point of the box (mean value theorem).
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.eval.certified.tip.enclosures import SLACK, ball, centre, radius_of
from fuzzyarm.eval.certified.tip.laws import BallLaw, Sample
from fuzzyarm.eval.certified.tip.zonotope import Zonotope, product

__all__ = ["LAW_ROUNDING", "MEASURED", "FixedLaw", "Response", "SampledLaw", "smooth_part"]

MEASURED = 2 * JOINTS
"""Numbers of θ, θ̇, which come before those of the memory."""

LAW_ROUNDING = 2.0**-42
"""Relative allowance for the floats of a law, of its terms: more than a thousand operations."""


class Response(NamedTuple):
    """What follows from a sample: deviations of (u, m⁺) from a point, |x - middle| = |columns g + β|, |β| <= box.

    Attributes:
        middle: (2 + m,) torques [N m] and the memory.
        columns: (2 + m, n); the first are those of the deviations that the law was given.
        box: (2 + m,).
    """

    middle: np.ndarray
    columns: np.ndarray
    box: np.ndarray


class SampledLaw(Protocol):
    """A policy, sample by sample.

    Attributes:
        memory: how many numbers it remembers.
    """

    memory: int

    def respond(self, k: int, point: np.ndarray, seen: Zonotope) -> Response:
        """Return the answer at the k-th sample.

        Args:
            k: number of the sample; at the first one the memory is zero.
            point: (4 + m,) θ, θ̇ as they are measured at the centre, and the memory.
            seen: the deviations from it.

        Raises:
            ValueError: the deviations leave what the law is defined on.
        """
        ...


def smooth_part(
    at: list[Any], slopes: list[list[Any]], spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the middle (n,), G (n, m) and the bound (n,) of what G leaves out, of a smooth function.

    Args:
        at: the function at the point, n balls.
        slopes: its derivatives at every point of the box, (n, m) balls; None where they are zero.
        spread: half the sides of the box (m,).
    """
    middle = np.array([centre(x) for x in at])
    gain, rest = np.zeros((len(at), len(spread))), np.zeros(len(at))
    for i, (value, row) in enumerate(zip(at, slopes, strict=True)):
        rest[i] = radius_of(value, middle[i])
        for j, slope in enumerate(row):
            if slope is not None:
                gain[i, j] = centre(slope)
                rest[i] += radius_of(slope, gain[i, j]) * spread[j]
    return middle, gain, rest * (1.0 + SLACK) + SLACK * np.abs(gain) @ spread


class FixedLaw:
    """A law that remembers the integral of the error alone, x_I⁺ = x_I + T (θ - q_r).

    Attributes:
        samples: what the law is told at each sample.
        memory: 2.
    """

    memory = JOINTS

    def __init__(self, law: BallLaw, samples: list[Sample], period: float) -> None:
        """Take the law on balls, what it is told, and T [s]."""
        self._law, self.samples, self._period = law, samples, period

    def respond(self, k: int, point: np.ndarray, seen: Zonotope) -> Response:
        """Return the answer at the k-th sample, see `SampledLaw`."""
        sample, spread, period = self.samples[k], seen.totals(), self._period
        theta, velocity, integral = (slice(i * JOINTS, (i + 1) * JOINTS) for i in range(3))
        here = [ball(x) for x in point.tolist()]
        around = [x + ball(0.0, r) for x, r in zip(here, spread.tolist(), strict=True)]
        at = self._law.torque(here[theta], here[velocity], here[integral], sample)
        tube = self._law.torque(around[theta], around[velocity], around[integral], sample)
        torque, gain, rest = smooth_part(at.value, tube.slopes, spread)
        rest += SLACK * rest + LAW_ROUNDING * tube.terms
        error = point[theta] - sample.reference[:JOINTS]
        slip = np.abs(point[integral]) + period * (np.abs(error) + np.abs(point[theta]))
        columns = np.hstack([
            np.vstack([product(gain, seen.columns), seen.columns[integral] + period * seen.columns[theta]]),
            np.vstack([np.diag(rest), np.zeros((JOINTS, JOINTS))]),
        ])  # fmt: skip
        kept = seen.box[integral] + period * seen.box[theta] + SLACK * (2.0 * slip + spread[integral] + spread[theta])
        box = np.concatenate([np.abs(gain) @ seen.box, kept])
        return Response(np.concatenate([torque, point[integral] + period * error]), columns, box)
