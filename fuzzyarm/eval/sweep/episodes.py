"""The episodes of some plants under policies: their metrics as arrays, or one of them again with all its signals."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.closed_loops import Channel, closed_loops
from fuzzyarm.eval.episodes.loop import Step, TipErrors, episodes
from fuzzyarm.eval.episodes.metrics import swept
from fuzzyarm.eval.episodes.rollout import Rollout, Signals
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.plants import CONTROL_PERIOD, Plants
from fuzzyarm.fuzzy_policy.law import law_of
from fuzzyarm.fuzzy_policy.policy import Policy, Predictor

__all__ = [
    "WORTHWHILE", "Delay", "SweepResults", "errors_in_one_kernel", "errors_step_by_step", "replay", "run_plants",
    "steps",
]  # fmt: skip

WORTHWHILE = 1000
"""Episodes from which on a kernel of law and plant is used: to compile it, once on a machine, takes a few seconds."""


@dataclasses.dataclass(frozen=True)
class SweepResults:
    """Some plants of a sweep, or all, and the metrics of their episodes."""

    plants: np.ndarray  # (n,) records of `distributions.plant_record`
    metrics: dict[str, np.ndarray]  # by `Metric.key`, (policies, cases, n) [its unit]
    seconds: np.ndarray  # (policies, cases, n), duration of the episode [s]
    completed: np.ndarray  # (policies, cases, n), whether the episode lasted to the end of the reference

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by name, as files have them."""
        return {"plants": self.plants, **self.metrics, "seconds": self.seconds, "completed": self.completed}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> SweepResults:
        """Return the results with these `arrays`; KeyError if one is missing."""
        metrics = {key: arrays[key] for key in swept()}
        return cls(arrays["plants"], metrics, arrays["seconds"], arrays["completed"])

    @classmethod
    def joined(cls, parts: Sequence[SweepResults]) -> SweepResults:
        """Return the results of several chunks as one."""
        arrays = [part.arrays for part in parts]
        return cls.of({name: np.concatenate([one[name] for one in arrays], axis=-1) for name in arrays[0]})

    def episodes(self, policy: int, case: int) -> SweepResults:
        """Return the results of one policy in one case by their places in the sweep; every array is (n,)."""
        own = {name: array if name == "plants" else array[policy, case] for name, array in self.arrays.items()}
        return SweepResults.of(own)

    def finished(self, key: str) -> np.ndarray:
        """Return a metric (..., n) [its unit]; inf where the episode ended early."""
        return np.where(self.completed, self.metrics[key], np.inf)

    @property
    def errors(self) -> np.ndarray:
        """Largest tip error [mm], (policies, cases, n); inf where the episode ended early."""
        return self.finished("max_mm")


def _noisy(factor: np.ndarray, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
    """Return what the policy reads: q + f (y - q), y the environment's reading of q, f (lanes,) the plant's factor."""
    true = np.concatenate([info["q_motor"], info["dq_motor"]], axis=1)
    measured, result = slice(true.shape[1]), observation.copy()
    result[:, measured] = true + factor[:, np.newaxis] * (observation[:, measured] - true)
    return result


class Delay:
    """What the motors get at control step k: u_max(k-d, 0), u_k the policy's torque and d the plant's delay (lanes,).

    The torque of the first instant, when the arm is at rest, acts as if it had been commanded before, too.
    """

    def __init__(self, delay: np.ndarray, joints: int) -> None:
        """Take whole control periods (lanes,)."""
        self._delay, self._lanes, self._step = delay, np.arange(len(delay)), 0
        self._sent = np.empty((int(delay.max()) + 1, len(delay), joints))

    def __call__(self, torque: np.ndarray) -> np.ndarray:
        """Return what the motors get (lanes, joints) [N m] for what is commanded; called once in each step."""
        depth, k = len(self._sent), self._step
        self._sent[k % depth if k else slice(None)] = torque
        self._step += 1
        return np.asarray(self._sent[(k - self._delay) % depth, self._lanes])


def steps(plants: Plants, envs: FuzzyArmVectorEnv, policy: Predictor) -> Iterator[Step]:
    """Run one episode of every lane of the plants' environment, with each plant's noise and delay."""
    start, (noise, delay) = plants.begin(envs), _channel(plants, envs)
    sense = None if noise is None else functools.partial(_noisy, noise)
    actuate = Delay(delay, plants.config.joints) if delay.any() else None
    return episodes(envs, policy, start, sense=sense, actuate=actuate)


def _channel(plants: Plants, envs: FuzzyArmVectorEnv) -> Channel:
    """Return noise and delay of every lane of the plants' environment."""
    cases = envs.num_envs // len(plants.members)
    noise = np.tile(plants.values["noise"], cases)
    return Channel(noise if noise.any() else None, np.tile(plants.values["delay"], cases).astype(np.int64))


def run_plants(config: SweepConfig, policies: Mapping[str, Predictor], members: Sequence[int]) -> SweepResults:
    """Run the plants with these numbers under all policies, by label, in all cases; ValueError: a policy fails."""
    plants, found = Plants.draw(config, members), []
    envs = plants.environment(config.cases)
    for label, policy in policies.items():
        try:
            errors = errors_in_one_kernel(plants, envs, policy) if envs.num_envs >= WORTHWHILE else None
            found.append(errors or errors_step_by_step(plants, envs, policy))
        except ValueError as error:
            raise ValueError(f"policy {label}, plants {members[0]} to {members[-1]}: {error}") from error
    shape = len(policies), len(config.cases), len(members)
    arrays = {
        **{key: [metric.swept(errors) for errors in found] for key, metric in swept().items() if metric.swept},
        "seconds": [CONTROL_PERIOD * errors.steps for errors in found],
        "completed": [errors.completed for errors in found],
    }
    return SweepResults.of(
        {"plants": plants.values} | {name: np.reshape(array, shape) for name, array in arrays.items()}
    )


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
    seen = observation if channel.noise is None else _noisy(channel.noise, observation, info)
    return closed_loops(envs.lanes, seen, policy, law, channel)


def replay(config: SweepConfig, policies: Mapping[str, Predictor], member: int, policy: str, case: str) -> Rollout:
    """Run plant `member` of a sweep again, with all signals; its metrics are those of the sweep, bit for bit."""
    if not 0 <= member < config.total:
        raise ValueError(f"plant {member} is not in the sweep; allowed: 0 to {config.total - 1}")
    if policy not in policies or case not in config.cases:
        raise ValueError(
            f"policy {policy!r} in case {case!r} is not in the sweep; choose from: {', '.join(policies)}; "
            f"{', '.join(config.cases)}"
        )
    plants, signals = Plants.draw(config, [member]), Signals(lane=0)
    for step in steps(plants, plants.environment([case]), policies[policy]):
        signals.add(step)
    return signals.rollout(
        policy=policy, case=case, seed=plants.seeds[0], control_period=CONTROL_PERIOD, parameters=config.arm
    )
