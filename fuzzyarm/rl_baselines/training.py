"""The trainer: a training run of any algorithm in a folder.

After every update of the algorithm the trainer writes a row of the learning curve; at the configured intervals it also
evaluates the policy and writes the policy bundles and a checkpoint. The bundle is evaluated as it is shipped, on the
paper's three cases, in NumPy at 1 kHz. A run that was killed and resumed gives the same bits as an uninterrupted one.
"""

from __future__ import annotations

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

from fuzzyarm.common.checks import shown
from fuzzyarm.common.files import csv_text, write_atomically
from fuzzyarm.envs.physics.equations import AnyArm, argument_of, chosen_arm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.fuzzy_policy.known_arm import joints_of, per_joint_of
from fuzzyarm.fuzzy_policy.laws.learned.bundle import BEST, LAST, PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.registry import known_names
from fuzzyarm.policies.spec import load_policy, resolve
from fuzzyarm.rl_baselines._case_evaluation import COLUMNS, evaluate_cases
from fuzzyarm.rl_baselines._checkpoint import (
    CheckpointError,
    check_finite,
    check_like,
    progress_in,
    random_state,
    read_checkpoint,
    set_random_state,
    write_checkpoint,
)
from fuzzyarm.rl_baselines.algorithms import algorithm_of, find_algorithm
from fuzzyarm.rl_baselines.config import TrainingConfig
from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv, learning_envs

__all__ = ["CHECKPOINT", "Training", "default_scale"]

CHECKPOINT = "checkpoint.pt"
"""Name of the file with the last checkpoint in the folder of a training run."""

_CURVE = "curve.csv"
_TIMES = "run.json"  # not in the bundles, which are equal for all runs with the same seed
_EVALUATION_PERIOD = 1e-3  # s, control period of the environment in which policies are compared


