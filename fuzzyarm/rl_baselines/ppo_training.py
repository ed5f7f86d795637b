"""One training with PPO of stable-baselines3 in its folder, which goes on after a kill as if it had not been.

Between two rollouts nothing is under way: there the curve's row, the evaluation, the bundles and the checkpoint are
made. What is evaluated on the three cases is the bundle, in NumPy at 1 kHz, as it is shipped.
"""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import math
import shutil
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.learned_policy.bundle import PolicyBundle
from fuzzyarm.learned_policy.network import Network
from fuzzyarm.learned_policy.policy import LearnedPolicy
from fuzzyarm.policies import load_policy
from fuzzyarm.rl_baselines.case_evaluation import COLUMNS, evaluate_cases
from fuzzyarm.rl_baselines.checkpoint import (
    CheckpointError,
    learner_state,
    read_checkpoint,
    set_learner_state,
    write_checkpoint,
)
from fuzzyarm.rl_baselines.learning_env import learning_envs
from fuzzyarm.rl_baselines.ppo_config import PPOConfig

CHECKPOINT, CURVE, LAST, BEST, TENSORBOARD = "checkpoint.pt", "curve.csv", "policy", "best", "tensorboard"
TIMES = "run.json"  # what differs between two runs of the same: how long it took
EVALUATION_PERIOD = 1e-3  # s, of the environment the policies are compared on
LEARNER = {  # columns of the curve, and what stable-baselines3 calls them
    "learning_rate": "train/learning_rate",
    "approx_kl": "train/approx_kl",
    "clip_fraction": "train/clip_fraction",
    "value_loss": "train/value_loss",
    "explained_variance": "train/explained_variance",
    "action_std": "train/std",
}
FIELDS = ("steps", "episode_reward", "episode_length", "tip_error_mm", *LEARNER, *COLUMNS)
VERSIONS = ("fuzzyarm", "numpy", "torch", "stable-baselines3", "gymnasium", "numba")


