"""The weights of the elastic observer for any robot: those of Table 1, softened until the loop has its margins.

`ObserverWeights` were tuned for the two-joint arm. Where a robot's mass matrix depends on more angles than gains are
tabulated over, they are too sharp, and the loop may be unstable in part of its range. With a factor s ≥ 1,

    link_angle → s link_angle,    link_velocity → √s link_velocity

weaken the feedback and make it more robust. The smallest s of `FACTORS` is taken with which the loop is stable at
random postures in all of `sampled_margins.CONDITIONS`.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, nearest_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    ObserverWeights,
    estimate_parts,
    feedback_gain,
    observer_gain,
    sampled_arm,
    state_part,
)
from fuzzyarm.fuzzy_policy.laws.sampled_margins import CONDITIONS, LinearLaw, Place, places_of, worst_radius

__all__ = ["FACTORS", "linear_observer", "softened", "weights_for"]

FACTORS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Factors s that are tried, one after the other."""


@functools.lru_cache(maxsize=32)
def weights_for(arm: AnyArm, control_period: float) -> ObserverWeights:
    """Return the default weights for an arm and a control period [s]; for a two-joint arm those of Table 1.

    If no factor gives the margins, it is the one whose largest radius is smallest.
    """
    weights = ObserverWeights()
    if not isinstance(arm, Robot):
        return weights
    places, schedule = places_of(arm, control_period), schedule_of(arm)
    best, smallest = weights, math.inf
    for factor in FACTORS:
        trial = softened(weights, factor)
        radius = _largest_radius(places, schedule, trial)
        if radius < 1.0:
            return trial
        if radius < smallest:
            best, smallest = trial, radius
    return best


def softened(weights: ObserverWeights, factor: float) -> ObserverWeights:
    """Return weights softened by s = `factor`."""
    return dataclasses.replace(
        weights,
        link_angle=factor * weights.link_angle,
        link_velocity=math.sqrt(factor) * weights.link_velocity,
    )


def _largest_radius(places: list[Place], schedule: GainSchedule, weights: ObserverWeights) -> float:
    """Return the largest radius over postures and conditions; inf where a Riccati equation has no solution."""
    try:
        laws = [linear_observer(place, nearest_inertia(schedule, place.q), weights) for place in places]
    except (np.linalg.LinAlgError, ValueError):  # scipy raises either
        return math.inf
    return max(worst_radius(place, law, CONDITIONS) for place, law in zip(places, laws, strict=True))


def linear_observer(place: Place, designed_for: np.ndarray, weights: ObserverWeights) -> LinearLaw:
    """Return the elastic observer near rest, with gains designed for an inertia (n, n) [kg m²]; s is (x̂, d̂)⁻."""
    robot, period = place.robot, place.control_period
    joints, limit = len(robot), per_joint_of(robot, "torque_limit")
    part, state = estimate_parts(joints), state_part(joints)
    A, B = sampled_arm(robot, period, designed_for)
    K, L = feedback_gain(A, B, limit, weights), observer_gain(A, B, period, limit, weights)
    measured = np.eye(len(A))[np.r_[part.q_motor, part.dq_motor]]
    acts = np.zeros((joints, len(A)))  # u = acts (x̂, d̂)
    acts[:, state] = -K
    acts[:, part.load] = -np.eye(joints) - K[:, part.q_motor] / per_joint_of(robot, "stiffness")
    A, B = place.plant()  # what the observer predicts with
    from_plant, from_memory = L @ measured[:, state], np.eye(len(A)) - L @ measured
    predicts = A + B @ acts
    return LinearLaw(acts @ from_plant, acts @ from_memory, predicts @ from_plant, predicts @ from_memory)
