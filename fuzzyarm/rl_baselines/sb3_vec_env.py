"""The batched environment behind the interface of stable-baselines3."""

from __future__ import annotations

import time
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from fuzzyarm.envs.batch.lanes import checked_arrays
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv

__all__ = ["StableBaselinesVecEnv", "learning_envs"]


_OWN_STATE = ("returns", "errors", "lengths")


def learning_envs(num_envs: int, **arguments: Any) -> StableBaselinesVecEnv:
    """Return ``FuzzyArmLearn-v0`` in `num_envs` lanes for stable-baselines3.

    The other arguments are those of `FuzzyArmLearnVectorEnv`. Call ``torch.set_num_threads(1)`` before learning: by
    default torch uses a thread per core, and for networks of a few hundred weights per layer the threads spend most of
    their time waiting for each other.
    """
    return StableBaselinesVecEnv(FuzzyArmLearnVectorEnv(num_envs, **arguments))


class StableBaselinesVecEnv(VecEnv):
    """A Gymnasium vector environment with same-step autoreset, for the algorithms of stable-baselines3.

    A step is one call for the whole batch; Python loops only over lanes whose episode ends. The info of these lanes
    contains ``terminal_observation``, ``TimeLimit.truncated``, ``episode`` (return ``r``, length ``l`` and seconds
    ``t`` since the start, as `Monitor` gives them, and the mean ``tip_error`` [m]) and, if the episode was terminated,
    ``reason``. The other lanes share one empty info.

    Args:
        envs: for example ``gym.make_vec("FuzzyArm-v0", num_envs=64)``, possibly wrapped; must not be stepped elsewhere.
            For ``FuzzyArmLearn-v0`` call `learning_envs` instead.

    Raises:
        ValueError: the environment does not reset itself within the step.

    Attributes:
        vector_info: info of the last step or reset in the format of Gymnasium's vector environments: arrays by name.
    """

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        mode = envs.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode = {mode}; stable-baselines3 needs {AutoresetMode.SAME_STEP}")
        self.envs = envs
        self.vector_info: dict[str, Any] = {}
        self._returns, self._lengths = np.zeros(envs.num_envs), np.zeros(envs.num_envs, dtype=np.int64)
        self._errors = np.zeros(envs.num_envs)  # sums of the tip errors of the running episodes [m]
        self._start = time.perf_counter()
        self._actions: np.ndarray | None = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> np.ndarray:
        """Begin an episode in every lane, with the seeds and options set before; return observations (lanes, size)."""
        seeds: Any = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        observation, self.vector_info = self.envs.reset(seed=seeds, options=self._joint_options())
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._errors[:], self._lengths[:] = 0.0, 0.0, 0
        self.reset_infos: list[dict[str, Any]] = [{}] * self.num_envs
        return np.asarray(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions (lanes, joints) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step every lane; return observations (lanes, size), rewards (lanes,) in float32, dones (lanes,) and infos."""
        observation, rewards, terminated, truncated, self.vector_info = self.envs.step(self._actions)
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        final = self.vector_info.get("final_info", self.vector_info)
        self._errors += np.where(dones, final["tip_error"], self.vector_info["tip_error"])
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        for lane in np.flatnonzero(dones).tolist():
            infos[lane] = self._final_info(lane, bool(truncated[lane] and not terminated[lane]))
        self._returns[dones], self._errors[dones], self._lengths[dones] = 0.0, 0.0, 0
        return observation, rewards.astype(np.float32), dones, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Return `FuzzyArmVectorEnv.get_state` and the returns, tip error sums and lengths of the running episodes."""
        state = _attribute(self.envs, "get_state")()
        return {**state, **{name: getattr(self, f"_{name}").copy() for name in _OWN_STATE}}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore the state of an environment with the same arguments; continue with `step`, not with `reset`.

        If the state does not fit, raise TypeError or ValueError and change nothing, see `FuzzyArmVectorEnv.set_state`.
        """
        own = checked_arrays(state, {name: getattr(self, f"_{name}") for name in _OWN_STATE})
        _attribute(self.envs, "set_state")({name: array for name, array in state.items() if name not in own})
        for name, array in own.items():
            setattr(self, f"_{name}", array)

    def close(self) -> None:
        """Close the environment."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return a list with the batch's attribute `attr_name`, which all lanes share, once for each given lane."""
        return [_attribute(self.envs, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise NotImplementedError, since lanes have no attributes of their own."""
        raise NotImplementedError(
            f"{attr_name!r} cannot be set: a batch has no separate environment objects; give one value per environment "
            "as an argument of gymnasium.make_vec"
        )

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Raise NotImplementedError, since lanes have no environment objects of their own."""
        raise NotImplementedError(f"{method_name!r} cannot be called for one environment; call it on `envs` for all")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Return, for each given lane, whether `Monitor`, whose infos the lanes provide, is a `wrapper_class`."""
        return [issubclass(Monitor, wrapper_class)] * len(self._chosen(indices))

    def _final_info(self, lane: int, out_of_time: bool) -> dict[str, Any]:
        elapsed, length = round(time.perf_counter() - self._start, 6), int(self._lengths[lane])
        info = {
            "terminal_observation": self.vector_info["final_obs"][lane],
            "TimeLimit.truncated": out_of_time,
            "episode": {
                **{"r": float(self._returns[lane]), "l": length, "t": elapsed},
                "tip_error": float(self._errors[lane]) / length,
            },
        }
        reasons = self.vector_info["final_info"].get("reason")
        if reasons is not None and reasons[lane] is not None:
            info["reason"] = reasons[lane]
        return info

    def _joint_options(self) -> dict[str, Any] | None:
        """Return the reset options as one mapping from names to lists with an entry per lane; None without options."""
        if not any(self._options):
            return None
        names = set(self._options[0])
        if any(set(options) != names for options in self._options):
            raise ValueError("reset options must have the same keys for every environment")
        return {name: [options[name] for options in self._options] for name in names}

    def _chosen(self, indices: VecEnvIndices) -> list[int]:
        lanes = range(self.num_envs)
        return [lanes[index] for index in self._get_indices(indices)]


def _attribute(envs: VectorEnv[Any, Any, Any], name: str) -> Any:
    """Return an attribute of the outermost wrapper that has it."""
    while not hasattr(envs, name) and hasattr(envs, "env"):
        envs = envs.env
    return getattr(envs, name)
