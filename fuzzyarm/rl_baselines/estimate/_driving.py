"""Chunks of experience: the student drives the lanes of `Courses`, and the teacher labels every step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from fuzzyarm.envs.batch.layout import SCALARS
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import units_of
from fuzzyarm.rl_baselines.config import SEGMENT
from fuzzyarm.rl_baselines.estimate._courses import NOISE, Courses
from fuzzyarm.rl_baselines.estimate._teacher import Teacher

__all__ = ["Chunk", "DrivenLanes"]


_TIP_ERROR, _OVER, _REASON = map(SCALARS.index, ("tip_error", "truncated", "reason"))
_LATEST = 4  # sent torques that are kept for the delay
_RESTARTS = 0.5  # fraction of the lanes that restart with each chunk, since the onset of a load is hardest


class Chunk(NamedTuple):
    """A chunk of experience for learning; the symbols are those of `laws.learned.estimate.rnn`."""

    z: torch.Tensor  # (steps, lanes, size of z)
    c: torch.Tensor  # (steps, lanes, size of c)
    label: torch.Tensor  # (steps, lanes, n), the teacher's torque minus u_b, in units of R, clipped to ±1
    free: torch.Tensor  # (steps, lanes, n), 0 where the teacher's torque is at its limit or unknown, else 1
    begins: torch.Tensor  # (steps, lanes, 1), 0 where an episode begins, else 1
    memory: torch.Tensor  # (segments, lanes, hidden), h of the driving student before every `SEGMENT`-th step

    def window(self, segment: int, steps: int) -> Chunk:
        """Return the `steps` steps of this chunk from step `segment` * `SEGMENT` on, with the memory before them."""
        where = slice(SEGMENT * segment, SEGMENT * segment + steps)
        return Chunk._make([*(part[where] for part in self[:-1]), self.memory[segment : segment + 1]])


class DrivenLanes:
    """The lanes of `courses`, driven by the student, chunk by chunk; the generator draws noise and plants.

    Attributes:
        lost: number of episodes that ended before the end of their reference.
        error: root mean square tip error of the last chunk [m].
    """

    def __init__(self, courses: Courses, policy: LearnedObserverPolicy, generator: np.random.Generator) -> None:
        self._courses, self._lanes, self._generator = courses, courses.lanes, generator
        self._teacher = Teacher(policy.adaptive, courses)
        count, joints = self._lanes.count, policy.joints
        seeds = generator.integers(0, 2**31, count).tolist()
        self._observation = self._lanes.reset(seeds, None, courses.start)[0].copy()
        self._memory, self._begins = np.zeros((count, policy.memory_size)), np.ones(count, dtype=bool)
        self._sent = np.zeros((_LATEST, count, joints))
        self._torques = units_of(policy.parameters).torque
        self._limit = np.array(policy.torque_limit)
        self.lost, self.error = 0, 0.0

    def chunk(self, policy: LearnedObserverPolicy, steps: int) -> Chunk:
        """Return a chunk of `steps` control periods, driven by `policy`; before it, half of the lanes restart."""
        self._begins |= self._generator.random(self._lanes.count) < _RESTARTS
        self._restart()
        count, limit, part = self._lanes.count, self._limit, policy.seen
        seen, label = np.empty((steps, count, part.base.stop)), np.empty((steps, count, policy.joints))
        free, begins, memory = np.empty(label.shape), np.ones((steps, count, 1)), []
        torque, squares = np.empty((count, policy.joints)), 0.0
        for k in range(steps):
            if self._begins.any():
                begins[k, self._begins] = 0.0
                self._memory[self._begins] = 0.0
            if k % SEGMENT == 0:
                memory.append(self._memory[:, policy.hidden].copy())
            wanted = self._teacher.torque(self._observation, self._memory[:, policy.filter])
            free[k] = np.abs(wanted) < limit
            policy.observe(self._read(), self._memory, torque, seen[k])
            label[k] = np.nan_to_num(wanted)
            squares += self._step(self._late(np.clip(torque, -limit, limit)))
        self.error = float(np.sqrt(squares / steps))
        rho = np.clip((label - seen[:, :, part.base]) / self._torques, -1.0, 1.0)
        return Chunk(*map(_as_tensor, (seen[:, :, part.z], seen[:, :, part.c], rho, free, begins, np.array(memory))))

    def _read(self) -> np.ndarray:
        """Return the latest observation (lanes, 5 n) with encoder noise."""
        read = self._observation.copy()
        measured = 2 * len(self._limit)
        unit = np.repeat(NOISE, len(self._limit)) * self._generator.standard_normal((len(read), measured))
        read[:, :measured] += self._courses.noise[:, np.newaxis] * unit
        return read

    def _late(self, torque: np.ndarray) -> np.ndarray:
        """Send torques (lanes, n) [N m]; return those that reach the motors now, after the delay of each lane."""
        self._sent = np.concatenate([torque[np.newaxis], self._sent[:-1]])
        self._sent[1:, self._begins] = torque[self._begins]
        delay, lane = self._courses.delay, np.arange(len(torque))
        whole = np.floor(delay).astype(np.int64)
        share = (delay - whole)[:, np.newaxis]
        arrived: np.ndarray = (1.0 - share) * self._sent[whole, lane] + share * self._sent[whole + 1, lane]
        return arrived

    def _step(self, torque: np.ndarray) -> float:
        """Hold torques (lanes, n) [N m] for a step, restart ended episodes; return the mean squared tip error [m²]."""
        observation, _, scalars = self._lanes.step(torque)
        self._observation = observation.copy()
        self._begins = (scalars[_OVER] != 0.0) | (scalars[_REASON] != 0.0)
        self.lost += int(np.count_nonzero(scalars[_REASON]))
        self._restart()
        return float(np.mean(scalars[_TIP_ERROR] ** 2))

    def _restart(self) -> None:
        """Begin an episode in the lanes marked in `_begins`."""
        which = np.flatnonzero(self._begins)
        if len(which):
            begun = self._lanes.reset(None, None, self._courses.start[which], which)
            self._observation[which] = begun[0]


def _as_tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
