"""What a learned policy looks at: functions of the ten numbers that every policy sees, and of what it remembers.

At the k-th action instant, with e = q_d - q_a, ė = q̇_d - q̇_a (motors) and the action a in [-1, 1]²,

    f_k = (s(e_k/E), s(ė_k/V), q_d, q̇_d/D, q̈_d/A, s(e_(k-1)/E), ..., s(e_(k-n)/E), a_(k-1), ..., a_(k-m), s(x_k/X))

with s = asinh, which is the identity for small errors and keeps large ones within reach, and the leaky integral

    x_(k+1) = (x_k + T e_k) exp(-T/τ).

Before an episode begins errors and actions were zero, and so was x. Training and the shipped policy run the same code.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzyarm.envs.compiled import kernel
from fuzzyarm.learned_policy.definition import FeatureDefinition


class Features:
    """The features of a definition, lane by lane; see the module for the equations."""

    def __init__(self, definition: FeatureDefinition, period: float) -> None:
        """Keep the definition and the time T between two actions [s].

        Raises:
            ValueError: the period is not positive.
        """
        if not (math.isfinite(period) and period > 0.0):
            raise ValueError(f"action period = {period!r} s is out of range; allowed: (0, inf) s")
        self.definition, self.period = definition, period
        self.size, self.memory_size = definition.size, definition.memory_size
        d = definition
        self._counts = d.past_errors, d.past_actions
        # Floats and nothing near them: the kernels are compiled for one signature.
        integral_scale = d.integral_scale if d.integral_time > 0.0 else 0.0
        scales = d.error_scale, d.rate_scale, d.velocity_scale, d.acceleration_scale, integral_scale
        self._scales = tuple(map(float, scales))
        self._leak = math.exp(-period / d.integral_time) if d.integral_time > 0.0 else 0.0

    def fill(self, observation: np.ndarray, memory: np.ndarray, features: np.ndarray) -> None:
        """Fill `features` (lanes, size) from `observation` (lanes, 10) and `memory` (lanes, memory_size)."""
        _fill(observation, memory, *self._counts, *self._scales, features)

    def advance(self, observation: np.ndarray, action: np.ndarray, memory: np.ndarray) -> None:
        """Remember the error of `observation` (lanes, 10) and the `action` (lanes, 2) taken on it, in place."""
        _advance(observation, action, *self._counts, float(self.period), self._leak, memory)


@kernel
def _fill(
    observation: np.ndarray,
    memory: np.ndarray,
    past_errors: int,
    past_actions: int,
    error_scale: float,
    rate_scale: float,
    velocity_scale: float,
    acceleration_scale: float,
    integral_scale: float,
    features: np.ndarray,
) -> None:
    """See `Features.fill`; an `integral_scale` of 0 is no integral."""
    errors, actions = 2 * past_errors, 2 * past_actions
    for lane in range(len(observation)):
        seen, past, out = observation[lane], memory[lane], features[lane]
        for joint in range(2):
            out[joint] = np.arcsinh((seen[4 + joint] - seen[joint]) / error_scale)
            out[2 + joint] = np.arcsinh((seen[6 + joint] - seen[2 + joint]) / rate_scale)
            out[4 + joint] = seen[4 + joint]
            out[6 + joint] = seen[6 + joint] / velocity_scale
            out[8 + joint] = seen[8 + joint] / acceleration_scale
            if integral_scale > 0.0:
                integral = past[errors + actions + joint]
                out[10 + errors + actions + joint] = np.arcsinh(integral / integral_scale)
        for k in range(errors):
            out[10 + k] = np.arcsinh(past[k] / error_scale)
        for k in range(errors, errors + actions):
            out[10 + k] = past[k]


@kernel
def _advance(
    observation: np.ndarray,
    action: np.ndarray,
    past_errors: int,
    past_actions: int,
    period: float,
    leak: float,
    memory: np.ndarray,
) -> None:
    """See `Features.advance`; memory holds errors, latest first, then actions, latest first, then the integral."""
    errors, actions = 2 * past_errors, 2 * past_actions
    for lane in range(len(observation)):
        seen, past = observation[lane], memory[lane]
        for k in range(errors - 1, 1, -1):
            past[k] = past[k - 2]
        for k in range(errors + actions - 1, errors + 1, -1):
            past[k] = past[k - 2]
        for joint in range(2):
            error = seen[4 + joint] - seen[joint]
            if errors > 0:
                past[joint] = error
            if actions > 0:
                past[errors + joint] = action[lane, joint]
            past[errors + actions + joint] = leak * (past[errors + actions + joint] + period * error)
