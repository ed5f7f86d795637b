"""Run what a sweep's folder has not got yet, chunk by chunk."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.engine import Engine
from fuzzyarm.eval.sweep.episodes import measure
from fuzzyarm.eval.sweep.plants import CONTROL_PERIOD
from fuzzyarm.eval.sweep.store import Store, difference, made_with
from fuzzyarm.fuzzy_policy.policy import Predictor
from fuzzyarm.policies import load_policy
from fuzzyarm.policies.registry import policy_label


class Chunk(NamedTuple):
    """What a worker returns: the arrays of `episodes.measure`, its process, and what it computed them with."""

    arrays: dict[str, np.ndarray]
    process: int
    made_with: dict[str, str]


def load_policies(config: SweepConfig) -> dict[str, Predictor]:
    """Return the policies by label.

    Raises:
        ValueError: one is unknown or damaged, or two have the same label.
        OSError: a file cannot be read.
    """
    policies: dict[str, Predictor] = {
        policy_label(name): load_policy(name, control_period=CONTROL_PERIOD) for name in config.policies
    }
    if len(policies) < len(config.policies):
        raise ValueError(f"policies {', '.join(config.policies)}: two of them have the same name; rename a file")
    return policies


def run_chunk(config: SweepConfig, policies: Mapping[str, Predictor], number: int) -> Chunk:
    """Run a chunk in this process."""
    return Chunk(measure(config, policies, config.members(number)), os.getpid(), made_with())


def run_missing(
    store: Store,
    policies: Mapping[str, Predictor],
    engine: Engine,
    progress: Callable[[int, Chunk], None] = lambda number, chunk: None,
    report: Callable[[str], None] = lambda text: None,
) -> None:
    """Run the chunks that the folder has not got, and write each as soon as it is there.

    Args:
        store: the folder.
        policies: by label; they travel to the workers, who need none of their files.
        engine: where it is run.
        progress: called after each chunk is written.
        report: called with a line when something went wrong that is put right.

    Raises:
        ValueError: a chunk in the folder is broken, or a worker has other versions than this process.
        engine.WorkersLost: workers die again and again.
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
            store.save(number, chunk.arrays)
            progress(number, chunk)
