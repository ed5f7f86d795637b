"""Accuracy of the environment's time step: the same closed loop on the integrator and on the event integrator."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import tip_position
from fuzzyarm.envs.physics.event_integrator import integrate
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.eval.episodes.loop import Steppable, episodes
from fuzzyarm.fuzzy_policy.policy import Predictor

__all__ = ["exact_tips", "max_tip_difference", "stepped_tips", "tips"]


def stepped_tips(policy: Predictor, case: str, substep: float) -> np.ndarray:
    """Return the tip (n, 2) [m] after every control step of the environment with the given sub-step [s]."""
    env = FuzzyArmEnv(case=case, substep=substep)
    return tips(env, policy, env.reset(seed=0))


def exact_tips(policy: Predictor, case: str) -> np.ndarray:
    """Return the same (n, 2) [m] with the plant solved by `event_integrator` and the tip force as a function of time.

    The policy closes this loop by itself, from the states found here. About ten seconds.
    """
    arm = _ExactArm(case)
    return tips(arm, policy, arm.reset())


def tips(env: Steppable, policy: Predictor, start: tuple[np.ndarray, dict[str, Any]]) -> np.ndarray:
    """Return the tip (n, 2) [m] after every control step of an episode that begins with `start`, of a single arm."""
    return np.array([step.info["tip"] for step in episodes(env, policy, start)])


class _ExactArm:
    """An arm as `FuzzyArmEnv` makes it, whose state is found by the event integrator; no sensors, no rewards."""

    def __init__(self, case: str) -> None:
        self._env, self._disturbance = FuzzyArmEnv(case=case), find_case(case).disturbance
        self._reference, self._period, self._k = self._env.reference, self._env.control_period, 0
        self._steps = round(self._reference.duration / self._period)
        wanted = self._reference.sample(self._period * np.arange(self._steps + 1))
        self._targets = np.concatenate([wanted.q, wanted.dq, wanted.ddq], axis=1)

    def reset(self) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin the episode where the environment begins it."""
        _, info = self._env.reset(seed=0)
        self._state = np.concatenate([info["q_motor"], info["q_link"], info["dq_motor"], info["dq_link"]])
        self._k = 0
        return self._observation(), {}

    def step(self, torque: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold a torque for a control period."""
        times = self._k * self._period, (self._k + 1) * self._period
        parameters = self._env.parameters
        self._state = integrate(self._state, torque, self._force, parameters, self._disturbance.payload, *times)
        self._k += 1
        _, q_link, _, _ = np.split(self._state, len(self._state) // JOINTS)
        info = {"tip": tip_position(q_link, parameters.length)}
        return self._observation(), 0.0, False, self._k == self._steps, info

    def _observation(self) -> np.ndarray:
        q_motor, _, dq_motor, _ = np.split(self._state, len(self._state) // JOINTS)
        return np.concatenate([q_motor, dq_motor, self._targets[self._k]])

    def _force(self, time: float) -> tuple[float, float]:
        if self._disturbance.tip_force is None:
            return 0.0, 0.0
        x, y = self._disturbance.tip_force.at(np.array(time), self._reference.tip(time).velocity)
        return float(x), float(y)


def max_tip_difference(stepped: np.ndarray, exact: np.ndarray) -> float:
    """Return the largest distance [m] between two tip paths (n, 2) [m]."""
    return float(np.hypot(*(stepped - exact).T).max())
