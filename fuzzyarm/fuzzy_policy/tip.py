"""Any fixed law, told to bring the tip rather than the motors to the reference.

The law tracks θ_d of `elastic_target` in place of q_d, and its own feedforward, which is what it answers at zero error,
makes way for u_ff:

    u = law(q_a, q̇_a, x_I; θ_d, θ̇_d, θ̈_d) - law(θ_d, θ̇_d, 0; θ_d, θ̇_d, θ̈_d) + u_ff.

For the fuzzy law that is K_hv e + H_hv x_I + (L_h(z)v(z) - L_h(z_d)v(z_d)) r + u_ff, with e, x_I and r of θ_d. θ_d is as good
a reference as q_d, so the certificate keeps its words; `tip_statement` says what d holds then.
"""

from __future__ import annotations

import numpy as np

from fuzzyarm.fuzzy_policy.elastic_target import MEMORY_SIZE, ElasticTarget
from fuzzyarm.fuzzy_policy.model_based import ModelBasedPolicy


class TipPolicy(ModelBasedPolicy):
    """A fixed law that tracks θ_d; see the module. Its memory is that of the law and that of `ElasticTarget`."""

    def __init__(self, law: ModelBasedPolicy, *, friction: bool = True, average: bool = True) -> None:
        """Wrap a law.

        Args:
            law: a policy that tracks what its observation calls the reference.
            friction: whether the feedforward holds the dry friction.
            average: whether the feedforward is that of the middle of the coming hold.
        """
        super().__init__(law.parameters, law.control_period)
        self.law = law
        self.memory_size = law.memory_size + MEMORY_SIZE
        self._target = ElasticTarget(law.parameters, law.control_period, friction=friction, average=average)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `ModelBasedPolicy`."""
        own = self.law.memory_size
        seen, resting = np.empty_like(observation), np.empty_like(observation)
        own_feedforward, feedforward = np.empty_like(torque), np.empty_like(torque)
        self._target.advance(observation, memory[:, own:], seen[:, 4:], feedforward)
        seen[:, :4] = observation[:, :4]
        resting[:, 4:] = seen[:, 4:]
        resting[:, :4] = seen[:, 4:8]
        self.law.act(resting, np.zeros((len(memory), own)), own_feedforward)
        self.law.act(seen, memory[:, :own], torque)
        torque += feedforward - own_feedforward
