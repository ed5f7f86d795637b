"""The plants and forces of `comparison.py`, and the errors of a policy over them, which a file keeps between runs.

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
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep._episodes import SweepResults, run_plants
from fuzzyarm.eval.sweep.config import SweepConfig

__all__ = ["COMPARED_CASES", "FIRST_SEED", "Errors", "errors_of", "measured"]


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


UNSEEN = (
    Case("blows", "Blows", Disturbance(tip_force=Blows())),
    Case("turning", "A force that turns", Disturbance(tip_force=Turning())),
)
COMPARED_CASES = {case.name: case.title for case in (*(CASES[name] for name in PAPER_CASES), *UNSEEN)}
"""Titles of the cases by name."""
DISTRIBUTION, FIRST_SEED, CHUNK = "loads", 700_000, 250  # plants at once


class Errors(NamedTuple):
    """The errors of a policy.

    Attributes:
        rms_mm: rms tip errors (cases, plants) [mm]; inf where an episode ended early.
        largest_mm: largest tip errors (cases, plants) [mm]; inf where an episode ended early.
        commit: at which they were measured; empty outside a checkout.
    """

    rms_mm: np.ndarray
    largest_mm: np.ndarray
    commit: str


def measured(path: Path | None, policy: Any, plants: int, jobs: int | None, report: Callable[[int], None]) -> Errors:
    """Return the errors of a policy over the first plants from a file if they are there, else measure and keep them.

    Args:
        path: of the file; None: nothing is read or kept.
        policy: the policy.
        plants: how many.
        jobs: processes; None: one per core.
        report: called with the number of plants that are done.
    """
    on = [DISTRIBUTION, str(FIRST_SEED), *COMPARED_CASES]
    if path is not None and path.exists():
        with np.load(path, allow_pickle=False) as kept:
            found = Errors(kept["rms_mm"], kept["largest_mm"], str(kept["commit"]))
            if kept["on"].tolist() == on and found.rms_mm.shape == (len(COMPARED_CASES), plants):
                return found
    found = errors_of(policy, plants, jobs, report)
    if path is not None:
        buffer = io.BytesIO()
        np.savez(buffer, on=on, **found._asdict())
        write_atomically(path, buffer.getvalue())
    return found


def errors_of(policy: Any, plants: int, jobs: int | None, report: Callable[[int], None]) -> Errors:
    """Run a policy on the first plants and return its errors; arguments as in `measured`."""
    _register()
    config = SweepConfig(
        policies=("fuzzy-1",),  # a name is asked for; the policy that is run is given to `run_plants`
        cases=tuple(COMPARED_CASES),
        distribution=DISTRIBUTION,
        plants=plants,
        seed=FIRST_SEED,
        chunk=CHUNK,
    )
    work, parts = functools.partial(_chunk, config, policy), {}
    for number, part in Engine(jobs=jobs).run(work, range(config.chunks)):
        parts[number] = part
        report(sum(len(one.plants) for one in parts.values()))
    found = SweepResults.joined([parts[number] for number in sorted(parts)])
    lost = ~found.completed[0]
    rms, largest = (np.where(lost, np.inf, errors[0]) for errors in (found.metrics["rms_mm"], found.metrics["max_mm"]))
    return Errors(rms, largest, current_provenance()["commit"] or "")


def _chunk(config: SweepConfig, policy: Any, number: int) -> SweepResults:
    _register()  # in the process of a worker
    return run_plants(config, {"compared": policy}, config.members(number))


def _register() -> None:
    """Make the forces known as cases, once."""
    for case in UNSEEN:
        if case.name not in CASES:
            add_case(case)
