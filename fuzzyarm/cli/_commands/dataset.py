"""`fuzzyarm dataset`: write episodes of named policies as a data set in Minari's format."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._options import chosen, with_fields_of
from fuzzyarm.cli._usage import claimed_folder
from fuzzyarm.common.console import progress, say
from fuzzyarm.eval.dataset.config import DatasetConfig

__all__ = ["Options"]


@with_fields_of(DatasetConfig)
@dataclass(frozen=True, kw_only=True)
class Options:
    """Write episodes of named policies as a data set that Minari loads, with their score and provenance.

    With MINARI_DATASETS_PATH=DIR, where DIR is that of --out, minari.load_dataset finds the data set by its name,
    fuzzyarm/LEVEL-CONDITION-v0. The command needs pip install -c constraints.txt -e ".[datasets]" in the repository.
    """

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder of data sets, created if needed"""

    def run(self) -> int:
        """Write a data set."""
        from fuzzyarm.eval.dataset.store import check_installed, open_dataset, provenance_of, write_dataset

        config = chosen(self, DatasetConfig())
        check_installed()
        with claimed_folder(self.out), progress("episodes", config.episodes) as advance:
            folder = write_dataset(config, self.out, advance)
        dataset = open_dataset(folder)
        mean = sum(float(episode.rewards.sum()) for episode in dataset) / config.episodes
        say(
            f"{config.name}: {config.episodes} episodes, {dataset.total_steps:,} steps, mean return {mean:.1f}, "
            f"score N = {provenance_of(dataset)['N']:.1f} (computed-torque scores 0 on these, learned-observer 100)"
        )
        say(f"written to {folder}; set MINARI_DATASETS_PATH={self.out} so that Minari finds it")
        return 0
