"""The episodes of some plants under a policy: their metrics, or one of them again with all its signals."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs import observation as observations
from fuzzyarm.envs.batch.kernels import INFO
from fuzzyarm.envs.observation import observed
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.plants import CONTROL_PERIOD, Plants
from fuzzyarm.eval.sweep.results import METRICS, SweepResults
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["replay", "run_plants"]

SIGNALS = tuple(field.name for field in dataclasses.fields(Rollout) if field.name in INFO)
"""What a `Rollout` takes from the environment's info."""


class Step(NamedTuple):
    """One control step of all lanes; where an episode `ended`, the numbers are its last.

    Attributes:
        observation: (lanes, 10).
        info: arrays with a row per lane, see `FuzzyArmEnv`; of the last step of an episode, `SIGNALS` and the reason.
        reward: (lanes,).
        running: (lanes,) the episode had not ended before this step; other rows mean nothing.
        ended, completed: (lanes,) the episode ends with this step, and at the end of the reference.
    """

    observation: np.ndarray
    info: dict[str, Any]
    reward: np.ndarray
    running: np.ndarray
    ended: np.ndarray
    completed: np.ndarray


def steps(plants: Plants, envs: FuzzyArmVectorEnv, policy: Predictor) -> Iterator[Step]:
    """Run one episode of every lane of the plants' environment.

    The policy reads q + f (y - q), y the environment's noisy reading of q and f the plant's factor of noise. Its
    torque u_k of control step k acts d steps later, d the plant's delay: the motors get u_max(k-d, 0), as if what is
    commanded at the first instant, when the arm is at rest, had been commanded before.
    """
    observation, info = plants.begin(envs)
    lanes, cases = envs.num_envs, envs.num_envs // len(plants.members)
    noise = np.tile(plants.values["noise"], cases)[:, np.newaxis]
    delay = np.tile(plants.values["delay"], cases).astype(np.int64)
    depth = int(delay.max()) + 1
    sent = np.empty((depth, lanes, 2))
    state, running, each, k = None, np.ones(lanes, dtype=bool), np.arange(lanes), 0
    ended = np.zeros(lanes, dtype=bool)
    while running.any():
        if noise.any():
            read = observation[:, observations.MEASURED]
            true = np.concatenate([info["q_motor"], info["dq_motor"]], axis=1)
            observation[:, observations.MEASURED] = true + noise * (read - true)
        # A lane that has ended begins anew by itself; it goes on unread, with a policy that remembers nothing.
        torque, state = policy.predict(observation, state, episode_start=ended if ended.any() else None)
        if depth > 1:
            sent[k % depth if k else slice(None)] = torque
            torque = sent[(k - delay) % depth, each]
        observation, reward, terminated, truncated, info = envs.step(torque)
        ended = terminated | truncated
        if ended.any():
            last = observation.copy()
            last[ended] = np.stack(info["final_obs"][ended])
            yield Step(last, _with_final(info, ended), reward, running, running & ended, running & truncated)
        else:
            yield Step(observation, info, reward, running, ended, ended)
        running = running & ~ended
        k += 1


def run_plants(config: SweepConfig, policies: Mapping[str, Predictor], members: Sequence[int]) -> SweepResults:
    """Run some plants under all policies in all cases.

    Args:
        config: of the sweep.
        policies: by label.
        members: numbers of the plants.

    Raises:
        ValueError: a policy fails; the message names it.
    """
    plants = Plants.draw(config, members)
    envs = plants.environment(config.cases)
    runs = []
    for label, policy in policies.items():
        try:
            runs.append(_metrics(plants, envs, policy))
        except ValueError as error:
            raise ValueError(f"policy {label}, plants {members[0]} to {members[-1]}: {error}") from error
    shape = len(policies), len(config.cases), len(members)
    return SweepResults(
        plants.values, **{name: np.stack([run[name] for run in runs]).reshape(shape) for name in METRICS}
    )


def _metrics(plants: Plants, envs: FuzzyArmVectorEnv, policy: Predictor) -> dict[str, np.ndarray]:
    """Return `METRICS` (lanes,) of one policy."""
    lanes = envs.num_envs
    largest, squares, count = np.zeros(lanes), np.zeros(lanes), np.zeros(lanes)
    completed = np.zeros(lanes, dtype=bool)
    for step in steps(plants, envs, policy):
        error = np.where(step.running, step.info["tip_error"], 0.0)
        np.maximum(largest, error, out=largest)
        squares += error * error
        count += step.running
        completed |= step.completed
    rms = 1e3 * np.sqrt(squares / count)
    return {"max_mm": 1e3 * largest, "rms_mm": rms, "seconds": CONTROL_PERIOD * count, "completed": completed}


def replay(config: SweepConfig, policies: Mapping[str, Predictor], member: int, policy: str, case: str) -> Rollout:
    """Run one plant of a sweep again, with all signals; its metrics are those of the sweep, bit for bit.

    Args:
        config: of the sweep.
        policies: by label, as the sweep had them.
        member: number of the plant.
        policy: label of one of the policies.
        case: name of one of the cases.

    Raises:
        ValueError: the sweep has no such plant, policy or case.
    """
    if not 0 <= member < config.total:
        raise ValueError(f"plant {member} is not in the sweep; allowed: 0 to {config.total - 1}")
    if policy not in policies or case not in config.cases:
        raise ValueError(
            f"policy {policy!r} in case {case!r} is not in the sweep; choose from: {', '.join(policies)}; "
            f"{', '.join(config.cases)}"
        )
    plants = Plants.draw(config, [member])
    run = list(steps(plants, plants.environment([case]), policies[policy]))
    reference = observed(np.array([step.observation[0] for step in run]))
    signals = {name: np.array([step.info[name][0] for step in run]) for name in SIGNALS}
    limits = config.robot
    shares = [
        np.abs(signals[name]) / limit
        for side in ("motor", "link")
        for name, limit in ((f"q_{side}", limits.joint_limit), (f"dq_{side}", limits.velocity_limit))
    ]
    return Rollout(
        policy=policy,
        case=case,
        seed=plants.seeds[0],
        control_period=CONTROL_PERIOD,
        completed=bool(run[-1].completed[0]),
        reason="" if run[-1].completed[0] else str(run[-1].info["reason"][0]),
        step_time=math.nan,  # not timed
        q_reference=reference.q_reference,
        dq_reference=reference.dq_reference,
        reward=np.array([step.reward[0] for step in run]),
        domain_use=np.concatenate(shares, axis=1).max(axis=1),
        **signals,
    )


def _with_final(info: dict[str, Any], ended: np.ndarray) -> dict[str, Any]:
    """Return info with the last values of the episodes that ended in place of their successors' first."""
    final = info["final_info"]
    merged = {name: np.where(_rows(ended, final[name]), final[name], info[name]) for name in SIGNALS}
    return merged | {"reason": final.get("reason", np.full(len(ended), None, dtype=object))}


def _rows(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    return mask if values.ndim == 1 else mask[:, np.newaxis]
