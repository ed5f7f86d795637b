"""The tracking task at one instant: where the tip is, how far off, what that is worth, and whether the episode goes on.

Elementwise source, see `elementwise`: one arm, a batch and tensors are measured by the same lines.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba.extending import register_jitable

from fuzzyarm.envs.physics.dynamics import Arm, State, joint_torque
from fuzzyarm.envs.physics.elementwise import root, sine_cosine
from fuzzyarm.envs.physics.friction import friction_torque

TRACKING_LENGTH = 0.005  # m; the tip error at which the tracking reward is one half [a choice, no source]
BEYOND_MEASURE = 1e13  # rad, rad/s; from about here on `sine_cosine` is nonsense and products overflow
EFFORT_WEIGHT = 0.1  # share of the reward that full torque takes away [a choice, no source]


class Target(NamedTuple):
    """What the tip is compared with: its reference [m], the curve's unit normal, the circle's center and radius [m].

    The radius is 0 for a curve that is no circle.
    """

    x: Any
    y: Any
    normal_x: Any
    normal_y: Any
    center_x: Any
    center_y: Any
    radius: Any


class Limits(NamedTuple):
    """Limits of the joint angles [rad], of their velocities [rad/s] and of the motor torques [N m]."""

    angle1: Any
    angle2: Any
    velocity1: Any
    velocity2: Any
    torque1: Any
    torque2: Any


class Assessment(NamedTuple):
    """What `assess` finds; lengths in m, torques in N m, the flags 0.0 or 1.0."""

    tip_x: Any
    tip_y: Any
    friction_torque1: Any
    friction_torque2: Any
    tip_error: Any
    circularity_error: Any
    circularity_error_motor: Any
    reward_tracking: Any
    reward_effort: Any
    reward: Any
    angles_inside: Any
    velocities_inside: Any


@register_jitable(forceinline=True)
def assess(
    state: State, torque1: Any, torque2: Any, bias1: Any, bias2: Any, arm: Arm, limits: Limits, target: Target
) -> Assessment:
    """Measure an arm under the controller's (clipped) torques and the biases that act beside them [N m].

    reward = tracking (1 - 0.1 effort), tracking = 1 / (1 + |tip - reference| / 5 mm),
    effort = ((Γ_1/Γ_1max)² + (Γ_2/Γ_2max)²) / 2.
    """
    tip_x, tip_y, deviation = _tip_and_deviation(state.link1, state.link2, arm, target)
    _, _, motor_deviation = _tip_and_deviation(state.motor1, state.motor2, arm, target)
    joint1, joint2 = joint_torque(state, arm)
    net1, net2 = torque1 + bias1 - joint1, torque2 + bias2 - joint2
    error = _norm(tip_x - target.x, tip_y - target.y)
    effort1, effort2 = torque1 / limits.torque1, torque2 / limits.torque2
    tracking, effort = 1.0 / (1.0 + error / TRACKING_LENGTH), 0.5 * (effort1 * effort1 + effort2 * effort2)
    inside1 = (abs(state.motor1) <= limits.angle1) & (abs(state.link1) <= limits.angle1)
    inside2 = (abs(state.motor2) <= limits.angle2) & (abs(state.link2) <= limits.angle2)
    slow1 = (abs(state.motor_velocity1) <= limits.velocity1) & (abs(state.link_velocity1) <= limits.velocity1)
    slow2 = (abs(state.motor_velocity2) <= limits.velocity2) & (abs(state.link_velocity2) <= limits.velocity2)
    return Assessment(
        tip_x,
        tip_y,
        friction_torque(state.motor_velocity1, net1, arm.coulomb1, arm.static1, arm.stribeck_velocity),
        friction_torque(state.motor_velocity2, net2, arm.coulomb2, arm.static2, arm.stribeck_velocity),
        error,
        deviation,
        motor_deviation,
        tracking,
        effort,
        tracking * (1.0 - EFFORT_WEIGHT * effort),
        1.0 * (inside1 & inside2),
        1.0 * (slow1 & slow2),
    )


@register_jitable(forceinline=True)
def clipped(torque: Any, limit: Any) -> Any:
    """Return the torque within ± limit; exact."""
    return torque * (abs(torque) <= limit) + limit * (torque > limit) - limit * (torque < -limit)


@register_jitable(forceinline=True)
def finite(state: State) -> Any:
    """Return 1.0 if the numbers of the state are finite, and small enough that whatever is measured is; else 0.0."""
    motors = abs(state.motor1) + abs(state.motor2) + abs(state.motor_velocity1) + abs(state.motor_velocity2)
    links = abs(state.link1) + abs(state.link2) + abs(state.link_velocity1) + abs(state.link_velocity2)
    return 1.0 * (motors + links < BEYOND_MEASURE)


@register_jitable(forceinline=True)
def _tip_and_deviation(q1: Any, q2: Any, arm: Arm, target: Target) -> tuple[Any, Any, Any]:
    """Return the tip (x, y) [m] at joint angles [rad] and its signed distance from the curve [m].

    Outwards positive for a circle, else the component along the curve's left normal.
    """
    sin1, cos1 = sine_cosine(q1)
    sin12, cos12 = sine_cosine(q1 + q2)
    x = arm.length1 * cos1 + arm.length2 * cos12
    y = arm.length1 * sin1 + arm.length2 * sin12
    is_circle = 1.0 * (target.radius > 0.0)
    outwards = _norm(x - target.center_x, y - target.center_y) - target.radius
    sideways = (x - target.x) * target.normal_x + (y - target.y) * target.normal_y
    return x, y, is_circle * outwards + (1.0 - is_circle) * sideways


@register_jitable(forceinline=True)
def _norm(x: Any, y: Any) -> Any:
    return root(x * x + y * y)
