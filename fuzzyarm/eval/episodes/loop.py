"""The one loop in which policies act: an episode of a single arm, or one per lane of a batch, step by step.

The caller decides what to keep: `rollout.rollout_of` all signals of one arm, `TipErrors` every lane's tip errors.

    errors = TipErrors(envs.num_envs)
    for step in episodes(envs, policy, envs.reset(seed=0)):
        errors.add(step)
"""

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.batch.layout import INFO
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["Step", "TipErrors", "episodes"]


class Step(NamedTuple):
    """One control step; for a batch every array has a leading axis of lanes.

    Where an episode `ended`, all values are those after its last step, although the lanes of a batch restart
    immediately.
    """

    observation: np.ndarray  # (10,) or (lanes, 10), after the step
    info: dict[str, Any]  # of the environment, see `FuzzyArmEnv`; with ``"reason"`` where an episode terminated
    reward: np.ndarray  # () or (lanes,)
    running: np.ndarray  # booleans () or (lanes,): the episode had not ended before; other rows are to be ignored
    ended: np.ndarray  # booleans: the episode ends with this step
    completed: np.ndarray  # booleans: it ends because the reference was followed to its end
    memory: Any  # the policy's state after it acted
    seconds: float  # wall time of `predict` [s]


def episodes(
    env: Any,
    policy: Predictor,
    start: tuple[np.ndarray, dict[str, Any]],
    *,
    sense: Callable[[np.ndarray, dict[str, Any]], np.ndarray] | None = None,
    actuate: Callable[[np.ndarray], np.ndarray] | None = None,
    memory: Any = None,
) -> Iterator[Step]:
    """Run one episode, or one in each lane, until the last of these has ended; yield each step.

    Args:
        env: `FuzzyArmEnv`, `FuzzyArmVectorEnv` for a batch, or another environment with the same `step`; a lane of a
            batch that has ended begins another episode, which is ignored, and the policy's memory is reset.
        policy: the policy that acts.
        start: the observation (10,) or (lanes, 10) and the info of ``env.reset``.
        sense: returns the observation that the policy gets, given observation and info; default: the observation.
        actuate: returns the torque of the step [N m], given the policy's, once in each step; default: the latter.
        memory: the state with which the policy begins, if any.
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
    """Return observation and info of a batch; where an episode ended, its final ones, not the next episode's first."""
    final = info["final_info"]
    last = observation.copy()
    last[ended] = np.stack(info["final_obs"][ended])

    def merged(name: str) -> np.ndarray:
        rows = ended if info[name].ndim == 1 else ended[:, np.newaxis]
        return np.asarray(np.where(rows, final[name], info[name]))

    reasons = final.get("reason", np.full(len(ended), None, dtype=object))
    return last, {name: merged(name) for name in INFO} | {"reason": reasons}


class TipErrors:
    """The tip errors of every lane's episode, without its signals; every attribute is (lanes,).

    These are the largest tip error [m], the sum of the squares [m²], the number of control steps, and whether the
    reference was followed to its end.
    """

    def __init__(self, lanes: int) -> None:
        """Begin with no steps, for a batch of `lanes` lanes."""
        self.largest, self.squares, self.steps = np.zeros((3, lanes))
        self.completed = np.zeros(lanes, dtype=bool)

    def add(self, step: Step) -> None:
        """Take account of the tip errors after one step, in the lanes whose episode had not ended."""
        error = np.where(step.running, step.info["tip_error"], 0.0)
        np.maximum(self.largest, error, out=self.largest)
        self.squares += error * error
        self.steps += step.running
        self.completed |= step.completed

    @property
    def rms(self) -> np.ndarray:
        """Root mean square tip error [m], (lanes,)."""
        return np.asarray(np.sqrt(self.squares / self.steps))
