"""The scheduled regulator K of the adaptive observer, tabulated over the posture and over the payload."""

from __future__ import annotations

import numpy as np

from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.observer_gains import GRID, ObserverWeights, feedback_gain, sampled_arm

__all__ = ["PAYLOADS", "feedback_table"]

PAYLOADS = np.linspace(0.0, 0.5, 6)


def feedback_table(parameters: ArmParameters, control_period: float, weights: AdaptiveWeights) -> np.ndarray:
    """Return K (payloads, cos q2, 2, 8)."""
    chosen = ObserverWeights(link_angle=weights.link_angle, link_velocity=weights.link_velocity)
    limit = np.array(parameters.torque_limit)
    table = []
    for share in PAYLOADS:
        load = Payload(share * sum(parameters.mass))
        row = []
        for cos2 in GRID:
            A, B = sampled_arm(parameters, control_period, float(cos2), load)
            row.append(feedback_gain(A, B, limit, chosen))
        table.append(row)
    return np.array(table)
