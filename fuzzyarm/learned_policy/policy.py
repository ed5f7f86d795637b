"""A bundle at work: the `predict` of every policy here, without the library it was trained with."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.bundle import PolicyBundle
from fuzzyarm.learned_policy.features import Features

# Memory of a lane: calls since its action (0: it is due), the action, then that of the features and of the base.
PHASE, ACTION, PAST = 0, slice(1, 3), 3


class LearnedPolicy(Policy):
    """The mean action of a trained network, held for its action period; see `features` and `network`.

    u(t) = scale · a_k, smoothed as the definition says, from action instant k to the next; or with a base u(t) =
    u_base(t), the base being told that the motors stand at q_a - scale · a_k. What is remembered between calls is in
    the state: how long the action has been held, the action, what the features remember, and the base's own memory.
    """

    def __init__(
        self,
        bundle: PolicyBundle,
        control_period: float = 1e-3,
        parameters: ArmParameters | None = None,
        base: Policy | None = None,
        *,
        friction: bool = True,
    ) -> None:
        """Set a bundle to work.

        Args:
            bundle: what was trained.
            control_period: time between two calls of `predict` [s]; the action period must be a whole multiple of it.
            parameters: the arm, for its torque limits; default Table 1.
            base: the policy that ``bundle.action.base`` names, for the same control period.
            friction: whether the torque an unloaded arm needs, where the features know it, holds the dry friction.

        Raises:
            ValueError: the periods do not fit, or the base is missing, not asked for, or for another period.
        """
        super().__init__(parameters or ArmParameters(), control_period)
        self.bundle, self.base = bundle, base
        self.action_period = bundle.action.period
        self.calls_per_action = bundle.action.calls(control_period)
        if (base is None) != (bundle.action.base is None):
            given = "none" if base is None else type(base).__name__
            raise ValueError(f"this policy was trained on the base {bundle.action.base}; base = {given} was given")
        if base is not None and base.control_period != control_period:
            raise ValueError(f"the base is for a control period of {base.control_period} s, not {control_period} s")
        self._features = Features(bundle.features, bundle.action.period, self.parameters, friction=friction)
        self._own = PAST + self._features.memory_size
        self._smoothing = bundle.action.smoothing
        self._scale = np.array(bundle.action.scale)
        self.memory_size = self._own + (0 if base is None else base.memory_size)

    def without_dry_friction(self) -> LearnedPolicy:
        """Return this policy for an arm without dry friction: base and features forget it, the network stays."""
        base = None if self.base is None else self.base.without_dry_friction()
        return LearnedPolicy(self.bundle, self.control_period, self.parameters, base, friction=False)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy`."""
        due = _count_due(memory)
        if due == len(memory):
            self._choose(observation, memory)
        elif due:  # lanes whose episodes began at different calls
            which = memory[:, PHASE] == 0.0
            chosen = memory[which]
            self._choose(observation[which], chosen)
            memory[which] = chosen
        _hold(memory, self._scale, self.calls_per_action, torque)  # with a base it is a shift, and no torque yet
        if self.base is not None:
            shifted = observation.copy()
            shifted[:, :2] -= torque
            self.base.act(shifted, memory[:, self._own :], torque)
        self._features.command(torque, memory[:, PAST : self._own])

    def _choose(self, observation: np.ndarray, memory: np.ndarray) -> None:
        """Take the next action, and remember it."""
        features = np.empty((len(memory), self._features.size))
        action, past = memory[:, ACTION], memory[:, PAST : self._own]
        self._features.fill(observation, past, features)
        told = np.empty((len(memory), 2))
        self.bundle.network.act(features, told)
        action[:] = self._smoothing * action + (1.0 - self._smoothing) * told
        self._features.advance(observation, action, past)


@kernel
def _count_due(memory: np.ndarray) -> int:
    """Return how many lanes are to choose an action now."""
    count = 0
    for lane in range(len(memory)):
        count += memory[lane, PHASE] == 0.0
    return count


@kernel
def _hold(memory: np.ndarray, scale: np.ndarray, calls: int, output: np.ndarray) -> None:
    """Fill `output` with scale times action, and count the calls of the hold."""
    for lane in range(len(memory)):
        output[lane, 0], output[lane, 1] = scale[0] * memory[lane, 1], scale[1] * memory[lane, 2]
        memory[lane, PHASE] += 1.0
        if memory[lane, PHASE] >= calls:
            memory[lane, PHASE] = 0.0
