"""The speed table: entries take turns; a speed is a median over rounds, and a ratio is taken within each round."""

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
from fuzzyarm.eval.bench import _entries as entries
from fuzzyarm.eval.bench._entries import Entry
from fuzzyarm.eval.provenance import json_text, made_now, version_of

__all__ = ["BenchConfig", "run_bench", "write_document"]


_SWEEP_LANES = tuple(4**power for power in range(10))  # batch sizes in the figure of the throughput
_FEWEST_ROUNDS = 5  # quartiles of fewer rounds say little


@dataclasses.dataclass(frozen=True)
class BenchConfig:
    """What to measure, and for how long.

    Attributes:
        seconds: wall time of each turn [s].
        rounds: turns of each entry; odd, so that the median is one of the measurements, and at least 5.
        lanes: sizes of the batches in the table; peers are measured up to 4096 lanes, torch from there on.
        threads: CPU threads that a batch may use, at most one per core.
        lanes_sweep: also measure batches of 1, 4, 16, ... 262144 lanes and draw throughput.png; takes a few minutes and
            needs --out.
    """

    seconds: float = 0.5
    rounds: int = 5
    lanes: tuple[int, ...] = (64, 1024, 65536)
    threads: int = dataclasses.field(default_factory=lambda: os.cpu_count() or 1)
    lanes_sweep: bool = False

    def __post_init__(self) -> None:
        """Check the values before anything runs."""
        real("seconds", self.seconds, "s", above=0.0)
        if whole("rounds", self.rounds) < _FEWEST_ROUNDS or self.rounds % 2 == 0:
            raise ValueError(
                f"rounds = {self.rounds} must be odd and at least {_FEWEST_ROUNDS}, so that the median is one of the "
                "rounds"
            )
        whole("threads", self.threads, low=1, high=os.cpu_count() or 1)
        for lanes in instance("lanes", self.lanes, tuple):
            whole("lanes", lanes, low=1)
        truth("lanes_sweep", self.lanes_sweep)
        if not self.lanes or len(set(self.lanes)) != len(self.lanes):
            raise ValueError(
                f"lanes = {shown(list(self.lanes))} must be one or more distinct whole numbers, each at least 1"
            )

    def groups(self) -> dict[str, list[Entry]]:
        """Return the entries of the table by heading; those under one heading are measured alternately."""
        batches = {f"{lanes} lanes": entries.batch_entries(lanes, self.threads) for lanes in self.lanes}
        return {"one environment": entries.single_entries()} | batches | entries.sweep_entries()

    def sweep_groups(self) -> dict[str, list[Entry]]:
        """Return this project's batches by number of lanes; empty unless `lanes_sweep`."""
        # Of the torch entries only the fastest: torch compiles for each number of lanes, which takes a minute.
        return {
            f"sweep, {lanes} lanes": [
                one
                for one in entries.batch_entries(lanes, self.threads)
                if not one.peer and (one.dtype == "float32" or "torch" not in one.name)
            ]
            for lanes in _SWEEP_LANES * self.lanes_sweep
        }

    def turns(self) -> int:
        """Return how often `run_bench` calls `progress`: per entry and round or warm-up, per group, and for memory."""
        groups = itertools.chain(self.groups().values(), self.sweep_groups().values())
        return sum(len(group) * (self.rounds + 1) + 1 for group in groups) + 1

    def command(self) -> str:
        """Return the command line of this configuration."""
        lanes = " ".join(map(str, self.lanes))
        text = f"fuzzyarm bench --seconds {self.seconds:g} --rounds {self.rounds} --lanes {lanes}"
        return f"{text} --threads {self.threads}{' --lanes-sweep' if self.lanes_sweep else ''}"


_SCHEMA = "fuzzyarm-bench/1"
_WARM_UP = 0.1  # s, after the first step, which may compile
_MEMORY_LANES = (1024, 5120)  # two batch sizes; the memory per lane follows from the difference between them


