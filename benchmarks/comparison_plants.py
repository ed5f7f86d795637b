"""The plants and forces of `comparison.py`, what nobody trained on.

The plants are those of the sweeps' distribution ``loads``, from a seed that no training, tuning or test uses. Beside
the paper's three cases each of them meets two forces that no training has drawn: blows, and a force that turns around.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from plant_errors import Population

from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES, Case
from fuzzyarm.envs.scenario.disturbances import Disturbance

__all__ = ["COMPARED", "COMPARED_CASES"]


@dataclasses.dataclass(frozen=True)
class Blows:
    """Blows of `size` [N] for `length` [s] every `interval` [s], each a right angle further than the one before."""

    size: float = 250.0
    length: float = 0.01
    interval: float = 0.19

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s]; the tip's velocity plays no part."""
        number, since = np.divmod(np.asarray(time, dtype=float), self.interval)
        size, angle = np.where(since < self.length, self.size, 0.0), 0.5 * np.pi * number
        return np.stack([size * np.cos(angle), size * np.sin(angle)], axis=-1)


@dataclasses.dataclass(frozen=True)
class Turning:
    """A force of `size` [N] that turns around `frequency` times a second, whatever the tip does."""

    size: float = 110.0
    frequency: float = 6.5

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s]; the tip's velocity plays no part."""
        angle = 2.0 * np.pi * self.frequency * np.asarray(time, dtype=float)
        return np.stack([self.size * np.cos(angle), self.size * np.sin(angle)], axis=-1)


_UNSEEN = (
    Case("blows", "Blows", Disturbance(tip_force=Blows())),
    Case("turning", "A force that turns", Disturbance(tip_force=Turning())),
)
COMPARED = Population("loads", (*(CASES[name] for name in PAPER_CASES), *_UNSEEN), first_seed=700_000, chunk=250)
"""The plants, and for each the paper's cases and the forces that no training has drawn."""

COMPARED_CASES: dict[str, str] = {case.name: case.title for case in COMPARED.cases}
"""Titles of the cases by name."""
