"""The scheduled regulator K of the adaptive observer, tabulated over the posture and over the payload.

An episode begins with a share of it: K is so sharp that motors stronger or later than known swing against it until the
filter knows them better, and their first tens of milliseconds are where an arm is lost.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.memory import FLAG, Memory
from fuzzyarm.fuzzy_policy.laws.adaptive.settings import Settings
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights, mass_of
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, corners_of, loaded_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, feedback_gain, sampled_arm
from fuzzyarm.numbers.functions import each, entry, floor, maximum, minimum, select

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
    for number, mass in enumerate(np.linspace(0.0, HEAVIEST * mass_of(arm), PAYLOADS)):
        for column, inertia in enumerate(loaded_inertia(arm, schedule, float(mass))):
            A, B = sampled_arm(arm, control_period, inertia)
            try:
                gains[number, column] = feedback_gain(A, B, limit, costs)
            except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises either
                raise ValueError(
                    f"no gains at {schedule.places[column]} for control_period = {control_period!r} s, {weights} and "
                    f"this arm ({error}): take a shorter period, or other weights"
                ) from None
    gains.flags.writeable = False
    return FeedbackTable(schedule, gains)


def feedback_at(s: Settings, q: Any, payload: Any, gain: Any) -> None:
    """Fill K (n, 4 n) at angles q (n,) [rad] and a payload in masses of the links, between the table's entries."""
    payloads, entries = s.feedback.shape[0], s.feedback_rows.shape[0]
    place = minimum(maximum(payload / HEAVIEST, 0.0), 1.0) * (payloads - 1.0)
    lower = minimum(payloads - 2.0, maximum(0.0, floor(place)))  # a share that is nan is mapped into the table, too
    low, corners, points = place - lower, corners_of(q, s.kept, s.cosine, s.points), entries / payloads
    for i in each(len(gain)):
        for k in each(gain.shape[1]):
            near: Any = 0.0
            far: Any = 0.0
            for corner, weight in corners:
                column = i * gain.shape[1] + k
                near = near + weight * entry(s.feedback_rows, lower * points + corner, column)
                far = far + weight * entry(s.feedback_rows, (lower + 1.0) * points + corner, column)
            gain[i, k] = (1.0 - low) * near + low * far


def gain_share(m: Memory, s: Settings) -> Any:
    """Return the share of K at this sample: `first_gain` at the soft start, from there in as long again up to 1.

    It is 1 at once where an earlier pass has taught how strong and how late the motors are.
    """
    past = (m.flags[FLAG.samples] - 1.0) / s.soft_samples - 1.0
    share = s.first_gain + (1.0 - s.first_gain) * minimum(maximum(past, 0.0), 1.0)
    return select(m.flags[FLAG.taught] != 0.0, 1.0, share)
