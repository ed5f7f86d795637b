"""The one loop in which policies act: an episode of a single arm, or one of each lane of a batch, step by step.

Whoever iterates decides what to keep of an episode: `rollout.Signals` keeps all signals of one arm, `TipErrors` the tip
errors of every lane.

    errors = TipErrors()
    for step in episodes(envs, policy, envs.reset(seed=0)):
        errors.add(step)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np

from fuzzyarm.envs.batch.layout import INFO
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["Step", "TipErrors", "episodes"]


class _Steppable(Protocol):
    """Anything with the `step` of Gymnasium: `FuzzyArmEnv`, or `FuzzyArmVectorEnv` for a batch."""

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Return observation, reward, terminated, truncated and info."""
        ...


class Step(NamedTuple):
    """One control step. Of a batch every array has a row per lane; of a single arm there is no such axis.

    Where an episode `ended`, all values are those after its last step, also in a batch whose lanes begin again at once.
    """

    observation: np.ndarray  # (10,) or (lanes, 10), after the step
    info: dict[str, Any]  # as the environment gives it, see `FuzzyArmEnv`; of a terminated episode also ``"reason"``
    reward: np.ndarray  # () or (lanes,)
    running: np.ndarray  # booleans () or (lanes,): the episode had not ended before; other rows mean nothing
    ended: np.ndarray  # booleans: the episode ends with this step
    completed: np.ndarray  # booleans: it ends because the reference was followed to its end
    memory: Any  # the policy's state after it acted
    seconds: float  # wall time of `predict` [s]


def episodes(
    env: _Steppable,
    policy: Predictor,
    start: tuple[np.ndarray, dict[str, Any]],
    *,
    sense: Callable[[np.ndarray, dict[str, Any]], np.ndarray] | None = None,
    actuate: Callable[[np.ndarray], np.ndarray] | None = None,
    memory: Any = None,
) -> Iterator[Step]:
    """Run one episode, or one of each lane, until the last of them has ended.

    Args:
        env: the environment; a lane of a batch that has ended begins again by itself and goes on unread, with a policy
            whose memory of it is reset.
        policy: what acts.
        start: what ``env.reset`` returned, with the observation (10,) or (lanes, 10).
        sense: turns observation and info into the observation that the policy gets; default: the observation.
        actuate: turns the policy's torque [N m] into the torque of the step, called once in each; default: the torque.
        memory: state that the policy begins with; None: none.
    """
    observation, info = start
    running = np.ones(observation.shape[:-1], dtype=bool)
    begins = np.atleast_1d(running & (memory is None))
    while running.any():
        seen = observation if sense is None else sense(observation, info)
        begin = time.perf_counter()
        torque, memory = policy.predict(seen, state=memory, episode_start=begins, deterministic=True)
        seconds = time.perf_counter() - begin
        if actuate is not None:
            torque = actuate(torque)
        observation, reward, terminated, truncated, info = env.step(torque)
        ended = np.asarray(terminated | truncated)
        last, last_info = _last(observation, info, ended) if "final_obs" in info else (observation, info)
        yield Step(last, last_info, reward, running, running & ended, running & truncated, memory, seconds)
        running, begins = running & ~ended, np.atleast_1d(ended)


def _last(observation: np.ndarray, info: dict[str, Any], ended: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """Return observation and info of a batch, where an episode ended those of its end, not of its successor's start."""
    final = info["final_info"]
    last = observation.copy()
    last[ended] = np.stack(info["final_obs"][ended])

    def merged(name: str) -> np.ndarray:
        rows = ended if info[name].ndim == 1 else ended[:, np.newaxis]
        return np.asarray(np.where(rows, final[name], info[name]))

    reasons = final.get("reason", np.full(len(ended), None, dtype=object))
    return last, {name: merged(name) for name in INFO} | {"reason": reasons}


class TipErrors:
    """The tip errors of every lane's episode, kept without its signals."""

    def __init__(self, lanes: int) -> None:
        """Begin with no steps."""
        self.largest, self.squares = np.zeros(lanes), np.zeros(lanes)  # tip error [m], and the sum of squares [m²]
        self.steps = np.zeros(lanes)  # number of control steps
        self.completed = np.zeros(lanes, dtype=bool)  # whether the reference was followed to its end

    def add(self, step: Step) -> None:
        """Take a step into account."""
        error = np.where(step.running, step.info["tip_error"], 0.0)
        np.maximum(self.largest, error, out=self.largest)
        self.squares += error * error
        self.steps += step.running
        self.completed |= step.completed

    @property
    def rms(self) -> np.ndarray:
        """Root mean square tip error [m], (lanes,)."""
        return np.asarray(np.sqrt(self.squares / self.steps))
