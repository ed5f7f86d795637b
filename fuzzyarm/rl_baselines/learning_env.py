"""The batched environment as a learner of torques sees it: features in, actions in [-1, 1]² out."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.randomisation import find_randomisation, reference_family
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import EFFORT_WEIGHT
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.features import Features
from fuzzyarm.rl_baselines.ppo_config import PPOConfig
from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

OWN_STATE = ("memory", "base_memory", "observation", "action")
FARTHEST = 4.0  # m, twice what two arms of Table 1 stretched out in opposite directions are apart


def learning_envs(config: PPOConfig, base: Policy | None) -> LearningEnvs:
    """Return the arms that a configuration trains on.

    Args:
        config: of the training.
        base: the policy that ``config.base`` names, for a control period of ``config.action_period``.
    """
    arguments: dict[str, Any] = {}
    if config.distribution == "robust":
        references = reference_family(ArmParameters(), config.references) + (JointReference(),) * config.circles
        # The force of the machining case is what the randomisation scales, by 0 to 1.
        arguments["case"] = "machining"
        arguments["randomisation"] = dataclasses.replace(
            find_randomisation("robust", ArmParameters()), references=references
        )
    envs = FuzzyArmVectorEnv(config.lanes, control_period=config.action_period, threads=config.threads, **arguments)
    return LearningEnvs(StableBaselinesVecEnv(envs), config, base)


class LearningEnvs(VecEnvWrapper):
    """Features of the observation and of what was done, see `learned_policy.features`; torques from actions.

    A lane that ends is asked for its last features with what it remembers, and begins anew with nothing.

    Attributes:
        tip_errors: (lanes,) distance of tip and reference after the last step [m]; for the log and the reward, the
            features do not hold it.
    """

    def __init__(self, venv: StableBaselinesVecEnv, config: PPOConfig, base: Policy | None) -> None:
        """Wrap arms whose actions are torques [N m]."""
        self._features, self._base = Features(config.features, config.action_period), base
        self._smoothing = config.action.smoothing
        self._scale, self._reward_length = np.array(config.scale), 1e-3 * config.tip_error_scale
        self.tip_errors = np.zeros(venv.num_envs)
        self._memory = np.zeros((venv.num_envs, self._features.memory_size))
        self._base_memory = np.zeros((venv.num_envs, 0 if base is None else base.memory_size))
        self._observation, self._action = np.zeros((venv.num_envs, 10)), np.zeros((venv.num_envs, 2))
        bound = np.full(self._features.size, np.inf, dtype=np.float32)
        unit = np.ones(2, dtype=np.float32)
        super().__init__(venv, gym.spaces.Box(-bound, bound), gym.spaces.Box(-unit, unit))

    def reset(self) -> np.ndarray:
        """Begin an episode in every lane and return its features (lanes, size)."""
        self._observation = np.ascontiguousarray(self.venv.reset())
        self._memory[:], self._base_memory[:], self._action[:] = 0.0, 0.0, 0.0
        return self._seen()

    def step_async(self, actions: np.ndarray) -> None:
        """Turn actions (lanes, 2) in [-1, 1] into torques, and remember what they answer to."""
        told = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        self._action = self._smoothing * self._action + (1.0 - self._smoothing) * told
        self._features.advance(self._observation, self._action, self._memory)
        torque = self._scale * self._action
        if self._base is not None:
            shifted = self._observation.copy()
            shifted[:, :2] -= torque
            self._base.act(shifted, self._base_memory, torque)
        self._features.command(torque, self._memory)
        self.venv.step_async(torque)

    def step_wait(self) -> VecEnvStepReturn:
        """Step every lane; return features, rewards (float32), dones and infos."""
        observation, rewards, dones, infos = self.venv.step_wait()
        self._observation = np.ascontiguousarray(observation)
        vector_info: dict[str, Any] = self.venv.vector_info
        effort = vector_info["reward_effort"]
        self.tip_errors = vector_info["tip_error"]
        if dones.any():
            final = vector_info["final_info"]
            self.tip_errors = np.where(dones, final["tip_error"], self.tip_errors)
            effort = np.where(dones, final["reward_effort"], effort)
            self._end(dones, infos)
        if self._reward_length > 0.0:
            rewards = sharpened_reward(self.tip_errors, effort, self._reward_length).astype(np.float32)
        return self._seen(), rewards, dones, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that changes from step to step, for `set_state`."""
        state: dict[str, np.ndarray] = self.venv.get_state()
        return {**state, **{name: getattr(self, f"_{name}").copy() for name in OWN_STATE}}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on where `get_state` was called; a step comes next."""
        self.venv.set_state(state)
        for name in OWN_STATE:
            setattr(self, f"_{name}", state[name].copy())

    def _seen(self) -> np.ndarray:
        features = np.empty((self.num_envs, self._features.size))
        self._features.fill(self._observation, self._memory, features)
        return features

    def _end(self, dones: np.ndarray, infos: list[dict[str, Any]]) -> None:
        """Give the lanes that ended their last features, and let them begin with nothing remembered."""
        ended = np.flatnonzero(dones)
        last = np.array([infos[lane]["terminal_observation"] for lane in ended])
        features = np.empty((len(ended), self._features.size))
        self._features.fill(last, self._memory[ended], features)
        for row, lane in enumerate(ended):
            infos[lane]["terminal_observation"] = features[row]
        self._memory[ended], self._base_memory[ended], self._action[ended] = 0.0, 0.0, 0.0


def sharpened_reward(tip_error: np.ndarray, effort: np.ndarray, length: float) -> np.ndarray:
    """Return (1 - ln(1 + e/s)/ln(1 + L/s)) (1 - 0.1 effort), at least 0, for tip errors e [m] and a length s [m].

    The environment's reward is flat where the tip is far away, and flat again below its 5 mm. This one has a slope
    everywhere: halving the error is worth the same at a metre as at ten millimetres. L = 4 m is beyond any tip error.
    """
    tracking = 1.0 - np.log1p(tip_error / length) / np.log1p(FARTHEST / length)
    reward: np.ndarray = np.maximum(tracking, 0.0) * (1.0 - EFFORT_WEIGHT * effort)
    return reward
