"""The errors of a policy over the plants of a sweep's distribution, and files that keep them between runs."""

from __future__ import annotations

import dataclasses
import functools
import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES, Case, add_case
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import SweepResults, run_plants

__all__ = ["Errors", "Population", "errors_of", "keep", "kept", "measured"]


@dataclasses.dataclass(frozen=True)
class Population:
    """Plants and the cases that each of them meets.

    Attributes:
        distribution: of the plants, one of the sweeps'.
        cases: those that are not known yet become known as cases.
        first_seed: of the first plant.
        chunk: plants at once.
    """

    distribution: str
    cases: tuple[Case, ...]
    first_seed: int
    chunk: int

    @property
    def names(self) -> tuple[str, ...]:
        """The cases' names."""
        return tuple(case.name for case in self.cases)


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


def measured(
    path: Path | None,
    policy: Any,
    population: Population,
    plants: int,
    jobs: int | None,
    report: Callable[[int], None],
) -> Errors:
    """Return the errors of a policy from a file if they are there, else measure them and keep them there.

    Args:
        path: of the file; None: nothing is read or kept.
        policy: the policy.
        population: the first `plants` of it are run.
        plants: how many.
        jobs: processes; None: one per core.
        report: called with the number of plants that are done.

    Raises:
        ValueError: the file is damaged.
    """
    found = None if path is None else kept(path, population, plants)
    if found is None:
        found = errors_of(policy, population, plants, jobs, report)
        if path is not None:
            keep(path, population, found)
    return found


def errors_of(
    policy: Any, population: Population, plants: int, jobs: int | None, report: Callable[[int], None]
) -> Errors:
    """Run a policy on the first plants of a population and return its errors; arguments as in `measured`."""
    _register(population)
    config = SweepConfig(
        policies=("fuzzy-1",),  # a name is asked for; the policy that is run is given to `run_plants`
        cases=population.names,
        distribution=population.distribution,
        plants=plants,
        seed=population.first_seed,
        chunk=population.chunk,
    )
    work, parts = functools.partial(_chunk, population, config, policy), {}
    for number, part in Engine(jobs=jobs).run(work, range(config.chunks)):
        parts[number] = part
        report(sum(len(one.plants) for one in parts.values()))
    found = SweepResults.joined([parts[number] for number in sorted(parts)])
    lost = ~found.completed[0]
    rms, largest = (np.where(lost, np.inf, errors[0]) for errors in (found.metrics["rms_mm"], found.metrics["max_mm"]))
    return Errors(rms, largest, current_provenance()["commit"])


def kept(path: Path, population: Population, plants: int) -> Errors | None:
    """Return the errors of a file that `keep` wrote; None without one, or if it has other plants or cases.

    Raises:
        ValueError: the file is damaged.
    """
    if not path.exists():
        return None
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
            if _described(population) != (
                str(stored["distribution"]),
                int(stored["first_seed"]),
                tuple(map(str, stored["cases"])),
            ):
                return None
            errors = Errors(stored["rms_mm"], stored["largest_mm"], str(stored["commit"]) or None)
    except (EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is damaged; delete it, and its policy is measured again") from error
    return errors if errors.rms_mm.shape == (len(population.cases), plants) else None


def keep(path: Path, population: Population, errors: Errors) -> None:
    """Write errors to a file, with what they were measured on."""
    distribution, first_seed, cases = _described(population)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        rms_mm=errors.rms_mm,
        largest_mm=errors.largest_mm,
        commit=errors.commit or "",
        distribution=distribution,
        first_seed=first_seed,
        cases=list(cases),
    )
    write_atomically(path, buffer.getvalue())


def _described(population: Population) -> tuple[str, int, tuple[str, ...]]:
    return population.distribution, population.first_seed, population.names


def _chunk(population: Population, config: SweepConfig, policy: Any, number: int) -> SweepResults:
    _register(population)  # in the process of a worker
    return run_plants(config, {"compared": policy}, config.members(number))


def _register(population: Population) -> None:
    """Make the population's cases known, once."""
    for case in population.cases:
        if case.name not in CASES:
            add_case(case)
