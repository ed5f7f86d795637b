"""The motion that a robot makes along a path with a name: the circle, if no other is asked of it.

The two-joint arm has the paths of `PAPER_PATHS`, as a `Robot` too, wherever it can follow them; the circle is the
paper's, in the paper's 1.5 s whatever the arm's motors. Any other arm draws the path of that name in its home posture:
in the plane of a planar robot; otherwise upright and facing the base, across the horizontal direction from the base to
the tip. The circle and the square begin and end there, at their lowest point; the lemniscate and the line have their
middle there. Half of the width is the largest of `SIZES` that the robot can follow with the orientation of its last
link kept. The duration is the shortest multiple of 0.1 s from 1.5 s on for which every joint turns at no more than half
of its velocity limit, and every motor, on the rigid robot, needs no more than half of its torque limit.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from fuzzyarm.common.checks import choice
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import chain, freedom, home_posture, reach, velocity_limits
from fuzzyarm.envs.scenario.paths import PAPER_PATHS, SHAPES, Placed
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference, Reference, joint_angles
from fuzzyarm.envs.scenario.robot_reference import EXACT, TipReference

__all__ = ["LONGEST", "default_reference", "flattened", "is_placed", "timed"]

SIZES = (0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01)  # half of the width, share of the robot's reach
SHORTEST, STEP = 1.5, 0.1  # s
LONGEST = 60.0
"""The longest duration of the rule [s]."""
SHARE = 0.5  # of the limits


def default_reference(robot: Robot | ArmParameters, path: str = "circle") -> Reference:
    """Return the motion of the module's rule along a path of `SHAPES`; the two-joint arm may be given in either way.

    Raises:
        ValueError: there is no path of this name, or the robot can follow none of any size, or not even slowly.
    """
    choice("path", path, tuple(SHAPES))
    if isinstance(robot, Robot):
        return _papers(robot, path) or _fitted(robot, path)
    return _in_plane(robot, path)


@functools.lru_cache(maxsize=64)
def _in_plane(arm: ArmParameters, name: str) -> JointReference:
    """Return the motion of the two-joint arm."""
    try:
        if name == "circle":
            return JointReference(parameters=arm)
        slow = JointReference(PAPER_PATHS[name], LONGEST, parameters=arm)
        return JointReference(slow.path, _shortest(slow, robot_of(arm)), parameters=arm)
    except ValueError:
        return flattened(_fitted(robot_of(arm), name), arm)


def is_placed(reference: Reference) -> bool:
    """Return whether a motion of the two-joint arm is placed and timed for one arm alone, by no number of its links."""
    return isinstance(reference, JointReference) and isinstance(reference.path, Placed)


def flattened(reference: TipReference, arm: ArmParameters) -> JointReference:
    """Return the reference of a two-joint arm, as a robot in space, as one of the arm in its plane.

    Raises:
        ValueError: the arm cannot follow it.
    """
    placed = reference.path
    assert isinstance(placed, Placed)
    parts = (tuple(getattr(placed, name)[:2]) for name in ("origin", "first", "second"))
    elbow = 1 if float(reference.sample(0.0).q[-1]) > 0.0 else -1
    return JointReference(Placed(placed.path, *parts), reference.duration, elbow, arm)


@functools.lru_cache(maxsize=64)
def _papers(robot: Robot, name: str) -> TipReference | None:
    """Return the motion of the paper's arm for a robot with the joint frames of `Robot.of`; None for any other."""
    if len(robot) != len(ArmParameters().length):
        return None
    lengths = float(np.linalg.norm(robot.arrays.position[1])), float(np.linalg.norm(robot.arrays.tip))
    path = Placed(PAPER_PATHS[name], (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    start = path.points(0.0)[0]
    paper = JointReference()
    posture = joint_angles(start[:2], lengths, paper.elbow_sign)
    if not np.abs(chain(robot, posture).tip - start).max() <= EXACT:  # nan: out of reach
        return None
    try:
        slow = TipReference(path, LONGEST, robot, tuple(posture.tolist()))
        return dataclasses.replace(slow, duration=paper.duration) if name == "circle" else timed(slow)
    except ValueError:  # it leaves the reach later on, or the motors are too weak
        return None


@functools.lru_cache(maxsize=64)
def _fitted(robot: Robot, name: str) -> TipReference:
    """Return the path of a name in the largest size that the robot can follow from its home posture."""
    tip = chain(robot, np.array(home_posture(robot))).tip
    first, second = _plane(robot, tip)
    reason: ValueError | None = None
    for share in SIZES:
        shape = SHAPES[name](share * reach(robot))
        path = Placed(shape, tuple(tip.tolist()), tuple((first + 0.0).tolist()), tuple((second + 0.0).tolist()))
        try:
            return timed(TipReference(path, LONGEST, robot))
        except ValueError as error:
            reason = error
    raise ValueError(
        f"{robot.name} cannot follow a {name} at its home posture; give a reference=, or other limits of its joints "
        f"(joint_limit, velocity_limit, torque_limit): {reason}"
    )


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


def timed(slow: TipReference) -> TipReference:
    """Return a reference of the duration `LONGEST` with the duration of the rule.

    Raises:
        ValueError: a motor is too weak, or the robot too slow.
    """
    return TipReference(slow.path, _shortest(slow, slow.robot), slow.robot, slow.posture)


def _shortest(slow: Reference, robot: Robot) -> float:
    """Return the duration of the rule [s] for the motion of a reference of the duration `LONGEST`."""
    torque_limit = robot.drive("torque_limit")
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
            return round(duration, 1)
    raise ValueError(
        f"{robot.name} passes half of a torque or velocity limit even in {LONGEST:g} s: raise torque_limit or "
        "velocity_limit, or give a reference="
    )
