"""The distribution of training episodes: courses, plants, loads, sensors and drives, drawn for each lane.

Cases 2 and 3 and the courses and seeds of the comparisons are not among the draws. A course is drawn from
`reference_family`, but a quarter of the lanes follow the default reference, and a sixth a circle of a few millimetres
(for a robot, an equally small spline), on which the arm hardly moves, so that the student learns to rest under a load.
In a quarter of the draws all lanes have the known arm. A load is a payload at the tip and one of these forces:

    none, a constant push F from t_0 to t_1, or F = -f(t) Q v / max(|v|, v_0), f(t) = f_0 (1 + a sin(ω t + φ)),

with v the velocity of the tip and Q a rotation by zero (along the course) or by any angle (across it). Pushes have any
direction in which the tip can move. Forces, payloads and small courses are those for the arm of Table 1 times the
factors of `signals.scale_of`. Encoders are noisy in half of the lanes, in half of these very little; torques are
delayed in a quarter of the lanes, by 0.5 to 2 control periods. Lanes that need more than nine tenths of the torque
limits are drawn again.
"""

import dataclasses
import functools
import math

import numpy as np

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import AnyArm, equations_of, robot_of
from fuzzyarm.envs.physics.rigid_body import gravity, inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, TipForce
from fuzzyarm.envs.scenario.kinematics import freedom
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference, Reference
from fuzzyarm.envs.scenario.robot_reference import SplineReference
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import scale_of

__all__ = ["Courses", "TravelForce", "draw_courses"]

_FAMILY = 256  # references from which lanes draw
_CIRCLES, _RESTS = 0.25, 0.16  # fractions of the lanes on the default reference and almost at rest
KNOWN = 0.25  # fraction of the draws in which all lanes have the known arm
_SMALLEST, _LARGEST = 5e-4, 5e-3  # m, radii of the small circles for the arm of Table 1
_STRONGEST, HEAVIEST = 220.0, 10.0  # N, kg, largest force and payload for the arm of Table 1
_FADES = 5e-3, 0.1  # m/s, range of v_0
_LATENESS = (*[0.0] * 12, 0.5, 1.0, 1.5, 2.0)  # control periods
_TRIES = 100  # draws per lane, after which the motors count as too weak for the loads
_BEARABLE, _INSTANTS = 0.9, 120  # largest part of the torque limits; number of instants checked
_NOISIEST, _LEAST = 2.0, 1e-3  # in units of the encoder noise of the sweeps
NOISE = 1e-5, 1e-3  # rad, rad/s
_PLANE = 2  # directions in which the tip of a planar robot can move


@dataclasses.dataclass(frozen=True)
class TravelForce:
    """The force -f(t) Q v / max(|v|, v_0) [N] with f(t) = f_0 (1 + a sin(ω t + φ)), against the tip's velocity v.

    Q is a rotation. Below the speed v_0 the force falls to zero with |v|.
    """

    level: float  # f_0 [N]
    swing: float  # a
    frequency: float  # ω [rad/s]
    phase: float  # φ [rad]
    rotation: tuple[tuple[float, ...], ...]  # Q, its rows (axes, axes)
    fade_speed: float  # v_0 [m/s]

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., axes) [N] at times (...) [s] for tip velocities (..., axes) [m/s]."""
        size = self.level * (1.0 + self.swing * np.sin(self.frequency * np.asarray(time) + self.phase))
        speed = np.maximum(functools.reduce(np.hypot, np.moveaxis(tip_velocity, -1, 0)), self.fade_speed)
        transposed = np.array(list(zip(*self.rotation, strict=True)))
        force: np.ndarray = -(size / speed)[..., np.newaxis] * (tip_velocity @ transposed)
        return force


@dataclasses.dataclass(frozen=True, eq=False)
class Courses:
    """Simulated arms, the lanes, with their randomly drawn plants, loads, sensors and references."""

    lanes: Lanes  # the arms
    start: np.ndarray  # (lanes, 4 n) initial states; nan: at rest on the reference
    noise: np.ndarray  # (lanes,) of the encoders, in units of `NOISE`
    delay: np.ndarray  # (lanes,) delay of the torques [control periods], in halves
    payload: np.ndarray  # (lanes,) mass at the tip [kg]


def draw_courses(arm: AnyArm, count: int, period: float, generator: np.random.Generator) -> Courses:
    """Draw `count` lanes with the control period `period` [s]; ValueError if the motors are too weak for the loads."""
    scenarios = _draw_scenarios(arm, count, generator)
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
    noise = _NOISIEST * generator.random(count) * (generator.random(count) < 0.5)
    little = np.exp(generator.uniform(math.log(_LEAST), 0.0, count))
    noise = np.where(generator.random(count) < 0.5, noise, little * noise)
    carried = np.array([one.disturbance.payload.mass for one in scenarios])
    return Courses(lanes, start, noise, generator.choice(_LATENESS, count), carried)


def _draw_scenarios(arm: AnyArm, count: int, generator: np.random.Generator) -> list[Scenario]:
    """Draw `count` scenarios: reference, payload and tip force; ValueError if the motors are too weak for them."""
    family, scale, robot = _family(arm), scale_of(arm), robot_of(arm)
    usual, span, axes = default_reference(arm), freedom(robot).motion, equations_of(arm).axes
    scenarios: list[Scenario] = []
    for _ in range(_TRIES * count):
        if len(scenarios) == count:
            break
        kind = generator.random()
        reference: Reference = usual
        if kind >= _CIRCLES + _RESTS:
            reference = family[int(generator.integers(len(family)))]
        elif kind >= _CIRCLES:
            reference = _all_but_rest(arm, generator)
        mass = scale.mass * generator.uniform(0.0, HEAVIEST) if generator.random() < 0.6 else 0.0
        force = _force(span, axes, reference.duration, scale.force, generator)
        load = Disturbance(tip_force=force, payload=Payload(mass))
        if _within_limits(robot, axes, reference, load):
            scenarios.append(Scenario(load, reference))
    if len(scenarios) < count:
        raise ValueError(
            f"only {len(scenarios)} of {_TRIES * count} random motions and loads stay within the motors' torque "
            f"limits; needed: {count}. Raise the arm's torque_limit"
        )
    return scenarios


@functools.lru_cache(maxsize=1)
def _family(arm: AnyArm) -> tuple[Reference, ...]:
    return reference_family(arm, _FAMILY)


def _force(
    span: np.ndarray, axes: int, duration: float, scale: float, generator: np.random.Generator
) -> TipForce | None:
    """Draw a tip force with `axes` components, 2 or 3, in the span of orthonormal rows (·, 3); None for no force.

    The course takes `duration` [s]; `scale` is a factor on the forces, 1 for the arm of Table 1.
    """
    kind = generator.random()
    if kind < 0.15:
        return None
    level = scale * generator.uniform(0.0, _STRONGEST)
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
        fade_speed=math.exp(generator.uniform(*np.log(_FADES))),
    )


def _direction(span: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return a uniformly distributed unit vector (3,) in the span of two or three orthonormal rows (·, 3)."""
    angle = generator.uniform(-math.pi, math.pi)
    height = generator.uniform(-1.0, 1.0) if len(span) > _PLANE else 0.0
    flat = math.cos(angle) * span[0] + math.sin(angle) * span[1]
    return np.asarray(math.sqrt(1.0 - height * height) * flat + height * span[-1])


