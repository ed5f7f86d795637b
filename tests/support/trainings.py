"""A training that is run through, and the same one stopped and resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fuzzyarm.rl_baselines.training import Training

SMALL_TRAINING: dict[str, Any] = {
    "total_timesteps": 256,
    "lanes": 2,
    "n_steps": 16,
    "batch_size": 32,
    "n_epochs": 1,
    "hidden": (4,),
    "evaluation_interval": 10**6,
    "checkpoint_interval": 64,
}
RESULTS = ("curve.csv", "policy/policy.json", "policy/weights.safetensors")


class Stopped(Exception):
    """A training is stopped on purpose."""


def results(folder: Path) -> dict[str, bytes]:
    """Return what has to be the same to the bit in every run with the same seed."""
    return {name: (folder / name).read_bytes() for name in RESULTS}


def stopped(config: Any, folder: Path, steps: int) -> Path:
    """Train, and stop at the first row of the curve with so many steps; return the folder."""

    def stop(row: dict[str, Any]) -> None:
        if row["steps"] >= steps:
            raise Stopped

    with pytest.raises(Stopped):
        Training(config, folder, stop).run()
    return folder


def resumed_to_the_bit(config: Any, folder: Path, steps: int) -> Training:
    """Train once through and once with a stop and a resume, check that both end alike; return the first."""
    whole = Training(config, folder / "whole")
    whole.run()
    Training.resume(config, stopped(config, folder / "stopped", steps)).run()
    assert results(folder / "stopped") == results(folder / "whole")
    return whole
