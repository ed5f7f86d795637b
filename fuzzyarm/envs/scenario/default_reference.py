"""The motion that a robot makes if no other is asked of it.

The two-joint arm has the paper's circle, as a `Robot` too. Any other robot draws a circle that begins and ends in its
home posture, at the circle's lowest point: in the plane of a planar robot; otherwise upright and facing the base,
across the horizontal direction from the base to the tip. Its radius is the largest of `SIZES` that the robot can follow
with the orientation of its last link kept. Its duration is the shortest multiple of 0.1 s from 1.5 s on for which every
joint turns at no more than half of its velocity limit, and every motor, on the rigid robot, needs no more than half of
its torque limit.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.home import home_posture
from fuzzyarm.envs.scenario.inverse_kinematics import freedom
from fuzzyarm.envs.scenario.kinematics import chain, reach, velocity_limits
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.placed import Placed
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference, Reference, joint_angles
from fuzzyarm.envs.scenario.tip_reference import EXACT, TipReference

__all__ = ["default_reference"]

SIZES = (0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01)  # radius, share of the robot's reach
SHORTEST, STEP, LONGEST = 1.5, 0.1, 60.0  # s
SHARE = 0.5  # of the limits


def default_reference(robot: Robot | ArmParameters) -> Reference:
    """Return the motion of the module's rule; the two-joint arm may be given as a robot or by its parameters.

    Raises:
        ValueError: the robot can follow none of the circles, or not even slowly.
    """
    if isinstance(robot, ArmParameters):
        return JointReference(parameters=robot)
    return _papers_circle(robot) or _circle(robot)


@functools.lru_cache(maxsize=64)
def _papers_circle(robot: Robot) -> TipReference | None:
    """Return the paper's motion for a robot with the joint frames of `Robot.of`; None for any other."""
    if len(robot) != len(ArmParameters().length):
        return None
    lengths = float(np.linalg.norm(robot.arrays.position[1])), float(np.linalg.norm(robot.arrays.tip))
    paper = JointReference()
    path = Placed(paper.path, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    start = path.points(0.0)[0]
    posture = joint_angles(start[:2], lengths, paper.elbow_sign)
    if not np.abs(chain(robot, posture).tip - start).max() <= EXACT:  # nan: out of reach
        return None
    return TipReference(path, paper.duration, robot, tuple(posture.tolist()))


@functools.lru_cache(maxsize=64)
def _circle(robot: Robot) -> TipReference:
    """Return the circle of a robot in space."""
    tip = chain(robot, np.array(home_posture(robot))).tip
    first, second = _plane(robot, tip)
    reason: ValueError | None = None
    for share in SIZES:
        radius = share * reach(robot)
        bottom = Circle(center=(radius, 0.0), radius=radius, start_angle=math.pi, turns=1.0)
        path = Placed(bottom, tuple(tip.tolist()), tuple((first + 0.0).tolist()), tuple((second + 0.0).tolist()))
        try:
            return _timed(TipReference(path, LONGEST, robot))
        except ValueError as error:
            reason = error
    raise ValueError(f"{robot.name} cannot follow a circle at its home posture; give a reference=: {reason}")


def _plane(robot: Robot, tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit vectors upwards and sideways of the plane of the circle."""
    motion = freedom(robot).motion
    pull = robot.arrays.gravity
    if len(motion) < len(tip):  # a planar robot: upwards in its plane, if there is such a direction
        first = -(pull @ motion.T) @ motion
        first = first / np.linalg.norm(first) if np.linalg.norm(first) > 0.0 else motion[0]
        inside = motion - np.outer(motion @ first, first)
        second = inside[np.argmax(np.linalg.norm(inside, axis=1))]
        return first, second / np.linalg.norm(second)
    up = -pull / np.linalg.norm(pull) if pull.any() else np.array([0.0, 0.0, 1.0])
    outward = tip - robot.arrays.position[0]
    outward = outward - (outward @ up) * up
    if np.linalg.norm(outward) < 0.05 * reach(robot):
        outward = np.eye(3)[np.argmin(np.abs(up))]
    side = np.cross(up, outward)
    return up, side / np.linalg.norm(side)


def _timed(slow: TipReference) -> TipReference:
    """Return the reference with the duration of the rule."""
    robot, torque_limit = slow.robot, slow.robot.drive("torque_limit")
    q, dq, ddq = slow.sample(np.linspace(0.0, slow.duration, CHECKED_INSTANTS))
    weight = inverse_dynamics(robot, q, np.zeros_like(dq), np.zeros_like(dq))
    moving = inverse_dynamics(robot, q, dq, ddq) - weight + robot.drive("motor_inertia") * ddq
    speed = float(np.max(np.abs(dq) / velocity_limits(robot)))
    held = np.max(np.abs(weight) / torque_limit, axis=0)
    if held.max() > SHARE:
        joint = robot.joints[int(np.argmax(held))].name
        raise ValueError(
            f"{robot.name} needs {100.0 * held.max():.3g} % of the torque limit of {joint} "
            f"to hold its weight; allowed: {100.0 * SHARE:g} %. Raise the torque_limit, or give a reference="
        )
    for number in range(round(SHORTEST / STEP), round(LONGEST / STEP) + 1):
        duration = number * STEP
        faster = slow.duration / duration  # velocities grow with it, inertial and centrifugal torques with its square
        torque = np.abs(weight + faster**2 * moving) / torque_limit
        if faster * speed <= SHARE and torque.max() <= SHARE:
            return TipReference(slow.path, round(duration, 1), robot)
    raise ValueError(
        f"{robot.name} passes half of a torque or velocity limit even in {LONGEST:g} s: raise torque_limit or "
        "velocity_limit, or give a reference="
    )
