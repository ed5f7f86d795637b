"""Entries of the speed table: a sweep's episodes with law and plant in one kernel, and the same step by step."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator

from fuzzyarm.eval.bench.entries import SUBSTEPS, Entry, Measure, timed
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.episodes import errors_in_one_kernel, errors_step_by_step
from fuzzyarm.eval.sweep.plants import Plants
from fuzzyarm.policies import load_policy

__all__ = ["SWEPT", "sweep_entries"]

SWEPT = ("fuzzy-4-tip", "elastic-observer")
"""Policies that are measured."""

RUN = {"in one kernel": errors_in_one_kernel, "step by step": errors_step_by_step}
"""How the episodes of a chunk are run, by name; the second is the peer of the first."""


def sweep_entries(policy: str) -> list[Entry]:
    """Return the two entries of a policy: a chunk of a sweep as `fuzzyarm sweep` cuts it, on one thread."""
    config = SweepConfig(policies=(policy,))
    config = SweepConfig(policies=(policy,), plants=config.chunk)
    lanes = config.plants * len(config.cases)
    first, second = RUN
    return [
        Entry(f"sweep of {policy}, {how}", lanes, 1, SUBSTEPS, "float64", functools.partial(_swept, config, how), peer)
        for how, peer in ((first, ""), (second, second))
    ]


@contextlib.contextmanager
def _swept(config: SweepConfig, how: str) -> Iterator[Measure]:
    (name,) = config.policies
    plants, policy, run = Plants.draw(config, config.members(0)), load_policy(name), RUN[how]
    envs = plants.environment(config.cases)
    try:

        def advance() -> int:
            errors = run(plants, envs, policy)
            assert errors is not None  # the policy has a law for the kernel
            return int(errors.steps.sum())

        yield timed(advance)
    finally:
        envs.close()
