"""What the fixed policies share: the `predict` protocol of stable-baselines3, single and batched."""

from __future__ import annotations

import abc
import math

import numpy as np

from fuzzyarm.envs.parameters import ArmParameters

OBSERVATION_SIZE = 10


class ModelBasedPolicy(abc.ABC):
    """A fixed feedback law with an integral of the position error as its state.

    The law is u(t_k) from the observation at t_k and x_I(t_k), then x_I(t_(k+1)) = x_I(t_k) + T (q - q_d)(t_k).
    Torques are clipped to the robot's limits.
    """

    def __init__(self, parameters: ArmParameters, control_period: float) -> None:
        """Keep the robot and the control period T [s]."""
        if not (math.isfinite(control_period) and control_period > 0.0):
            raise ValueError(f"control_period = {control_period!r} s is out of range; allowed: (0, inf) s")
        self.parameters, self.control_period = parameters, control_period
        self._torque_limit = np.array(parameters.torque_limit)

    @abc.abstractmethod
    def _act(self, observation: np.ndarray, state: np.ndarray, action: np.ndarray) -> None:
        """Fill `action` (lanes, 2) and advance `state` (lanes, 2), both in place."""

    def predict(
        self,
        observation: np.ndarray,
        state: np.ndarray | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return motor torques [N m] and the next state.

        Args:
            observation: (10,) or (lanes, 10), as `FuzzyArmEnv` gives it.
            state: what the last call returned; None begins an episode.
            episode_start: (lanes,) booleans; True resets that lane's state.
            deterministic: ignored, the law is deterministic.

        Returns:
            Torques, (2,) or (lanes, 2), and the state, likewise.

        Raises:
            ValueError: an argument has a wrong shape.
        """
        given = np.asarray(observation, dtype=np.float64)
        if given.ndim not in (1, 2) or given.shape[-1] != OBSERVATION_SIZE:
            raise ValueError(f"observation has shape {given.shape}; allowed: (10,) or (lanes, 10)")
        batch = np.ascontiguousarray(given[np.newaxis] if given.ndim == 1 else given)
        lanes = len(batch)
        if state is None:
            memory = np.zeros((lanes, 2))
        else:
            memory = np.array(state, dtype=np.float64, ndmin=2)
            if memory.shape != (lanes, 2):
                raise ValueError(f"state has shape {np.shape(state)}; allowed: {(*given.shape[:-1], 2)}")
            if episode_start is not None:
                starts = np.atleast_1d(episode_start)
                if starts.shape != (lanes,):
                    raise ValueError(f"episode_start has shape {starts.shape}; allowed: ({lanes},)")
                memory[starts.astype(bool)] = 0.0
        action = np.empty((lanes, 2))
        self._act(batch, memory, action)
        return (action[0], memory[0]) if given.ndim == 1 else (action, memory)