class Training:
    """A training in its folder, new or resumed.

    Args:
        config: what is trained.
        folder: where everything goes; made if needed.
        report: called after every update with the row of the curve.

    Raises:
        ValueError: the configuration names an unknown base, or its periods do not fit.
        OSError: the folder cannot be written.
    """

    def __init__(self, config: PPOConfig, folder: Path, report: Callable[[dict[str, Any]], None] | None = None) -> None:
        """Make networks and arms; nothing is written before `run`."""
        self.config, self.folder, self._report = config, folder, report
        self.rows: list[dict[str, Any]] = []
        self.best = math.inf
        self._before, self._since = (0.0, 0.0), _clocks()  # of the runs before this one, up to their checkpoint
        torch.set_num_threads(config.threads)
        self.envs = learning_envs(config, _base(config, config.action_period))
        self._evaluation_base = _base(config, EVALUATION_PERIOD)
        self.normaliser = VecNormalize(self.envs, gamma=config.gamma)
        self.model = PPO("MlpPolicy", self.normaliser, **_arguments(config))
        self.model.set_logger(Logger(None, []))
        self._writer: Any = None
        LearnedPolicy(self.bundle(), EVALUATION_PERIOD, base=self._evaluation_base)  # refuses what could not be shipped

    @classmethod
    def resume(cls, folder: Path, report: Callable[[dict[str, Any]], None] | None = None) -> Training:
        """Return the training of a folder as it was at its last checkpoint.

        Raises:
            CheckpointError: there is none, or it is damaged or does not fit.
        """
        found = read_checkpoint(folder / CHECKPOINT)
        try:
            training = cls(PPOConfig.from_dict(found["config"]), folder, report)
            training.rows, training.best, training._before = found["rows"], found["best"], found["seconds"]
            learner = found["learner"]
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"{folder / CHECKPOINT} is of another version: {error}; start anew") from None
        set_learner_state(learner, training.model, training.normaliser, training.envs)
        return training

    def run(self) -> PolicyBundle:
        """Train to the end and return the bundle, which is also written.

        Raises:
            OSError: something cannot be written; the last checkpoint is whole.
        """
        self._since = _clocks()
        self.folder.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(self.folder)
        write_atomically(self.folder / CURVE, _csv(self.rows, header=True))  # without rows after the checkpoint
        if self.config.tensorboard and tensorboard_installed():
            from torch.utils.tensorboard.writer import SummaryWriter

            self._writer = SummaryWriter(str(self.folder / TENSORBOARD), purge_step=self.model.num_timesteps + 1)
        left = self.config.steps - self.model.num_timesteps
        if left > 0:
            begun = self.model._last_obs is not None
            try:
                self.model.learn(left, _AfterUpdates(self), log_interval=None, reset_num_timesteps=not begun)
            except OSError as error:
                if error.filename == str(self.folder / CHECKPOINT):
                    raise  # it says what is left
                text = f"{error.strerror or error}; {CHECKPOINT} is whole: make room and resume"
                raise OSError(error.errno, text, error.filename or str(self.folder)) from None
            wall, cpu = self._elapsed()
            times = {"wall_time_s": round(wall, 1), "cpu_time_s": round(cpu, 1)}
            write_atomically(self.folder / TIMES, json.dumps(times, indent=1) + "\n")
        if self._writer is not None:
            self._writer.close()
        self.envs.close()
        return self.bundle()

    def _elapsed(self) -> tuple[float, float]:
        """Return wall and processor time of the training so far [s], without what a kill undid."""
        (wall, cpu), (wall_before, cpu_before), (wall_since, cpu_since) = _clocks(), self._before, self._since
        return wall_before + wall - wall_since, cpu_before + cpu - cpu_since

    def bundle(self) -> PolicyBundle:
        """Return the policy of this moment as it is shipped."""
        model = self.model
        layers = [
            *(part for part in model.policy.mlp_extractor.policy_net if isinstance(part, torch.nn.Linear)),
            model.policy.action_net,
        ]
        moments, config = self.normaliser.obs_rms, self.config
        assert not isinstance(moments, dict)
        network = Network(
            mean=moments.mean.copy(),
            std=np.sqrt(moments.var + self.normaliser.epsilon),
            clip=self.normaliser.clip_obs,
            weights=tuple(layer.weight.detach().numpy().copy() for layer in layers),
            biases=tuple(layer.bias.detach().numpy().copy() for layer in layers),
        )
        return PolicyBundle(
            features=config.features,
            action=config.action,
            network=network,
            training={
                "algorithm": "PPO of stable-baselines3",
                "steps_done": self.model.num_timesteps,
                **config.to_dict(),
            },
            seed=config.seed,
            curve=[row for row in self.rows if COLUMNS[0] in row],
            versions={name: version(name) for name in VERSIONS},
        )

    def begin(self) -> None:
        """Keep the very beginning, so that there is always something to resume; a disk that is full shows here."""
        self._write_checkpoint()

    def after_update(self, tip_error: float) -> None:
        """Write the row of an update, with an evaluation and a checkpoint if they are due.

        Args:
            tip_error: mean over the last rollout [m].
        """
        model, config = self.model, self.config
        episodes = list(model.ep_info_buffer or ())
        row: dict[str, Any] = {"steps": model.num_timesteps, "tip_error_mm": 1e3 * tip_error}
        if episodes:
            row["episode_reward"] = float(np.mean([one["r"] for one in episodes]))
            row["episode_length"] = float(np.mean([one["l"] for one in episodes]))
        row |= {name: float(model.logger.name_to_value[key]) for name, key in LEARNER.items()}
        last = model.num_timesteps >= config.steps
        evaluated = last or self._due(config.evaluation_interval)
        if evaluated:
            row |= evaluate_cases(LearnedPolicy(self.bundle(), EVALUATION_PERIOD, base=self._evaluation_base))
        self.rows.append(row)
        with open(self.folder / CURVE, "a", encoding="utf-8", newline="") as file:
            file.write(_csv([row]))
        self._log(row)
        if evaluated:
            self._ship(row)
        if last or self._due(config.checkpoint_interval):
            self._write_checkpoint()
        if self._report is not None:
            self._report(row)

    def _ship(self, row: dict[str, Any]) -> None:
        """Write the bundle as the last one, and as the best one if it is."""
        bundle = self.bundle()
        bundle.save(self.folder / LAST)
        judged = ["nominal"] if self.config.distribution == "nominal" else list(CASES)
        score = sum(row[f"{case}_rms_mm"] for case in judged) / len(judged)
        if all(row[f"{case}_share"] == 1.0 for case in judged) and score < self.best:
            self.best = score
            bundle.save(self.folder / BEST)

    def _due(self, interval: int) -> bool:
        """Return whether the last update passed a multiple of an interval."""
        steps: int = self.model.num_timesteps
        return steps // interval > (steps - self.config.lanes * self.config.rollout) // interval

    def _write_checkpoint(self) -> None:
        learner = learner_state(self.model, self.normaliser, self.envs)
        content = {
            "config": self.config.to_dict(),
            "rows": self.rows,
            "best": self.best,
            "seconds": self._elapsed(),
            "learner": learner,
        }
        write_checkpoint(self.folder / CHECKPOINT, content)

    def _log(self, row: dict[str, Any]) -> None:
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, row["steps"])