def _rotation(span: np.ndarray, axes: int, generator: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    """Return the rows of a random rotation Q = cos φ I + sin φ [a]× + (1 - cos φ) a aᵀ, (axes, axes).

    φ is 0 in 70 % of the draws, else any angle; a is the normal of `span` (2, 3) or any direction of `span` (3, 3).
    """
    angle = 0.0 if generator.random() < 0.7 else generator.uniform(-math.pi, math.pi)
    a = _direction(span, generator) if len(span) > _PLANE else np.cross(*span)
    c, s, across = math.cos(angle), math.sin(angle), np.cross(np.eye(3), a)
    whole = c * np.eye(3) + s * across + (1.0 - c) * np.outer(a, a)
    return tuple(map(tuple, whole[:axes, :axes].tolist()))


def _all_but_rest(arm: AnyArm, generator: np.random.Generator) -> Reference:
    """Return a reference a few millimetres in size: a spline for a `Robot`, a circle for a two-joint arm."""
    if isinstance(arm, Robot):
        return _small_spline(arm, generator)
    reach, nearest = sum(arm.length), abs(arm.length[0] - arm.length[1])
    low = max(0.45, nearest / reach + 0.05)
    distance, bearing = reach * generator.uniform(low, max(0.85, low)), generator.uniform(-0.3, 1.9)
    center = distance * math.cos(bearing), distance * math.sin(bearing)
    path = Circle(center=center, radius=scale_of(arm).length * generator.uniform(_SMALLEST, _LARGEST))
    return JointReference(path, duration=generator.uniform(0.8, 2.0), parameters=arm)


def _small_spline(robot: Robot, generator: np.random.Generator) -> Reference:
    """Return a spline a few millimetres long, from a posture of a random reference to two nearby postures and back."""
    family = _family(robot)
    course = family[int(generator.integers(len(family)))]
    assert isinstance(course, SplineReference)
    rest = np.array(course.waypoints[1])
    size = scale_of(robot).length * generator.uniform(_SMALLEST, _LARGEST)
    lever = np.linalg.norm(tip_jacobian(robot, rest), axis=0)
    beside = rest + size / np.maximum(lever, np.max(lever) / len(lever)) * generator.uniform(-1.0, 1.0, (2, len(rest)))
    waypoints = tuple(map(tuple, np.stack([rest, *beside, rest]).tolist()))
    return SplineReference(waypoints, generator.uniform(0.8, 2.0), robot)


def _within_limits(robot: Robot, axes: int, reference: Reference, load: Disturbance) -> bool:
    """Return whether 0.9 of a rigid robot's torque limits suffice for a reference under a load with a force (axes,)."""
    time = np.linspace(0.0, reference.duration, _INSTANTS)
    q, dq, ddq = reference.sample(time)[:3]
    torque = inverse_dynamics(robot.with_payload(load.payload.mass), q, dq, ddq) + ddq * robot.drive("motor_inertia")
    if load.tip_force is not None:
        jacobian = tip_jacobian(robot, q)[..., :axes, :]
        velocity = np.einsum("tai,ti->ta", jacobian, dq)
        torque -= np.einsum("tai,ta->ti", jacobian, load.tip_force.at(time, velocity))
    return bool(np.all(np.abs(torque) <= _BEARABLE * robot.drive("torque_limit")))


def _rest(arm: AnyArm, reference: Reference) -> np.ndarray:
    """Return the state (4 n,) [rad, rad/s] of the nominal arm at rest at the beginning of a reference."""
    q = reference.sample(0.0).q
    still = np.zeros(len(q))
    weight = gravity(arm, q) if isinstance(arm, Robot) else rigid_inverse_dynamics(q, still, still, arm_constants(arm))
    return np.concatenate([q + weight / per_joint_of(arm, "stiffness"), q, still, still])
