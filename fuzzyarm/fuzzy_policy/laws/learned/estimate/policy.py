"""`learned-observer`: the elastic observer at rest, the adaptive observer in motion, and a network that corrects it.

Two laws run in parallel. With (x̂, d̂), K, L, x_d and u_ff of `elastic_observer`, the torque
u_a of `adaptive.policy`, m and g of `rnn`, and the output ρ of the network,

    correct   (x̂, d̂) = (x̂, d̂)⁻ + L ν,    ν = y - (θ̂, θ̂̇)⁻,    and the filter of the adaptive observer by y,
    act       u_o = u_ff - d̂ - K (x̂ - x_d),    u_b = u_o + m g (u_a - u_o),    u = u_b + R ρ(z, c, h),
    predict   (x̂, d̂)⁻ and the filter's prediction under the clipped u.

At rest m = 0, and without a load g is close to 0: the elastic observer then acts alone, in a loop that is locally
stable despite unknown delays and wrong loop gains. In motion under a load the adaptive observer takes over.
u_a is clipped to four times the torque limits; u = u_o where the adaptive filter has diverged or the commands swing
from limit to limit (`AdaptiveWeights.largest_swing`). z, c and the torques R are those of `signals`. The network was
trained by regression on a teacher that knows plant, load and delay, see `fuzzyarm.rl_baselines.estimate`.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy, seen_by
from fuzzyarm.fuzzy_policy.laws.adaptive import filter as kalman
from fuzzyarm.fuzzy_policy.laws.adaptive import regulator
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FLAG, Memory, places
from fuzzyarm.fuzzy_policy.laws.adaptive.filter import Scratch
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy, Beliefs
from fuzzyarm.fuzzy_policy.laws.elastic_observer import Constants, ElasticObserverPolicy, Observed, steps_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate import signals
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateNetwork, Layers, heard, respond
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import context_parts, unexplained_parts
from fuzzyarm.numbers.functions import Cells, array, each, maximum, minimum, select
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["LearnedObserverPolicy"]

# Weights of the adaptive observer, also in training; the elastic observer acts at rest, so no soft start is needed.
_WEIGHTS = {"first_gain": 1.0, "scale_doubt": 3e-3}
_FARTHEST = 4.0  # bound on u_a, in torque limits: a filter that is about to diverge could give any value


class _SeenParts(NamedTuple):
    """The slices of the network's inputs z and c and of u_b [N m] in the result of `LearnedObserverPolicy.observe`."""

    z: slice
    c: slice
    base: slice


class _EstimateMemory(NamedTuple):
    """A lane's memory: elastic observer, last output ρ of the network, adaptive filter, and h of the network."""

    observer: Observed
    residual: Any
    filter: Memory
    hidden: Any


