"""The features of a learned policy: functions of the observation and of a memory.

At the k-th action instant, with e = q_d - q_a, ė = q̇_d - q̇_a (motors) and the action a in [-1, 1]²,

    f_k = (s(e_k/E), s(ė_k/V), q_d, q̇_d/D, q̈_d/A, s(e_(k-1)/E), ..., s(e_(k-n)/E), a_(k-1), ..., a_(k-m), s(x_k/X))

with s = asinh, which is the identity for small errors and compresses large ones, and the leaky integral

    x_(k+1) = (x_k + T e_k) exp(-T/τ).

With an elastic target the errors are e = θ_d - q_a, ė = θ̇_d - q̇_a, where θ_d are the angles at which the motors of the
unloaded arm belong (`fuzzy_policy.laws.elastic_target`), and f_k ends with the torque in excess of what that arm needs,

    (..., w_(k-1)/U, ..., w_(k-m)/U),    w_k = u_k - u_ff,k,

where u_k is the last torque commanded before instant k + 1. When an episode begins, all past errors, actions and excess
torques and the integral x are zero. The training and the shipped policy run the same code.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import JOINTS, observed
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws import elastic_target
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget
from fuzzyarm.learned_policy.definition import FeatureDefinition, FeatureStarts

__all__ = ["Features"]


class _MemoryStarts(NamedTuple):
    """Where each part of a lane's memory begins, and its size; past values are sorted by age, the latest first."""

    past_errors: int
    past_actions: int
    integral: int
    past_excesses: int
    feedforward: int
    elastic_target: int
    size: int


class _Scales(NamedTuple):
    """The scales of the features, see `FeatureDefinition`; without an integral its scale is 0."""

    error: float
    rate: float
    velocity: float
    acceleration: float
    integral: float


class Features:
    """The features of a definition, lane by lane; see the module for the equations.

    Attributes:
        definition: which features.
        period: T, time between two actions [s].
        size: number of features.
        memory_size: size of a lane's memory: past errors, past actions, integral; with an elastic target also past
            excess torques, u_ff, and the memory of `ElasticTarget`.
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
            friction: whether u_ff includes the dry friction.

        Raises:
            TypeError: the period is not a number.
            ValueError: the period is not positive.
        """
        self.definition, self.period, d = definition, real("period", period, "s", above=0.0), definition
        parameters = parameters or ArmParameters()
        self.size = d.size
        self._starts, self._memory = d.starts, _memory_starts(d)
        self.memory_size = self._memory.size
        self._target = ElasticTarget(parameters, period, friction=friction) if d.elastic_target else None
        self._limit = np.array(parameters.torque_limit)
        integral_scale = d.integral_scale if d.integral_time > 0.0 else 0.0
        scales = d.error_scale, d.rate_scale, d.velocity_scale, d.acceleration_scale, integral_scale
        # A whole number among them would make Numba compile the kernels once more, for other types.
        self._scales = _Scales(*map(float, scales))
        self._leak = math.exp(-period / d.integral_time) if d.integral_time > 0.0 else 0.0

    def fill(self, observation: np.ndarray, memory: np.ndarray, features: np.ndarray) -> None:
        """Compute the features of the instant; the memory stays as it is.

        Args:
            observation: (lanes, 10).
            memory: (lanes, memory_size).
            features: (lanes, size), filled in place.
        """
        # The elastic target advances a memory of its own, here that of a copy.
        aim, _ = self._aim(observation, memory if self._target is None else memory.copy())
        if self._target is not None:
            features[:, self._starts.past_excesses :] = self._past_excesses(memory) / self.definition.excess_scale
        _fill(observation, *aim, memory, self._starts, self._memory, self._scales, features)

    def advance(self, observation: np.ndarray, action: np.ndarray, memory: np.ndarray) -> None:
        """Store the error of an observation and the action taken on it.

        Args:
            observation: (lanes, 10).
            action: (lanes, 2), in [-1, 1].
            memory: (lanes, memory_size), advanced in place.
        """
        aim, feedforward = self._aim(observation, memory)
        if feedforward is not None:
            memory[:, self._feedforward] = feedforward
            excesses = self._past_excesses(memory)
            excesses[:, JOINTS:] = excesses[:, :-JOINTS].copy()
        _advance(observation, *aim, action, self._memory, self.period, self._leak, memory)

    def command(self, torque: np.ndarray, memory: np.ndarray) -> None:
        """Store the excess of a commanded torque; of several calls between two `advance`, the last one counts.

        Args:
            torque: (lanes, 2) [N m], not yet clipped to the limits of the robot.
            memory: (lanes, memory_size), changed in place.
        """
        if self.definition.past_excesses:
            applied = np.clip(torque, -self._limit, self._limit)
            self._past_excesses(memory)[:, :JOINTS] = applied - memory[:, self._feedforward]

    @property
    def _feedforward(self) -> slice:
        return slice(self._memory.feedforward, self._memory.elastic_target)

    def _past_excesses(self, memory: np.ndarray) -> np.ndarray:
        """Return the past excess torques in a memory as a view (lanes, 2 m)."""
        return memory[:, self._memory.past_excesses : self._memory.feedforward]

    def _aim(
        self, observation: np.ndarray, memory: np.ndarray
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray | None]:
        """Return what errors count from, and u_ff with an elastic target, whose memory advances.

        The first is (q_d, q̇_d), or (θ_d, θ̇_d) with an elastic target; each is (lanes, 2).
        """
        if self._target is None:
            o = observed(observation)
            return (o.q_reference, o.dq_reference), None
        target, feedforward = np.empty((len(observation), 3 * JOINTS)), np.empty((len(observation), JOINTS))
        self._target.advance(observation, memory[:, self._memory.elastic_target :], target, feedforward)
        return (target[:, :JOINTS], target[:, JOINTS : 2 * JOINTS]), feedforward


