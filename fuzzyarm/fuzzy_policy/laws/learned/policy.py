"""The policy of a bundle, which is used like any other policy and needs no learning library."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

from fuzzyarm.envs.observation import Observation
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.law import Law, LawPolicy
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.features import Features, guided
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import flat, select, when

__all__ = ["LearnedPolicy"]


class LearnedPolicy(LawPolicy):
    """The mean action of a trained network, held for its action period; see `features` and `network`.

    From action instant k to the next, the torque is u(t) = scale · a_k, with a_k smoothed as in `ActionDefinition`.
    With a base it is the base's torque for a target shifted by scale · a_k.
    """

    def __init__(
        self,
        bundle: PolicyBundle,
        control_period: float = 1e-3,
        parameters: AnyArm | None = None,
        base: Policy | None = None,
        *,
        friction: bool = True,
    ) -> None:
        """Make the policy of a bundle for the arm `parameters` it was trained for (default: `ArmParameters()`).

        The control period [s] must divide the action period. `base` is the policy that ``bundle.action.base`` names,
        for the same control period. `friction` says whether the unloaded arm's torque in the features, if any, includes
        dry friction. ValueError if the periods do not fit, or the base is missing, superfluous or for another period.
        """
        self._arm: AnyArm = ArmParameters() if parameters is None else parameters
        super().__init__(self._arm, control_period)
        self.bundle, self.base = bundle, base
        self.action_period = bundle.action.period
        self.calls_per_action = bundle.action.calls(control_period)
        if (base is None) != (bundle.action.base is None):
            given = "none" if base is None else type(base).__name__
            raise ValueError(f"base = {given} is not the base with which this policy was trained: {bundle.action.base}")
        if base is not None and base.control_period != control_period:
            raise ValueError(f"the base has control_period = {base.control_period} s; needed: {control_period} s")
        self._features = Features(bundle.features, bundle.action.period, self._arm, friction=friction)
        self._smoothing, self._scale = bundle.action.smoothing, tuple(map(float, bundle.action.scale))
        self.memory_size = len(flat(self.control_law.memory))

    def without_dry_friction(self) -> LearnedPolicy:
        """Return this policy with the same network, but without dry friction in its base and its features."""
        base = None if self.base is None else self.base.without_dry_friction()
        return LearnedPolicy(self.bundle, self.control_period, self._arm, base, friction=False)

    @functools.cached_property
    def control_law(self) -> Law:
        """The network, with its base if it has one, as a law; its memory is a `_Memory`."""
        features, network, base = self._features, self.bundle.network, guided(self.base, self.bundle.action.base)
        own, still = len(base.tables), (0.0,) * self.joints
        held = _Memory(0.0, still, features.memory, base.memory, network.memory)

        def act(memory: _Memory, seen: Observation, given: Any, *tables: Any) -> tuple[_Memory, Any]:
            def chosen() -> tuple[Any, Any]:
                told = features.told(memory.features, seen)
                found = features.fill(memory.features, seen, told[2])
                output = network.outputs(found, memory.network, *tables[own:])
                pairs = zip(memory.action, output, strict=True)
                action = tuple(self._smoothing * old + (1.0 - self._smoothing) * new for old, new in pairs)
                return action, features.advance(memory.features, seen, told, action)

            action, past = when(memory.phase == 0.0, chosen, (memory.action, memory.features))
            phase = memory.phase + 1.0
            phase = select(phase >= self.calls_per_action, 0.0, phase)
            told = [scale * a for scale, a in zip(self._scale, action, strict=True)]
            remembered, torque = base.act(memory.base, seen, told, given, *tables[:own])
            past = features.command(past, torque)
            return _Memory(phase, action, past, remembered, memory.network), tuple(torque)

        return Law(act, held, base.constants, (*base.tables, *network.tables))


class _Memory(NamedTuple):
    """The memory of a lane: the last action, and the memories of the features, of the base policy and of the network.

    `phase` is the number of calls since that action was computed, 0 if the next call computes a new action.
    """

    phase: Any
    action: Any
    features: Any
    base: Any
    network: Any
