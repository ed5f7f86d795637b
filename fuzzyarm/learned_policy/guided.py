"""How an action guides the base of a learned policy, and what of the base the features hold."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.observation import starts
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.definition import INNOVATION_UNITS, ActionDefinition, FeatureDefinition

__all__ = ["guided", "seen_by"]


def guided(
    base: Policy, action: ActionDefinition, observation: np.ndarray, memory: np.ndarray, torque: np.ndarray
) -> None:
    """Replace `torque`, which holds scale · a (lanes, n), by that of the guided base [N m], and advance its memory.

    With a gate the torque is not clipped yet; the prediction of the base knows the limits.

    Args:
        base: the policy that ``action.base`` names.
        action: what the action means; [rad], or with a gate [N m].
        observation: (lanes, 5 n).
        memory: (lanes, memory_size) of the base, advanced in place.
        torque: (lanes, n), changed in place.
    """
    if action.gate > 0.0:
        assert isinstance(base, ElasticObserverPolicy)
        extra = gate(base.innovation(observation, memory), action.gate)[:, np.newaxis] * torque
        base.act_beside(observation, memory, extra, torque)
        return
    shifted, motors = observation.copy(), slice(starts(base.joints).q_motor, base.joints)
    shifted[:, motors] -= torque
    base.command(shifted, memory, torque)


def gate(innovation: np.ndarray, width: float) -> np.ndarray:
    """Return γ (lanes,) of `ActionDefinition` for ν (lanes, 2 n) [rad, rad/s] and G."""
    share = np.empty(len(innovation))
    _gate(innovation, width * INNOVATION_UNITS[0], width * INNOVATION_UNITS[1], share)
    return share


@kernel
def _gate(innovation: np.ndarray, angle: float, velocity: float, share: np.ndarray) -> None:
    """Fill γ (lanes,), see `gate`, for the units of angles [rad] and of velocities [rad/s]."""
    count = innovation.shape[1]
    for lane in range(len(innovation)):
        total = 0.0
        for k in range(count):
            ratio = innovation[lane, k] / (angle if k < count // 2 else velocity)
            total += ratio * ratio
        share[lane] = total / (count + total)


def seen_by(
    base: Policy | None, features: FeatureDefinition, observation: np.ndarray, memory: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return ν (lanes, 2 n) and d̂ (lanes, n) of the base before it acts; None where no feature needs them.

    For observations (lanes, 5 n) and the memory (lanes, memory_size) of the base.
    """
    if not features.innovation_times:
        return None, None
    assert isinstance(base, ElasticObserverPolicy)
    return base.innovation(observation, memory), memory[:, base.load]
