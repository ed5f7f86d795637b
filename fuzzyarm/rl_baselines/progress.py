"""A training on the terminal: what `fuzzyarm train` runs.

The folder gets ``curve.csv`` (a row per update), ``checkpoint.pt``, the bundles ``policy`` (the last evaluated) and
``best`` (the smallest tip error so far), and at the end ``run.json`` (wall and processor time); with tensorboard
installed ``tensorboard`` too.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from fuzzyarm.common import console
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.rl_baselines.config import TrainingConfig

__all__ = ["train_with_progress"]


def train_with_progress(
    config: TrainingConfig | None, folder: Path, total: int | None = None, algorithm: str | None = None
) -> PolicyBundle:
    """Train with a progress bar on the terminal and a line for every evaluation; return the last policy.

    Without a configuration the training in the folder is resumed; `total` and `algorithm` as for `Training.resume`.

    Raises:
        ValueError: the folder holds a training already, or none to resume, or the configuration is refused; or torch or
            stable-baselines3 is not installed.
        OSError: the folder cannot be written.
    """
    try:
        from fuzzyarm.rl_baselines.training import CHECKPOINT, Training, tensorboard_installed

        if config is not None and (folder / CHECKPOINT).exists():
            raise ValueError(f"{folder} holds a training already; go on with --resume, or choose another folder")
        with console.status("compiling and loading"):
            training = Training(config, folder) if config else Training.resume(folder, total, algorithm)
    except ModuleNotFoundError as error:
        raise ValueError(
            f'{error.name} is not installed; to train, run in the repository: pip install -c constraints.txt -e ".[rl]"'
        ) from None
    threads = training.config.threads
    title = f"training, {threads} {'thread' if threads == 1 else 'threads'}"
    with console.progress(title, training.config.total_timesteps) as advance:
        if training.config.tensorboard and not tensorboard_installed():
            advance(
                line='no TensorBoard logs: tensorboard is not installed (pip install -c constraints.txt -e ".[rl]")'
            )
        first, began = training.algorithm.steps, time.perf_counter()
        advance(completed=first)

        def show(row: dict[str, Any]) -> None:
            rate = (row["steps"] - first) / (time.perf_counter() - began)
            line = f"{row['steps']:>11,} steps, {rate:,.0f}/s; largest tip error [mm]: {_errors(row)}"
            description = f"{rate:,.0f} steps/s, tip error {row['tip_error_mm']:.2f} mm"
            advance(description, completed=row["steps"], line=line if _errors(row) else None)

        training.report = show
        return training.run()


def _errors(row: dict[str, Any]) -> str:
    """Return the largest tip errors of an evaluation by case; empty if the row holds none."""
    return ", ".join(
        f"{case} {row[f'{case}_max_mm']:.2f}"
        + ("" if row[f"{case}_share"] == 1.0 else f" (left after {100 * row[f'{case}_share']:.0f} %)")
        for case in PAPER_CASES
        if f"{case}_max_mm" in row
    )
