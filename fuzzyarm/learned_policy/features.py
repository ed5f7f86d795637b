"""What a learned policy looks at: functions of the ten numbers that every policy sees, and of what it remembers.

At the k-th action instant, with e = q_d - q_a, ė = q̇_d - q̇_a (motors) and the action a in [-1, 1]²,

    f_k = (s(e_k/E), s(ė_k/V), q_d, q̇_d/D, q̈_d/A, s(e_(k-1)/E), ..., s(e_(k-n)/E), a_(k-1), ..., a_(k-m), s(x_k/X))

with s = asinh, which is the identity for small errors and keeps large ones within reach, and the leaky integral

    x_(k+1) = (x_k + T e_k) exp(-T/τ).

With an elastic target the errors are e = θ_d - q_a, ė = θ̇_d - q̇_a, where θ_d is where the motors of the unloaded arm
belong (`fuzzy_policy.elastic_target`), and f_k ends with what the load adds to the torque that arm needs:

    (..., w_(k-1)/U, ..., w_(k-m)/U),    w_k = u_k - u_ff,k,

u_k the torque last commanded before instant k + 1. Before an episode begins errors, actions and excess torques were
zero, and so was x. Training and the shipped policy run the same code.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws import elastic_target
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget
from fuzzyarm.learned_policy.definition import JOINTS, FeatureDefinition


class Features:
    """The features of a definition, lane by lane; see the module for the equations.

    Attributes:
        size: number of features.
        memory_size: numbers to remember: past errors, past actions, integral; with an elastic target also past excess
            torques, u_ff, and what `ElasticTarget` remembers.
    """

    def __init__(
        self,
        definition: FeatureDefinition,
        period: float,
        parameters: ArmParameters | None = None,
        *,
        friction: bool = True,
    ) -> None:
        """Keep the definition.

        Args:
            definition: which features.
            period: T, time between two actions [s].
            parameters: the arm, for an elastic target and the torque limits; default Table 1.
            friction: whether u_ff holds the dry friction.

        Raises:
            ValueError: the period is not positive.
        """
        if not (math.isfinite(period) and period > 0.0):
            raise ValueError(f"action period = {period!r} s is out of range; allowed: (0, inf) s")
        self.definition, self.period, d = definition, period, definition
        parameters = parameters or ArmParameters()
        self.size = d.size
        self._counts = d.past_errors, d.past_actions
        self._plain = JOINTS * (d.past_errors + d.past_actions + 1)  # numbers to remember without an elastic target
        self._excess = slice(self._plain, self._plain + JOINTS * d.past_excesses)
        self._feedforward = slice(self._excess.stop, self._excess.stop + JOINTS)
        self._target = ElasticTarget(parameters, period, friction=friction) if d.elastic_target else None
        self._limit = np.array(parameters.torque_limit)
        self.memory_size = self._feedforward.stop + elastic_target.MEMORY_SIZE if d.elastic_target else self._plain
        # Floats and nothing near them: the kernels are compiled for one signature.
        integral_scale = d.integral_scale if d.integral_time > 0.0 else 0.0
        scales = d.error_scale, d.rate_scale, d.velocity_scale, d.acceleration_scale, integral_scale
        self._scales = tuple(map(float, scales))
        self._leak = math.exp(-period / d.integral_time) if d.integral_time > 0.0 else 0.0

    def fill(self, observation: np.ndarray, memory: np.ndarray, features: np.ndarray) -> None:
        """Fill `features` (lanes, size) from `observation` (lanes, 10) and `memory` (lanes, memory_size)."""
        target = observation[:, 4:]
        if self._target is not None:
            target, _ = self._aim(observation, memory.copy())
            excess = memory[:, self._excess]
            features[:, self.size - excess.shape[1] :] = excess / self.definition.excess_scale
        _fill(observation, target, memory, *self._counts, *self._scales, features)

    def advance(self, observation: np.ndarray, action: np.ndarray, memory: np.ndarray) -> None:
        """Remember the error of `observation` (lanes, 10) and the `action` (lanes, 2) taken on it, in place."""
        target = observation[:, 4:]
        if self._target is not None:
            target, memory[:, self._feedforward] = self._aim(observation, memory)
            older = memory[:, self._excess][:, :-JOINTS].copy()
            memory[:, self._excess][:, JOINTS:] = older
        _advance(observation, target, action, *self._counts, float(self.period), self._leak, memory)

    def command(self, torque: np.ndarray, memory: np.ndarray) -> None:
        """Remember the `torque` (lanes, 2) commanded after `advance`, in place; the last one before the next counts."""
        if self._target is not None and self.definition.past_excesses:
            applied = np.clip(torque, -self._limit, self._limit)
            start = self._excess.start
            memory[:, start : start + JOINTS] = applied - memory[:, self._feedforward]

    def _aim(self, observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return θ_d with derivatives (lanes, 6) and u_ff (lanes, 2), and advance their part of the memory."""
        assert self._target is not None
        target, feedforward = np.empty((len(observation), 6)), np.empty((len(observation), JOINTS))
        self._target.advance(observation, memory[:, self._feedforward.stop :], target, feedforward)
        return target, feedforward


@kernel
def _fill(
    observation: np.ndarray,
    target: np.ndarray,
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
        seen, aim, past, out = observation[lane], target[lane], memory[lane], features[lane]
        for joint in range(2):
            out[joint] = np.arcsinh((aim[joint] - seen[joint]) / error_scale)
            out[2 + joint] = np.arcsinh((aim[2 + joint] - seen[2 + joint]) / rate_scale)
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
    target: np.ndarray,
    action: np.ndarray,
    past_errors: int,
    past_actions: int,
    period: float,
    leak: float,
    memory: np.ndarray,
) -> None:
    """See `Features.advance`; memory begins with errors, then actions, latest first, then the integral."""
    errors, actions = 2 * past_errors, 2 * past_actions
    for lane in range(len(observation)):
        seen, aim, past = observation[lane], target[lane], memory[lane]
        for k in range(errors - 1, 1, -1):
            past[k] = past[k - 2]
        for k in range(errors + actions - 1, errors + 1, -1):
            past[k] = past[k - 2]
        for joint in range(2):
            error = aim[joint] - seen[joint]
            if errors > 0:
                past[joint] = error
            if actions > 0:
                past[errors + joint] = action[lane, joint]
            past[errors + actions + joint] = leak * (past[errors + actions + joint] + period * error)
