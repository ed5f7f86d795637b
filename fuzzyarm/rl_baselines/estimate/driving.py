"""Chunks of experience: the student drives the lanes of `Courses`, the teacher says what it would have done.

What the episodes of the training are drawn from: courses, plants, loads, sensors and drives, a draw for each lane.

Cases 2 and 3 are not among the draws, nor are the courses and seeds of the comparisons. Courses are those of
`reference_family`; in a quarter of the lanes the default one; in a sixth a circle of millimetres, or for a robot a
spline as small, on which the arm all but stands, so that the student learns to rest under a load. In a quarter of the
draws all lanes have the known arm. Loads are a payload at the tip and one force:

    none, a constant push F from t_0 to t_1, or F = -f(t) Q v / max(|v|, v_0), f(t) = f_0 (1 + a sin(ω t + φ)),

v the velocity of the tip and Q a rotation: by nothing (along the course) or by any angle (across it). Pushes have any
direction in which the tip can move, a plane or space; Q turns in that plane, or in space about any axis. Forces,
payloads and millimetres are those of Table 1 times the numbers of `units.scale_of`: of a robot, what asks for the same
share of a motor's torque limit along its default course, and ratios of reaches. Encoders are
noisy in half of the lanes, in half of these by as little as a computer rounds; torques are late in a quarter of them,
by 0.5 to 2 control periods. Lanes that ask for more than nine tenths of the torque limits are drawn again: what the
motors cannot do teaches nothing.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import NamedTuple

import numpy as np
import torch

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import SCALARS
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import AnyArm, equations_of, robot_of
from fuzzyarm.envs.physics.rigid_body import gravity, inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, TipForce
from fuzzyarm.envs.scenario.kinematics import freedom
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference, Reference
from fuzzyarm.envs.scenario.reference_family import reference_family
from fuzzyarm.envs.scenario.robot_reference import SplineReference
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.learned_policy.estimate.policy import LearnedObserverPolicy
from fuzzyarm.learned_policy.estimate.signals import scale_of, units_of
from fuzzyarm.rl_baselines.estimate.config import SEGMENT
from fuzzyarm.rl_baselines.estimate.teacher import Teacher
from fuzzyarm.rl_baselines.estimate.training import as_tensor

__all__ = ["Chunk", "Courses", "Drive", "TravelForce", "draw_courses", "draw_scenarios"]


FAMILY = 256  # references of which lanes draw
CIRCLES, RESTS = 0.25, 0.16  # share of lanes on the default reference and all but at rest
KNOWN = 0.25  # share of the draws of all lanes with the known arm
SMALLEST, LARGEST = 5e-4, 5e-3  # m, radius of the circles of millimetres of the arm of Table 1
STRONGEST, HEAVIEST = 220.0, 10.0  # N, kg, of the arm of Table 1
FADES = 5e-3, 0.1  # m/s, range of v_0
LATENESS = (*[0.0] * 12, 0.5, 1.0, 1.5, 2.0)  # control periods
TRIES = 100  # draws for each lane, after which the motors are too weak for what is drawn
BEARABLE, INSTANTS = 0.9, 120  # share of the torque limits; instants at which it is looked at
NOISIEST, LEAST = 2.0, 1e-3  # in units of the encoder noise of the sweeps
NOISE = 1e-5, 1e-3  # rad, rad/s
_PLANE = 2  # directions in which the tip of a planar robot can move


@dataclasses.dataclass(frozen=True)
class TravelForce:
    """The force of the module's docstring, in a fixed angle to the direction of travel.

    Attributes:
        level: f_0 [N].
        swing: a.
        frequency: ω [rad/s].
        phase: φ [rad].
        rotation: Q, its rows (axes, axes).
        fade_speed: v_0 [m/s].
    """

    level: float
    swing: float
    frequency: float
    phase: float
    rotation: tuple[tuple[float, ...], ...]
    fade_speed: float

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., axes) [N] at times (...) [s] for tip velocities (..., axes) [m/s]."""
        size = self.level * (1.0 + self.swing * np.sin(self.frequency * np.asarray(time) + self.phase))
        speed = np.maximum(functools.reduce(np.hypot, np.moveaxis(tip_velocity, -1, 0)), self.fade_speed)
        transposed = np.array(list(zip(*self.rotation, strict=True)))
        force: np.ndarray = -(size / speed)[..., np.newaxis] * (tip_velocity @ transposed)
        return force


