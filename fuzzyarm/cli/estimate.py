"""`fuzzyarm train estimate`: train a network beside the elastic observer, with the options of its settings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli.options import chosen, with_fields_of
from fuzzyarm.cli.usage import UsageError, claimed_folder
from fuzzyarm.common.console import progress, say, status
from fuzzyarm.rl_baselines.estimate.config import EstimateConfig

__all__ = ["Options", "run"]


@with_fields_of(EstimateConfig)
@dataclass(frozen=True, kw_only=True)
class Options:
    """Train the recurrent network of learned-observer, by regression on a teacher that knows plant, load and lateness.

    The folder gets policy/, which --policy and load_policy take. A training takes minutes and cannot be resumed. It
    needs pip install -c constraints.txt -e ".[rl]" in the repository.
    """

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder of the run, made if needed"""
    robot: Annotated[str | None, Parameter(metavar="FILE")] = None
    """Another arm: cicese, manutec-r3, planar-3r, ur5, panda, or the TOML file of a robot or of a two-joint arm
    (default: Table 1 of the paper)"""


def run(options: Options) -> int:
    """Train a policy."""
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.learned_policy.bundle import LAST

    config, arm = chosen(options, EstimateConfig()), chosen_arm(options.robot, None)
    folder = options.out / LAST
    if folder.exists():
        raise UsageError(f"{folder} holds a policy already; choose another folder")
    try:
        from fuzzyarm.rl_baselines.estimate.training import EstimateTraining
    except ModuleNotFoundError as error:
        raise UsageError(
            f'{error.name} is not installed; to train, run in the repository: pip install -c constraints.txt -e ".[rl]"'
        ) from None
    with claimed_folder(options.out):
        with status("compiling and loading"):
            training = EstimateTraining(config, arm=arm)
        with progress("training", config.chunks) as advance:
            training.report = lambda row: advance(f"loss {row['loss']:.3f}", completed=row["chunk"] + 1)
            bundle = training.run()
        bundle.save(folder)
    say(f"written to {folder}")
    return 0
