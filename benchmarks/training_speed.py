"""Environment steps a second of each trainer, beside the plain library on environments one by one.

    python benchmarks/training_speed.py [--json FILE]

`fuzzyarm train` and the library take turns, with the first preset of each algorithm and one thread: collecting,
normalising and learning, in whole updates, without evaluations and checkpoints. The library's model has the arguments
of ours, which are read from it, and learns on `DummyVecEnv` of ``gym.make("fuzzyarm:FuzzyArm-v0")`` with actions in
[-1, 1] and with the same normaliser. It sees the 10 numbers of an observation, ours the features of the preset.
Beside that, the time for which an evaluation with its checkpoints interrupts a training. About three minutes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import RescaleAction
from measuring import options_of, printed, write
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from fuzzyarm.envs.periods import whole_substeps
from fuzzyarm.eval.bench.entries import Entry, Measure, timed
from fuzzyarm.eval.bench.run import race
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS
from fuzzyarm.rl_baselines.config import TrainingConfig
from fuzzyarm.rl_baselines.training import Training

ROUNDS, SECONDS = 5, 2.0
PEER = "the library"


@contextlib.contextmanager
def trainer(config: TrainingConfig) -> Iterator[Measure]:
    """Open the trainer of a configuration."""
    with _training(config) as training:
        algorithm = training.algorithm

        def update() -> int:
            before = algorithm.steps
            algorithm.update()
            return algorithm.steps - before

        yield _learning(update, config)


@contextlib.contextmanager
def library(config: TrainingConfig) -> Iterator[Measure]:
    """Open the library's model with the arguments that the trainer's has, on environments one by one."""
    with _training(config) as training:
        ours: Any = training.algorithm
    kind, normaliser = type(ours.model), ours.normaliser
    names = inspect.signature(kind).parameters.keys() - {"env", "policy"}
    arguments = {name: getattr(ours.model, name) for name in names if hasattr(ours.model, name)}
    envs = make_vec_env(lambda: environment(config), n_envs=config.lanes)
    model = kind(
        ours.model.policy_class,
        VecNormalize(envs, gamma=normaliser.gamma, norm_reward=normaliser.norm_reward),
        **arguments,
    )

    def update() -> int:
        before = model.num_timesteps
        model.learn(1, reset_num_timesteps=before == 0)  # it ends after a whole update
        return int(model.num_timesteps - before)

    yield _learning(update, config)
    envs.close()


def environment(config: TrainingConfig) -> gym.Env[Any, Any]:
    """Return one environment with the control period of a configuration and actions in [-1, 1]."""
    env = gym.make("fuzzyarm:FuzzyArm-v0", control_period=config.action_period)
    return RescaleAction(env, np.float32(-1.0), np.float32(1.0))


def pause(config: TrainingConfig) -> float:
    """Return the time [s] of an evaluation on the three cases and of the checkpoints around it."""
    with _training(dataclasses.replace(config, total_timesteps=1)) as training:
        algorithm, learning = training.algorithm, 0.0
        update = algorithm.update

        def timed_update() -> dict[str, float]:
            nonlocal learning
            begin = time.perf_counter()
            row = update()
            learning += time.perf_counter() - begin
            return row

        algorithm.update = timed_update  # type: ignore[method-assign]
        begin = time.perf_counter()
        training.run()
        return time.perf_counter() - begin - learning


@contextlib.contextmanager
def _training(config: TrainingConfig) -> Iterator[Training]:
    with tempfile.TemporaryDirectory() as folder:
        yield Training(dataclasses.replace(config, tensorboard=False), Path(folder))


def _learning(update: Callable[[], int], config: TrainingConfig) -> Measure:
    """Return the function that measures, once the steps before the first gradient step are done."""
    steps = 0
    while steps <= getattr(config, "learning_starts", 0):
        steps += update()
    return timed(update)


def measured(name: str) -> dict[str, Any]:
    """Return the row of an algorithm."""
    spec = ALGORITHMS[name]
    preset, config = next(iter(spec.presets.items()))
    pause(config)  # may compile
    substeps = whole_substeps(config.action_period, None)
    own = Entry(name, config.lanes, config.threads, functools.partial(trainer, config), substeps)
    plain = dataclasses.replace(own, name=spec.title, open=functools.partial(library, config), peer=PEER)
    ours, theirs = race(name, [own, plain], ROUNDS, SECONDS)
    return {
        **{"algorithm": name, "preset": preset, "lanes": config.lanes, "features": config.features.size},
        "steps_per_s": ours["steps_per_s"],
        "library_steps_per_s": theirs["steps_per_s"],
        "ratio": ours["ratios"][PEER],
        "pause_s": pause(config),
        "evaluation_interval": config.evaluation_interval,
    }


def main() -> None:
    """Measure, print, and write the result with `--json`."""
    options = options_of(__doc__).parse_args()
    rows = printed(map(measured, ALGORITHMS))
    versions = current_provenance()["versions"]
    versions |= {name: version(name) for name in ("torch", "stable-baselines3")}
    write(options.json, "training_speed.py", versions=versions, rounds=ROUNDS, seconds=SECONDS, rows=rows)


if __name__ == "__main__":
    main()
