"""The configuration of the speed table: what is measured, and for how long."""

from __future__ import annotations

import dataclasses
import itertools
import os
from typing import TYPE_CHECKING

from fuzzyarm.common.checks import instance, real, shown, truth, whole

if TYPE_CHECKING:
    from fuzzyarm.eval.bench.entries import Entry

__all__ = ["BenchConfig"]

SWEEP_LANES = tuple(4**power for power in range(10))
"""Sizes of the batches that throughput is drawn over."""

FEWEST_ROUNDS = 5  # quartiles of fewer rounds say little
MOST_PEER_LANES = 4096  # EnvPool takes a minute to open a thousand environments of one kind


@dataclasses.dataclass(frozen=True)
class BenchConfig:
    """What is measured, and for how long.

    Attributes:
        seconds: wall time of each turn [s].
        rounds: turns of each entry; odd, so that the median is one of them, and at least 5.
        lanes: sizes of the batches in the table; peers are measured up to 4096 lanes, torch from there on.
        threads: CPU threads that a batch may use, at most one per core.
        lanes_sweep: measure batches of 1, 4, 16, ... 262144 lanes too and draw throughput.png; takes a few minutes, and
            needs --out.

    Raises:
        TypeError: a value is no number of its kind.
        ValueError: a value is out of range; the message names what is allowed.
    """

    seconds: float = 0.5
    rounds: int = 5
    lanes: tuple[int, ...] = (64, 1024, 65536)
    threads: int = dataclasses.field(default_factory=lambda: os.cpu_count() or 1)
    lanes_sweep: bool = False

    def __post_init__(self) -> None:
        """Check the numbers before anything runs."""
        real("seconds", self.seconds, "s", above=0.0)
        if whole("rounds", self.rounds) < FEWEST_ROUNDS or self.rounds % 2 == 0:
            raise ValueError(
                f"rounds = {self.rounds} must be odd and at least {FEWEST_ROUNDS}: the median is one of the rounds"
            )
        whole("threads", self.threads, low=1, high=os.cpu_count() or 1)
        for lanes in instance("lanes", self.lanes, tuple):
            whole("lanes", lanes, low=1)
        truth("lanes_sweep", self.lanes_sweep)
        if not self.lanes or len(set(self.lanes)) != len(self.lanes):
            raise ValueError(f"lanes = {shown(list(self.lanes))} must be one or more different whole numbers from 1")

    def groups(self) -> dict[str, list[Entry]]:
        """Return the entries of the table by heading; those under one heading take turns."""
        from fuzzyarm.eval.bench.entries import own_batches, own_single
        from fuzzyarm.eval.bench.peers import batch_peers, gymnasium_peers
        from fuzzyarm.eval.bench.sweeps import SWEPT, sweep_entries

        groups = {"one environment": [own_single(), *gymnasium_peers()]}
        for lanes in self.lanes:
            peers = batch_peers(lanes, self.threads) if lanes <= MOST_PEER_LANES else []
            groups[f"{lanes} lanes"] = own_batches(lanes, self.threads) + peers
        return groups | {f"sweep of {policy}": sweep_entries(policy) for policy in SWEPT}

    def sweep_groups(self) -> dict[str, list[Entry]]:
        """Return this project's batches by number of lanes; empty unless `lanes_sweep`."""
        if not self.lanes_sweep:
            return {}
        from fuzzyarm.eval.bench.entries import own_batches

        # In torch the fastest only: each number of lanes is compiled anew, which takes a minute.
        return {
            f"sweep, {lanes} lanes": [
                one for one in own_batches(lanes, self.threads) if one.dtype == "float32" or "torch" not in one.name
            ]
            for lanes in SWEEP_LANES
        }

    def turns(self) -> int:
        """Return how often `run.run_bench` reports progress."""
        groups = itertools.chain(self.groups().values(), self.sweep_groups().values())
        return sum(map(len, groups)) * (self.rounds + 1) + 2

    def command(self) -> str:
        """Return the command line of this configuration."""
        lanes = " ".join(map(str, self.lanes))
        text = f"fuzzyarm bench --seconds {self.seconds:g} --rounds {self.rounds} --lanes {lanes}"
        return f"{text} --threads {self.threads}{' --lanes-sweep' if self.lanes_sweep else ''}"
