"""The tracking task at one instant: tip position, tip error, reward, and whether the episode terminates.

Elementwise source, see `elementwise`: the same code assesses one arm, a batch and tensors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import Arm, State
from fuzzyarm.envs.physics.elementwise import root
from fuzzyarm.envs.physics.readings import (
    link_angles,
    link_velocities,
    motor_angles,
    motor_friction,
    motor_velocities,
    tip_point,
)
from fuzzyarm.envs.physics.records import PerJoint, Point

__all__ = [
    "EFFORT_WEIGHT",
    "TRACKING_LENGTH",
    "Assessment",
    "Limits",
    "Target",
    "assess",
    "clipped",
    "finite",
]

TRACKING_LENGTH = 0.005  # m; the tip error at which the tracking reward is one half [a choice, no source]
BEYOND_MEASURE = 1e13  # rad, rad/s; beyond about this, `sine_cosine` is meaningless and products overflow
EFFORT_WEIGHT = 0.1  # share of the reward that full torque takes away [a choice, no source]


class Target(NamedTuple):
    """The target of the tip: its reference [m], the curve's unit normal, the circle's center and radius [m].

    The radius is 0 for a curve that is no circle.
    """

    position: Point
    normal: Point
    center: Point
    radius: Any


class Limits(NamedTuple):
    """Limits of the joint angles [rad], of their velocities [rad/s] and of the motor torques [N m]."""

    angle: PerJoint
    velocity: PerJoint
    torque: PerJoint


class Assessment(NamedTuple):
    """What `assess` finds; lengths in m, torques in N m, the flags 0.0 or 1.0."""

    tip: Point
    friction_torque: PerJoint
    tip_error: Any
    circularity_error: Any
    circularity_error_motor: Any
    reward_tracking: Any
    reward_effort: Any
    reward: Any
    angles_inside: Any
    velocities_inside: Any


@register_jitable(forceinline=True)
def assess(state: State, torque: PerJoint, bias: PerJoint, arm: Arm, limits: Limits, target: Target) -> Assessment:
    """Assess an arm under the controller's (clipped) torques and the biases that act beside them [N m].

    reward = tracking (1 - 0.1 effort), tracking = 1 / (1 + |tip - reference| / 5 mm),
    effort = ((Γ_1/Γ_1max)² + (Γ_2/Γ_2max)²) / 2.
    """
    motor, link = motor_angles(state), link_angles(state)
    tip = tip_point(link, arm)
    error = _norm(tip.x - target.position.x, tip.y - target.position.y)
    tracking, effort = 1.0 / (1.0 + error / TRACKING_LENGTH), _effort(torque, limits.torque)
    return Assessment(
        tip,
        motor_friction(state, torque, bias, arm),
        error,
        _deviation(tip, target),
        _deviation(tip_point(motor, arm), target),
        tracking,
        effort,
        tracking * (1.0 - EFFORT_WEIGHT * effort),
        1.0 * (_within(motor, limits.angle) & _within(link, limits.angle)),
        1.0 * (_within(motor_velocities(state), limits.velocity) & _within(link_velocities(state), limits.velocity)),
    )


@register_jitable(forceinline=True)
def clipped(torque: Any, limit: Any) -> Any:
    """Return the torque within ± limit; exact."""
    return torque * (abs(torque) <= limit) + limit * (torque > limit) - limit * (torque < -limit)


@register_jitable(forceinline=True)
def finite(state: State) -> Any:
    """Return 1.0 if the state is finite and small enough that everything computed from it is finite, else 0.0."""
    motors = _sizes(motor_angles(state), motor_velocities(state))
    return 1.0 * (motors + _sizes(link_angles(state), link_velocities(state)) < BEYOND_MEASURE)


@register_jitable(forceinline=True)
def _deviation(tip: Point, target: Target) -> Any:
    """Return the signed distance of a tip [m] from the curve.

    Outwards positive for a circle, else the component along the curve's left normal.
    """
    is_circle = 1.0 * (target.radius > 0.0)
    outwards = _norm(tip.x - target.center.x, tip.y - target.center.y) - target.radius
    sideways = (tip.x - target.position.x) * target.normal.x + (tip.y - target.position.y) * target.normal.y
    return is_circle * outwards + (1.0 - is_circle) * sideways


@register_jitable(forceinline=True)
def _effort(torque: PerJoint, limit: PerJoint) -> Any:
    """Return the mean over the joints of (Γ/Γ_max)²."""
    share1, share2 = torque[0] / limit[0], torque[1] / limit[1]
    return 0.5 * (share1 * share1 + share2 * share2)


@register_jitable(forceinline=True)
def _within(values: PerJoint, limit: PerJoint) -> Any:
    """Return whether every joint is within its limit."""
    return (abs(values[0]) <= limit[0]) & (abs(values[1]) <= limit[1])


@register_jitable(forceinline=True)
def _norm(x: Any, y: Any) -> Any:
    return root(x * x + y * y)


@register_jitable(forceinline=True)
def _sizes(angle: PerJoint, velocity: PerJoint) -> Any:
    return abs(angle[0]) + abs(angle[1]) + abs(velocity[0]) + abs(velocity[1])