class LearnedObserverPolicy(LawPolicy):
    """The policy `learned-observer`; its law is in the module's docstring, its memory is an `_EstimateMemory`."""

    def __init__(
        self, network: EstimateNetwork, parameters: AnyArm | None = None, control_period: float = 1e-3
    ) -> None:
        """Design the elastic and the adaptive observer for T [s] and the arm as the policy knows it (default Table 1).

        `network` gives the residual torque. ValueError if the control period is out of range, there are no gains for
        these arguments, or the network is for another number of joints or axes.
        """
        super().__init__(ArmParameters() if parameters is None else parameters, control_period)
        arm, physics = self.parameters, equations_of(self.parameters)
        if (network.joints, network.axes) != (physics.joints, physics.axes):
            raise ValueError(
                f"the network is for {network.joints} joints and a tip with {network.axes} coordinates, but the arm "
                f"has {physics.joints} joints and a tip with {physics.axes} coordinates"
            )
        weights = dataclasses.replace(regulator.adaptive_weights_for(arm, self.control_period), **_WEIGHTS)
        self.network, self.adaptive = network, AdaptiveObserverPolicy(arm, control_period, weights)
        self.elastic, of_arm = ElasticObserverPolicy(arm, control_period), (physics.joints, physics.axes)
        self.seen = _SeenParts(
            *consecutive(unexplained_parts(*of_arm).belief.stop, context_parts(*of_arm).motion.stop, physics.joints)
        )
        sizes = self.elastic.memory_size + self.joints, self.adaptive.memory.noise.stop, network.hidden
        _, self.filter, self.hidden = consecutive(*sizes)  # slices of a lane's memory
        self.memory_size = self.hidden.stop

    def with_network(self, network: EstimateNetwork) -> LearnedObserverPolicy:
        """Return this policy with another network of the same size."""
        other = copy.copy(self)  # without the machine code
        other.network = network
        return other

    def without_dry_friction(self) -> ElasticObserverPolicy:
        """Return the law that acts alone at rest, the elastic observer, for the same arm without dry friction."""
        return self.elastic.without_dry_friction()

    def beliefs(self, state: np.ndarray) -> Beliefs:
        """Return the adaptive observer's estimates at the next sample, from a state (..., memory_size) of `predict`.

        Where they are `diverged`, the elastic observer acts alone. Errors as in `AdaptiveObserverPolicy.beliefs`.
        """
        return self.adaptive.beliefs_of(self.checked_state(state)[..., self.filter])

    def observe(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray, seen: np.ndarray) -> None:
        """Evaluate the law like `act`, and fill `seen` (lanes, size) with the network's inputs, see `_SeenParts`."""
        self._observing((memory, observation, torque, seen), self._constants, self.control_law.tables)

    @functools.cached_property
    def control_law(self) -> Law:
        """Both observers and the network as a law; its memory is a `_EstimateMemory`."""
        act = self._act_of()

        def alone(
            memory: _EstimateMemory, seen: Observation, c: Constants, *tables: Any, admit: Any = None
        ) -> tuple[_EstimateMemory, Any]:
            after, torque, *_ = act(memory, seen, c, *tables, admit=admit)
            return after, torque

        at_rest = self.elastic.control_law
        filter_places, hidden = places(equations_of(self.parameters)), Cells((self.network.hidden,))
        memory = _EstimateMemory(at_rest.memory, (0.0,) * self.joints, filter_places, hidden)
        tables = (*at_rest.tables, *self.adaptive.settings.tables, *self.network.layers)
        return Law(alone, memory, at_rest.constants, tables, told=True)

    @functools.cached_property
    def _observing(self) -> Kernel:
        act, joints, law = self._act_of(), self.joints, self.control_law

        def observe(
            memory: _EstimateMemory, seen: Observation, _: Any, out: Any, c: Constants, *tables: Any
        ) -> tuple[Any, ...]:
            after, torque, z, context, base = act(memory, seen, c, *tables)
            for part, numbers in zip(self.seen, (z, context, base), strict=True):
                for k in each(len(numbers)) if hasattr(numbers, "shape") else range(len(numbers)):
                    out[k + part.start] = numbers[k]
            return after, seen, torque, out

        ports = law.memory, seen_by(joints), (0.0,) * joints, Cells((self.seen.base.stop,))
        return Kernel(Program(observe, ports, law.constants, [table.shape for table in law.tables]))

    def _act_of(self) -> Any:
        """Return a function of the arguments of `Law.act` that returns (memory, torque, z, c, u_b), torques in N m."""
        arm, settings, joints, physics = self.parameters, self.adaptive.settings, self.joints, self.elastic.where[0]
        correct, act, predict = steps_of(*self.elastic.where)
        units, turns, limit = signals.units_of(arm), signals.turns_of(arm), self.torque_limit.tolist()
        in_z, in_c = unexplained_parts(joints, physics.axes), context_parts(joints, physics.axes)
        see_context, torques = signals.context_of(physics), units.torque.tolist()

        def learned(
            memory: _EstimateMemory, seen: Observation, c: Constants, *tables: Any, admit: Any = None
        ) -> tuple[Any, ...]:
            feedback, observer, *others = tables
            s, layers = settings.with_tables(others[: -len(Layers._fields)]), Layers(*others[-len(Layers._fields) :])
            m, h, room, adaptive = memory.filter, memory.hidden, Scratch(physics, s), array(joints)
            z, context = array(in_z.belief.stop), array(in_c.motion.stop)
            found = correct(memory.observer, seen, c, observer)
            see_context(seen, found.u_ff, limit, turns, c.target.arm, units, context)
            signals.see_innovation(seen, m, units, z, in_z)
            kalman.correct(m, s, room, seen)
            regulator.act(room.acted, m, s, room, adaptive)
            torque, gap = act(found, seen, c, feedback), []
            for i, most in enumerate(limit):
                asked, far = adaptive[i], _FARTHEST * most
                aim = minimum(maximum(asked, -far), far)
                gap.append(select(asked - asked == 0.0, aim - torque[i], 0.0))
            signals.see_unexplained(found.innovation, found.x.load, gap, memory.residual, units, z, in_z)
            signals.see_beliefs(m, s, units, z, context, in_z, in_c)
            share = heard(z, context, joints, physics.axes)
            base = [u + share * far for u, far in zip(torque, gap, strict=True)]
            answer = respond(z, context, h, gap, torques, layers, physics.axes)
            lost = m.flags[FLAG.lost] != 0.0
            residual = tuple(select(lost, 0.0, rho) for rho in answer)
            torque = tuple(u + unit * rho for u, unit, rho in zip(base, torques, residual, strict=True))
            limited = [minimum(maximum(u, -most), most) for u, most in zip(torque, limit, strict=True)]
            applied = limited if admit is None else admit(torque)
            for i, u in enumerate(applied):
                m.commands[0, i] = u
            observed = Observed(found.past, 1.0, predict(found.x, applied, c, c.target.arm))
            kalman.predict(m, s, room, adaptive)
            return _EstimateMemory(observed, residual, m, h), torque, z, context, base

        return learned