@dataclasses.dataclass(frozen=True, eq=False)
class Courses:
    """Lanes with their draws.

    Attributes:
        lanes: the arms.
        start: (lanes, 4 n) where episodes begin; nan: at rest on the reference.
        noise: (lanes,) of the encoders, in units of `NOISE`.
        delay: (lanes,) lateness of the torques [control periods], in halves.
        payload: (lanes,) mass at the tip [kg].
    """

    lanes: Lanes
    start: np.ndarray
    noise: np.ndarray
    delay: np.ndarray
    payload: np.ndarray


def draw_courses(arm: AnyArm, count: int, period: float, generator: np.random.Generator) -> Courses:
    """Draw `count` lanes for a control period [s].

    Raises:
        ValueError: the motors are too weak for these courses and loads.
    """
    scenarios = draw_scenarios(arm, count, generator)
    drawn = find_randomisation("nominal" if generator.random() < KNOWN else "plants", arm)
    lanes = Lanes(
        [arm],
        scenarios,
        count,
        control_period=period,
        substeps=default_substeps(period, fastest_rate([arm], drawn)),
        randomisation=drawn,
        threads=1,
    )
    start = np.array([_rest(arm, one.reference or default_reference(arm)) for one in scenarios])
    start[generator.random(count) < 0.5] = np.nan
    noise = NOISIEST * generator.random(count) * (generator.random(count) < 0.5)
    little = np.exp(generator.uniform(math.log(LEAST), 0.0, count))
    noise = np.where(generator.random(count) < 0.5, noise, little * noise)
    carried = np.array([one.disturbance.payload.mass for one in scenarios])
    return Courses(lanes, start, noise, generator.choice(LATENESS, count), carried)


def draw_scenarios(arm: AnyArm, count: int, generator: np.random.Generator) -> list[Scenario]:
    """Draw `count` courses with a payload and a force.

    Raises:
        ValueError: the motors are too weak for these courses and loads.
    """
    family, scale, robot = _family(arm), scale_of(arm), robot_of(arm)
    usual, span, axes = default_reference(arm), freedom(robot).motion, equations_of(arm).axes
    scenarios: list[Scenario] = []
    for _ in range(TRIES * count):
        if len(scenarios) == count:
            break
        kind = generator.random()
        reference: Reference = usual
        if kind >= CIRCLES + RESTS:
            reference = family[int(generator.integers(len(family)))]
        elif kind >= CIRCLES:
            reference = _all_but_rest(arm, generator)
        mass = scale.mass * generator.uniform(0.0, HEAVIEST) if generator.random() < 0.6 else 0.0
        force = _force(span, axes, reference.duration, scale.force, generator)
        load = Disturbance(tip_force=force, payload=Payload(mass))
        if _within_limits(robot, axes, reference, load):
            scenarios.append(Scenario(load, reference))
    if len(scenarios) < count:
        raise ValueError(
            f"of {TRIES * count} courses and loads the motors bear only {len(scenarios)}; raise torque_limit of the arm"
        )
    return scenarios


@functools.lru_cache(maxsize=1)
def _family(arm: AnyArm) -> tuple[Reference, ...]:
    return reference_family(arm, FAMILY)


def _force(
    span: np.ndarray, axes: int, duration: float, scale: float, generator: np.random.Generator
) -> TipForce | None:
    """Return a force, or none, along what orthonormal rows (·, 3) span, of which some axes are the tip's."""
    kind = generator.random()
    if kind < 0.15:
        return None
    level = scale * generator.uniform(0.0, STRONGEST)
    if kind < 0.4:
        force = level * _direction(span, generator)[:axes]
        start = generator.uniform(0.0, 0.75 * duration)
        stop = math.inf if generator.random() < 0.5 else start + generator.uniform(0.05, 1.0)
        return ConstantForce(tuple(force.tolist()), start, stop)
    return TravelForce(
        level=level,
        swing=generator.uniform(-0.6, 0.6),
        frequency=generator.uniform(1.0, 12.0),
        phase=generator.uniform(-math.pi, math.pi),
        rotation=_rotation(span, axes, generator),
        fade_speed=math.exp(generator.uniform(*np.log(FADES))),
    )


