"""The finished trainings that `learned_comparison.py` compares, one for each seed of a configuration."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from learned_tasks import CONTROL_PERIOD

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy

BUNDLE, TIMES = "policy", "run.json"
MEASURED_TIMES = {"wall_time_s": "wall time of a seed [s]", "cpu_time_s": "processor time [s]"}
# The settings in which the seeds of one configuration may differ, because nothing that is learned depends on them.
OF_THE_RUN = ("seed", "steps_done", "threads", "evaluation_interval", "checkpoint_interval", "tensorboard")


@dataclasses.dataclass(frozen=True)
class TrainedSeed:
    """A finished training.

    Attributes:
        folder: of the training.
        policy: the policy of its last bundle.
        times: of the training [s] by `MEASURED_TIMES`; None where a time was not recorded.
    """

    folder: Path
    policy: LearnedPolicy
    times: dict[str, float | None]

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return self.policy.bundle.seed

    @property
    def training(self) -> dict[str, Any]:
        """The configuration, and the steps that were done."""
        return self.policy.bundle.training

    @property
    def distribution(self) -> str:
        """What was trained on."""
        return str(self.training.get("distribution"))

    @property
    def curve(self) -> list[dict[str, Any]]:
        """The evaluations during the training."""
        return self.policy.bundle.curve


def trained_seed(folder: Path) -> TrainedSeed:
    """Load the last bundle of a finished training.

    Raises:
        ValueError: there is none, it is damaged, or the training is unfinished.
    """
    if not (folder / BUNDLE).is_dir():
        raise ValueError(
            f"{folder} has no folder {BUNDLE}/; give the folder that was --out of fuzzyarm train, after the end of the "
            "training"
        )
    policy = load_policy(folder / BUNDLE, control_period=CONTROL_PERIOD)
    assert isinstance(policy, LearnedPolicy)
    training = policy.bundle.training
    done = training.get("steps_done")
    asked = training.get("total_timesteps", training.get("steps"))  # earlier trainings recorded it as ``steps``
    if not (isinstance(done, int) and isinstance(asked, int)):
        raise ValueError(f"{folder / BUNDLE} does not say how many steps it was trained for; train again")
    if done < asked:
        raise ValueError(
            f"{folder} is unfinished, {done} of {asked} steps; go on with fuzzyarm train ppo --resume --out {folder}"
        )
    measured = ("steps", *(f"{case}_rms_mm" for case in PAPER_CASES))
    curve = policy.bundle.curve
    if not (curve and all(_is_number(row.get(key)) and row[key] > 0 for row in curve for key in measured)):
        raise ValueError(f"{folder / BUNDLE} has no curve with positive {', '.join(measured)} in all rows; train again")
    return TrainedSeed(folder, policy, _times(folder / TIMES))


def trained_seeds(name: str, folders: Sequence[Path]) -> list[TrainedSeed]:
    """Load the seeds of one configuration, in the order of their seeds.

    Raises:
        ValueError: as `trained_seed`; or no folder is given, a seed comes twice, or the configurations differ.
    """
    if not folders:
        raise ValueError(f"--learned {name} names no folder; give one or more: --learned NAME FOLDER [FOLDER ...]")
    runs = sorted((trained_seed(folder) for folder in folders), key=lambda run: run.seed)
    first, by_seed = runs[0], {runs[0].seed: runs[0]}
    for run in runs[1:]:
        if run.seed in by_seed:
            raise ValueError(
                f"--learned {name}: {by_seed[run.seed].folder} and {run.folder} both have seed {run.seed}; give each "
                "seed once"
            )
        by_seed[run.seed] = run
        ours, theirs = configuration(first.training), configuration(run.training)
        differing = [key for key in sorted({*ours, *theirs}) if ours.get(key) != theirs.get(key)]
        if differing:
            raise ValueError(
                f"--learned {name}: {first.folder} and {run.folder} differ in {', '.join(differing)}; give each "
                "configuration a name of its own"
            )
    return runs


def configuration(training: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a training that all its seeds share."""
    return {key: value for key, value in training.items() if key not in OF_THE_RUN}


def _times(path: Path) -> dict[str, float | None]:
    """Return the `MEASURED_TIMES` that a training recorded in `TIMES`."""
    if not path.exists():
        return dict.fromkeys(MEASURED_TIMES)
    try:
        times = {name: json.loads(path.read_text(encoding="utf-8")).get(name) for name in MEASURED_TIMES}
    except (ValueError, AttributeError):
        raise ValueError(f"{path} is damaged: it must be a JSON mapping; remove it for dashes instead") from None
    for name, seconds in times.items():
        if seconds is not None and not (_is_number(seconds) and 0.0 <= seconds < math.inf):
            raise ValueError(f"{path} is damaged: {name} must be a number of seconds; remove it for a dash instead")
    return times


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
