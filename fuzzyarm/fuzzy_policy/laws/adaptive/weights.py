"""The numbers of the adaptive observer: how fast a load may change, how wrong the known arm may be, what errors cost.

Torques are shares of the arm's `torque_limit`, joint by joint, and forces shares of `unit_force`, so that the same
numbers fit arms of another size.

The weights of the adaptive observer for any robot: those of Table 1, softened until the regulator is stable.

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

from fuzzyarm.common.checks import real
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import reach
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, nearest_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    FACTORS,
    WEIGHT_RANGE,
    ObserverWeights,
    Place,
    feedback_gain,
    places_of,
    sampled_arm,
    state_part,
)

__all__ = ["AdaptiveWeights", "adaptive_weights_for", "largest_radius", "mass_of", "softened", "unit_force"]


def unit_force(arm: AnyArm) -> float:
    """Return the force [N] at the tip of the stretched arm that takes the whole torque of the first motor."""
    if isinstance(arm, Robot):
        return float(arm.drive("torque_limit")[0] / reach(arm))
    return arm.torque_limit[0] / sum(arm.length)


def mass_of(arm: AnyArm) -> float:
    """Return the mass of all links [kg]."""
    return float(sum(arm.arrays.mass)) if isinstance(arm, Robot) else sum(arm.mass)


@dataclasses.dataclass(frozen=True)
class AdaptiveWeights:
    """What the filter expects and what the regulator weighs.

    Attributes:
        link_angle: link error [rad] that costs as much as the whole torque.
        link_velocity: link velocity error [rad/s] that costs as much as the whole torque.
        first_gain: share of the regulator's gain with which an episode begins.
        soft_start: how long it is that share [s], which then grows to 1 in as long again.
        motor_torque: white noise of the motor torque, share of the torque limit times √s.
        torque_doubt: share of the torque limit by which a motor's torque may be wrong after a jump of the commanded
            torque by the whole limit; it grows with the square of the jump.
        travel_walk: random walk of the force along the path, share of the unit force per √s.
        force_walk: random walk of each component of the free force, likewise.
        calm_walk: share of these walks that the forces make where nothing but noise corrects them.
        reopening: time of walk that a force is given at once where it begins to move [s].
        encoder_angle: standard deviation of a measured angle [rad].
        encoder_velocity: standard deviation of a measured velocity [rad/s].
        first_force: standard deviation of each force when an episode begins, share of the unit force.
        first_payload: of the payload at the tip, share of the mass of all links.
        first_stiffness: of the factors of joint stiffness.
        first_damping: of the factors of joint damping.
        first_friction: of the factors of dry friction.
        first_inertia: of the factors of link masses and of motor inertias.
        first_offset: of the torques beside the motors', share of the torque limit.
        first_scale: of a factor that all of the arm's constants share, as a wrong torque constant gives them.
        first_lateness: of the lateness [control periods].
        first_link_angle: of the link angles [rad].
        scale_doubt: variance that a sample of surprise a adds to that factor, over a.
        gate: squared standardised innovation above which a sample counts less.
        dead_zone: squared innovation, in variances of the noise that is read, below which constants do not learn.
        largest_swing: mean of the commands' jumps, as shares of the torque limits, from which on the loop counts as
            lost; a mean above 2 is not possible.

    Raises:
        TypeError: a weight is no number.
        ValueError: a weight lies outside `WEIGHT_RANGE`.
    """

    link_angle: float = 0.0037
    link_velocity: float = 1.57
    first_gain: float = 0.5
    soft_start: float = 0.015
    motor_torque: float = 4.9e-4
    torque_doubt: float = 0.4
    travel_walk: float = 1.5
    force_walk: float = 0.59
    calm_walk: float = 0.33
    reopening: float = 0.29
    encoder_angle: float = 2e-5
    encoder_velocity: float = 2.1e-3
    first_force: float = 2e-3
    first_payload: float = 0.125
    first_stiffness: float = 0.12
    first_damping: float = 0.3
    first_friction: float = 0.3
    first_inertia: float = 0.06
    first_offset: float = 0.01
    first_scale: float = 0.1
    first_lateness: float = 1.5
    first_link_angle: float = 1e-3
    scale_doubt: float = 1.5e-3
    gate: float = 1.5
    dead_zone: float = 16.0
    largest_swing: float = 0.5

    def __post_init__(self) -> None:
        """Check the weights."""
        low, high = WEIGHT_RANGE
        for field in dataclasses.fields(self):
            real(f"AdaptiveWeights.{field.name}", getattr(self, field.name), low=low, high=high)


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
