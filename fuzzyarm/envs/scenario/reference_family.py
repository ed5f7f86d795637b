"""Families of references for domain randomisation: of each, an episode draws one."""

from __future__ import annotations

import functools
import math

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import angle_ranges, home_posture, velocity_limits
from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, TipPath
from fuzzyarm.envs.scenario.reference import JointReference, Reference
from fuzzyarm.envs.scenario.robot_reference import SplineReference

__all__ = ["reference_family"]

FAMILY = 32  # references
FAMILY_SEED = 2022
TURN = 0.6  # rad, by which the postures of a robot's references differ from its home at most
INSIDE = 0.95  # share of a joint's range, about its middle, that the postures keep to
SPEED = (0.1, 0.5)  # share of the velocity limits that the fastest joint of a reference reaches
TORQUE = 0.6  # share of the torque limits that the rigid robot may need
SLOWER = 1.25  # factor on the duration of a reference that needs more
LONGEST = 60.0  # s


def reference_family(arm: AnyArm, count: int = FAMILY) -> tuple[Reference, ...]:
    """Return `count` references that always come out the same for an arm.

    For the two-joint arm circles, lemniscates and lines of the tip; for a robot splines of the joint angles that begin
    and end at home and pass two postures within 0.6 rad of it, at a tenth to a half of the velocity limits.

    Raises:
        ValueError: the motors of the robot are too weak for any of them.
    """
    return _tip_paths(arm, count) if isinstance(arm, ArmParameters) else _splines(arm, count)


@functools.lru_cache(maxsize=16)
def _splines(robot: Robot, count: int) -> tuple[Reference, ...]:
    """Return references of a robot through random postures."""
    generator = np.random.default_rng(FAMILY_SEED)
    home, (low, high) = np.array(home_posture(robot)), angle_ranges(robot)
    middle, half = 0.5 * (low + high), 0.5 * INSIDE * (high - low)
    family: list[Reference] = []
    while len(family) < count:
        turns = generator.uniform(-TURN, TURN, (2, len(robot)))
        between = np.clip(home + turns, middle - half, middle + half)
        family.append(_timed(robot, np.stack([home, *between, home]), generator.uniform(*SPEED)))
    return tuple(family)


def _timed(robot: Robot, postures: np.ndarray, speed: float) -> SplineReference:
    """Return the reference through postures (k, n) [rad] whose fastest joint reaches a share of its velocity limit.

    It is slower if the motors ask for it.
    """
    slow = SplineReference(tuple(map(tuple, postures.tolist())), LONGEST, robot)
    q, dq, ddq = slow.sample(np.linspace(0.0, LONGEST, 501))
    weight = inverse_dynamics(robot, q, np.zeros_like(q), np.zeros_like(q))
    moving = inverse_dynamics(robot, q, dq, ddq) - weight + robot.drive("motor_inertia") * ddq
    duration = LONGEST * float(np.max(np.abs(dq) / velocity_limits(robot))) / speed
    while duration < LONGEST:
        torque = weight + (LONGEST / duration) ** 2 * moving
        if np.max(np.abs(torque) / robot.drive("torque_limit")) <= TORQUE:
            return SplineReference(slow.waypoints, duration, robot)
        duration *= SLOWER
    raise ValueError(
        f"the motors of {robot.name} are too weak to move it about its home: raise torque_limit, or give a reference="
    )


@functools.lru_cache(maxsize=16)
def _tip_paths(parameters: ArmParameters, count: int) -> tuple[JointReference, ...]:
    """Return references of the two-joint arm along curves of the tip.

    Circles mostly, every eighth a lemniscate and every eighth a line: size 5-20 % of the reach, center anywhere that
    keeps the curve within 30-92 % of it, any start angle, either direction, peak tip speed 0.4-2.2 reaches a second
    (a lemniscate passes its crossing up to 1.46 times faster), by rejection.
    """
    generator = np.random.default_rng(FAMILY_SEED)
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
            path, length = _line(center, step), 2.0 * size
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


def _line(center: tuple[float, float], step: tuple[float, float]) -> Line:
    return Line((center[0] - step[0], center[1] - step[1]), (center[0] + step[0], center[1] + step[1]))
