"""What the episodes of the training are drawn from: courses, plants, loads, sensors and drives, a draw for each lane.

Cases 2 and 3 are not among the draws, nor are the courses and seeds of the comparisons. Courses are those of
`reference_family`; in a quarter of the lanes the default one; in a sixth a circle of millimetres, on which the arm
all but stands, so that the student learns to rest under a load. In a quarter of the draws all lanes have the known arm.
Loads are a payload at the tip and one force, scaled to the arm as the circles of millimetres are:

    none, a constant push F from t_0 to t_1, or F = -f(t) Q v / max(|v|, v_0), f(t) = f_0 (1 + a sin(ω t + φ)),

v the velocity of the tip and Q a rotation: by nothing (along the course) or by any angle (across it). Encoders are
noisy in half of the lanes, in half of these by as little as a computer rounds; torques are late in a quarter of them,
by 0.5 to 2 control periods. Lanes that ask for more than nine tenths of the torque limits are drawn again: what the
motors cannot do teaches nothing.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Payload, arm_constants, rigid_inverse_dynamics, tip_jacobian
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, TipForce
from fuzzyarm.envs.scenario.paths import Circle
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference, Reference
from fuzzyarm.envs.scenario.reference_family import reference_family
from fuzzyarm.envs.scenario.scenario import Scenario
from fuzzyarm.learned_policy.estimate.signals import scale_of

__all__ = ["Courses", "TravelForce", "draw_courses"]

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


@dataclasses.dataclass(frozen=True)
class TravelForce:
    """The force of the module's docstring, in a fixed angle to the direction of travel.

    Attributes:
        level: f_0 [N].
        swing: a.
        frequency: ω [rad/s].
        phase: φ [rad].
        angle: of the rotation Q [rad].
        fade_speed: v_0 [m/s].
    """

    level: float
    swing: float
    frequency: float
    phase: float
    angle: float
    fade_speed: float

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s] for tip velocities (..., 2) [m/s]."""
        size = self.level * (1.0 + self.swing * np.sin(self.frequency * np.asarray(time) + self.phase))
        speed = np.maximum(np.hypot(tip_velocity[..., 0], tip_velocity[..., 1]), self.fade_speed)
        c, s = math.cos(self.angle), math.sin(self.angle)
        turned = tip_velocity @ np.array([[c, s], [-s, c]])
        force: np.ndarray = -(size / speed)[..., np.newaxis] * turned
        return force


@dataclasses.dataclass(frozen=True, eq=False)
class Courses:
    """Lanes with their draws.

    Attributes:
        lanes: the arms.
        start: (lanes, 8) where episodes begin; nan: at rest on the reference.
        noise: (lanes,) of the encoders, in units of `NOISE`.
        delay: (lanes,) lateness of the torques [control periods], in halves.
    """

    lanes: Lanes
    start: np.ndarray
    noise: np.ndarray
    delay: np.ndarray


def draw_courses(arm: ArmParameters, count: int, period: float, generator: np.random.Generator) -> Courses:
    """Draw `count` lanes for a control period [s].

    Raises:
        ValueError: the motors are too weak for these courses and loads.
    """
    family, scale = _family(arm), scale_of(arm)
    usual = default_reference(arm)
    scenarios: list[Scenario] = []
    starts: list[np.ndarray] = []
    for _ in range(TRIES * count):
        if len(starts) == count:
            break
        kind = generator.random()
        reference: Reference = usual
        if kind >= CIRCLES + RESTS:
            reference = family[int(generator.integers(len(family)))]
        elif kind >= CIRCLES:
            reference = _all_but_rest(arm, generator)
        mass = scale.mass * generator.uniform(0.0, HEAVIEST) if generator.random() < 0.6 else 0.0
        force = _force(reference.duration, scale.force, generator)
        load = Disturbance(tip_force=force, payload=Payload(mass))
        if not _within_limits(arm, reference, load):
            continue
        scenarios.append(Scenario(load, reference))
        starts.append(_rest(arm, reference))
    if len(starts) < count:
        raise ValueError(
            f"of {TRIES * count} courses and loads the motors bear only {len(starts)}; raise torque_limit of the arm"
        )
    lanes = Lanes(
        [arm],
        scenarios,
        count,
        control_period=period,
        substeps=default_substeps(period),
        randomisation=find_randomisation("nominal" if generator.random() < KNOWN else "plants", arm),
        threads=1,
    )
    start = np.array(starts)
    start[generator.random(count) < 0.5] = np.nan
    noise = NOISIEST * generator.random(count) * (generator.random(count) < 0.5)
    little = np.exp(generator.uniform(math.log(LEAST), 0.0, count))
    noise = np.where(generator.random(count) < 0.5, noise, little * noise)
    return Courses(lanes, start, noise, generator.choice(LATENESS, count))


