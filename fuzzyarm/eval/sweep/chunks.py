"""Running the chunks that a sweep's folder lacks, one by one or on many workers."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Generator, Mapping
from typing import NamedTuple

from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.engine import Engine, Report
from fuzzyarm.eval.sweep.episodes import run_plants
from fuzzyarm.eval.sweep.identity import difference, made_with
from fuzzyarm.eval.sweep.plants import CONTROL_PERIOD
from fuzzyarm.eval.sweep.results import SweepResults
from fuzzyarm.eval.sweep.store import Store
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["Chunk", "load_policies", "run_chunk", "run_missing"]


class Chunk(NamedTuple):
    """What a worker returns.

    Attributes:
        results: of the chunk's plants.
        process: id of the worker's process.
        made_with: the versions and the code that the worker computed with.
    """

    results: SweepResults
    process: int
    made_with: dict[str, str]


def load_policies(store: Store) -> dict[str, Predictor]:
    """Return the policies of a sweep by label, loaded for its robot.

    Raises:
        ValueError: one is unknown or damaged, or was made for another robot.
        OSError: a file cannot be read.
    """
    return {label: spec.load(CONTROL_PERIOD, store.config.arm) for label, spec in store.specs.items()}


def run_chunk(config: SweepConfig, policies: Mapping[str, Predictor], number: int) -> Chunk:
    """Run a chunk in this process."""
    return Chunk(run_plants(config, policies, config.members(number)), os.getpid(), made_with())


def run_missing(
    store: Store, policies: Mapping[str, Predictor], engine: Engine, report: Report = lambda text: None
) -> Generator[tuple[int, Chunk]]:
    """Run the chunks that the folder lacks; yield the number of each and the chunk as soon as it is written.

    Args:
        store: the folder.
        policies: by label; they travel to the workers, which need none of their files.
        engine: what runs them.
        report: called with a line when something failed that is repeated.

    Raises:
        ValueError: a chunk in the folder is broken, a policy fails, or a worker has other versions than this process.
        losses.WorkersLost: workers die again and again.
        OSError: a chunk cannot be written.
    """
    work = functools.partial(run_chunk, store.config, policies)
    with contextlib.closing(engine.run(work, store.missing(), report)) as chunks:
        for number, chunk in chunks:
            if found := difference(chunk.made_with, made_with()):
                raise ValueError(
                    f"a worker has other versions than this process ({found}): install the same on all, "
                    "and change no source while it runs"
                )
            store.save(number, chunk.results)
            yield number, chunk
