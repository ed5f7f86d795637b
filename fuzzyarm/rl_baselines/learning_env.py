"""The batched environment for learning: observations become features, and actions in [-1, 1]ⁿ become torques."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.batch.lanes import checked_arrays
from fuzzyarm.envs.observation import PARTS
from fuzzyarm.envs.physics.equations import AnyArm, argument_of, chosen_arm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.task import EFFORT_WEIGHT
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.fuzzy_policy.known_arm import joints_of, per_joint_of
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.features import Base, Features, Lanes
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.policies.registry import known_names
from fuzzyarm.policies.spec import load_policy, resolve
from fuzzyarm.rl_baselines.config import TrainingConfig
from fuzzyarm.rl_baselines.ppo_policy import plant_view
from fuzzyarm.rl_baselines.sb3_vec_env import StableBaselinesVecEnv

__all__ = [
    "LearningEnvs", "arm_definition", "arm_of", "base_of", "default_scale", "learning_envs", "sharpened_reward",
]  # fmt: skip

_OWN_STATE = ("memory", "base_memory", "observation", "action")
_FARTHEST = 4.0  # m, twice the distance between two arms of Table 1 that are stretched out in opposite directions


def learning_envs(config: TrainingConfig, base: Policy | None) -> LearningEnvs:
    """Return the arms that a configuration trains on, with the base that it names for its action period."""
    arm = arm_of(config)
    arguments = argument_of(arm)
    if config.distribution == "robust":
        references = (*reference_family(arm, config.references), *[default_reference(arm)] * config.circles)
        # The randomisation scales the force of the machining case by a factor from 0 to 1.
        arguments["case"] = "machining"
        arguments["randomisation"] = dataclasses.replace(find_randomisation("robust", arm), references=references)
    envs = FuzzyArmVectorEnv(config.lanes, control_period=config.action_period, threads=config.threads, **arguments)
    return LearningEnvs(StableBaselinesVecEnv(envs), config, base, arm)


def arm_of(config: TrainingConfig) -> AnyArm:
    """Return the arm that a configuration names; ValueError if its actions are for another number of joints."""
    arm = chosen_arm(config.robot, None)
    joints = joints_of(arm)
    if len(config.scale) != joints:
        raise ValueError(f"scale = {list(config.scale)} must be {joints} numbers, one for each joint of the arm")
    return arm


def base_of(config: TrainingConfig, arm: AnyArm, control_period: float) -> Policy | None:
    """Return the policy that ``config.base`` names, for an arm and a control period [s]; None: no base.

    A file is no base: a bundle names its base, and nothing would show that the file had changed.
    """
    if config.base == "none":
        return None
    if not resolve(config.base).named:
        raise ValueError(f"base = {shown(config.base)} is no name of a policy; choose from: {', '.join(known_names())}")
    return load_policy(config.base, control_period=control_period, robot=arm)


def arm_definition(arm: AnyArm) -> ArmDefinition | None:
    """Return what a bundle says of the arm; None for the arm of Table 1."""
    robot = robot_of(arm)
    return None if arm == ArmParameters() else ArmDefinition(robot.name, robot.digest)


def default_scale(arm: AnyArm, base: bool) -> tuple[float, ...]:
    """Return the default largest actions (joints,): shifts of 0.01 rad with a base, else 0.8 of the limits [N m]."""
    return tuple(0.01 if base else 0.8 * limit for limit in per_joint_of(arm, "torque_limit").tolist())


class LearningEnvs(VecEnvWrapper):
    """Arms whose observations are the features of `laws.learned.features`, and whose actions lie in [-1, 1]ⁿ.

    When the episode of a lane ends, its last features are computed from the memory of that episode, and the next
    episode begins with an empty memory, as it does for the shipped policy.

    Attributes:
        tip_errors: (lanes,) distance between tip and reference after the last step [m], for the log and the reward.
        plant_size: how many numbers behind the features no sensor measures, see `show_plant`.
    """

    def __init__(
        self, venv: StableBaselinesVecEnv, config: TrainingConfig, base: Policy | None, arm: AnyArm | None = None
    ) -> None:
        joints = len(config.scale)
        features = Features(config.features, config.action_period, arm)
        self._arms = Lanes(features, None if base is None else Base(base, config.action))
        self._smoothing = config.action.smoothing
        self._scale, self._reward_length = np.array(config.scale), 1e-3 * config.tip_error_scale
        self.tip_errors = np.zeros(venv.num_envs)
        self._tip_error_sum, self._steps = 0.0, 0  # since `take_mean_tip_error`
        self._memory = np.zeros((venv.num_envs, features.memory_size))
        self._base_memory = np.zeros((venv.num_envs, 0 if base is None else base.memory_size))
        self._observation, self._action = np.zeros((venv.num_envs, PARTS * joints)), np.zeros((venv.num_envs, joints))
        self.plant_size = 0
        unit = np.ones(joints, dtype=np.float32)
        super().__init__(venv, _unbounded(features.size), gym.spaces.Box(-unit, unit))

    def show_plant(self) -> None:
        """Append what `plant_view` tells to the features from now on, for a value function that is not shipped."""
        observation = self.venv.reset()  # shows which quantities there are
        self.plant_size = plant_view(self.venv.vector_info, observation).shape[-1]
        self.observation_space = _unbounded(self._arms.size + self.plant_size)

    def reset(self) -> np.ndarray:
        """Begin an episode in every lane and return its features (lanes, size)."""
        self._observation = np.ascontiguousarray(self.venv.reset())
        self._memory[:], self._base_memory[:], self._action[:] = 0.0, 0.0, 0.0
        return self._seen()

    def step_async(self, actions: np.ndarray) -> None:
        """Turn actions (lanes, n) in [-1, 1] into torques, and store action and observation in the memory."""
        clipped = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        self._action = self._smoothing * self._action + (1.0 - self._smoothing) * clipped
        torque = self._scale * self._action
        self._arms.act(self._observation, self._action, torque, self._memory, self._base_memory)
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
        self._tip_error_sum += float(self.tip_errors.mean())
        self._steps += 1
        if self._reward_length > 0.0:
            rewards = sharpened_reward(self.tip_errors, effort, self._reward_length).astype(np.float32)
        return self._seen(), rewards, dones, infos

    def take_mean_tip_error(self) -> float:
        """Return the mean tip error over all lanes and all steps since the last call [m]; NaN without a step."""
        mean = self._tip_error_sum / self._steps if self._steps else math.nan
        self._tip_error_sum, self._steps = 0.0, 0
        return mean

    def get_state(self) -> dict[str, np.ndarray]:
        """Return all that changes from step to step, for `set_state`; the sum of the tip errors is not part of it."""
        state: dict[str, np.ndarray] = self.venv.get_state()
        return {**state, **{name: getattr(self, f"_{name}").copy() for name in _OWN_STATE}}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Continue from what `get_state` returned; TypeError or ValueError, without a change, if it does not fit."""
        own = checked_arrays(state, {name: getattr(self, f"_{name}") for name in _OWN_STATE})
        self.venv.set_state(state)
        for name, array in own.items():
            setattr(self, f"_{name}", array)

    def _seen(self) -> np.ndarray:
        """Return what the learner sees of all lanes, (lanes, size)."""
        return self._sight(self._observation, self.venv.vector_info, slice(None))

    def _sight(self, observation: np.ndarray, info: dict[str, Any], which: Any) -> np.ndarray:
        """Return what the learner sees of some lanes for their observations (rows, 5 n) and the info of the batch."""
        features = self._arms.see(observation, self._memory[which], self._base_memory[which])
        return np.hstack([features, plant_view(info, observation, which)]) if self.plant_size else features

    def _end(self, dones: np.ndarray, infos: list[dict[str, Any]]) -> None:
        """Put the last features of the episodes that ended into the infos, and empty the memory of their lanes."""
        ended = np.flatnonzero(dones)
        last = np.array([infos[lane]["terminal_observation"] for lane in ended])
        features = self._sight(last, self.venv.vector_info["final_info"], ended)
        for row, lane in enumerate(ended):
            infos[lane]["terminal_observation"] = features[row]
        self._memory[ended], self._base_memory[ended], self._action[ended] = 0.0, 0.0, 0.0


def _unbounded(size: int) -> gym.spaces.Box:
    return gym.spaces.Box(-np.inf, np.inf, (size,))


def sharpened_reward(tip_error: np.ndarray, effort: np.ndarray, length: float) -> np.ndarray:
    """Return (1 - ln(1 + e/s)/ln(1 + L/s)) (1 - 0.1 effort), at least 0, for tip errors e (lanes,) and a length s [m].

    The environment's own reward hardly changes where the tip is far away or closer than 5 mm. The slope of this one
    vanishes nowhere: halving the error is worth the same at a metre as at ten millimetres. L = 4 m exceeds every tip
    error.
    """
    tracking = 1.0 - np.log1p(tip_error / length) / np.log1p(_FARTHEST / length)
    reward: np.ndarray = np.maximum(tracking, 0.0) * (1.0 - EFFORT_WEIGHT * effort)
    return reward
