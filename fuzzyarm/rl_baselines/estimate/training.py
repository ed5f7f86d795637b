"""The training: the student drives, the teacher labels, the student learns from the latest chunks.

A gradient step lowers the mean over a window of

    √(1 + ((ρ - ρ*)/s)²) - 1    where the teacher's torque is not at its limit,

with ρ* what the teacher's torque has beyond u_b, in units of R. A training takes minutes and is not resumed; the same
seed gives the same network on the same machine.
"""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
import torch

from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.bundle import EstimateBundle
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.rl_baselines.config import SEGMENT, EstimateConfig
from fuzzyarm.rl_baselines.estimate.courses import draw_courses
from fuzzyarm.rl_baselines.estimate.driving import Chunk, Drive
from fuzzyarm.rl_baselines.estimate.student import Student

__all__ = ["PERIOD", "EstimateTraining"]


PERIOD = 1e-3
"""Control period of the training [s]."""

_SCALE = 0.02  # s
_LAST_RATE, _LARGEST_GRADIENT = 1e-5, 1.0
_NEWEST = 3  # one gradient step in so many is from the newest chunk


class EstimateTraining:
    """A training from its settings, for the arm of Table 1 or another one.

    Attributes:
        report: called after every chunk with its row of the curve.
        student: the network.
        rows: the curve: chunk, tip_error_mm (root mean square over all lanes), loss, lost (episodes that ended early).
    """

    def __init__(
        self,
        config: EstimateConfig,
        report: Callable[[dict[str, Any]], None] = lambda row: None,
        arm: AnyArm | None = None,
    ) -> None:
        torch.set_num_threads(1)
        self.config, self.report, self._arm = config, report, ArmParameters() if arm is None else arm
        self._generator = np.random.default_rng(config.seed)
        first, physics = torch.Generator().manual_seed(config.seed), equations_of(self._arm)
        self.student = Student(config.hidden, config.modulation, first, physics)
        self._policy = LearnedObserverPolicy(self.student.network(), self._arm, PERIOD)
        self._optimiser = torch.optim.Adam(self.student.parameters(), lr=config.learning_rate)
        steps = config.chunks * config.updates
        self._rate = torch.optim.lr_scheduler.CosineAnnealingLR(self._optimiser, steps, _LAST_RATE)
        self.rows: list[dict[str, Any]] = []

    def run(self) -> EstimateBundle:
        """Train to the end and return the bundle.

        Raises:
            ValueError: the loss is not finite any more.
        """
        config, began = self.config, time.process_time()
        replay: deque[Chunk] = deque(maxlen=config.replay)
        for number in range(config.chunks):
            if number % config.redraw == 0:
                courses = draw_courses(self._arm, config.lanes, PERIOD, self._generator)
                drive = Drive(courses, self._policy, self._generator)
            replay.append(drive.chunk(self._policy, config.steps))
            learned = [self._update(replay, update) for update in range(config.updates)]
            self._policy = self._policy.with_network(self.student.network())
            loss = float(np.mean(learned))
            row = {"chunk": number, "tip_error_mm": 1e3 * drive.error, "loss": loss, "lost": drive.lost}
            if not np.isfinite(loss):
                raise ValueError(
                    f"the training has diverged: its loss is {loss} in chunk {number}; choose a learning_rate "
                    f"below {config.learning_rate:g}, or another seed"
                )
            self.rows.append(row)
            self.report({**row, "cpu_time_s": time.process_time() - began})
        versions = {name: version(name) for name in ("fuzzyarm", "numpy", "torch", "llvmlite")}
        training = {**dataclasses.asdict(config), "cpu_time_s": round(time.process_time() - began, 1)}
        arm = self._arm if isinstance(self._arm, ArmParameters) else ArmDefinition(self._arm.name, self._arm.digest)
        record: dict[str, Any] = {"training": training, "curve": self.rows, "versions": versions}
        return EstimateBundle(self.student.network(), arm, PERIOD, seed=config.seed, **record)

    def _update(self, replay: deque[Chunk], number: int) -> float:
        """Do a gradient step and return the loss."""
        config, draw = self.config, self._generator
        chunk = replay[-1] if number % _NEWEST == 0 else replay[int(draw.integers(len(replay)))]
        segments = (config.steps - config.window) // SEGMENT + 1
        window = chunk.window(int(draw.integers(segments)), config.window)
        rho, _ = self.student(window.z, window.c, window.memory[0], window.begins)
        error = (rho - window.label) / _SCALE
        loss = ((torch.sqrt(1.0 + error * error) - 1.0) * window.free).mean()
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.student.parameters(), _LARGEST_GRADIENT)
        if torch.isfinite(norm):
            self._optimiser.step()
        self._rate.step()
        return float(loss.detach())
