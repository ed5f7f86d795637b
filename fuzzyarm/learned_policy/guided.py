"""How an action guides the base of a learned policy, and what of the base the features hold."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fuzzyarm.fuzzy_policy.law import constants_array, law_of, seen_by, within_limits
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.definition import INNOVATION_UNITS, ActionDefinition, FeatureDefinition
from fuzzyarm.numbers.functions import select
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["Base", "gate"]


class Base:
    """A base that acts under the guidance of actions.

    With a gate the torque is not clipped yet; the prediction of the base knows the limits.

    Attributes:
        policy: the one that the definition of the action names.
        law: its law.
        memory_size: numbers that it remembers.
    """

    def __init__(self, policy: Policy, action: ActionDefinition) -> None:
        """Take the law of a policy.

        Args:
            policy: the base.
            action: what an action means; [rad], or with a gate [N m].

        Raises:
            ValueError: the policy is no law.
        """
        found = law_of(policy)
        if found is None:
            raise ValueError(
                f"the base {action.base} is a {type(policy).__name__}, which has no law; allowed: a fuzzy policy, "
                "computed-torque, their -tip forms, or elastic-observer"
            )
        self.policy, self.law, self._action = policy, found, action
        self.memory_size = policy.memory_size

    @property
    def constants(self) -> Any:
        """What the law takes: its constants, and the limits of the torques [N m]."""
        return self.law.constants, tuple(map(float, self.policy.torque_limit))

    def guided(self, memory: Any, seen: Any, told: Any, given: Any, *tables: Any) -> tuple[Any, Any]:
        """Return memory and torque (n,) of the guided base [N m].

        Args:
            memory: of the law.
            seen: the observation, one number for each joint in each part.
            told: scale · a (n,).
            given: `constants`.
            *tables: of the law.
        """
        if self._action.gate > 0.0:
            share = gate(self.innovation(memory, seen), self._action.gate)
            extra = [share * u for u in told]
            return self.law.act(memory, seen, given[0], *tables, extra=extra)
        command = within_limits(self.law, self.policy.joints, self.policy.integral_at)
        motors = type(seen.q_motor)(*(q - shift for q, shift in zip(seen.q_motor, told, strict=True)))
        return command(memory, seen._replace(q_motor=motors), given, *tables)

    def innovation(self, memory: Any, seen: Any) -> tuple[Any, ...]:
        """Return ν (2 n,) of an observer before it acts [rad, rad/s]; 0 where an episode begins."""
        x, measured = memory.predicted, (*seen.q_motor, *seen.dq_motor)
        pairs = zip(measured, (*x.q_motor, *x.dq_motor), strict=True)
        return tuple(select(memory.started == 0.0, 0.0, y - predicted) for y, predicted in pairs)

    def observed(self, features: FeatureDefinition, memory: Any, seen: Any) -> tuple[Any, Any]:
        """Return ν (2 n,) and d̂ (n,) of the base before it acts; nothing where no feature needs them."""
        if not features.innovation_times:
            return (), ()
        return self.innovation(memory, seen), tuple(memory.predicted.load)

    # The same for arrays of lanes, in training -------------------------------------------------------------------

    def guide_lanes(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Replace `torque` (lanes, n), which holds scale · a, by that of the guided base, and advance its memory."""
        self._guiding((memory, observation, torque), constants_array(self.law, self.constants[1]), self.law.tables)

    def observed_lanes(
        self, features: FeatureDefinition, observation: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ν (lanes, 2 n) and d̂ (lanes, n), without columns where no feature needs them."""
        if not features.innovation_times:
            return np.empty((len(observation), 0)), np.empty((len(observation), 0))
        assert isinstance(self.policy, ElasticObserverPolicy)
        return self.policy.innovation(observation, memory), memory[:, self.policy.load].copy()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the machine code."""
        return {name: value for name, value in self.__dict__.items() if name != "_guiding"}

    @functools.cached_property
    def _guiding(self) -> Kernel:
        def guide(memory: Any, seen: Any, told: Any, given: Any, *tables: Any) -> tuple[Any, ...]:
            memory, torque = self.guided(memory, seen, told, given, *tables)
            return memory, seen, tuple(torque)

        joints, tables = self.policy.joints, [table.shape for table in self.law.tables]
        return Kernel(Program(guide, (self.law.memory, seen_by(joints), (0.0,) * joints), self.constants, tables))


def gate(innovation: Any, width: float) -> Any:
    """Return γ of `ActionDefinition` for ν (2 n,) [rad, rad/s] and G."""
    count, total = len(innovation), 0.0
    for k, number in enumerate(innovation):
        ratio = number / (width * INNOVATION_UNITS[0 if k < count // 2 else 1])
        total = total + ratio * ratio
    return total / (count + total)
