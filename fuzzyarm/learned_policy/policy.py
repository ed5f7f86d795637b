"""The policy that a bundle holds, with the `predict` of every policy; it needs no learning library."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.lanes import in_lanes
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.bundle import PolicyBundle
from fuzzyarm.learned_policy.features import Features
from fuzzyarm.learned_policy.guided import guided, seen_by

__all__ = ["LearnedPolicy"]

# The memory of a lane: the number of calls since its last action, 0 if the next action is due; that action; then the
# memories of the features, of the base and of the network.
_PHASE = 0
_ACTION = 1


class LearnedPolicy(Policy):
    """The mean action of a trained network, held for its action period; see `features` and `network`.

    From action instant k to the next the torque is u(t) = scale · a_k, with a_k smoothed as the definition says. With a
    base it is u(t) = u_base(t), guided by scale · a_k as `ActionDefinition` has it. The state holds everything
    that is remembered between calls: for how long the action has been held, the action, and the memories of the
    features, of the base and of a recurrent network.

    Attributes:
        bundle: the trained policy.
        base: the policy whose target is shifted; None: no base.
        calls_per_action: number of calls for which an action is held.
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
        """Make the policy of a bundle.

        Args:
            bundle: the trained policy.
            control_period: time between two calls of `predict` [s]; the action period must be a whole multiple of it.
            parameters: the arm or the robot that it was trained for; default Table 1.
            base: the policy that ``bundle.action.base`` names, for the same control period.
            friction: whether the torque that an unloaded arm needs, if it is among the features, includes the dry
                friction.

        Raises:
            ValueError: the periods do not fit, or the base is missing, not asked for, or for another period.
        """
        self._arm: AnyArm = ArmParameters() if parameters is None else parameters
        super().__init__(self._arm, control_period)
        self.bundle, self.base = bundle, base
        self.action_period = bundle.action.period
        self.calls_per_action = bundle.action.calls(control_period)
        if (base is None) != (bundle.action.base is None):
            given = "none" if base is None else type(base).__name__
            raise ValueError(f"this policy was trained on the base {bundle.action.base}; base = {given} was given")
        if base is not None and base.control_period != control_period:
            raise ValueError(f"the base is for a control period of {base.control_period} s, not {control_period} s")
        self._features = Features(bundle.features, bundle.action.period, self._arm, friction=friction)
        self._past = _ACTION + self.joints
        self._base_memory = self._past + self._features.memory_size
        self._smoothing = bundle.action.smoothing
        self._scale = np.array(bundle.action.scale)
        self._base = slice(self._base_memory, self._base_memory + (0 if base is None else base.memory_size))
        self.memory_size = self._base.stop + bundle.network.memory_size

    def without_dry_friction(self) -> LearnedPolicy:
        """Return this policy for an arm without dry friction: base and features omit it, the network stays."""
        base = None if self.base is None else self.base.without_dry_friction()
        return LearnedPolicy(self.bundle, self.control_period, self._arm, base, friction=False)

    def act(self, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray) -> None:
        """Evaluate the law, see `Policy.act`.

        Args:
            observation: (lanes, 5 n).
            memory: (lanes, memory_size), advanced in place.
            torque: (lanes, n) [N m], filled in place.
        """
        in_lanes(memory[:, _PHASE], 0.0, self._choose, observation, memory)
        _hold(memory, self._scale, self.calls_per_action, torque)
        if self.base is not None:
            guided(self.base, self.bundle.action, observation, memory[:, self._base], torque)
        self._features.command(torque, memory[:, self._past : self._base_memory])

    def _choose(self, observation: np.ndarray, memory: np.ndarray) -> None:
        """Compute the next action of every lane and store it in the memory."""
        features, output = np.empty((len(memory), self._features.size)), np.empty((len(memory), self.joints))
        action, past = memory[:, _ACTION : self._past], memory[:, self._past : self._base_memory]
        innovation, load = seen_by(self.base, self.bundle.features, observation, memory[:, self._base])
        self._features.fill(observation, past, features, innovation, load)
        self.bundle.network.act(features, output, memory[:, self._base.stop :])
        action[:] = self._smoothing * action + (1.0 - self._smoothing) * output
        self._features.advance(observation, action, past, innovation)


@kernel
def _hold(memory: np.ndarray, scale: np.ndarray, calls: int, output: np.ndarray) -> None:
    """Fill `output` (lanes, n) with scale times action, and count the calls for which the action is held."""
    for lane in range(len(memory)):
        for joint in range(len(scale)):
            output[lane, joint] = scale[joint] * memory[lane, _ACTION + joint]
        memory[lane, _PHASE] += 1.0
        if memory[lane, _PHASE] >= calls:
            memory[lane, _PHASE] = 0.0