def run_bench(config: BenchConfig, progress: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Measure everything and return the document that `fuzzyarm bench --json` prints.

    The document contains the provenance and ``memory_per_lane`` [bytes]. Each entry in ``rows`` and ``sweep`` has its
    configuration, ``steps_per_s`` (median and quartiles; None if it was not measured, for the ``reason`` given there),
    ``ratios`` to the peers of its group, and ``tip_error_um``. `progress` is called `config.turns()` times with a
    description of the next turn.
    """
    rows, sweep = (
        [row for name, group in groups.items() for row in _race(name, group, config.rounds, config.seconds, progress)]
        for groups in (instance("config", config, BenchConfig).groups(), config.sweep_groups())
    )
    progress("memory")
    made_with = made_now(config.command())
    made_with["versions"] |= {name: version_of(name) for name in ("envpool", "mujoco", "torch")}
    return {
        "schema": _SCHEMA,
        **made_with,
        "method": {name: getattr(config, name) for name in ("rounds", "seconds", "threads")},
        "rows": rows,
        "sweep": sweep,
        "memory_per_lane": {"bytes": _memory_per_lane()},
    }


def _race(
    name: str, group: Sequence[Entry], rounds: int, seconds: float, progress: Callable[[str], None] = lambda _: None
) -> list[dict[str, Any]]:
    """Measure the entries of the group `name` in turn in each round; return for each a row of the results document.

    The ratio of one of our entries to a peer is taken round by round, so that a disturbance of the machine that lasts
    longer than a round slows both. A measurement takes `seconds` [s]; `progress` is called before each with its name.
    """
    with contextlib.ExitStack() as stack:
        measures, reasons = {}, {}
        for entry in group:
            progress(f"{name}: warming up {entry.name}")
            try:
                measures[entry] = stack.enter_context(entry.open())
                measures[entry](_WARM_UP)
            except entries.UNAVAILABLE as error:
                measures.pop(entry, None)
                reasons[entry] = _reason(error, "bench" if entry.peer else "rl")
        speeds: dict[Entry, list[float]] = {entry: [] for entry in measures}
        for turn in range(rounds):
            for entry in group:
                progress(f"{name}: round {turn + 1} of {rounds}, {entry.name}")
                if entry in measures:
                    speeds[entry].append(measures[entry](seconds))
    progress(f"{name}: accuracy")
    return [
        {
            "group": name,
            **{key: getattr(entry, key) for key in ("name", "lanes", "threads", "dtype")},
            "steps_per_s": _spread(speeds[entry]) if entry in speeds else None,
            "ratios": {
                peer.peer: _spread([own / other for own, other in zip(speeds[entry], theirs, strict=True)])
                for peer, theirs in speeds.items()
                if peer.peer and not entry.peer and entry in speeds
            },
            "tip_error_um": 1e6 * entry.tip_error() if entry.tip_error and entry in speeds else None,
            "reason": reasons.get(entry),
        }
        for entry in group
    ]


def _spread(values: Sequence[float]) -> dict[str, float]:
    """Return the median, the lower and the upper quartile of the values as "median", "q1" and "q3"."""
    q1, median, q3 = statistics.quantiles(values, n=4, method="inclusive")
    return {"median": median, "q1": q1, "q3": q3}


def _memory_per_lane() -> float:
    """Return the memory [bytes] of each further lane of the vector environment, including the results of one step."""

    def traced(lanes: int) -> int:
        actions = np.zeros((lanes, 2), dtype=np.float32)
        gc.collect()
        tracemalloc.start()
        try:
            with contextlib.closing(entries.compiled_batch(lanes, 1)) as envs:
                _kept = envs.step(actions)
                return tracemalloc.get_traced_memory()[0]
        finally:
            tracemalloc.stop()

    few, many = _MEMORY_LANES
    traced(few)  # creates objects that are made once and kept: they do not count
    return (traced(many) - traced(few)) / (many - few)


def _reason(error: Exception, extra: str) -> str:
    """Return one line on why an entry was not measured; `extra` names the optional dependencies that would help."""
    if isinstance(error, ModuleNotFoundError):
        return f'{error.name} is not installed; run in the repository: pip install -c constraints.txt -e ".[{extra}]"'
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def write_document(document: dict[str, Any], folder: Path) -> list[Path]:
    """Write ``bench.json``, and ``throughput.png`` if there was a sweep; return the paths."""
    written = [folder / "bench.json"]
    write_atomically(written[0], json_text(document))
    if document["sweep"]:
        # Imported here, as Matplotlib takes a second to load.
        from fuzzyarm.eval._figure_files import figure_style, write_all
        from fuzzyarm.eval.bench.speed_table import draw_throughput

        with figure_style():
            figures = {"throughput": draw_throughput(document)}
        written += write_all(figures, folder, svg=False)
    return written
