"""Which policies have a law on balls, and that law."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.certified.tip.enclosures import NoBound
from fuzzyarm.eval.certified.tip.laws import asked, ball_law
from fuzzyarm.eval.certified.tip.network_law import NetworkLaw
from fuzzyarm.eval.certified.tip.observer_law import ObserverLaw
from fuzzyarm.eval.certified.tip.response import FixedLaw, SampledLaw
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy
from fuzzyarm.fuzzy_policy.laws.elastic_observer import ElasticObserverPolicy
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.learned_policy.estimate.policy import LearnedObserverPolicy
from fuzzyarm.learned_policy.policy import LearnedPolicy

__all__ = ["sampled_law"]

_UNKNOWN: dict[type[Policy], str] = {
    AdaptiveObserverPolicy: "there is no bound for the adaptive observer: the corrections of its Kalman filter divide "
    "by a covariance that it remembers, and are cut by a gate and a dead zone; no enclosure of them is stated",
    LearnedObserverPolicy: "there is no bound for the learned observer: its filter divides by a covariance that it "
    "remembers, the gates of its network multiply what they remember, and no enclosure of these steps is stated",
}
"""What stands in the way of a bound, by the kind of a policy whose base has one."""


def sampled_law(policy: Policy, references: np.ndarray) -> SampledLaw:
    """Return a policy, sample by sample, for a schedule's `references` (steps + 1, 6) [rad, rad/s, rad/s²].

    `NoBound` where its law is not known on balls, or its arm has other joints.
    """
    if type(policy) is ElasticObserverPolicy and isinstance(policy.parameters, ArmParameters):
        return ObserverLaw(policy, references)
    if type(policy) is LearnedPolicy:
        network = policy.bundle.network
        if (network.activation, network.output, network.cell) != ("tanh", "clip", None):
            kind = "a recurrent network" if network.cell else f"layers of {network.activation} and {network.output}"
            raise NoBound(f"there is no bound for {kind}; choose a policy of PPO, whose layers are tanh and clip")
        if policy.bundle.features.innovation_times or policy.bundle.action.gate > 0.0:
            raise NoBound("there is no bound for a policy that sees the innovation of its base; prove the base instead")
        return NetworkLaw(policy, references)
    if type(policy) in _UNKNOWN:
        raise NoBound(f"{_UNKNOWN[type(policy)]}; choose elastic-observer, which has one")
    return FixedLaw(ball_law(policy), asked(policy, references), policy.control_period)
