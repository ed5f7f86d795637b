"""The scheduled regulator K of the adaptive observer, tabulated over the posture and over the payload."""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, mass_matrix
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GRID
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, feedback_gain, sampled_arm

__all__ = ["feedback_at", "feedback_table"]

HEAVIEST = 0.5  # payload of the table's end, share of the mass of all links
PAYLOADS = 6


def feedback_table(parameters: ArmParameters, control_period: float, weights: AdaptiveWeights) -> np.ndarray:
    """Return K (payloads, cos q2, 2, 8) [N m/rad, N m s/rad] at payloads up to half the links' mass and at `GRID`.

    Raises:
        ValueError: a Riccati equation has no solution in double precision.
    """
    costs = ObserverWeights(link_angle=weights.link_angle, link_velocity=weights.link_velocity)
    limit = np.array(parameters.torque_limit)
    table = np.empty((PAYLOADS, len(GRID), len(limit), 4 * len(limit)))
    for row, mass in enumerate(np.linspace(0.0, HEAVIEST * sum(parameters.mass), PAYLOADS)):
        for column, cos2 in enumerate(GRID):
            m11, m12, m22 = mass_matrix(float(cos2), arm_constants(parameters, Payload(mass)))
            A, B = sampled_arm(parameters, control_period, np.array([[m11, m12], [m12, m22]]))
            try:
                table[row, column] = feedback_gain(A, B, limit, costs)
            except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
                raise ValueError(
                    f"no gains at cos q2 = {cos2:g} for control_period = {control_period!r} s, {weights} and this arm "
                    f"({error}): take a shorter period, or other weights"
                ) from None
    return table


@register_jitable
def feedback_at(table: np.ndarray, posture: float, payload: float, gain: np.ndarray) -> None:
    """Fill K (n, 4 n) at a posture from -1 to 1 and a payload in masses of the links, between the table's entries."""
    row, low = _place(payload / HEAVIEST, table.shape[0])
    column, left = _place(0.5 * (posture + 1.0), table.shape[1])
    for i in range(gain.shape[0]):
        for k in range(gain.shape[1]):
            near = (1.0 - left) * table[row, column, i, k] + left * table[row, column + 1, i, k]
            far = (1.0 - left) * table[row + 1, column, i, k] + left * table[row + 1, column + 1, i, k]
            gain[i, k] = (1.0 - low) * near + low * far


@register_jitable
def _place(share: float, entries: int) -> tuple[int, float]:
    """Return the entry before a share of a table's length, from 0 to 1, and how far after it the share lies."""
    place = min(max(share, 0.0), 1.0) * (entries - 1)
    entry = min(max(int(place), 0), entries - 2)  # a share that is nan is mapped into the table, too
    return entry, place - entry
