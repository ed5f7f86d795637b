"""Any fixed law, with a reference that makes the tip rather than the motors follow the path.

The law tracks θ_d of `_elastic_target` in place of q_d. Its own feedforward, its torque at zero error, is replaced by
the target's feedforward u_ff:

    u = law(q_a, q̇_a, x_I; θ_d, θ̇_d, θ̈_d) - law(θ_d, θ̇_d, 0; θ_d, θ̇_d, θ̈_d) + u_ff.

θ_d is a twice differentiable reference like q_d, so the inequalities of the certificate also hold for it; the
disturbance d then includes other torques, see `tip_statement`.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import equations_of
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy, law_of
from fuzzyarm.fuzzy_policy.laws._elastic_target import ElasticTarget, Past, past_of, target_of
from fuzzyarm.fuzzy_policy.laws._iterative_learning import TorqueLearning
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import zeros

__all__ = ["TipPolicy"]


class TipPolicy(LawPolicy):
    """A fixed law that tracks θ_d (see the module's docstring); its memory is the law's, then `ElasticTarget`'s."""

    def __init__(self, law: Policy, *, friction: bool = True, average: bool = True) -> None:
        """Wrap the policy `law`; arguments `friction` and `average` of the feedforward as in `ElasticTarget`."""
        super().__init__(law.parameters, law.control_period)
        self.law, self.friction, self.average = law, friction, average
        self._target = ElasticTarget(law.parameters, law.control_period, friction=friction, average=average)
        self.memory_size = law.memory_size + self._target.memory_size
        self.integral_at = law.integral_at

    def without_dry_friction(self) -> TipPolicy:
        """Return this policy for an arm without dry friction, which needs no friction feedforward."""
        return TipPolicy(self.law, friction=False, average=self.average)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Fill `torque` and advance `memory`, see `Policy.act`."""
        if self.control_law is not None:
            super().act(observation, memory, torque)
            return
        own_feedforward, feedforward = self._act(observation, memory, torque)
        torque += feedforward - own_feedforward

    @functools.cached_property
    def control_law(self) -> Law | None:  # type: ignore[override]
        """The law that tracks θ_d; None if the wrapped policy has no `Law`."""
        law = law_of(self.law)
        if law is None:
            return None
        act = _law_of(equations_of(self.law.parameters), law.act)
        constants = (law.constants, self._target.constants)
        return Law(act, (law.memory, past_of(self.joints)), constants, law.tables)

    def feedback_and_feedforward(self, observation: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return feedback and feedforward, (lanes, n) each [N m], not clipped, and advance the memory in place."""
        torque = np.empty((len(observation), self.joints))
        own_feedforward, feedforward = self._act(observation, memory, torque)
        return torque - own_feedforward, feedforward

    def repeated(self) -> TorqueLearning:
        """Return this policy with classical iterative learning control around it."""
        return TorqueLearning(self)

    def _act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fill `torque` with the torque of the wrapped law, which tracks θ_d.

        Return the feedforward contained in this torque, and the feedforward u_ff that replaces it, (lanes, n) [N m].
        """
        law_memory, target_memory = memory[:, : self.law.memory_size], memory[:, self.law.memory_size :]
        own_feedforward, feedforward = np.empty_like(torque), np.empty_like(torque)
        target, measured = np.empty((len(observation), 3 * self.joints)), slice(2 * self.joints)
        self._target.advance(observation, target_memory, target, feedforward)
        # The law's torque for motors on θ_d and an empty memory: its own feedforward.
        resting = np.concatenate([target[:, measured], target], axis=1)
        self.law.act(resting, np.zeros(law_memory.shape), own_feedforward)
        self.law.act(np.concatenate([observation[:, measured], target], axis=1), law_memory, torque)
        return own_feedforward, feedforward


@functools.cache
def _law_of(physics: Physics, law: Any) -> Any:
    """Return a `Law.act` that calls the wrapped `Law.act`, `law`, with the reference θ_d, and u_ff as feedforward."""
    target = target_of(physics)

    def tip(memory: tuple[Any, Past], seen: Observation, given: Any, *tables: Any) -> tuple[Any, Any]:
        (own, past), (constants, of_target) = memory, given
        past, aim, u_ff = target(past, seen, of_target)
        # The law's torque for motors on θ_d and an empty memory: its own feedforward.
        _, feedforward = law(zeros(own), Observation(aim.q, aim.dq, *aim), constants, *tables)
        own, torque = law(own, Observation(seen.q_motor, seen.dq_motor, *aim), constants, *tables)
        return (own, past), tuple(u + (f - o) for u, f, o in zip(torque, u_ff, feedforward, strict=True))

    return tip
