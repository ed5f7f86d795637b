"""Checks of a motion against the joints of a robot: where a limit is passed, at which joint, and by how much."""

from __future__ import annotations

import math

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import angle_ranges, velocity_limits

__all__ = ["check_angles", "check_velocities", "checked_angles"]


def checked_angles(name: str, values: object, robot: Robot) -> tuple[float, ...]:
    """Return one angle [rad] for each joint, each within the joint's range.

    Raises:
        TypeError: they are no sequence of real numbers.
        ValueError: there are more or fewer than joints, or one leaves its range.
    """
    angles = checks.reals(name, values, len(robot), "rad")
    for angle, joint in zip(angles, robot.joints, strict=True):
        low, high = joint.angle_range
        if not low <= angle <= high:
            raise ValueError(
                f"{name}: {joint.name} = {angle:.6g} rad is out of range; allowed: [{low:.6g}, {high:.6g}] rad"
            )
    return angles


def check_angles(robot: Robot, t: np.ndarray, q: np.ndarray, advice: str) -> None:
    """Raise ValueError if an angle leaves its joint's range.

    Args:
        robot: the robot.
        t: times (k,) [s].
        q: angles (k, n) [rad] at these times.
        advice: the way out, the end of the message.
    """
    low, high = angle_ranges(robot)
    beyond = np.maximum(q - high, low - q)
    k, number = np.unravel_index(np.argmax(beyond), beyond.shape)
    if beyond[k, number] > 0.0:
        joint, first = robot.joints[number], int(np.argmax(beyond[:, number] > 0.0))
        raise ValueError(
            f"{joint.name} leaves its range at t = {t[first]:.4g} s, and by {beyond[k, number]:.3g} rad at t = "
            f"{t[k]:.4g} s, where it is {q[k, number]:.6g} rad; allowed: [{low[number]:.6g}, {high[number]:.6g}] rad. "
            f"{advice}"
        )


def check_velocities(robot: Robot, t: np.ndarray, dq: np.ndarray, duration: float) -> None:
    """Raise ValueError if a velocity passes its joint's limit; the message names the shortest duration that fits.

    Args:
        robot: the robot.
        t: times (k,) [s].
        dq: velocities (k, n) [rad/s] at these times, which go with 1/duration.
        duration: T [s].
    """
    limits = velocity_limits(robot)
    share = np.abs(dq) / limits
    k, number = np.unravel_index(np.argmax(share), share.shape)
    if share[k, number] > 1.0:
        needed = math.ceil(duration * share[k, number] * 1000.0) / 1000.0
        raise ValueError(
            f"{robot.joints[number].name} turns at {dq[k, number]:.6g} rad/s at t = {t[k]:.4g} s, "
            f"{100.0 * (share[k, number] - 1.0):.3g} % beyond its velocity limit; allowed: [-{limits[number]:g}, "
            f"{limits[number]:g}] rad/s. Raise duration = {duration:g} s to {needed:.3f} s or more"
        )
