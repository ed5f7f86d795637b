"""The motion of a robot along a named path, by default the circle.

The two-joint arm, also as a `Robot`, uses the paths of `PAPER_PATHS` if it can follow them; its circle is the paper's
and takes 1.5 s, whatever the motors. Any other arm follows the path of that name at the tip of its home posture: a
planar robot in its plane; another robot in the vertical plane perpendicular to the horizontal direction from
the base to the tip. The circle and the square begin and end at this tip, their lowest point; the lemniscate and the
line have their middle there. Half of the path's width is the largest of `_SIZES` that the robot can follow while its
last link keeps its orientation. The duration is the shortest multiple of 0.1 s from 1.5 s on for which every joint
turns at no more than half of its velocity limit, and every motor of the rigid robot needs no more than half of its
torque limit.
"""

import dataclasses
import functools
import math

import numpy as np

from fuzzyarm.common.checks import choice
from fuzzyarm.envs.physics.equations import AnyArm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import frames, inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import angle_ranges, freedom, home_posture, reach, upwards, velocity_limits
from fuzzyarm.envs.scenario.paths import PAPER_PATHS, SHAPES, Circle, Lemniscate, Line, Placed, TipPath
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference, Reference, joint_angles
from fuzzyarm.envs.scenario.robot_reference import EXACT, SplineReference, TipReference

__all__ = ["LONGEST", "default_reference", "flattened", "is_placed", "reference_family", "timed"]

_SIZES = (0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01)  # half of the width, share of the robot's reach
_SHORTEST, _STEP = 1.5, 0.1  # s
LONGEST = 60.0  # the longest duration that the rule allows [s]
_SHARE = 0.5  # of the limits


def default_reference(robot: Robot | ArmParameters, path: str = "circle") -> Reference:
    """Return the motion by the module's rule along a path of `SHAPES`; the two-joint arm may be of either type.

    Raises:
        ValueError: the path is unknown, or the robot cannot follow it in any size or at any speed.
    """
    choice("path", path, tuple(SHAPES))
    if isinstance(robot, Robot):
        return _papers(robot, path) or _fitted(robot, path)
    return _in_plane(robot, path)


@functools.lru_cache(maxsize=64)
def _in_plane(arm: ArmParameters, name: str) -> JointReference:
    try:
        if name == "circle":
            return JointReference(parameters=arm)
        slow = JointReference(PAPER_PATHS[name], LONGEST, parameters=arm)
        return JointReference(slow.path, _shortest(slow, robot_of(arm)), parameters=arm)
    except ValueError:
        return flattened(_fitted(robot_of(arm), name), arm)


def is_placed(reference: Reference) -> bool:
    """Return whether a motion was placed and timed for one two-joint arm, so that no other arm can share it."""
    return isinstance(reference, JointReference) and isinstance(reference.path, Placed)


def flattened(reference: TipReference, arm: ArmParameters) -> JointReference:
    """Convert a motion of the two-joint arm as a `Robot`, on a path (x, y, z), into one of `arm` on a path (x, y)."""
    placed = reference.path
    assert isinstance(placed, Placed)
    parts = (tuple(getattr(placed, name)[:2]) for name in ("origin", "first", "second"))
    elbow = 1 if float(reference.sample(0.0).q[-1]) > 0.0 else -1
    return JointReference(Placed(placed.path, *parts), reference.duration, elbow, arm)


