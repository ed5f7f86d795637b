"""A policy of stable-baselines3 in the comparison: the zip of `model.save`, with the normaliser it learned with.

SB3_POLICY=model.zip SB3_NORMALISER=normaliser.pkl fuzzyarm evaluate --policy examples.sb3_policy:factory

Loading these files runs code that they hold: name only files that you trust. The normaliser is what `VecNormalize.save`
wrote; leave it out if there was none. Set SB3_ALGORITHM if it was not PPO, and SB3_PERIOD [s] if an action was not held
for the control period of 1 ms.
"""

import os
import pickle
from pathlib import Path

import numpy as np
import stable_baselines3

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv


class HeldPolicy:
    """A model of stable-baselines3 that sees normalised observations, and whose action is held for several calls."""

    def __init__(self, model, normaliser, space, calls):
        """Keep the model, the normaliser or None, the environment's space of torques, and the calls of an action."""
        self.model, self.normaliser, self.calls = model, normaliser, calls
        # Learners act in [-1, 1], and a wrapper of the environment scales that to torques.
        low, high = model.action_space.low.astype(float), model.action_space.high.astype(float)
        self.middle, self.scale = (space.low + space.high) / 2, (space.high - space.low) / (high - low)
        self.rest = (low + high) / 2

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return motor torques [N m], and as the next state the calls that are left and what is held."""
        left, torque, inner = (0, None, None) if state is None else state
        if left == 0:
            seen = observation if self.normaliser is None else self.normaliser.normalize_obs(observation)
            start = None if state is not None else np.ones(1, dtype=bool)
            action, inner = self.model.predict(seen, inner, start, deterministic)
            left, torque = self.calls, self.middle + self.scale * (action - self.rest)
        return torque, (left - 1, torque, inner)


def factory(control_period, robot):
    """Load the files that the environment variables name, for calls every `control_period` [s] of the arm `robot`."""
    if "SB3_POLICY" not in os.environ:
        raise ValueError("set SB3_POLICY to the zip that model.save wrote")
    algorithm = getattr(stable_baselines3, os.environ.get("SB3_ALGORITHM", "PPO"))
    model = algorithm.load(os.environ["SB3_POLICY"], device="cpu")
    normaliser = None
    if "SB3_NORMALISER" in os.environ:
        normaliser = pickle.loads(Path(os.environ["SB3_NORMALISER"]).read_bytes())
        normaliser.training = False
    calls = round(float(os.environ.get("SB3_PERIOD", control_period)) / control_period)
    return HeldPolicy(model, normaliser, FuzzyArmEnv(parameters=robot).action_space, max(calls, 1))
