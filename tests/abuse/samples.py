"""Good files of every format, made once in a process, and a place for changed copies."""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.eval.episodes.rollout_file import write_rollouts
from fuzzyarm.eval.evaluation.run import EvaluationConfig, evaluate, write_results
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.engine import Engine
from fuzzyarm.eval.sweep.run import Sweep
from fuzzyarm.fuzzy_policy.hexadecimal import digest_of
from fuzzyarm.learned_policy.bundle import PolicyBundle
from fuzzyarm.learned_policy.cell import Cell
from fuzzyarm.learned_policy.definition import ActionDefinition, FeatureDefinition
from fuzzyarm.learned_policy.network import Network
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.training import Training

__all__ = ["CANARY", "SMALL_TRAINING", "evaluation", "recurrent_bundle", "room", "scratch", "sweep", "training"]

ROOM = Path(tempfile.mkdtemp(prefix="abuse-"))
CANARY = ROOM / "canary"
SMALL_TRAINING = {
    "total_timesteps": 256,
    "lanes": 2,
    "n_steps": 16,
    "batch_size": 32,
    "n_epochs": 1,
    "hidden": (4,),
    "evaluation_interval": 10**6,
    "checkpoint_interval": 64,
    "tensorboard": False,
}
_MODULE = "import os\nos.mkdir({!r})\n\ndef make():\n    return None\n"


@atexit.register
def _clear() -> None:
    shutil.rmtree(ROOM, ignore_errors=True)


def room() -> Path:
    """A folder for files of a process, with a module that leaves the canary if it is ever imported; on `sys.path`."""
    module = ROOM / "abuse_canary.py"
    if not module.exists():
        module.write_text(_MODULE.format(str(CANARY)))
        sys.path.append(str(ROOM))
    return ROOM


def scratch() -> Path:
    """An empty folder for one try, the only one at a time."""
    folder = room() / "try"
    if folder.exists():
        for path, folders, _ in os.walk(folder):
            for name in folders:
                os.chmod(os.path.join(path, name), 0o700) if not os.path.islink(os.path.join(path, name)) else None
        shutil.rmtree(folder)
    folder.mkdir()
    return folder


@functools.cache
def evaluation(policy: str = "fuzzy-1") -> Path:
    """The folder of an evaluation, without figures. Of a certified policy, a report simulates the proven loop."""
    folder = room() / f"evaluation-{policy}"
    folder.mkdir()
    done = evaluate(EvaluationConfig(policies=(policy,), cases=("nominal",)))
    write_results(done, folder)
    write_rollouts(done.rollouts, folder)
    return folder


@functools.cache
def sweep() -> Path:
    """The folder of a sweep with two chunks, without its summary."""
    folder = room() / "sweep"
    config = SweepConfig(policies=("fuzzy-1",), cases=("nominal",), plants=4, chunk=2)
    for _ in Sweep.begin(folder, config).run(Engine(jobs=1)):
        pass
    return folder


@functools.cache
def training() -> Path:
    """The folder of a training that is at its end."""
    folder = room() / "training"
    Training(PPOConfig(**SMALL_TRAINING), folder).run()
    return folder


@functools.cache
def recurrent_bundle() -> Path:
    """A recurrent network beside the elastic observer, with random weights."""
    rng, folder, hidden = np.random.default_rng(0), room() / "recurrent", 3
    features = FeatureDefinition(innovation_times=(0.01,))

    def random(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    network = Network(
        mean=np.zeros(features.size),
        std=np.ones(features.size),
        clip=10.0,
        weights=(random(2, hidden),),
        biases=(random(2),),
        cell=Cell(random(4 * hidden, features.size), random(4 * hidden, hidden), random(4 * hidden)),
    )
    action = ActionDefinition(scale=(30.0, 20.0), period=1e-3, base="elastic-observer", gate=1.0)
    PolicyBundle(features, action, network).save(folder)
    return folder


def signed(document: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a controller file with the digest put right."""
    content = {name: value for name, value in document.items() if name != "digest"}
    return content | {"digest": digest_of(content)}
