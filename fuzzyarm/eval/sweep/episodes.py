"""The episodes of some plants under a policy: their metrics, or one of them again with all its signals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.closed_loops import Channel, closed_loops
from fuzzyarm.eval.episodes.loop import Step, TipErrors, episodes
from fuzzyarm.eval.episodes.rollout import Rollout, Signals
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.plants import CONTROL_PERIOD, Plants
from fuzzyarm.eval.sweep.results import METRICS, SweepResults
from fuzzyarm.fuzzy_policy.law import law_of
from fuzzyarm.fuzzy_policy.policy import Policy, Predictor

__all__ = ["WORTHWHILE", "errors_in_one_kernel", "errors_step_by_step", "replay", "run_plants", "steps"]


WORTHWHILE = 1000
"""Episodes from which on a kernel of law and plant is used: to compile it, once on a machine, takes a few seconds."""


class _Noise:
    """What the policy reads: q + f (y - q), y the environment's reading of q and f the plant's factor."""

    def __init__(self, factor: np.ndarray) -> None:
        self._factor = factor[:, np.newaxis]

    def __call__(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        true = np.concatenate([info["q_motor"], info["dq_motor"]], axis=1)
        measured, result = slice(true.shape[1]), observation.copy()
        result[:, measured] = true + self._factor * (observation[:, measured] - true)
        return result


class _Delay:
    """What the motors get at control step k: u_max(k-d, 0), u_k the policy's torque and d the plant's delay (lanes,).

    The torque of the first instant, when the arm is at rest, acts as if it had been commanded before, too.
    """

    def __init__(self, delay: np.ndarray, joints: int) -> None:
        self._delay, self._lanes, self._step = delay, np.arange(len(delay)), 0
        self._sent = np.empty((int(delay.max()) + 1, len(delay), joints))

    def __call__(self, torque: np.ndarray) -> np.ndarray:
        depth, k = len(self._sent), self._step
        self._sent[k % depth if k else slice(None)] = torque
        self._step += 1
        return np.asarray(self._sent[(k - self._delay) % depth, self._lanes])


def steps(plants: Plants, envs: FuzzyArmVectorEnv, policy: Predictor) -> Iterator[Step]:
    """Run one episode of every lane of the plants' environment, with each plant's noise and delay."""
    start, (noise, delay) = plants.begin(envs), _channel(plants, envs)
    sense = None if noise is None else _Noise(noise)
    actuate = _Delay(delay, plants.config.joints) if delay.any() else None
    return episodes(envs, policy, start, sense=sense, actuate=actuate)


def _channel(plants: Plants, envs: FuzzyArmVectorEnv) -> Channel:
    """Return noise and delay of every lane of the plants' environment."""
    cases = envs.num_envs // len(plants.members)
    noise = np.tile(plants.values["noise"], cases)
    return Channel(noise if noise.any() else None, np.tile(plants.values["delay"], cases).astype(np.int64))


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
    errors = errors_in_one_kernel(plants, envs, policy) if envs.num_envs >= WORTHWHILE else None
    if errors is None:
        errors = errors_step_by_step(plants, envs, policy)
    return {
        "max_mm": 1e3 * errors.largest,
        "rms_mm": 1e3 * errors.rms,
        "seconds": CONTROL_PERIOD * errors.steps,
        "completed": errors.completed,
    }


def errors_step_by_step(plants: Plants, envs: FuzzyArmVectorEnv, policy: Predictor) -> TipErrors:
    """Return the tip errors of one episode of every lane of the plants' environment."""
    errors = TipErrors(envs.num_envs)
    for step in steps(plants, envs, policy):
        errors.add(step)
    return errors


def errors_in_one_kernel(plants: Plants, envs: FuzzyArmVectorEnv, policy: Predictor) -> TipErrors | None:
    """Return the same from one kernel of law and plant; None where there is no such law, or a torque is not finite."""
    if not isinstance(policy, Policy) or (law := law_of(policy)) is None:
        return None
    observation, info = plants.begin(envs)
    channel = _channel(plants, envs)
    seen = observation if channel.noise is None else _Noise(channel.noise)(observation, info)
    return closed_loops(envs.lanes, seen, policy, law, channel)


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
    signals = Signals(lane=0)
    for step in steps(plants, plants.environment([case]), policies[policy]):
        signals.add(step)
    return signals.rollout(
        policy=policy,
        case=case,
        seed=plants.seeds[0],
        control_period=CONTROL_PERIOD,
        parameters=config.arm,
    )