def _direction(span: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return a unit vector (3,), evenly from those that two or three orthonormal rows (·, 3) span."""
    angle = generator.uniform(-math.pi, math.pi)
    height = generator.uniform(-1.0, 1.0) if len(span) > _PLANE else 0.0
    flat = math.cos(angle) * span[0] + math.sin(angle) * span[1]
    return np.asarray(math.sqrt(1.0 - height * height) * flat + height * span[-1])


def _rotation(span: np.ndarray, axes: int, generator: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    """Return Q = cos φ 1 + sin φ [a]× + (1 - cos φ) a aᵀ, (axes, axes).

    φ is 0 or any angle, a is across the plane that is spanned, or any direction in space.
    """
    angle = 0.0 if generator.random() < 0.7 else generator.uniform(-math.pi, math.pi)
    a = _direction(span, generator) if len(span) > _PLANE else np.cross(*span)
    c, s, across = math.cos(angle), math.sin(angle), np.cross(np.eye(3), a)
    whole = c * np.eye(3) + s * across + (1.0 - c) * np.outer(a, a)
    return tuple(map(tuple, whole[:axes, :axes].tolist()))


def _all_but_rest(arm: AnyArm, generator: np.random.Generator) -> Reference:
    """Return a slow course of millimetres: a circle between 0.45 and 0.85 of the reach, or a robot's spline."""
    if isinstance(arm, Robot):
        return _small_spline(arm, generator)
    reach, nearest = sum(arm.length), abs(arm.length[0] - arm.length[1])
    low = max(0.45, nearest / reach + 0.05)
    distance, bearing = reach * generator.uniform(low, max(0.85, low)), generator.uniform(-0.3, 1.9)
    center = distance * math.cos(bearing), distance * math.sin(bearing)
    path = Circle(center=center, radius=scale_of(arm).length * generator.uniform(SMALLEST, LARGEST))
    return JointReference(path, duration=generator.uniform(0.8, 2.0), parameters=arm)


def _small_spline(robot: Robot, generator: np.random.Generator) -> Reference:
    """Return a spline of millimetres about a posture of the robot's family: to two places beside it and back."""
    family = _family(robot)
    course = family[int(generator.integers(len(family)))]
    assert isinstance(course, SplineReference)
    rest = np.array(course.waypoints[1])
    size = scale_of(robot).length * generator.uniform(SMALLEST, LARGEST)
    lever = np.linalg.norm(tip_jacobian(robot, rest), axis=0)
    beside = rest + size / np.maximum(lever, np.max(lever) / len(lever)) * generator.uniform(-1.0, 1.0, (2, len(rest)))
    waypoints = tuple(map(tuple, np.stack([rest, *beside, rest]).tolist()))
    return SplineReference(waypoints, generator.uniform(0.8, 2.0), robot)


def _within_limits(robot: Robot, axes: int, reference: Reference, load: Disturbance) -> bool:
    """Return whether the rigid nominal robot follows a reference under a load with `BEARABLE` of its torques."""
    time = np.linspace(0.0, reference.duration, INSTANTS)
    q, dq, ddq = reference.sample(time)[:3]
    torque = inverse_dynamics(robot.with_payload(load.payload.mass), q, dq, ddq) + ddq * robot.drive("motor_inertia")
    if load.tip_force is not None:
        jacobian = tip_jacobian(robot, q)[..., :axes, :]
        velocity = np.einsum("tai,ti->ta", jacobian, dq)
        torque -= np.einsum("tai,ta->ti", jacobian, load.tip_force.at(time, velocity))
    return bool(np.all(np.abs(torque) <= BEARABLE * robot.drive("torque_limit")))


def _rest(arm: AnyArm, reference: Reference) -> np.ndarray:
    """Return where the nominal arm rests at the beginning of a reference (4 n,) [rad, rad/s]."""
    q = reference.sample(0.0).q
    still = np.zeros(len(q))
    weight = gravity(arm, q) if isinstance(arm, Robot) else rigid_inverse_dynamics(q, still, still, arm_constants(arm))
    return np.concatenate([q + weight / per_joint_of(arm, "stiffness"), q, still, still])


_TIP_ERROR, _OVER, _REASON = map(SCALARS.index, ("tip_error", "truncated", "reason"))
_LATEST = 4  # torques that may be on their way
_RESTARTS = 0.5  # share of the lanes that begin an episode anew with each chunk, for a load is hardest when it comes


class Chunk(NamedTuple):
    """What is learned from.

    Attributes:
        z: (steps, lanes, numbers of z).
        c: (steps, lanes, numbers of c).
        label: (steps, lanes, n), what the teacher's torque has beyond u_b, as ρ.
        free: (steps, lanes, n), 0 where the teacher's torque is at its limit or unknown, else 1.
        begins: (steps, lanes, 1), 0 where an episode begins, else 1.
        memory: (segments, lanes, hidden), h of the driving student before every `SEGMENT`-th step.
    """

    z: torch.Tensor
    c: torch.Tensor
    label: torch.Tensor
    free: torch.Tensor
    begins: torch.Tensor
    memory: torch.Tensor

    def window(self, segment: int, steps: int) -> Chunk:
        """Return so many steps from the beginning of a segment on."""
        where = slice(SEGMENT * segment, SEGMENT * segment + steps)
        return Chunk._make([*(part[where] for part in self[:-1]), self.memory[segment : segment + 1]])


class Drive:
    """Lanes that a student drives, chunk after chunk.

    Args:
        courses: the lanes, whose episodes begin here.
        policy: a student.
        generator: of noise and plants.

    Attributes:
        lost: episodes that ended before their reference.
        error: root mean square tip error of the last chunk [m].
    """

    def __init__(self, courses: Courses, policy: LearnedObserverPolicy, generator: np.random.Generator) -> None:
        """Begin an episode in every lane."""
        self._courses, self._lanes, self._generator = courses, courses.lanes, generator
        self._teacher = Teacher(policy.adaptive, courses)
        count, joints = self._lanes.count, policy.joints
        seeds = generator.integers(0, 2**31, count).tolist()
        self._observation = self._lanes.reset(seeds, None, courses.start)[0].copy()
        self._memory, self._begins = np.zeros((count, policy.memory_size)), np.ones(count, dtype=bool)
        self._sent = np.zeros((_LATEST, count, joints))
        self._torques = units_of(policy.parameters).torque
        self._limit = np.array(policy.torque_limit)
        self.lost, self.error = 0, 0.0

    def chunk(self, policy: LearnedObserverPolicy, steps: int) -> Chunk:
        """Drive so many control periods; some lanes begin anew."""
        self._begins |= self._generator.random(self._lanes.count) < _RESTARTS
        self._restart()
        count, limit, part = self._lanes.count, self._limit, policy.seen
        seen, label = np.empty((steps, count, part.base.stop)), np.empty((steps, count, policy.joints))
        free, begins, memory = np.empty(label.shape), np.ones((steps, count, 1)), []
        torque, squares = np.empty((count, policy.joints)), 0.0
        for k in range(steps):
            if self._begins.any():
                begins[k, self._begins] = 0.0
                self._memory[self._begins] = 0.0
            if k % SEGMENT == 0:
                memory.append(self._memory[:, policy.hidden].copy())
            wanted = self._teacher.torque(self._observation, self._memory[:, policy.filter])
            free[k] = np.abs(wanted) < limit
            policy.observe(self._read(), self._memory, torque, seen[k])
            label[k] = np.nan_to_num(wanted)
            squares += self._step(self._late(np.clip(torque, -limit, limit)))
        self.error = float(np.sqrt(squares / steps))
        rho = np.clip((label - seen[:, :, part.base]) / self._torques, -1.0, 1.0)
        return Chunk(*map(as_tensor, (seen[:, :, part.z], seen[:, :, part.c], rho, free, begins, np.array(memory))))

    def _read(self) -> np.ndarray:
        """Return the observation (lanes, 5 n) with encoder noise."""
        read = self._observation.copy()
        measured = 2 * len(self._limit)
        unit = np.repeat(NOISE, len(self._limit)) * self._generator.standard_normal((len(read), measured))
        read[:, :measured] += self._courses.noise[:, np.newaxis] * unit
        return read

    def _late(self, torque: np.ndarray) -> np.ndarray:
        """Return what the motors apply (lanes, n) [N m]: the torques of each lane, late."""
        self._sent = np.concatenate([torque[np.newaxis], self._sent[:-1]])
        self._sent[1:, self._begins] = torque[self._begins]
        delay, lane = self._courses.delay, np.arange(len(torque))
        whole = np.floor(delay).astype(np.int64)
        share = (delay - whole)[:, np.newaxis]
        arrived: np.ndarray = (1.0 - share) * self._sent[whole, lane] + share * self._sent[whole + 1, lane]
        return arrived

    def _step(self, torque: np.ndarray) -> float:
        """Advance all lanes, begin anew where an episode ended, and return the mean squared tip error [m²]."""
        observation, _, scalars = self._lanes.step(torque)
        self._observation = observation.copy()
        self._begins = (scalars[_OVER] != 0.0) | (scalars[_REASON] != 0.0)
        self.lost += int(np.count_nonzero(scalars[_REASON]))
        self._restart()
        return float(np.mean(scalars[_TIP_ERROR] ** 2))

    def _restart(self) -> None:
        """Begin an episode in the lanes that are marked."""
        which = np.flatnonzero(self._begins)
        if len(which):
            begun = self._lanes.reset(None, None, self._courses.start[which], which)
            self._observation[which] = begun[0]
