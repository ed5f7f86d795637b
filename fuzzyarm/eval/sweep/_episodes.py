"""The episodes of plants under policies: their metrics as arrays, or a replay of one with all signals."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fuzzyarm.eval.episodes._closed_loops import closed_loops
from fuzzyarm.eval.episodes.loop import Step, TipErrors, episodes
from fuzzyarm.eval.episodes.metrics import swept
from fuzzyarm.eval.episodes.rollout import Rollout, rollout_of
from fuzzyarm.eval.sweep._plants import CONTROL_PERIOD, Plants
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.fuzzy_policy.law import law_of
from fuzzyarm.fuzzy_policy.policy import Policy, Predictor

__all__ = ["Delay", "SweepResults", "errors_in_one_kernel", "errors_step_by_step", "replay", "run_plants"]

_WORTHWHILE = 1000  # number of episodes from which a kernel of law and plant is used: compiling it takes a few seconds


@dataclasses.dataclass(frozen=True)
class SweepResults:
    """Some or all plants of a sweep, and the metrics of their episodes."""

    plants: np.ndarray  # (n,) records of `distributions.plant_record`
    metrics: dict[str, np.ndarray]  # by `Metric.key`, (policies, cases, n) [its unit]
    seconds: np.ndarray  # (policies, cases, n), duration of the episode [s]
    completed: np.ndarray  # (policies, cases, n), whether the episode lasted to the end of the reference

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays, by their names in files."""
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
        """Return the results of one policy in one case, given by their indices, as arrays (n,) over the n plants."""
        own = {name: array if name == "plants" else array[policy, case] for name, array in self.arrays.items()}
        return SweepResults.of(own)

    def finished(self, key: str) -> np.ndarray:
        """Return the metric `key` (..., plants) in its own unit; inf where the episode ended early."""
        return np.where(self.completed, self.metrics[key], np.inf)

    @property
    def errors(self) -> np.ndarray:
        """Largest tip error [mm], (policies, cases, plants); inf where the episode ended early."""
        return self.finished("max_mm")


def _noisy(factor: np.ndarray, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
    """Return the observation with its encoder noise times `factor` (lanes,); `info` has the true motor states."""
    true = np.concatenate([info["q_motor"], info["dq_motor"]], axis=1)
    measured, result = slice(true.shape[1]), observation.copy()
    result[:, measured] = true + factor[:, np.newaxis] * (observation[:, measured] - true)
    return result


class Delay:
    """The torque that reaches the motors at control step k: the command of step max(k - d, 0), for delays d (lanes,).

    The first command is assumed to have been given before the first step as well, while the arm was at rest.
    """

    def __init__(self, delay: np.ndarray, joints: int) -> None:
        """Begin with no torques; the delay (lanes,) is in whole control periods."""
        self._delay, self._lanes, self._step = delay, np.arange(len(delay)), 0
        self._sent = np.empty((int(delay.max()) + 1, len(delay), joints))

    def __call__(self, torque: np.ndarray) -> np.ndarray:
        """Return the motors' torques (lanes, joints) [N m] for those commanded now; called once in each step."""
        depth, k = len(self._sent), self._step
        self._sent[k % depth if k else slice(None)] = torque
        self._step += 1
        return np.asarray(self._sent[(k - self._delay) % depth, self._lanes])


def run_plants(config: SweepConfig, policies: Mapping[str, Predictor], members: Sequence[int]) -> SweepResults:
    """Run the plants `members` in all cases under policies keyed by label; ValueError if a policy fails."""
    plants, found = Plants(config, members, config.cases), []
    for label, policy in policies.items():
        try:
            errors = errors_in_one_kernel(plants, policy) if plants.envs.num_envs >= _WORTHWHILE else None
            found.append(errors or errors_step_by_step(plants, policy))
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


def errors_step_by_step(plants: Plants, policy: Predictor) -> TipErrors:
    """Return the tip errors of one episode in every lane of the plants, computed step by step."""
    errors = TipErrors(plants.envs.num_envs)
    for step in _steps(plants, policy):
        errors.add(step)
    return errors


def errors_in_one_kernel(plants: Plants, policy: Predictor) -> TipErrors | None:
    """Return the tip errors, computed by one kernel; None if the policy has no law for it or a torque is not finite."""
    if not isinstance(policy, Policy) or (law := law_of(policy)) is None:
        return None
    (observation, info), channel = plants.begin(), plants.channel
    seen = observation if channel.noise is None else _noisy(channel.noise, observation, info)
    return closed_loops(plants.envs.lanes, seen, policy, law, channel)


def replay(config: SweepConfig, policies: Mapping[str, Predictor], member: int, policy: str, case: str) -> Rollout:
    """Run plant `member` of a sweep again, with all signals; its metrics equal the sweep's, bit for bit."""
    if not 0 <= member < config.total:
        raise ValueError(f"plant {member} is not in the sweep; allowed: 0 to {config.total - 1}")
    if policy not in policies or case not in config.cases:
        raise ValueError(
            f"policy {policy!r} in case {case!r} is not in the sweep; its policies: {', '.join(policies)}; its cases: "
            f"{', '.join(config.cases)}"
        )
    plants = Plants(config, [member], [case])
    named: dict[str, Any] = {"policy": policy, "case": case, "seed": plants.seeds[0], "control_period": CONTROL_PERIOD}
    return rollout_of(_steps(plants, policies[policy]), 0, parameters=config.arm, **named)


def _steps(plants: Plants, policy: Predictor) -> Iterator[Step]:
    """Yield the steps of one episode in every lane of the plants, with the noise and the delay of each plant."""
    noise, delay = plants.channel
    sense = None if noise is None else functools.partial(_noisy, noise)
    actuate = Delay(delay, plants.config.joints) if delay.any() else None
    return episodes(plants.envs, policy, plants.begin(), sense=sense, actuate=actuate)