@functools.lru_cache(maxsize=1)
def _family(arm: ArmParameters) -> tuple[Reference, ...]:
    return reference_family(arm, FAMILY)


def _force(duration: float, scale: float, generator: np.random.Generator) -> TipForce | None:
    kind = generator.random()
    if kind < 0.15:
        return None
    level = scale * generator.uniform(0.0, STRONGEST)
    if kind < 0.4:
        angle, start = generator.uniform(-math.pi, math.pi), generator.uniform(0.0, 0.75 * duration)
        stop = math.inf if generator.random() < 0.5 else start + generator.uniform(0.05, 1.0)
        return ConstantForce((level * math.cos(angle), level * math.sin(angle)), start, stop)
    return TravelForce(
        level=level,
        swing=generator.uniform(-0.6, 0.6),
        frequency=generator.uniform(1.0, 12.0),
        phase=generator.uniform(-math.pi, math.pi),
        angle=0.0 if generator.random() < 0.7 else generator.uniform(-math.pi, math.pi),
        fade_speed=math.exp(generator.uniform(*np.log(FADES))),
    )


def _all_but_rest(arm: ArmParameters, generator: np.random.Generator) -> Reference:
    """Return a slow circle of millimetres between 0.45 and 0.85 of the reach."""
    reach, nearest = sum(arm.length), abs(arm.length[0] - arm.length[1])
    low = max(0.45, nearest / reach + 0.05)
    distance, bearing = reach * generator.uniform(low, max(0.85, low)), generator.uniform(-0.3, 1.9)
    center = distance * math.cos(bearing), distance * math.sin(bearing)
    path = Circle(center=center, radius=scale_of(arm).length * generator.uniform(SMALLEST, LARGEST))
    return JointReference(path, duration=generator.uniform(0.8, 2.0), parameters=arm)


def _within_limits(arm: ArmParameters, reference: Reference, load: Disturbance) -> bool:
    """Return whether the rigid nominal arm follows a reference under a load with a share `BEARABLE` of its torques."""
    time = np.linspace(0.0, reference.duration, INSTANTS)
    q, dq, ddq = reference.sample(time)[:3]
    torque = rigid_inverse_dynamics(q, dq, ddq, arm_constants(arm, load.payload)) + ddq * np.array(arm.motor_inertia)
    if load.tip_force is not None:
        jacobian = tip_jacobian(q, arm.length)
        velocity = np.einsum("tai,ti->ta", jacobian, dq)
        torque -= np.einsum("tai,ta->ti", jacobian, load.tip_force.at(time, velocity))
    return bool(np.all(np.abs(torque) <= BEARABLE * np.array(arm.torque_limit)))


def _rest(arm: ArmParameters, reference: Reference) -> np.ndarray:
    """Return where the nominal arm rests at the beginning of a reference (8,) [rad, rad/s]."""
    q, still = reference.sample(0.0).q, np.zeros(2)
    bent = rigid_inverse_dynamics(q, still, still, arm_constants(arm)) / arm.stiffness
    return np.concatenate([q + bent, q, still, still])
