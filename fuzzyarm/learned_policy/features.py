"""The features of a learned policy: functions of the observation and of a memory.

At the k-th action instant, with e = q_d - q_a, ė = q̇_d - q̇_a (motors) and the action a in [-1, 1]ⁿ,

    f_k = (s(e_k/E), s(ė_k/V), q_d, q̇_d/D, q̈_d/A, s(e_(k-1)/E), ..., s(e_(k-n)/E), a_(k-1), ..., a_(k-m), s(x_k/X))

with s = asinh, which is the identity for small errors and compresses large ones, and the leaky integral

    x_(k+1) = (x_k + T e_k) exp(-T/τ).

With an elastic target the errors are e = θ_d - q_a, ė = θ̇_d - q̇_a, where θ_d are the angles at which the motors of the
unloaded arm belong (`fuzzy_policy.laws.elastic_target`), and f_k ends with the torque in excess of what that arm needs,

    (..., w_(k-1)/U, ..., w_(k-m)/U),    w_k = u_k - u_ff,k,

where u_k is the last torque commanded before instant k + 1. When an episode begins, all past errors, actions and excess
torques and the integral x are zero. The training and the shipped policy run the same code.

Of a base that observes, with the innovation ν of angles and velocities and the estimated load d̂, f_k ends with

    (..., s(ν_k/N), s(ν_k/(20 N)), s(n_(1,k)/N), s(n_(2,k)/N), ..., d̂_k/Z),

n_(i,k) = n_(i,k-1) + α_i (ν_k - n_(i,k-1)) with α_i = 1 - exp(-T/τ_i), and all n_i are zero before.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.envs.observation import observed, starts
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.known_arm import checked_arm, joints_of, per_joint_of
from fuzzyarm.fuzzy_policy.laws.elastic_target import ElasticTarget
from fuzzyarm.learned_policy.definition import FeatureDefinition
from fuzzyarm.learned_policy.functions import area_sine

__all__ = ["Features"]

COARSE = 20.0  # of the unit in which large innovations are seen

_OF_THE_INSTANT = 5  # features per joint: e, ė, q_d, q̇_d, q̈_d; those of the past follow them


class Features:
    """The features of a definition, lane by lane; see the module for the equations.

    Attributes:
        definition: which features.
        period: T, time between two actions [s].
        size: number of features.
        memory_size: size of a lane's memory: past errors, past actions, integral; with an elastic target also past
            excess torques, u_ff, and the memory of `ElasticTarget`; then the means of the innovation.
    """

    def __init__(
        self,
        definition: FeatureDefinition,
        period: float,
        parameters: AnyArm | None = None,
        *,
        friction: bool = True,
    ) -> None:
        """Keep the definition.

        Args:
            definition: which features.
            period: T, time between two actions [s].
            parameters: the arm or the robot, for an elastic target and the torque limits; default Table 1.
            friction: whether u_ff includes the dry friction.

        Raises:
            TypeError: the period is not a number.
            ValueError: the period is not positive, or the features are for another number of joints.
        """
        self.definition, self.period, d = definition, real("period", period, "s", above=0.0), definition
        arm: AnyArm = ArmParameters() if parameters is None else checked_arm("parameters", parameters)
        self.size, joints = d.size, joints_of(arm)
        if d.joints != joints:
            raise ValueError(f"the features are for {d.joints} joints, the arm has {joints}")
        self._joints, self._reference = joints, slice(starts(joints).q_reference, None)
        # The memory: past errors, past actions, integral, past excess torques, u_ff, memory of the elastic target.
        self._counts = d.past_errors, d.past_actions
        excess = joints * (d.past_errors + d.past_actions + 1)
        self._excess = slice(excess, excess + joints * d.past_excesses)
        self._feedforward = slice(self._excess.stop, self._excess.stop + joints)
        self._target = ElasticTarget(arm, period, friction=friction) if d.elastic_target else None
        self.memory_size = excess if self._target is None else self._feedforward.stop + self._target.memory_size
        self._means = slice(self.memory_size, self.memory_size + 2 * joints * len(d.innovation_times))
        self.memory_size = self._means.stop
        self._shares = np.array([1.0 - math.exp(-period / time) for time in d.innovation_times])
        self._units = np.repeat([d.innovation_scale, d.innovation_rate_scale], joints)
        self._limit = per_joint_of(arm, "torque_limit")
        integral_scale = d.integral_scale if d.integral_time > 0.0 else 0.0
        scales = d.error_scale, d.rate_scale, d.velocity_scale, d.acceleration_scale, integral_scale
        # A whole number among them would make Numba compile the kernels once more, for other types.
        self._scales = tuple(map(float, scales))
        self._load_scale = float(d.load_scale)
        self._leak = math.exp(-period / d.integral_time) if d.integral_time > 0.0 else 0.0

    def fill(
        self,
        observation: np.ndarray,
        memory: np.ndarray,
        features: np.ndarray,
        innovation: np.ndarray | None = None,
        load: np.ndarray | None = None,
    ) -> None:
        """Compute the features of the instant; the memory stays as it is.

        Args:
            observation: (lanes, 5 n).
            memory: (lanes, memory_size).
            features: (lanes, size), filled in place.
            innovation: ν (lanes, 2 n) of the base, if it is among the features.
            load: d̂ (lanes, n) [N m] of the base, likewise.
        """
        end = self.size - self._joints * self.definition.observed
        if innovation is not None and load is not None and end < self.size:
            means = memory[:, self._means]
            _fill_observed(innovation, load, means, self._shares, self._units, self._load_scale, features[:, end:])
        target = observation[:, self._reference]
        if self._target is not None:
            target, _ = self._aim(observation, memory.copy())
            excess = memory[:, self._excess]
            features[:, end - excess.shape[1] : end] = excess / self.definition.excess_scale
        _fill(observation, target, memory, *self._counts, *self._scales, features)

    def advance(
        self, observation: np.ndarray, action: np.ndarray, memory: np.ndarray, innovation: np.ndarray | None = None
    ) -> None:
        """Store the error of an observation and the action taken on it.

        Args:
            observation: (lanes, 5 n).
            action: (lanes, n), in [-1, 1].
            memory: (lanes, memory_size), advanced in place.
            innovation: as for `fill`.
        """
        if innovation is not None and len(self._shares):
            means = memory[:, self._means].reshape(len(memory), len(self._shares), -1)
            means += self._shares[:, np.newaxis] * (innovation[:, np.newaxis] - means)
            memory[:, self._means] = means.reshape(len(memory), -1)
        target = observation[:, self._reference]
        if self._target is not None:
            target, memory[:, self._feedforward] = self._aim(observation, memory)
            excess = memory[:, self._excess]
            excess[:, self._joints :] = excess[:, : -self._joints].copy()
        _advance(observation, target, action, *self._counts, self.period, self._leak, memory)

    def command(self, torque: np.ndarray, memory: np.ndarray) -> None:
        """Store the excess of a commanded torque; of several calls between two `advance`, the last one counts.

        Args:
            torque: (lanes, n) [N m], not yet clipped to the limits of the robot.
            memory: (lanes, memory_size), changed in place.
        """
        if self._target is not None and self.definition.past_excesses:
            applied = np.clip(torque, -self._limit, self._limit)
            memory[:, self._excess][:, : self._joints] = applied - memory[:, self._feedforward]

    def _aim(self, observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return θ_d with derivatives (lanes, 3 n) and u_ff (lanes, n), and advance the elastic target's memory."""
        assert self._target is not None
        lanes, n = len(observation), self._joints
        target, feedforward = np.empty((lanes, 3 * n)), np.empty((lanes, n))
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
    """Fill everything but the excess torques, see `Features.fill`.

    Errors count from the `target`, (lanes, 3 n) or (lanes, 2 n): angles, then velocities. An `integral_scale` of 0
    means that there is no integral.
    """
    o = observed(observation)
    joints = o.q_motor.shape[1]
    actions = joints * past_errors  # where the past actions begin in the memory, and then the integral
    integral, first = actions + joints * past_actions, joints * _OF_THE_INSTANT
    for lane in range(len(observation)):
        aim, past, out = target[lane], memory[lane], features[lane]
        for joint in range(joints):
            out[joint] = area_sine((aim[joint] - o.q_motor[lane, joint]) / error_scale)
            out[joints + joint] = area_sine((aim[joints + joint] - o.dq_motor[lane, joint]) / rate_scale)
            out[2 * joints + joint] = o.q_reference[lane, joint]
            out[3 * joints + joint] = o.dq_reference[lane, joint] / velocity_scale
            out[4 * joints + joint] = o.ddq_reference[lane, joint] / acceleration_scale
            if integral_scale > 0.0:
                out[first + integral + joint] = area_sine(past[integral + joint] / integral_scale)
        for k in range(actions):
            out[first + k] = area_sine(past[k] / error_scale)
        for k in range(actions, integral):
            out[first + k] = past[k]


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
    """Advance past errors, past actions and the integral, see `Features.advance`; the target as for `_fill`."""
    o = observed(observation)
    joints = o.q_motor.shape[1]
    actions = joints * past_errors
    integral = actions + joints * past_actions
    for lane in range(len(observation)):
        aim, past = target[lane], memory[lane]
        # Each past value moves to the place of the next older one, the oldest first.
        for k in range(actions - 1, joints - 1, -1):
            past[k] = past[k - joints]
        for k in range(integral - 1, actions + joints - 1, -1):
            past[k] = past[k - joints]
        for joint in range(joints):
            error = aim[joint] - o.q_motor[lane, joint]
            if past_errors > 0:
                past[joint] = error
            if past_actions > 0:
                past[actions + joint] = action[lane, joint]
            past[integral + joint] = leak * (past[integral + joint] + period * error)


@kernel
def _fill_observed(
    innovation: np.ndarray,
    load: np.ndarray,
    means: np.ndarray,
    shares: np.ndarray,
    units: np.ndarray,
    load_scale: float,
    features: np.ndarray,
) -> None:
    """Fill the features of the observer, see `Features.fill`; `means` (lanes, times · 2 n) as they were before."""
    count = innovation.shape[1]
    for lane in range(len(innovation)):
        out = features[lane]
        for number in range(2 + len(shares)):
            for k in range(count):
                value, unit = innovation[lane, k], units[k]
                if number == 1:
                    unit = COARSE * unit
                elif number > 1:
                    mean = means[lane, (number - 2) * count + k]
                    value = mean + shares[number - 2] * (value - mean)
                out[number * count + k] = area_sine(value / unit)
        for k in range(load.shape[1]):
            out[(2 + len(shares)) * count + k] = load[lane, k] / load_scale
