"""The weights of the adaptive observer for any robot: those of Table 1, softened until the regulator is stable.

`AdaptiveWeights` were tuned for the two-joint arm, whose mass matrix the regulator's table follows. Where a robot's
depends on more angles than that, the gains are those of a mean, and as sharp as they are they may be unstable in part
of its range, even for a state that is known. With a factor s ≥ 1,

    link_angle → s link_angle,    link_velocity → √s link_velocity,    first_gain → min(1, s first_gain)

weaken the feedback, which then needs less of a soft start. The smallest s of `FACTORS` is taken with which the loop of
the regulator and the known state is stable at random postures, with joints as stiff as known and 20 % softer and
stiffer.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, nearest_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights, feedback_gain, sampled_arm, state_part
from fuzzyarm.fuzzy_policy.laws.observer_weights import FACTORS
from fuzzyarm.fuzzy_policy.laws.sampled_margins import Place, places_of

__all__ = ["adaptive_weights_for", "largest_radius", "softened"]

STIFFNESS = (0.8, 1.0, 1.2)


@functools.lru_cache(maxsize=32)
def adaptive_weights_for(arm: AnyArm, control_period: float) -> AdaptiveWeights:
    """Return the default weights for an arm and a control period [s]; for a two-joint arm those of Table 1.

    If no factor is enough, it is the largest.
    """
    weights = AdaptiveWeights()
    if not isinstance(arm, Robot):
        return weights
    places, schedule = places_of(arm, control_period), schedule_of(arm)
    trials = [softened(weights, factor) for factor in FACTORS]
    return next((trial for trial in trials if largest_radius(places, schedule, trial) < 1.0), trials[-1])


def softened(weights: AdaptiveWeights, factor: float) -> AdaptiveWeights:
    """Return weights softened by s = `factor`."""
    link_angle, link_velocity = factor * weights.link_angle, math.sqrt(factor) * weights.link_velocity
    first_gain = min(1.0, factor * weights.first_gain)
    return dataclasses.replace(weights, link_angle=link_angle, link_velocity=link_velocity, first_gain=first_gain)


def largest_radius(places: list[Place], schedule: GainSchedule, weights: AdaptiveWeights) -> float:
    """Return the largest |λ| per control period at postures; inf where a Riccati equation has no solution."""
    costs, largest = ObserverWeights(link_angle=weights.link_angle, link_velocity=weights.link_velocity), 0.0
    for place in places:
        limit, state = per_joint_of(place.robot, "torque_limit"), state_part(len(place.robot))
        A, B = sampled_arm(place.robot, place.control_period, nearest_inertia(schedule, place.q))
        try:
            K = feedback_gain(A, B, limit, costs)
        except (np.linalg.LinAlgError, ValueError):  # scipy raises either
            return math.inf
        for stiffness in STIFFNESS:
            A, B = place.plant(stiffness)
            largest = max(largest, float(np.abs(np.linalg.eigvals(A[state, state] - B[state] @ K)).max()))
    return largest
