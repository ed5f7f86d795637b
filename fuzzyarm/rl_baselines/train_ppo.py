"""Train a policy with PPO, with a progress bar: what `fuzzyarm train ppo` runs, and a script of its own.

    python -m fuzzyarm.rl_baselines.train_ppo --preset nominal --out my-run      (or: fuzzyarm train ppo ...)

The folder gets ``curve.csv`` (a row per update), ``checkpoint.pt``, the bundles ``policy`` (the last evaluated) and
``best`` (the smallest tip error so far), and at the end ``run.json`` (wall and processor time); with tensorboard
installed ``tensorboard`` too.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.learned_policy.bundle import PolicyBundle
from fuzzyarm.rl_baselines.case_evaluation import COLUMNS
from fuzzyarm.rl_baselines.ppo_config import PPOConfig, add_run_flags, chosen_run
from fuzzyarm.rl_baselines.ppo_training import CHECKPOINT, Training, tensorboard_installed


def run(config: PPOConfig | None, folder: Path) -> PolicyBundle:
    """Train with a progress bar on the terminal.

    Args:
        config: of a new training; None: go on with the folder's.
        folder: of the training.

    Raises:
        ValueError: the folder holds a training already, or none to resume, or the configuration is refused.
        OSError: the folder cannot be written.
    """
    if config is not None and (folder / CHECKPOINT).exists():
        raise ValueError(f"{folder} holds a training already; go on with --resume, or choose another folder")
    stderr = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    with Progress(*columns, TimeRemainingColumn(), console=stderr, disable=not stderr.is_terminal) as bar:
        task = bar.add_task("compiling and loading", total=None)
        show = _Display(stderr, lambda steps, text: bar.update(task, completed=steps, description=text))
        training = Training.resume(folder, show) if config is None else Training(config, folder, show)
        if training.config.tensorboard and not tensorboard_installed():
            stderr.print("no TensorBoard logs: tensorboard is not installed (pip install tensorboard)")
        show.begin(training.model.num_timesteps)
        bar.update(task, total=training.config.steps, completed=training.model.num_timesteps)
        return training.run()


class _Display:
    """Steps a second and tip error on the bar; a line for every evaluation."""

    def __init__(self, console: Console, update: Callable[[int, str], None]) -> None:
        self._console, self._update = console, update
        self.begin(0)

    def begin(self, steps: int) -> None:
        """Count speed from here."""
        self._steps, self._time = steps, time.perf_counter()

    def __call__(self, row: dict[str, Any]) -> None:
        rate = (row["steps"] - self._steps) / (time.perf_counter() - self._time)
        self._update(row["steps"], f"{rate:,.0f} steps/s, tip error {row['tip_error_mm']:.2f} mm")
        if COLUMNS[0] in row:
            errors = ", ".join(
                f"{case} {row[f'{case}_max_mm']:.2f}"
                + ("" if row[f"{case}_share"] == 1.0 else f" (left after {100 * row[f'{case}_share']:.0f} %)")
                for case in CASES
            )
            line = f"{row['steps']:>11,} steps, {rate:,.0f}/s; largest tip error [mm]: {errors}"
            self._console.print(line, highlight=False, markup=False, emoji=False, soft_wrap=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run as a script; return the exit code: 0 fine, 2 bad usage or a disk that cannot be written, 130 interrupted."""
    parser = argparse.ArgumentParser(description="Train a policy with PPO.")
    add_run_flags(parser)
    try:
        run(*chosen_run(parser.parse_args(arguments)))
    except OSError as error:
        print(f"{error.filename}: {error.strerror}" if error.filename else error, file=sys.stderr)
        return 2
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; --resume goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
