"""A sweep from its beginning to its summary: begun or resumed in a folder, run, summarised, and replayed."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import instance, path_of
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.declarations import declarations_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.sweep.chunks import load_policies, run_missing
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.engine import Engine, Report
from fuzzyarm.eval.sweep.episodes import replay
from fuzzyarm.eval.sweep.store import Store
from fuzzyarm.eval.sweep.summary import summarise
from fuzzyarm.eval.sweep.table import summary_csv
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["EPISODES", "SUMMARY", "TABLE", "Replay", "Summary", "Sweep"]

EPISODES, SUMMARY, TABLE = "episodes.npz", "sweep.json", "sweep.csv"  # files that a finished sweep adds
_EPISODE = "episode.npz"  # of one plant


@dataclasses.dataclass(frozen=True)
class Summary:
    """The outcome of a finished sweep.

    Attributes:
        document: what ``sweep.json`` holds, see `summary.summarise`.
        paths: all files that were written.
    """

    document: dict[str, Any]
    paths: list[Path]


@dataclasses.dataclass(frozen=True)
class Replay:
    """One plant run again.

    Attributes:
        rollout: its signals.
        folder: where they were written, with their figures.
    """

    rollout: Rollout
    folder: Path


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A sweep in its folder, with its policies loaded.

    Attributes:
        store: the folder.
        policies: by label.
    """

    store: Store
    policies: dict[str, Predictor]

    @classmethod
    def begin(cls, folder: Path, config: SweepConfig) -> Sweep:
        """Begin a sweep in a folder that holds none.

        Raises:
            ValueError: there is a sweep already, or a policy is unknown, damaged or made for another robot; then
                nothing is left behind.
            OSError: a file cannot be read or written.
        """
        store = Store.create(path_of("folder", folder), instance("config", config, SweepConfig))
        try:
            return cls(store, load_policies(store))
        except BaseException:
            store.take_back()
            raise

    @classmethod
    def resume(cls, folder: Path, given: Mapping[str, Any] | None = None) -> Sweep:
        """Go on with the sweep of a folder; arguments and errors as for `Store.open`."""
        store = Store.open(folder, given)
        return cls(store, load_policies(store))

    def run(self, engine: Engine, report: Report = lambda text: None) -> Iterator[int]:
        """Run the chunks that are missing, each kept as soon as it is done, and yield the number of its plants.

        Args:
            engine: what runs them.
            report: called with a line when a worker was lost, whose chunk is repeated.

        Raises:
            ValueError, OSError, losses.WorkersLost: see `chunks.run_missing`.
        """
        for number, _ in run_missing(self.store, self.policies, engine, report):
            yield len(self.store.config.members(number))

    @property
    def remaining(self) -> int:
        """Number of plants that are still to be run; ValueError if a chunk in the folder is broken."""
        return sum(len(self.store.config.members(number)) for number in self.store.missing())

    def summarise(self, progress: Callable[[], None] = lambda: None) -> Summary:
        """Write the summary, the table, all episodes and the figures of a sweep whose chunks are all done.

        Args:
            progress: called after each figure.

        Raises:
            ValueError: a chunk is missing or broken.
            OSError: a file cannot be written.
        """
        # Imported here, as in `replay_plant`: Matplotlib takes a second to load.
        from fuzzyarm.eval.sweep.figures import write_sweep_figures

        config, folder = self.store.config, self.store.folder
        results = self.store.load_all()
        document = summarise(config, results, declarations_of(self.store.specs, self.policies, config.arm))
        write_atomically(folder / EPISODES, _compressed(results.arrays()))
        write_atomically(folder / TABLE, summary_csv(document["rows"]))
        write_atomically(folder / SUMMARY, json.dumps(document, indent=1) + "\n")
        figures = write_sweep_figures(config, results, document["rows"], folder, progress)
        return Summary(document, [folder / SUMMARY, folder / TABLE, folder / EPISODES, *figures])

    def replay_plant(self, policy: str, case: str, plant: int) -> Replay:
        """Run one plant again and write its signals and figures to a folder of their own.

        Args:
            policy: label of the policy.
            case: name of the case.
            plant: its number in the sweep.

        Raises:
            ValueError: the sweep has no such plant, policy or case.
            OSError: a file cannot be written.
        """
        from fuzzyarm.eval.evaluation.figures import write_figures

        rollout = replay(self.store.config, self.policies, plant, policy, case)
        folder = self.store.folder / f"replay-{policy.replace(':', '-')}-{case}-{plant}"
        folder.mkdir(exist_ok=True)
        write_atomically(folder / _EPISODE, _compressed(dataclasses.asdict(rollout)))
        write_figures([rollout], folder, titles=self.store.config.titles)
        return Replay(rollout, folder)


def _compressed(arrays: dict[str, Any]) -> bytes:
    """Return arrays as the content of an ``.npz`` file."""
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays)
    return content.getvalue()
