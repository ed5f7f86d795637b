"""The base class of all policies: the `predict` protocol of stable-baselines3, single and batched."""

from __future__ import annotations

import abc
import functools
import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from fuzzyarm.common.checks import all_finite, array_of, real_entries, shown
from fuzzyarm.envs.observation import PARTS, Observation
from fuzzyarm.envs.periods import checked_period
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.fuzzy_policy._sample_clock import SampleClock
from fuzzyarm.fuzzy_policy.known_arm import checked_arm, joints_of, per_joint_of

__all__ = ["PassLearner", "Policy", "Predictor"]

_MISMATCH = 0.01  # largest relative difference between sample time and control period without a warning


class Predictor(Protocol):
    """Anything with the `predict` of stable-baselines3."""

    def predict(
        self,
        observation: np.ndarray,
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Return the action (n,) or (lanes, n) [N m], n the number of joints, and the next state."""
        ...


class Policy(abc.ABC):
    """A feedback law with a memory: u(t_k) and the memory for t_(k+1) from observation and memory at t_k.

    Torques and integrals are limited as in `command`. For n joints an observation has 5 n entries and an action n. A
    batch has one robot per lane.

    Attributes:
        parameters: the two-joint arm or robot that the policy assumes.
        joints: number of joints n.
        control_period: T, time between two calls of `predict` [s].
        memory_size: size of a lane's memory, which is zero when an episode begins. By default one entry per joint: the
            integral of the position error, x_I(t_(k+1)) = x_I(t_k) + T (q - q_d)(t_k).
        torque_limit: largest torques (n,) [N m].
        action_period: time for which an action is held [s]; by default the control period.
        remake: function that makes this policy for another control period [s]; None if the user specified the period.
        integral_at: index of the first of the n integrals x_I in a lane's memory; None without integrals.
    """

    integral_at: int | None = None
    remake: Callable[..., Policy] | None = None
    _clock: SampleClock | None = None

    def __init__(self, parameters: AnyArm, control_period: float) -> None:
        """Store the robot and the control period [s]; TypeError or ValueError if one is invalid."""
        self.parameters = checked_arm("parameters", parameters)
        self.joints = joints_of(parameters)
        self.control_period = checked_period("control_period", control_period)
        self.action_period = self.control_period
        self.torque_limit = per_joint_of(parameters, "torque_limit")

    @functools.cached_property
    def memory_size(self) -> int:
        """Number of entries in the memory of one lane."""
        return self.joints

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_clock"}

    def without_dry_friction(self) -> Policy:
        """Return this policy for an arm without dry friction; the policy itself if it has no model of dry friction."""
        return self

    @abc.abstractmethod
    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Fill `torque` (lanes, n) [N m], unclipped, and advance `memory` (lanes, memory_size) for `observation`."""

    def command(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> bool:
        """Evaluate the law within the torque limits; return False if a torque is not a number.

        The torque u_j of joint j is clipped to ±Γ_j [N m]. If it exceeds a limit, the integral x_I,j is held if its
        change would drive u_j further: u_j > Γ_j and Δx_I,j < 0, or u_j < -Γ_j and Δx_I,j > 0. Arguments as for `act`:
        observation (lanes, 5 n), memory (lanes, memory_size), torque (lanes, n).
        """
        at, largest = self.integral_at, self.torque_limit
        held = memory[:, :0] if at is None else memory[:, at : at + self.joints]
        before = held.copy()
        self.act(observation, memory, torque)
        if at is not None:
            change = held - before
            further = ((torque > largest) & (change < 0.0)) | ((torque < -largest) & (change > 0.0))
            held[further] = before[further]
        numbers = not np.isnan(torque).any()
        np.clip(torque, -largest, largest, out=torque)
        return numbers

    def checked_state(self, state: Any) -> np.ndarray:
        """Return a state (..., memory_size) of `predict` as an array; TypeError or ValueError for anything else."""
        array = array_of("state", state)
        if array.dtype.kind not in "fiu":
            raise TypeError(
                f"state = {shown(state)} must be real numbers of shape (..., {self.memory_size}), as predict returns it"
            )
        if array.shape[-1:] != (self.memory_size,):
            raise ValueError(
                f"state has shape {array.shape}; allowed: (..., {self.memory_size}), as predict returns it"
            )
        return array

    def repeated(self) -> PassLearner | None:
        """Return the form of this policy that learns from repeated passes over one path; None if there is none."""
        return None

    def predict(
        self,
        observation: np.ndarray,
        state: np.ndarray | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return motor torques [N m] and the next state.

        The time between samples follows from the reference in the first samples of an episode, see `_sample_clock`. If
        it differs from the control period, a policy with `remake` changes to that time, with the memory that it would
        then have; any other policy warns (RuntimeWarning) and continues.

        `state` is never changed. After a ValueError for a reading that is not a number, hold the last torques and use
        the same state at the next sample: the bad sample then has no effect.

        Args:
            observation: (5 n,) or (lanes, 5 n), as `FuzzyArmEnv` gives it.
            state: what the last call returned; None begins an episode.
            episode_start: (lanes,) booleans; True resets that lane's state.
            deterministic: ignored.

        Returns:
            Torques, (n,) or (lanes, n), and the state, (memory_size,) or (lanes, memory_size).

        Raises:
            TypeError: an argument does not consist of real numbers.
            ValueError: an argument has a wrong shape; an entry of the observation is not finite, or so large that no
                torque can be computed.
        """
        batch = _checked_observation(observation, self.joints)
        lanes, single = len(batch), np.ndim(observation) == 1
        if state is None:
            memory, self._clock = np.zeros((lanes, self.memory_size)), SampleClock()
        else:
            remembered = array_of("state", state)
            real_entries("state", remembered)
            memory = np.array(remembered, dtype=np.float64, order="C", ndmin=2)
            if memory.shape != (lanes, self.memory_size):
                allowed = (*np.shape(observation)[:-1], self.memory_size)
                raise ValueError(f"state has shape {np.shape(state)}; allowed: {allowed}")
            if episode_start is not None:
                starts = np.atleast_1d(array_of("episode_start", episode_start))
                if starts.dtype.kind not in "biuf":
                    raise TypeError(f"episode_start must contain booleans, not {starts.dtype}")
                if starts.shape != (lanes,):
                    raise ValueError(f"episode_start has shape {starts.shape}; allowed: ({lanes},)")
                memory[starts.astype(bool)] = 0.0
        clock = self._clock
        action = np.empty((lanes, self.joints))
        if clock is not None and lanes and (period := clock.see(batch, state)):
            differs = abs(period - self.control_period) > _MISMATCH * self.control_period
            if differs and self._meets(period, clock.sure):
                memory = np.zeros((lanes, self.memory_size))
                for sample in clock.samples[:-1]:  # the memory that it would have by now
                    self.command(sample, memory, action)
            self._clock = clock = None if clock.sure else clock
        if not self.command(batch, memory, action):
            raise _no_torque(batch)
        result = (action[0], memory[0]) if single else (action, memory)
        if clock is not None:
            clock.returned = result[1]
        return result

    def _meets(self, period: float, sure: bool) -> bool:
        """Change the control period to `period` [s] if that is possible; return whether it was.

        If it was not, warn if `sure`: two successive intervals between samples had this length.
        """
        reason = ""
        if self.remake is not None:
            try:
                other = self.remake(control_period=period)
            except (OSError, ValueError) as error:
                reason = f" (this policy cannot be made for that period: {error})"
            else:
                self.__dict__ = {**other.__dict__, "remake": self.remake}
                return True
        if sure:
            warnings.warn(
                f"the policy is made for a control period of {1e3 * self.control_period:g} ms, but the "
                f"observations are {1e3 * period:g} ms apart, as their references show; load the policy with "
                f"control_period={period:g}, or make the environment with "
                f"control_period={self.control_period:g}{reason}",
                RuntimeWarning,
                stacklevel=3,
            )
        return False


def _checked_observation(observation: Any, joints: int) -> np.ndarray:
    """Return observations (5 n,) or (lanes, 5 n) of n joints as a batch (lanes, 5 n) of finite numbers, in C order.

    Errors are those of `Policy.predict`.
    """
    seen = array_of("observation", observation)
    real_entries("observation", seen)
    size = PARTS * joints
    if seen.ndim not in (1, 2) or seen.shape[-1] != size:
        raise ValueError(f"observation has shape {seen.shape}; allowed: ({size},), or (n, {size}) for n observations")
    batch = np.array(seen, dtype=np.float64, order="C", ndmin=2, copy=None)
    if not batch.flags.carray:
        batch = batch.copy()
    if not all_finite(batch):
        lane, entry = (int(k) for k in np.argwhere(~np.isfinite(batch))[0])
        place = f"observation[{entry}]" if seen.ndim == 1 else f"observation[{lane}, {entry}]"
        part = f"{Observation._fields[entry // joints]} of joint {entry % joints + 1}"
        raise ValueError(
            f"{place} = {batch[lane, entry]} ({part}) is not finite; apply the last torques again and keep the state"
        )
    return batch


def _no_torque(observation: np.ndarray) -> ValueError:
    """Return the error to raise if a law returns nan for observations (lanes, 5 n)."""
    largest = np.abs(observation).max()
    return ValueError(f"the policy returns no finite torque, because an observed number has magnitude {largest:g}")


class PassLearner(abc.ABC):
    """A policy that learns from each pass over a path for the next; a pass is an episode along the path.

    The state contains what has been learned. Its type is the attribute `kind`; its `memory` (lanes, memory_size) is the
    memory of `policy`.
    """

    policy: Policy
    kind: type[Any]

    def predict(
        self,
        observation: np.ndarray,
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Return the torques [N m] and the next state for an observation (5 n,) or (lanes, 5 n).

        The state is None for a first pass, else what the last call or `begin_pass` returned; it changes in place,
        unless an error is raised. The state defines the start of a pass, so `episode_start` is ignored, as is
        `deterministic`. Errors are as for `Policy.predict`, with a TypeError for a state of another type.
        """
        seen = _checked_observation(observation, self.policy.joints)
        state = self._first(np.zeros((len(seen), self.policy.memory_size))) if state is None else self._checked(state)
        if len(state.memory) != len(seen):
            raise ValueError(
                f"state is for {len(state.memory)} environment(s), observation for {len(seen)}; give both for the same"
            )
        torque = self._go_on(seen, state)
        return (torque[0] if np.ndim(observation) == 1 else torque), state

    @abc.abstractmethod
    def begin_pass(self, state: Any) -> Any:
        """Return the state that begins the next pass, given the last pass's; ValueError if that pass has no samples."""

    @abc.abstractmethod
    def _first(self, memory: np.ndarray) -> Any:
        """Return the state before a first pass, which contains the `memory` (lanes, memory_size) of the policy."""

    @abc.abstractmethod
    def _go_on(self, seen: np.ndarray, state: Any) -> np.ndarray:
        """Return torques (lanes, n) [N m] within the limits, for observations (lanes, 5 n); advance `state` too."""

    def _checked(self, state: Any) -> Any:
        """Return `state`; TypeError or ValueError if it does not belong to this policy."""
        if not isinstance(state, self.kind):
            needed = f"the {self.kind.__name__} returned by predict or begin_pass"
            raise TypeError(f"state = {shown(state)} must be {needed}")
        size, own = state.memory.shape[1], self.policy.memory_size
        if size != own:
            raise ValueError(f"state has a memory of {size} numbers, not {own}; use one from a policy for the same arm")
        return state

    def _clipped(self, seen: np.ndarray, torque: np.ndarray) -> np.ndarray:
        if np.isnan(torque).any():
            raise _no_torque(seen)
        return np.asarray(np.clip(torque, -self.policy.torque_limit, self.policy.torque_limit))


NOTHING_LEARNED = "there is no pass to learn from: call predict along the path before begin_pass"
"""Message of the ValueError that `begin_pass` raises for a state without samples."""
