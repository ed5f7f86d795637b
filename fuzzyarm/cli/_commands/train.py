"""`fuzzyarm train ALGORITHM`: a command for each learning algorithm and one for regression, each with its own settings.

It writes to its output folder ``curve.csv`` (a row per update), ``checkpoint.pt``, the bundles ``policy`` (the last
evaluated) and ``best`` (the smallest tip error so far), and at the end ``run.json`` (wall and processor time). The same
command resumes a stopped run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from cyclopts import App, Parameter

from fuzzyarm.cli._options import chosen, given, with_fields_of
from fuzzyarm.cli._usage import UsageError, claimed_folder
from fuzzyarm.common.console import progress, say
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS, find_algorithm
from fuzzyarm.rl_baselines.config import EstimateConfig

if TYPE_CHECKING:
    from fuzzyarm.rl_baselines.algorithm import AlgorithmSpec
    from fuzzyarm.rl_baselines.config import TrainingConfig

__all__ = ["Options", "add_algorithms", "train_with_progress"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options common to all algorithms."""

    algorithm: ClassVar[str]

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder of the run, created if needed. If a run was stopped, the same command continues it, with the same result
    bit for bit; with a larger --total-timesteps it continues beyond the end, with a learning rate that falls linearly
    until the new end"""
    preset: Annotated[str | None, Parameter(metavar="NAME")] = None
    """Settings that apply unless the other options change them"""

    def run(self) -> int:
        """Train a policy, or continue a training run."""
        with claimed_folder(self.out):
            try:
                train_with_progress(_config(self), self.out)
            except KeyboardInterrupt:
                say("fuzzyarm train: interrupted; run this command again to continue from the checkpoint", error=True)
                return 130
        say(f"written to {self.out / 'policy'}")
        return 0


@with_fields_of(EstimateConfig)
@dataclass(frozen=True, kw_only=True)
class _EstimateOptions:
    """Train the recurrent network of learned-observer, by regression on a teacher that knows plant, load and delay.

    The run writes the folder policy/, for --policy and load_policy. Training takes minutes and cannot be resumed. It
    needs pip install -c constraints.txt -e ".[rl]" in the repository.
    """

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder of the run, created if needed"""
    robot: Annotated[str | None, Parameter(metavar="FILE")] = None
    """Another arm: cicese, manutec-r3, planar-3r, ur5, panda, or the TOML file of a robot or of a two-joint arm
    (default: Table 1 of the paper)"""

    def run(self) -> int:
        """Train the network of learned-observer."""
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.fuzzy_policy.laws.learned.bundle import LAST

        config, arm = chosen(self, EstimateConfig()), chosen_arm(self.robot, None)
        folder = self.out / LAST
        if folder.exists():
            raise UsageError(f"{folder} already exists; choose another folder with --out DIR")
        with claimed_folder(self.out):
            with progress("compiling and loading", config.chunks, first=1.0) as advance:
                with _training_libraries():
                    from fuzzyarm.rl_baselines.estimate.training import EstimateTraining
                training = EstimateTraining(config, arm=arm)
                training.report = lambda row: advance(f"loss {row['loss']:.3f}", completed=row["chunk"] + 1)
                bundle = training.run()
            bundle.save(folder)
        say(f"written to {folder}")
        return 0


def add_algorithms(application: App) -> None:
    """Add a command for each registered algorithm, and one for the learned observer."""
    for spec in ALGORITHMS.values():
        application.command(_options_of(spec), name=spec.name)
    application.command(_EstimateOptions, name="estimate")


def _options_of(spec: AlgorithmSpec) -> type[Options]:
    """Return the class of an algorithm's options: the common ones, and one for each field of its configuration."""
    made = with_fields_of(spec.config)(Options)
    made.algorithm = spec.name
    first, *others = spec.presets
    made.__doc__ = (
        f"Train a policy with {spec.title}.\n\nThe run writes curve.csv, checkpoint.pt and two policies to the folder: "
        "policy/, the last one, and best/, the one with the smallest tip error. Training needs pip install -c "
        f'constraints.txt -e ".[rl]" in the repository. The defaults below are those of --preset {first}'
        f"{'; other presets: ' + ', '.join(others) if others else ''}."
    )
    return made


def train_with_progress(config: TrainingConfig, folder: Path) -> None:
    """Train, or resume the training in the folder; show progress and every evaluation on standard error."""
    threads = config.threads
    with progress("compiling and loading", config.total_timesteps, first=1.0) as advance:
        with _training_libraries():
            from fuzzyarm.rl_baselines.training import CHECKPOINT, Training

            resumes = (folder / CHECKPOINT).exists()
            training = Training.resume(config, folder) if resumes else Training(config, folder)
        first, began = training.algorithm.steps, time.perf_counter()
        advance(f"training, {threads} {'thread' if threads == 1 else 'threads'}", completed=first)

        def show(row: dict[str, Any]) -> None:
            rate = (row["steps"] - first) / (time.perf_counter() - began)
            line = f"{row['steps']:>11,} steps, {rate:,.0f}/s; largest tip error [mm]: {_errors(row)}"
            error = f", mean tip error {row['tip_error_mm']:.2f} mm" if "tip_error_mm" in row else ""
            description = f"{rate:,.0f} steps/s{error}"
            advance(description, completed=row["steps"], line=line if _errors(row) else None)

        training.report = show
        training.run()


def _errors(row: dict[str, Any]) -> str:
    """Return as text the largest tip error [mm] of an evaluation in each case; an empty string if the row has none."""
    return ", ".join(
        f"{case} {row[f'{case}_max_mm']:.2f}"
        + ("" if row[f"{case}_share"] == 1.0 else f" (ended after {100 * row[f'{case}_share']:.0f} %)")
        for case in PAPER_CASES
        if f"{case}_max_mm" in row
    )


@contextlib.contextmanager
def _training_libraries() -> Iterator[None]:
    """Raise ValueError, with the install command, if the block imports a library that is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ValueError(
            f'{error.name} is not installed; run in the repository: pip install -c constraints.txt -e ".[rl]"'
        ) from None


def _config(options: Options) -> TrainingConfig:
    spec = find_algorithm(options.algorithm)
    preset = options.preset or next(iter(spec.presets))
    if preset not in spec.presets:
        raise UsageError(f"--preset {preset} is unknown; choose from: {', '.join(spec.presets)}")
    start, changed = spec.presets[preset], given(options, spec.config)
    if "robot" not in changed or "scale" in changed:
        return chosen(options, start)
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.rl_baselines.training import default_scale

    scale = default_scale(chosen_arm(changed["robot"], None), changed.get("base", start.base) != "none")
    if len(scale) != len(start.scale):  # the preset's scales are for two joints
        changed["scale"] = scale
    return dataclasses.replace(start, **changed)