class _AfterUpdates(BaseCallback):
    """Calls `Training.after_update` between an update and the next rollout, where nothing is under way."""

    def __init__(self, run: Training) -> None:
        super().__init__()
        self._run, self._sum, self._count = run, 0.0, 0

    def _on_rollout_start(self) -> None:
        if self._count:
            self._finish()
        elif self.num_timesteps == 0:
            self._run.begin()

    def _on_step(self) -> bool:
        self._sum += float(self._run.envs.tip_errors.mean())
        self._count += 1
        return True

    def _on_training_end(self) -> None:
        self._finish()

    def _finish(self) -> None:
        mean, self._sum, self._count = self._sum / self._count, 0.0, 0
        self._run.after_update(mean)


def _clocks() -> tuple[float, float]:
    """Return wall and processor time [s], from any beginning."""
    return time.perf_counter(), time.process_time()


def tensorboard_installed() -> bool:
    """Return whether TensorBoard logs can be written."""
    return importlib.util.find_spec("tensorboard") is not None


def _base(config: PPOConfig, control_period: float) -> Any:
    return None if config.base == "none" else load_policy(config.base, control_period=control_period)


def _remove_leftovers(folder: Path) -> None:
    """Remove what a killed run was writing aside."""
    for name in (CHECKPOINT, CURVE, LAST, BEST):
        for path in folder.glob(f".{name}.*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def _arguments(config: PPOConfig) -> dict[str, Any]:
    """Return the arguments of `PPO`."""
    first, last = config.learning_rate, config.final_learning_rate
    widths = list(config.hidden)
    return {
        "learning_rate": lambda left: last + (first - last) * left,
        "n_steps": config.rollout,
        "batch_size": config.batch_size,
        "n_epochs": config.epochs,
        "gamma": config.gamma,
        "gae_lambda": config.gae_lambda,
        "clip_range": config.clip_range,
        "ent_coef": config.entropy_weight,
        "vf_coef": config.value_weight,
        "max_grad_norm": config.max_gradient,
        "target_kl": config.target_kl or None,
        "policy_kwargs": {
            "net_arch": {"pi": widths, "vf": widths},
            "activation_fn": torch.nn.Tanh,
            "log_std_init": config.initial_log_std,
        },
        "seed": config.seed,
        "device": "cpu",
    }


def _csv(rows: Sequence[dict[str, Any]], header: bool = False) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=FIELDS, lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