def _memory_starts(definition: FeatureDefinition) -> _MemoryStarts:
    """Return where each part of a lane's memory begins."""
    lengths = _MemoryStarts(
        past_errors=JOINTS * definition.past_errors,
        past_actions=JOINTS * definition.past_actions,
        integral=JOINTS,
        past_excesses=JOINTS * definition.past_excesses,
        feedforward=JOINTS if definition.elastic_target else 0,
        elastic_target=elastic_target.MEMORY_SIZE if definition.elastic_target else 0,
        size=0,
    )
    return _MemoryStarts(*itertools.accumulate(lengths[:-1], initial=0))


@kernel
def _fill(
    observation: np.ndarray,
    q_target: np.ndarray,
    dq_target: np.ndarray,
    memory: np.ndarray,
    at: FeatureStarts,
    stored: _MemoryStarts,
    scale: _Scales,
    features: np.ndarray,
) -> None:
    """Fill everything but the excess torques, see `Features.fill`."""
    for lane in range(len(observation)):
        o, past, out = observed(observation[lane]), memory[lane], features[lane]
        for joint in range(JOINTS):
            out[at.error + joint] = np.arcsinh((q_target[lane, joint] - o.q_motor[joint]) / scale.error)
            out[at.rate + joint] = np.arcsinh((dq_target[lane, joint] - o.dq_motor[joint]) / scale.rate)
            out[at.q_reference + joint] = o.q_reference[joint]
            out[at.dq_reference + joint] = o.dq_reference[joint] / scale.velocity
            out[at.ddq_reference + joint] = o.ddq_reference[joint] / scale.acceleration
            if scale.integral > 0.0:
                out[at.integral + joint] = np.arcsinh(past[stored.integral + joint] / scale.integral)
        for k in range(at.past_actions - at.past_errors):
            out[at.past_errors + k] = np.arcsinh(past[stored.past_errors + k] / scale.error)
        for k in range(at.integral - at.past_actions):
            out[at.past_actions + k] = past[stored.past_actions + k]


@kernel
def _advance(
    observation: np.ndarray,
    q_target: np.ndarray,
    dq_target: np.ndarray,
    action: np.ndarray,
    stored: _MemoryStarts,
    period: float,
    leak: float,
    memory: np.ndarray,
) -> None:
    """Advance past errors, past actions and the integral, see `Features.advance`."""
    for lane in range(len(observation)):
        o, past = observed(observation[lane]), memory[lane]
        # Each past value moves to the place of the next older one, the oldest first.
        for k in range(stored.past_actions - 1, stored.past_errors + JOINTS - 1, -1):
            past[k] = past[k - JOINTS]
        for k in range(stored.integral - 1, stored.past_actions + JOINTS - 1, -1):
            past[k] = past[k - JOINTS]
        for joint in range(JOINTS):
            error = q_target[lane, joint] - o.q_motor[joint]
            if stored.past_actions > stored.past_errors:
                past[stored.past_errors + joint] = error
            if stored.integral > stored.past_actions:
                past[stored.past_actions + joint] = action[lane, joint]
            past[stored.integral + joint] = leak * (past[stored.integral + joint] + period * error)
