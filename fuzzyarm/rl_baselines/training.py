"""The trainer: a training in its folder, whatever the algorithm, which can be killed and resumed.

After every update of the algorithm the trainer writes a row of the curve, and when they are due an evaluation, the
policy bundles and a checkpoint. What is evaluated on the paper's three cases is the bundle, in NumPy at 1 kHz, in the
form in which it is shipped. A training that was killed and resumed gives the same bits as one that was not.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import shutil
import textwrap
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.files import csv_text, write_atomically
from fuzzyarm.envs.physics.equations import chosen_arm, robot_of
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.fuzzy_policy.laws.learned.bundle import BEST, LAST, PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.rl_baselines.algorithms import algorithm_of, find_algorithm
from fuzzyarm.rl_baselines.case_evaluation import COLUMNS, evaluate_cases
from fuzzyarm.rl_baselines.checkpoint import (
    CheckpointError,
    check_finite,
    check_like,
    progress_in,
    random_state,
    read_checkpoint,
    set_random_state,
    write_checkpoint,
)
from fuzzyarm.rl_baselines.config import TrainingConfig
from fuzzyarm.rl_baselines.learning_env import arm_definition, arm_of, base_of, learning_envs

__all__ = ["CHECKPOINT", "Training", "tensorboard_installed"]

CHECKPOINT = "checkpoint.pt"
"""File of the last checkpoint in the folder of a training."""

_CURVE, _TENSORBOARD = "curve.csv", "tensorboard"
_TIMES = "run.json"  # apart from the bundles, which are the same for every run with the same seed
_EVALUATION_PERIOD = 1e-3  # s, control period of the environment in which policies are compared


class Training:
    """A training in its folder, new or resumed; nothing is written before `run`.

    Attributes:
        config: the settings; their class decides on the algorithm.
        folder: where everything goes; made if needed.
        report: called after every update with the row of the curve.
        algorithm: what learns, on the arms `envs`.
        rows: the curve so far, one mapping per update.
        best: smallest score so far [mm], see `_ship`.

    Raises:
        ValueError: the configuration names an unknown base, its periods do not fit, or its class is not registered.
        OSError: the folder cannot be written.
    """

    def __init__(
        self, config: TrainingConfig, folder: Path, report: Callable[[dict[str, Any]], None] = lambda row: None
    ) -> None:
        self.config, self.folder, self.report = config, folder, report
        self.rows: list[dict[str, Any]] = []
        self.best = math.inf
        self._earlier, self._begun = (0.0, 0.0), _clocks()  # times of the runs before this one, up to their checkpoint
        self._spec, self.arm = algorithm_of(config), arm_of(config)
        self.envs = learning_envs(config, base_of(config, self.arm, config.action_period))
        self._evaluation_base = base_of(config, self.arm, _EVALUATION_PERIOD)
        self.algorithm = self._spec.create(config, self.envs)
        self._writer: Any = None
        self._shipped_policy()  # refuses before the training what could not be shipped after it

    @classmethod
    def resume(cls, folder: Path, total_timesteps: int | None = None, algorithm: str | None = None) -> Training:
        """Return the training of a folder as it was at its last checkpoint.

        Args:
            folder: of the training.
            total_timesteps: environment steps to go on to, also of a training that has reached its end; None: as many
                as it was configured for. What is done keeps its bits. A schedule over the training, such as the
                learning rate of PPO, continues as if this had been the total from the beginning: it may jump here.
            algorithm: name of the algorithm that it must be of; None: any.

        Raises:
            CheckpointError: there is no checkpoint, it is damaged, of another algorithm or arm, or it does not fit.
            ValueError: more steps than `total_timesteps` are done already.
        """
        found = read_checkpoint(folder / CHECKPOINT)
        try:
            config, done = find_algorithm(found["algorithm"]).config.from_dict(found["config"]), found["steps"]
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(f"{folder / CHECKPOINT} is of another version: {error}; start again") from None
        if algorithm not in (None, name := found["algorithm"]):
            raise CheckpointError(
                f"{folder} holds a training with {name}, not {algorithm}: fuzzyarm train {name} --resume"
            )
        if total_timesteps is not None:
            config = dataclasses.replace(config, total_timesteps=total_timesteps)
            if total_timesteps < done:
                raise ValueError(
                    f"total_timesteps = {total_timesteps} is below the {done} steps that {folder} has done already; "
                    "give a larger number, or start another training"
                )
        try:
            if robot_of(chosen_arm(config.robot, None)).digest != found["arm"]:
                raise CheckpointError(
                    f"{folder} holds a training of another arm than {config.robot} is now: bring its file back as it "
                    "was, or start again in another folder"
                )
            training = cls(config, folder)
            training.rows, training.best, training._earlier = progress_in(found)
            check_like("learner", found["learner"], training.algorithm.state())
            check_finite("learner", found["learner"])
            training.algorithm.set_state(found["learner"])
            training.envs.set_state({name: np.array(tensor.numpy()) for name, tensor in found["envs"].items()})
            set_random_state(found["generators"])
        except CheckpointError:
            raise
        except (AttributeError, KeyError, MemoryError, OverflowError, RuntimeError, TypeError, ValueError) as error:
            reason = textwrap.shorten(str(error), width=200)
            raise CheckpointError(
                f"the checkpoint does not fit this training ({reason}); start the training again"
            ) from None
        return training

    def run(self) -> PolicyBundle:
        """Train to the end and return the bundle, which is also written.

        Raises:
            OSError: something cannot be written; the last checkpoint is intact.
        """
        self._begun = _clocks()
        self.folder.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(self.folder)
        # The rows that a killed run wrote after its last checkpoint are dropped here; they are computed again.
        write_atomically(self.folder / _CURVE, self._csv(self.rows, header=True))
        if self.config.tensorboard and tensorboard_installed():
            from torch.utils.tensorboard.writer import SummaryWriter

            self._writer = SummaryWriter(str(self.folder / _TENSORBOARD), purge_step=self.algorithm.steps + 1)
        if self.algorithm.steps < self.config.total_timesteps:
            self._train()
            wall, cpu = self._elapsed()
            times = {"wall_time_s": round(wall, 1), "cpu_time_s": round(cpu, 1)}
            write_atomically(self.folder / _TIMES, json.dumps(times, indent=1) + "\n")
        if self._writer is not None:
            self._writer.close()
        self.envs.close()
        return self.bundle()

    def bundle(self) -> PolicyBundle:
        """Return the policy of this moment as it is shipped."""
        config, spec = self.config, self._spec
        return PolicyBundle(
            features=config.features,
            action=config.action,
            network=self.algorithm.network(),
            training={"algorithm": spec.title, "steps_done": self.algorithm.steps, **config.to_dict()},
            seed=config.seed,
            curve=[row for row in self.rows if COLUMNS[0] in row],
            versions={name: version(name) for name in ("fuzzyarm", "numpy", *spec.libraries, "gymnasium", "llvmlite")},
            arm=arm_definition(self.arm),
        )

    def _train(self) -> None:
        """Update the algorithm until all steps are done."""
        try:
            if self.algorithm.steps == 0:
                self._write_checkpoint()  # so that there is always one to resume from; a full disk is noticed here
            while self.algorithm.steps < self.config.total_timesteps:
                before = self.algorithm.steps
                self._after_update(before, self.algorithm.update())
        except OSError as error:
            if error.filename == str(self.folder / CHECKPOINT):
                raise  # its message already says what is left
            text = f"{error.strerror or error}; {CHECKPOINT} is intact: free some space and resume"
            raise OSError(error.errno, text, error.filename or str(self.folder)) from None

    def _after_update(self, before: int, learned: dict[str, float]) -> None:
        """Write the row of an update after so many steps, with an evaluation and a checkpoint if they are due."""
        steps, config = self.algorithm.steps, self.config
        row: dict[str, Any] = {"steps": steps, "tip_error_mm": 1e3 * self.envs.take_mean_tip_error(), **learned}

        def due(interval: int) -> bool:
            return steps >= config.total_timesteps or steps // interval > before // interval

        evaluated = due(config.evaluation_interval)
        if evaluated:
            row |= evaluate_cases(self._shipped_policy(), self.arm)
        self.rows.append(row)
        with open(self.folder / _CURVE, "a", encoding="utf-8", newline="") as file:
            file.write(self._csv([row]))
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, steps)
        if evaluated:
            self._ship(row)
        if due(config.checkpoint_interval):
            self._write_checkpoint()
        self.report(row)

    def _shipped_policy(self) -> LearnedPolicy:
        """Return the policy as it is evaluated: from its bundle, at the period of the comparison."""
        return LearnedPolicy(self.bundle(), _EVALUATION_PERIOD, self.arm, self._evaluation_base)

    def _ship(self, row: dict[str, Any]) -> None:
        """Write the bundle as the last one, and as the best one if it is.

        The score is the mean rms tip error over the cases that the distribution holds; a policy that does not reach
        the end of each of them is never the best.
        """
        bundle = self.bundle()
        bundle.save(self.folder / LAST)
        judged = ("nominal",) if self.config.distribution == "nominal" else PAPER_CASES
        score = sum(row[f"{case}_rms_mm"] for case in judged) / len(judged)
        if all(row[f"{case}_share"] == 1.0 for case in judged) and score < self.best:
            self.best = score
            bundle.save(self.folder / BEST)

    def _write_checkpoint(self) -> None:
        content = {
            "algorithm": self._spec.name,
            "config": self.config.to_dict(),
            "arm": robot_of(self.arm).digest,
            "steps": self.algorithm.steps,
            "rows": self.rows,
            "best": self.best,
            "seconds": self._elapsed(),
            "learner": self.algorithm.state(),
            "envs": self.envs.get_state(),
            "generators": random_state(),
        }
        write_checkpoint(self.folder / CHECKPOINT, content)

    def _elapsed(self) -> tuple[float, float]:
        """Return wall and processor time of the training [s], without what was lost when a run was killed."""
        (wall, cpu), (earlier_wall, earlier_cpu), (begun_wall, begun_cpu) = _clocks(), self._earlier, self._begun
        return earlier_wall + wall - begun_wall, earlier_cpu + cpu - begun_cpu

    def _csv(self, rows: Sequence[dict[str, Any]], header: bool = False) -> str:
        """Return rows of the curve as text; a column that a row lacks stays empty."""
        columns = ("steps", "episode_reward", "episode_length", "tip_error_mm", *self._spec.columns, *COLUMNS)
        return csv_text(rows, columns, header=header)


def _clocks() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()  # s


def tensorboard_installed() -> bool:
    """Return whether TensorBoard logs can be written."""
    return importlib.util.find_spec("tensorboard") is not None


def _remove_leftovers(folder: Path) -> None:
    """Remove the temporary files and folders of a run that was killed while it wrote."""
    for name in (CHECKPOINT, _CURVE, LAST, BEST):
        for path in folder.glob(f".{name}.*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
