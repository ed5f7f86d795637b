"""The plants and forces of `comparison.py`: what nobody trained on, and the errors of policies on it.

The plants are those of the sweeps' distribution ``loads``, from a seed that no training, tuning or test uses. Beside
the paper's three cases each of them meets two forces that no training has drawn: blows, and a force that turns around.
"""

from __future__ import annotations

import dataclasses
import functools
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES, Case, add_case
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.engine import Engine
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.eval.sweep.results import SweepResults

__all__ = ["CHUNK", "COMPARED_CASES", "SEED", "Errors", "errors_of", "keep", "kept"]

SEED, CHUNK = 700_000, 250  # the first plant's; plants at once


class Errors(NamedTuple):
    """The errors of a policy.

    Attributes:
        rms_mm: rms tip errors (cases, plants) [mm]; inf where an episode ended early.
        largest_mm: largest tip errors (cases, plants) [mm]; inf where an episode ended early.
        commit: at which they were measured; None outside a checkout.
    """

    rms_mm: np.ndarray
    largest_mm: np.ndarray
    commit: str | None


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
COMPARED_CASES: dict[str, str] = {case.name: case.title for case in (*(CASES[name] for name in PAPER_CASES), *_UNSEEN)}
"""The paper's cases, then the forces that no training has drawn: titles by name."""


def errors_of(policy: Any, plants: int, jobs: int | None, report: Callable[[int], None]) -> Errors:
    """Run a policy on the plants and return its errors.

    Args:
        policy: the policy.
        plants: how many, from seed `SEED` on.
        jobs: processes; None: one per core.
        report: called with the number of plants that are done.
    """
    _register()
    config = SweepConfig(policies=("fuzzy-1",), cases=tuple(COMPARED_CASES), plants=plants, seed=SEED, chunk=CHUNK)
    work, parts = functools.partial(_chunk, config, policy), {}
    for number, part in Engine(jobs=jobs).run(work, range(config.chunks)):
        parts[number] = part
        report(sum(len(one.plants) for one in parts.values()))
    found = SweepResults.joined([parts[number] for number in sorted(parts)])
    lost = ~found.completed[0]
    rms, largest = (np.where(lost, np.inf, errors[0]) for errors in (found.rms_mm, found.max_mm))
    return Errors(rms, largest, current_provenance()["commit"])


def kept(path: Path, plants: int) -> Errors | None:
    """Return the errors of a file that `keep` wrote; None without one, or if it has other plants or cases."""
    if not path.exists():
        return None
    with np.load(path, allow_pickle=False) as stored:
        if stored["first_seed"] != SEED or list(stored["cases"]) != list(COMPARED_CASES):
            return None
        errors = Errors(stored["rms_mm"], stored["largest_mm"], str(stored["commit"]) or None)
    return errors if errors.rms_mm.shape == (len(COMPARED_CASES), plants) else None


def keep(path: Path, errors: Errors) -> None:
    """Write errors to a file, with what they were measured on."""
    buffer = io.BytesIO()
    np.savez(
        buffer,
        rms_mm=errors.rms_mm,
        largest_mm=errors.largest_mm,
        commit=errors.commit or "",
        first_seed=SEED,
        cases=list(COMPARED_CASES),
    )
    write_atomically(path, buffer.getvalue())


def _chunk(config: SweepConfig, policy: Any, number: int) -> SweepResults:
    _register()  # in the process of a worker
    return run_plants(config, {"compared": policy}, config.members(number))


def _register() -> None:
    """Make the two forces known as cases, once."""
    for case in _UNSEEN:
        if case.name not in CASES:
            add_case(case)