class Training:
    """A training run in its folder, new or resumed; nothing is written before `run`.

    Attributes:
        config: the settings; their class determines the algorithm.
        folder: output folder; created if needed.
        report: called after every update with the new row of the learning curve.
        algorithm: the learning algorithm.
        rows: the learning curve so far, one mapping per update.
        best: smallest score so far [mm], see `_ship`.

    Raises:
        ValueError: a setting is refused, such as an unknown base or an action period that is not a multiple of 1 ms.
        OSError: the arm's file cannot be read.
    """

    def __init__(
        self, config: TrainingConfig, folder: Path, report: Callable[[dict[str, Any]], None] = lambda row: None
    ) -> None:
        self.config, self.folder, self.report = config, folder, report
        self.rows: list[dict[str, Any]] = []
        self.best = math.inf
        self._earlier, self._begun = (0.0, 0.0), _clocks()  # times of earlier runs, up to the checkpoint
        self._spec, self.arm = algorithm_of(config), chosen_arm(config.robot, None)
        self._base: Policy | None = None  # at the control period of the evaluation
        if config.base != "none":
            if not resolve(config.base).named:  # a bundle stores the name of its base, not a file
                names = ", ".join(known_names())
                raise ValueError(f"base = {shown(config.base)} is not the name of a policy; choose from: none, {names}")
            self._base = load_policy(config.base, control_period=_EVALUATION_PERIOD, robot=self.arm)
        self.envs = _envs_of(config)
        self.algorithm = self._spec.create(config, self.envs)
        self._shipped_policy()  # raises before training if the policy could not be shipped afterwards

    @classmethod
    def resume(cls, config: TrainingConfig, folder: Path) -> Training:
        """Return the training run in a folder as of its last checkpoint.

        `config` must equal the original one, except for `checkpoint_interval` and `total_timesteps`: a larger total
        extends the run and changes no bit of the finished steps. A schedule over the run, such as the learning
        rate of PPO, continues as if the new total had been set from the beginning.

        Raises:
            CheckpointError: the checkpoint is missing, damaged, of another algorithm, arm or configuration, or its
                tensors have other shapes.
            ValueError: more steps than `total_timesteps` are done already.
        """
        found = read_checkpoint(folder / CHECKPOINT)
        try:
            begun = find_algorithm(found["algorithm"]).config.from_dict(found["config"])
            done, arm = found["steps"], found["arm"]
        except (KeyError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{folder / CHECKPOINT} does not fit this version of fuzzyarm: {error}; train in another folder"
            ) from None
        if type(begun) is not type(config):
            raise CheckpointError(f"{folder} contains a training run with {found['algorithm']}; choose another folder")
        was, now = begun.to_dict(), config.to_dict()
        free = ("total_timesteps", "checkpoint_interval")  # they do not affect what is learned
        other = [name for name in {**was, **now} if name not in free and was.get(name) != now.get(name)]
        if other:
            name = other[0]
            raise CheckpointError(
                f"{folder} contains a training run with {name} = {shown(was.get(name))}, not {shown(now.get(name))}: "
                "give the options with which it began, or choose another folder"
            )
        if config.total_timesteps < done:
            raise ValueError(
                f"total_timesteps = {config.total_timesteps} is below the {done} steps already done in {folder}; "
                "give a larger number, or start a new training run in another folder"
            )
        training = cls(config, folder)
        if robot_of(training.arm).digest != arm:
            raise CheckpointError(
                f"{folder} contains a training run for a different arm: {config.robot} has changed since then. Restore "
                "the arm's file, or start a new training run in another folder"
            )
        try:
            training.rows, training.best, training._earlier = progress_in(found)
            check_like("learner", found["learner"], training.algorithm.state())
            check_finite("learner", found["learner"])
            training.algorithm.set_state(found["learner"])
            training.envs.set_state({name: np.array(tensor.numpy()) for name, tensor in found["envs"].items()})
            set_random_state(found["generators"])
        except (AttributeError, KeyError, MemoryError, OverflowError, RuntimeError, TypeError, ValueError) as error:
            reason = textwrap.shorten(str(error), width=200)
            raise CheckpointError(
                f"the checkpoint does not match this training run ({reason}); start a new run in another folder"
            ) from None
        return training

    def run(self) -> PolicyBundle:
        """Train to the end and return the bundle, which is also written.

        Raises:
            OSError: a file cannot be written; the last checkpoint is intact.
        """
        self._begun = _clocks()
        self.folder.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(self.folder)
        # The rows that a killed run wrote after its last checkpoint are dropped here; they are computed again.
        write_atomically(self.folder / _CURVE, self._csv(self.rows, header=True))
        if self.algorithm.steps < self.config.total_timesteps:
            (self.folder / _TIMES).unlink(missing_ok=True)
            self._train()
        if not (self.folder / _TIMES).exists():  # also if a finished run was killed before it wrote its times
            wall, cpu = self._elapsed()
            times = {"wall_time_s": round(wall, 1), "cpu_time_s": round(cpu, 1)}
            write_atomically(self.folder / _TIMES, json.dumps(times, indent=1) + "\n")
        self.envs.close()
        return self.bundle()

    def bundle(self) -> PolicyBundle:
        """Return the bundle of the current policy, as it is shipped."""
        config, spec, robot = self.config, self._spec, robot_of(self.arm)
        return PolicyBundle(
            features=config.features,
            action=config.action,
            network=self.algorithm.network(),
            training={"algorithm": spec.title, "steps_done": self.algorithm.steps, **config.to_dict()},
            seed=config.seed,
            curve=[row for row in self.rows if COLUMNS[0] in row],
            versions={name: version(name) for name in ("fuzzyarm", "numpy", *spec.libraries, "gymnasium", "llvmlite")},
            arm=None if self.arm == ArmParameters() else ArmDefinition(robot.name, robot.digest),
        )

    def _train(self) -> None:
        try:
            if self.algorithm.steps == 0:
                self._write_checkpoint()  # so that there is always one to resume from; a full disk is noticed here
            self.algorithm.learn(self._after_update)
        except OSError as error:
            if error.filename == str(self.folder / CHECKPOINT):
                raise  # its message already says what is left
            text = f"{error.strerror or error}; {CHECKPOINT} is intact: restore write access or free space, then resume"
            raise OSError(error.errno, text, error.filename or str(self.folder)) from None

    def _after_update(self, learned: dict[str, float]) -> None:
        """Append an update's values `learned` to the learning curve; evaluate, and write a checkpoint, when due."""
        steps, config = self.algorithm.steps, self.config
        before = self.rows[-1]["steps"] if self.rows else 0
        row: dict[str, Any] = {"steps": steps, **learned}

        def due(interval: int) -> bool:
            return steps >= config.total_timesteps or steps // interval > before // interval

        evaluated = due(config.evaluation_interval)
        if evaluated:
            row |= evaluate_cases(self._shipped_policy(), self.arm)
        self.rows.append(row)
        with open(self.folder / _CURVE, "a", encoding="utf-8", newline="") as file:
            file.write(self._csv([row]))
        if evaluated:
            self._ship(row)
        if due(config.checkpoint_interval):
            self._write_checkpoint()
        self.report(row)

    def _shipped_policy(self) -> LearnedPolicy:
        """Return the policy as it is evaluated: from its bundle, at `_EVALUATION_PERIOD`."""
        return LearnedPolicy(self.bundle(), _EVALUATION_PERIOD, self.arm, self._base)

    def _ship(self, row: dict[str, Any]) -> None:
        """Write the bundle as the last one, and also as the best one if its score is the smallest so far.

        The score is the mean rms tip error over the cases of the distribution; a policy that ends an episode early is
        never the best.
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
        """Return wall and processor time of the training run [s], without the work lost when it was killed."""
        (wall, cpu), (earlier_wall, earlier_cpu), (begun_wall, begun_cpu) = _clocks(), self._earlier, self._begun
        return earlier_wall + wall - begun_wall, earlier_cpu + cpu - begun_cpu

    def _csv(self, rows: Sequence[dict[str, Any]], header: bool = False) -> str:
        """Return rows of the learning curve as CSV, after a `header`; a column that a row lacks stays empty."""
        columns = ("steps", "episode_reward", "episode_length", "tip_error_mm", *self._spec.columns, *COLUMNS)
        return csv_text(rows, columns, header=header)


def _envs_of(config: TrainingConfig) -> StableBaselinesVecEnv:
    """Return ``FuzzyArmLearn-v0`` with the lanes, features, actions and arm of a configuration."""
    arm = chosen_arm(config.robot, None)
    if len(config.scale) != (joints := joints_of(arm)):
        raise ValueError(f"scale = {list(config.scale)} must be {joints} numbers, one for each joint of the arm")
    arguments = {**argument_of(arm), **({"case": "nominal"} if config.distribution == "nominal" else {})}
    return learning_envs(
        config.lanes, features=config.features, action=config.action, threads=config.threads, **arguments
    )


def default_scale(arm: AnyArm, base: bool) -> tuple[float, ...]:
    """Return the default largest actions (joints,): 0.01 rad for a policy with a base, else torque limits [N m]."""
    return (0.01,) * joints_of(arm) if base else tuple(per_joint_of(arm, "torque_limit").tolist())


def _clocks() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()  # s


def _remove_leftovers(folder: Path) -> None:
    """Remove the temporary files and folders of a run that was killed while it wrote."""
    for name in (CHECKPOINT, _CURVE, _TIMES, LAST, BEST):
        for path in folder.glob(f".{name}.*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
