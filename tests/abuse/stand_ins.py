"""What stands in place of a file: pipes, devices, links, and files that never end or explode."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.evaluation.results_file import read_results
from fuzzyarm.eval.paper.drift import load_expected
from fuzzyarm.eval.report.stored import read_evaluation
from fuzzyarm.eval.sweep.run import Sweep
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.rl_baselines.training import Training

from .damage import SPECIAL
from .documents import BUNDLES, no_code_ran, prepared
from .samples import evaluation, scratch, sweep, training
from .surface import Surface, Try

__all__ = ["SURFACES"]

BUNDLE = BUNDLES / "ppo-nominal"
READERS: dict[str, Callable[[Path], Any]] = {
    "controller": lambda path: Controller.load(path),
    "robot": lambda path: ArmParameters.from_toml(path),
    "expected": lambda path: load_expected(path),
    "results": lambda path: read_results(path),
    "bundle": lambda path: load_policy(_beside(path, "policy.json", BUNDLE)),
    "weights": lambda path: load_policy(_beside(path, "weights.safetensors", BUNDLE)),
    "rollouts": lambda path: read_evaluation(_beside(path, "rollouts.npz", evaluation())),
    "run.json": lambda path: Sweep.resume(_beside(path, "run.json", sweep())),
    "chunk": lambda path: Sweep.resume(_beside(path, "chunks/000000.npz", sweep())).remaining,
    "checkpoint": lambda path: Training.resume(_beside(path, "checkpoint.pt", training())),
}
"""Readers of one file of each format."""


def _beside(path: Path, name: str, good: Path) -> Path:
    folder = scratch()
    shutil.copytree(good, folder, dirs_exist_ok=True)
    (folder / name).unlink()
    (folder / name).symlink_to(path)
    return folder


def _in_place_of_a_file(rng: np.random.Generator) -> Try:
    kind, reader = list(SPECIAL)[rng.integers(len(SPECIAL))], list(READERS)[rng.integers(len(READERS))]

    def run() -> None:
        path = scratch() / "itself"
        SPECIAL[kind](path)
        try:
            READERS[reader](path)
        finally:
            no_code_ran()
            path.is_file() and path.unlink()

    return Try(f"{reader} is {kind}", run)


SURFACES = (Surface("in place of a file", "files", 240, _in_place_of_a_file, prepare=prepared),)
