"""The tracking task at one instant: tip position, tip error, reward, and whether the episode terminates.

Elementwise source, see `elementwise`: the same code assesses one arm, a batch and tensors.
"""

from __future__ import annotations

import functools
from typing import Any

from numba.extending import register_jitable

from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import over_joints, per_joint, point, record_type

__all__ = [
    "EFFORT_WEIGHT",
    "TRACKING_LENGTH",
    "assess_of",
    "assessment_record",
    "clipped",
    "finite_of",
    "target_record",
]

TRACKING_LENGTH = 0.005  # m; the tip error at which the tracking reward is one half [a choice, no source]
BEYOND_MEASURE = 1e13  # rad, rad/s; beyond about this, `sine_cosine` is meaningless and products overflow
EFFORT_WEIGHT = 0.1  # share of the reward that full torque takes away [a choice, no source]


@functools.cache
def target_record(axes: int) -> Any:
    """Return the record of the tip's target: its reference [m], a unit normal to the curve, a circle [m].

    The radius is 0 for a curve that is no circle.
    """
    kind = point(axes)
    return record_type("Target", position=kind, normal=kind, center=kind, radius=Any)


@functools.cache
def assessment_record(joints: int, axes: int) -> Any:
    """Return the record of what `assess_of` finds; lengths in m, torques in N m, the flags 0.0 or 1.0."""
    return record_type(
        "Assessment",
        tip=point(axes),
        friction_torque=per_joint(joints),
        tip_error=Any,
        circularity_error=Any,
        circularity_error_motor=Any,
        reward_tracking=Any,
        reward_effort=Any,
        reward=Any,
        angles_inside=Any,
        velocities_inside=Any,
    )


@functools.cache
def assess_of(physics: Physics) -> Any:
    """Return the compiled ``assess(state, torque, bias, arm, limits, target)``.

    It assesses an arm under the controller's (clipped) torques and the biases that act beside them [N m]:

    reward = tracking (1 - 0.1 effort), tracking = 1 / (1 + |tip - reference| / 5 mm),
    effort = mean over the joints of (Γ/Γ_max)².
    """
    PerJoint, Assessment = physics.PerJoint, assessment_record(physics.joints, physics.axes)
    tip_point, motor_friction, angle_range = physics.tip, physics.motor_friction, physics.angle_range
    distance, deviation = _distance_of(physics.axes), _deviation_of(physics.axes)
    squares, inside = over_joints(_square_share, PerJoint, 2), over_joints(_between, PerJoint, 3, "&")
    slow, share = over_joints(_within, PerJoint, 2, "&"), 1.0 / physics.joints

    @register_jitable(forceinline=True)
    def assess(state: Any, torque: Any, bias: Any, arm: Any, limits: Any, target: Any) -> Any:
        tip = tip_point(state.link, arm)
        error = distance(tip, target.position)
        tracking, effort = 1.0 / (1.0 + error / TRACKING_LENGTH), share * squares(torque, limits.torque)
        low, high = angle_range(limits)
        return Assessment(
            tip,
            motor_friction(state, torque, bias, arm),
            error,
            deviation(tip, target),
            deviation(tip_point(state.motor, arm), target),
            tracking,
            effort,
            tracking * (1.0 - EFFORT_WEIGHT * effort),
            1.0 * (inside(state.motor, low, high) & inside(state.link, low, high)),
            1.0 * (slow(state.motor_velocity, limits.velocity) & slow(state.link_velocity, limits.velocity)),
        )

    return assess


@register_jitable(forceinline=True)
def clipped(torque: Any, limit: Any) -> Any:
    """Return the torque within ± limit; exact."""
    return torque * (abs(torque) <= limit) + limit * (torque > limit) - limit * (torque < -limit)


@functools.cache
def finite_of(physics: Physics) -> Any:
    """Return the compiled ``finite(state)``.

    It is 1.0 if the state is finite and small enough that everything computed from it is finite, else 0.0.
    """
    sizes = over_joints(_size, physics.PerJoint, 1)

    @register_jitable(forceinline=True)
    def finite(state: Any) -> Any:
        motors, links = sizes(state.motor) + sizes(state.motor_velocity), sizes(state.link) + sizes(state.link_velocity)
        return 1.0 * (motors + links < BEYOND_MEASURE)

    return finite


@functools.cache
def _distance_of(axes: int) -> Any:
    """Return the compiled ``distance(a, b)`` of two points."""
    squares = over_joints(_square_difference, point(axes), 2)

    @register_jitable(forceinline=True)
    def distance(a: Any, b: Any) -> Any:
        return root(squares(a, b))

    return distance


@functools.cache
def _deviation_of(axes: int) -> Any:
    """Return the compiled ``deviation(tip, target)``, the signed distance of a tip [m] from the curve.

    Outwards positive for a circle, else the component along the curve's normal.
    """
    distance, along = _distance_of(axes), over_joints(_component, point(axes), 3)

    @register_jitable(forceinline=True)
    def deviation(tip: Any, target: Any) -> Any:
        is_circle = 1.0 * (target.radius > 0.0)
        outwards = distance(tip, target.center) - target.radius
        sideways = along(tip, target.position, target.normal)
        return is_circle * outwards + (1.0 - is_circle) * sideways

    return deviation


@register_jitable(forceinline=True)
def _square_share(torque: Any, limit: Any) -> Any:
    share = torque / limit
    return share * share


@register_jitable(forceinline=True)
def _square_difference(a: Any, b: Any) -> Any:
    return (a - b) * (a - b)


@register_jitable(forceinline=True)
def _component(a: Any, b: Any, normal: Any) -> Any:
    return (a - b) * normal


@register_jitable(forceinline=True)
def _between(value: Any, low: Any, high: Any) -> Any:
    return (value >= low) & (value <= high)


@register_jitable(forceinline=True)
def _within(value: Any, limit: Any) -> Any:
    return abs(value) <= limit


@register_jitable(forceinline=True)
def _size(value: Any) -> Any:
    return abs(value)
