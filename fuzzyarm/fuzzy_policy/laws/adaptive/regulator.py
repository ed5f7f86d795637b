"""The scheduled regulator K of the adaptive observer, tabulated over the posture and over the payload.

An episode begins with a share of it: K is so sharp that motors stronger or later than known swing against it until the
filter knows them better, and their first tens of milliseconds are where an arm is lost.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights, mass_of
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, loaded_inertia, place_in_schedule, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, feedback_gain, sampled_arm

__all__ = ["FeedbackTable", "feedback_at", "feedback_table", "gain_share"]

HEAVIEST = 0.5  # payload of the table's end, share of the mass of all links
PAYLOADS = 6


class FeedbackTable(NamedTuple):
    """The regulator at the points of a schedule.

    Attributes:
        schedule: over which angles, and at which points.
        gains: K (payloads, points, n, 4 n) [N m/rad, N m s/rad] at payloads up to half the links' mass.
    """

    schedule: GainSchedule
    gains: np.ndarray


@functools.lru_cache(maxsize=8)
def feedback_table(arm: AnyArm, control_period: float, weights: AdaptiveWeights) -> FeedbackTable:
    """Return the table for an arm and a control period [s].

    Raises:
        ValueError: a Riccati equation has no solution in double precision.
    """
    costs = ObserverWeights(link_angle=weights.link_angle, link_velocity=weights.link_velocity)
    limit, schedule = per_joint_of(arm, "torque_limit"), schedule_of(arm)
    gains = np.empty((PAYLOADS, len(schedule.places), len(limit), 4 * len(limit)))
    for row, mass in enumerate(np.linspace(0.0, HEAVIEST * mass_of(arm), PAYLOADS)):
        for column, inertia in enumerate(loaded_inertia(arm, schedule, float(mass))):
            A, B = sampled_arm(arm, control_period, inertia)
            try:
                gains[row, column] = feedback_gain(A, B, limit, costs)
            except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
                raise ValueError(
                    f"no gains at {schedule.places[column]} for control_period = {control_period!r} s, {weights} and "
                    f"this arm ({error}): take a shorter period, or other weights"
                ) from None
    gains.flags.writeable = False
    return FeedbackTable(schedule, gains)


@register_jitable
def feedback_at(
    table: np.ndarray,
    kept: np.ndarray,
    cosine: bool,
    points: int,
    q: np.ndarray,
    payload: float,
    index: np.ndarray,
    weight: np.ndarray,
    gain: np.ndarray,
) -> None:
    """Fill K (n, 4 n) at angles q (n,) [rad] and a payload in masses of the links, between the table's entries.

    `index` and `weight` (2^k,) are room for the points around k kept angles, see `place_in_schedule`.
    """
    place = min(max(payload / HEAVIEST, 0.0), 1.0) * (table.shape[0] - 1)
    row = min(max(int(place), 0), table.shape[0] - 2)  # a share that is nan is mapped into the table, too
    low = place - row
    place_in_schedule(q, kept, cosine, points, index, weight)
    for i in range(gain.shape[0]):
        for k in range(gain.shape[1]):
            near = far = 0.0
            for corner in range(len(index)):
                near += weight[corner] * table[row, index[corner], i, k]
                far += weight[corner] * table[row + 1, index[corner], i, k]
            gain[i, k] = (1.0 - low) * near + low * far


@register_jitable
def gain_share(m: Memory, s: Settings) -> float:
    """Return the share of K at this sample: `first_gain` at the soft start, from there in as long again up to 1.

    It is 1 at once where an earlier pass has taught how strong and how late the motors are.
    """
    past = (m.flags[FLAG.samples] - 1.0) / s.soft_samples - 1.0
    share: float = s.first_gain + (1.0 - s.first_gain) * min(max(past, 0.0), 1.0)
    if m.flags[FLAG.taught] != 0.0:
        share = 1.0
    return share