@functools.lru_cache(maxsize=64)
def _papers(robot: Robot, name: str) -> TipReference | None:
    """Return the paper's motion along a named path.

    None: the robot cannot follow it, or is no two-joint arm with the frames of `Robot.of`.
    """
    if len(robot) != len(ArmParameters().length):
        return None
    lengths = float(np.linalg.norm(robot.arrays.position[1])), float(np.linalg.norm(robot.arrays.tip))
    path = Placed(PAPER_PATHS[name], (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    start = path.points(0.0)[0]
    paper = JointReference()
    posture = joint_angles(start[:2], lengths, paper.elbow_sign)
    if not np.abs(frames(robot, posture).tip - start).max() <= EXACT:  # nan: out of reach
        return None
    try:
        slow = TipReference(path, LONGEST, robot, tuple(posture.tolist()))
        return dataclasses.replace(slow, duration=paper.duration) if name == "circle" else timed(slow)
    except ValueError:  # it leaves the reach later on, or the motors are too weak
        return None


@functools.lru_cache(maxsize=64)
def _fitted(robot: Robot, name: str) -> TipReference:
    """Return the motion along a named path in the largest size that the robot can follow from its home posture."""
    tip = frames(robot, np.array(home_posture(robot))).tip
    place = [tuple((vector + 0.0).tolist()) for vector in (tip, *_plane(robot, tip))]
    reason: ValueError | None = None
    for share in _SIZES:
        path = Placed(SHAPES[name](share * reach(robot)), *place)
        try:
            return timed(TipReference(path, LONGEST, robot))
        except ValueError as error:
            reason = error
    raise ValueError(
        f"{robot.name} cannot follow a {name} at its home posture; give a `reference`, or change the limits of its "
        f"joints (joint_limit, velocity_limit, torque_limit). The reason: {reason}"
    )


def _plane(robot: Robot, tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (3,) upwards and sideways in the plane of a path at the tip (3,) [m]."""
    motion = freedom(robot).motion
    pull = robot.arrays.gravity
    if len(motion) < len(tip):  # a planar robot: upwards in its plane, if there is such a direction
        first = -(pull @ motion.T) @ motion
        first = first / np.linalg.norm(first) if np.linalg.norm(first) > 0.0 else motion[0]
        inside = motion - np.outer(motion @ first, first)
        second = inside[np.argmax(np.linalg.norm(inside, axis=1))]
        return first, second / np.linalg.norm(second)
    up = upwards(robot)
    outward = tip - robot.arrays.position[0]
    outward = outward - (outward @ up) * up
    if np.linalg.norm(outward) < 0.05 * reach(robot):
        outward = np.eye(3)[np.argmin(np.abs(up))]
    side = np.cross(up, outward)
    return up, side / np.linalg.norm(side)


def timed(slow: TipReference) -> TipReference:
    """Return the motion `slow`, of duration `LONGEST`, with the duration that the module's rule gives instead."""
    return TipReference(slow.path, _shortest(slow, slow.robot), slow.robot, slow.posture)


def _torques(robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the torques (..., n) [N m] that hold the rigid robot still, and the additional torques for its motion."""
    weight = inverse_dynamics(robot, q, np.zeros_like(q), np.zeros_like(q))
    return weight, inverse_dynamics(robot, q, dq, ddq) - weight + robot.drive("motor_inertia") * ddq


def _shortest(slow: Reference, robot: Robot) -> float:
    """Return the duration [s] by the module's rule for the motion `slow`, whose own duration is `LONGEST`."""
    torque_limit = robot.drive("torque_limit")
    q, dq, ddq = slow.sample(np.linspace(0.0, slow.duration, CHECKED_INSTANTS))
    weight, moving = _torques(robot, q, dq, ddq)
    speed = float(np.max(np.abs(dq) / velocity_limits(robot)))
    held = np.max(np.abs(weight) / torque_limit, axis=0)
    if held.max() > _SHARE:
        joint = robot.joints[int(np.argmax(held))].name
        raise ValueError(
            f"{robot.name} needs {100.0 * held.max():.3g} % of the torque limit of {joint} to hold its weight; "
            f"allowed: at most {100.0 * _SHARE:g} %. Raise torque_limit, or give a `reference`"
        )
    for number in range(round(_SHORTEST / _STEP), round(LONGEST / _STEP) + 1):
        duration = number * _STEP
        faster = slow.duration / duration  # velocities grow with it, inertial and centrifugal torques with its square
        torque = np.abs(weight + faster**2 * moving) / torque_limit
        if faster * speed <= _SHARE and torque.max() <= _SHARE:
            return round(duration, 1)
    raise ValueError(
        f"{robot.name} needs more than the allowed half of a torque or velocity limit even in {LONGEST:g} s: raise "
        "torque_limit or velocity_limit, or give a `reference`"
    )


_FAMILY = 32  # references
_FAMILY_SEED = 2022
_TURN = 0.6  # rad, largest difference of the postures of a robot's references from home
_INSIDE = 0.95  # share of a joint's range, about its middle, that contains the postures
_SPEED = (0.1, 0.5)  # share of the velocity limits that the fastest joint of a reference reaches
_TORQUE = 0.6  # share of the torque limits that the rigid robot may need
_SLOWER = 1.25  # factor on the duration of a reference that needs more torque


def reference_family(arm: AnyArm, count: int = _FAMILY, seed: int = _FAMILY_SEED) -> tuple[Reference, ...]:
    """Return `count` references, determined by the arm and the seed.

    They are circles, lemniscates and lines of the tip for the two-joint arm; for a robot, splines of the joint angles
    that begin and end at home and pass through two postures within 0.6 rad of it, no joint above half its speed limit.

    Raises:
        ValueError: the motors of the robot are too weak for all references that were tried.
    """
    return _tip_paths(arm, count, seed) if isinstance(arm, ArmParameters) else _splines(arm, count, seed)


@functools.lru_cache(maxsize=16)
def _splines(robot: Robot, count: int, seed: int) -> tuple[Reference, ...]:
    """Return `count` references of a robot along splines of the joint angles through random postures."""
    generator = np.random.default_rng(seed)
    home, (low, high) = np.array(home_posture(robot)), angle_ranges(robot)
    middle, half = 0.5 * (low + high), 0.5 * _INSIDE * (high - low)
    family: list[Reference] = []
    while len(family) < count:
        turns = generator.uniform(-_TURN, _TURN, (2, len(robot)))
        between = np.clip(home + turns, middle - half, middle + half)
        family.append(_timed(robot, np.stack([home, *between, home]), generator.uniform(*_SPEED)))
    return tuple(family)


def _timed(robot: Robot, postures: np.ndarray, speed: float) -> SplineReference:
    """Return the motion through postures (k, n) [rad] at `speed` times the velocity limits, slower for weak motors."""
    slow = SplineReference(tuple(map(tuple, postures.tolist())), LONGEST, robot)
    q, dq, ddq = slow.sample(np.linspace(0.0, LONGEST, 501))
    weight, moving = _torques(robot, q, dq, ddq)
    duration = LONGEST * float(np.max(np.abs(dq) / velocity_limits(robot))) / speed
    while duration < LONGEST:
        torque = weight + (LONGEST / duration) ** 2 * moving
        if np.max(np.abs(torque) / robot.drive("torque_limit")) <= _TORQUE:
            return SplineReference(slow.waypoints, duration, robot)
        duration *= _SLOWER
    raise ValueError(
        f"the motors of {robot.name} are too weak to move it about its home posture within {LONGEST:g} s: raise "
        "torque_limit, or give a `reference`"
    )


@functools.lru_cache(maxsize=16)
def _tip_paths(parameters: ArmParameters, count: int, seed: int) -> tuple[JointReference, ...]:
    """Return `count` references of the two-joint arm along curves of the tip.

    Six of eight are circles, one a lemniscate and one a line. Rejection sampling draws a size of 5-20 % of the reach,
    any centre that keeps the curve at 30-92 % of the reach, any start angle and direction, and a nominal peak speed of
    0.4-2.2 reaches per second (a lemniscate is up to 1.46 times as fast, at its crossing).
    """
    generator = np.random.default_rng(seed)
    reach = sum(parameters.length)
    family: list[JointReference] = []
    path: TipPath
    while len(family) < count:
        size, angle = reach * generator.uniform(0.05, 0.2), generator.uniform(-math.pi, math.pi)
        distance, bearing = reach * generator.uniform(0.4, 0.8), generator.uniform(-0.3, 1.9)
        center = (distance * math.cos(bearing), distance * math.sin(bearing))
        speed, turns = reach * generator.uniform(0.4, 2.2), generator.choice([-1.0, 1.0])
        step = (size * math.cos(angle), size * math.sin(angle))
        if len(family) % 8 == 7:
            ends = ((center[0] + sign * step[0], center[1] + sign * step[1]) for sign in (-1.0, 1.0))
            path, length = Line(*ends), 2.0 * size
        elif len(family) % 4 == 3:
            path, length = Lemniscate(center=center, half_width=size, angle=angle), 6.1 * size
        else:
            path = Circle(center=center, radius=size, start_angle=angle, turns=turns)
            length = 2.0 * math.pi * size
        far = np.hypot(*path.points(np.linspace(0.0, 1.0, 200))[0].T)
        if far.min() < 0.3 * reach or far.max() > 0.92 * reach:
            continue
        try:
            # The quintic time law's peak speed is 1.875 times the mean.
            family.append(JointReference(path, duration=max(1.875 * length / speed, 0.4), parameters=parameters))
        except ValueError:
            continue  # too fast for the joints there: draw again
    return tuple(family)
