"""The speed table: entries take turns; a speed is a median over rounds, and a ratio is taken within each round."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import itertools
import os
import statistics
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance, real, shown, truth, whole
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.bench import entries
from fuzzyarm.eval.bench.entries import UNAVAILABLE, Entry, Measure, compiled_batch, own_batches
from fuzzyarm.eval.provenance import json_text, made_now, version_of

__all__ = ["BenchConfig", "Row", "memory_per_lane", "race", "run_bench", "spread", "write_document"]


_SWEEP_LANES = tuple(4**power for power in range(10))  # sizes of the batches that throughput is drawn over
_FEWEST_ROUNDS = 5  # quartiles of fewer rounds say little
_MOST_PEER_LANES = 4096  # EnvPool takes a minute to open a thousand environments of one kind


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
        if whole("rounds", self.rounds) < _FEWEST_ROUNDS or self.rounds % 2 == 0:
            raise ValueError(
                f"rounds = {self.rounds} must be odd and at least {_FEWEST_ROUNDS}: the median is one of the rounds"
            )
        whole("threads", self.threads, low=1, high=os.cpu_count() or 1)
        for lanes in instance("lanes", self.lanes, tuple):
            whole("lanes", lanes, low=1)
        truth("lanes_sweep", self.lanes_sweep)
        if not self.lanes or len(set(self.lanes)) != len(self.lanes):
            raise ValueError(f"lanes = {shown(list(self.lanes))} must be one or more different whole numbers from 1")

    def groups(self) -> dict[str, list[Entry]]:
        """Return the entries of the table by heading; those under one heading take turns."""
        groups = {"one environment": [entries.own_single(), *entries.gymnasium_peers()]}
        for lanes in self.lanes:
            peers = entries.batch_peers(lanes, self.threads) if lanes <= _MOST_PEER_LANES else []
            groups[f"{lanes} lanes"] = own_batches(lanes, self.threads) + peers
        return groups | {f"sweep of {policy}": entries.sweep_entries(policy) for policy in entries.SWEPT}

    def sweep_groups(self) -> dict[str, list[Entry]]:
        """Return this project's batches by number of lanes; empty unless `lanes_sweep`."""
        if not self.lanes_sweep:
            return {}
        # In torch the fastest only: each number of lanes is compiled again, which takes a minute.
        return {
            f"sweep, {lanes} lanes": [
                one for one in own_batches(lanes, self.threads) if one.dtype == "float32" or "torch" not in one.name
            ]
            for lanes in _SWEEP_LANES
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


SCHEMA = "fuzzyarm-bench/1"
WARM_UP = 0.1  # s, after the first step, which may compile
_MEMORY_LANES = (1024, 5120)  # two sizes of the batch; the memory of a lane is the difference between them


def run_bench(config: BenchConfig, progress: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Measure everything and return the document that `fuzzyarm bench --json` prints.

    Args:
        config: what is measured.
        progress: called `config.turns()` times with a few words on what comes next.

    Returns:
        Provenance; under ``rows`` and ``sweep``, for each entry, its configuration, ``steps_per_s`` (median and
        quartiles; None if it was not measured, and ``reason`` says why), ``ratios`` to the peers of its group, and
        ``tip_error_um``; and ``memory_per_lane`` [bytes].
    """
    load_average = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    rows, sweep = (
        [row for name, group in groups.items() for row in race(name, group, config.rounds, config.seconds, progress)]
        for groups in (instance("config", config, BenchConfig).groups(), config.sweep_groups())
    )
    progress("accuracy")
    measured = [row for row in (*rows, *sweep) if row.speeds]
    known = {error: 1e6 * error() for error in dict.fromkeys(row.entry.tip_error for row in measured) if error}
    for row in measured:
        row.tip_error_um = known[row.entry.tip_error] if row.entry.tip_error else None
    progress("memory")
    made_with = made_now(config.command())
    made_with["versions"] |= {name: version_of(name) for name in ("envpool", "mujoco", "torch")}
    return {
        "schema": SCHEMA,
        **made_with,
        "method": {
            "rounds": config.rounds,
            "seconds": config.seconds,
            "threads": config.threads,
            "load_average": load_average,  # of the minute before the first turn
        },
        "rows": [row.to_dict() for row in rows],
        "sweep": [row.to_dict() for row in sweep],
        "memory_per_lane": memory_per_lane(),
    }


@dataclasses.dataclass
class Row:
    """What was measured of an entry."""

    group: str  # heading under which it took turns with others
    entry: Entry
    speeds: list[float] = dataclasses.field(default_factory=list)  # steps per second in each round; empty: not measured
    ratios: dict[str, list[float]] = dataclasses.field(default_factory=dict)  # by the peer's heading, in each round
    tip_error_um: float | None = None  # largest distance of the tip from the event integrator's [µm]
    reason: str | None = None  # why it was not measured

    def to_dict(self) -> dict[str, Any]:
        """Return what goes into the document."""
        entry = self.entry
        return {
            "group": self.group,
            **{key: getattr(entry, key) for key in ("name", "lanes", "threads", "substeps", "dtype")},
            "steps_per_s": spread(self.speeds) if self.speeds else None,
            "ratios": {peer: spread(values) for peer, values in self.ratios.items()},
            "tip_error_um": self.tip_error_um,
            "reason": self.reason,
        }


def race(name: str, group: Sequence[Entry], rounds: int, seconds: float, progress: Callable[[str], None]) -> list[Row]:
    """Let the entries of a group take turns, all of them in every round, and return a row for each.

    The ratio of an own entry to a peer is taken round by round: a disturbance of the machine that lasts longer than a
    round slows both. A turn takes `seconds` [s]; `progress` is called before each with a few words on it.
    """
    rows = [Row(name, entry) for entry in group]
    measures: dict[int, Measure] = {}
    with contextlib.ExitStack() as stack:
        for index, row in enumerate(rows):
            progress(f"{name}: warming up {row.entry.name}")
            try:
                measure = stack.enter_context(row.entry.open())
                measure(WARM_UP)
            except UNAVAILABLE as error:
                row.reason = _reason(error, row.entry.extra)
            else:
                measures[index] = measure
        for turn in range(rounds):
            for index, row in enumerate(rows):
                progress(f"{name}: round {turn + 1} of {rounds}, {row.entry.name}")
                if index in measures:
                    row.speeds.append(measures[index](seconds))
    peers = [row for row in rows if row.entry.peer and row.speeds]
    for row in (row for row in rows if row.speeds and not row.entry.peer):
        for peer in peers:
            row.ratios[peer.entry.peer] = [own / other for own, other in zip(row.speeds, peer.speeds, strict=True)]
    return rows


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median and quartiles."""
    q1, median, q3 = statistics.quantiles(values, n=4, method="inclusive")
    return {"median": median, "q1": q1, "q3": q3}


def memory_per_lane() -> dict[str, Any]:
    """Return the memory that one more lane of the vector environment takes, with the results of a step [bytes]."""

    def traced(lanes: int) -> int:
        actions = np.zeros((lanes, 2), dtype=np.float32)
        gc.collect()
        tracemalloc.start()
        try:
            envs = compiled_batch(lanes, 1)
            envs.reset(seed=0)
            last = envs.step(actions)
            size = tracemalloc.get_traced_memory()[0]
            envs.close()
            del last
            return size
        finally:
            tracemalloc.stop()

    few, many = _MEMORY_LANES
    try:
        traced(few)  # makes what is made once and kept, which does not count
        return {"bytes": (traced(many) - traced(few)) / (many - few), "reason": None}
    except UNAVAILABLE as error:
        return {"bytes": None, "reason": _reason(error)}


def _reason(error: Exception, extra: str = "") -> str:
    """Return in one line why something was not measured, and what to install if that would help."""
    if isinstance(error, ModuleNotFoundError) and extra:
        return f'{error.name} is not installed: pip install -c constraints.txt -e ".[{extra}]" in the repository'
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def write_document(document: dict[str, Any], folder: Path) -> list[Path]:
    """Write ``bench.json``, and ``throughput.png`` if there was a sweep; return the paths."""
    written = [folder / "bench.json"]
    write_atomically(written[0], json_text(document))
    if document["sweep"]:
        # Imported here, as Matplotlib takes a second to load.
        from fuzzyarm.eval.bench.speed_table import draw_throughput
        from fuzzyarm.eval.figure_files import figure_style, write_all

        with figure_style():
            figures = {"throughput": draw_throughput(document)}
        written += write_all(figures, folder, svg=False)
    return written
