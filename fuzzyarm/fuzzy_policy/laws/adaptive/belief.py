"""What the adaptive observer estimates beside the arm's state: load, constants of the arm, lateness.

    p = (f_t, F, m_p, k, β, φ, μ, ι, w, d)

The load is a force f_t along the reference's tip velocity, a free force F at the tip and a payload m_p there. k, β, φ,
μ and ι are factors, one for each joint, of stiffness, damping, dry friction, link mass and inertia, and motor inertia.
w is a torque that acts beside that of each motor, and d the time from a command to the motors, in control periods.

The numbers of the arm, see `arm`, are affine in (m_p, k, β, φ, μ, ι): a = a_0 + S (p - p_0).

A lane remembers it from one sample to the next, with what else the law needs, in a fixed number of numbers: `Memory`.

The numbers of the adaptive observer: how fast a load may change, how wrong the known arm may be, what errors cost.

Torques are shares of the arm's `torque_limit`, joint by joint, and forces shares of `unit_force`, so that the same
numbers fit arms of another size.

The weights of the adaptive observer for any robot: those of Table 1, softened until the regulator is stable.

`AdaptiveWeights` were tuned for the two-joint arm, whose mass matrix the regulator's table follows. Where a robot's
depends on more angles than that, the gains are those of a mean, and as sharp as they are they may be unstable in part
of its range, even for a state that is known. With a factor s ≥ 1,

    link_angle → s link_angle,    link_velocity → √s link_velocity,    first_gain → min(1, s first_gain)

weaken the feedback, which then needs less of a soft start. The smallest s of `FACTORS` is taken with which the loop of
the regulator and the known state is stable at random postures, with joints as stiff as known and 20 % softer and
stiffer.

What the adaptive observer needs of the arm: functions of the numbers that its beliefs change.

These numbers are affine in the beliefs, see `belief.affine_numbers`. For the two-joint arm they are the constants of
its equations. The constants of a robot are not affine in its masses; its numbers are those of the `Plant`, then a mass
at the tip [kg], and the constants follow from them.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import real
from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.physics import records
from fuzzyarm.envs.physics.elementwise import root, select, sign
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.hold import held_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import filled, size
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.envs.scenario.kinematics import reach
from fuzzyarm.fuzzy_policy.known_arm import QUANTITIES, Drives, per_joint_of
from fuzzyarm.fuzzy_policy.laws.gain_schedule import GainSchedule, nearest_inertia, schedule_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import (
    WEIGHT_RANGE,
    ObserverWeights,
    feedback_gain,
    sampled_arm,
    state_part,
)
from fuzzyarm.fuzzy_policy.laws.observer_weights import FACTORS as SOFTER
from fuzzyarm.fuzzy_policy.laws.sampled_margins import Place, places_of
from fuzzyarm.numbers.functions import Cells, each, flat, maximum

__all__ = [
    "CAUTIOUS",
    "ENOUGH",
    "FACTORS",
    "FLAG",
    "KEPT",
    "LONGEST_LATENESS",
    "ORDERS",
    "AdaptiveWeights",
    "ArmFunctions",
    "Belief",
    "Flags",
    "Memory",
    "adaptive_weights_for",
    "affine_numbers",
    "allowed",
    "arm_functions",
    "belief_of",
    "dry_friction",
    "first_guess",
    "first_spread",
    "forces_in",
    "largest_radius",
    "layout",
    "mass_of",
    "numbers_of",
    "places",
    "remembered",
    "softened",
    "unit_force",
    "walks",
]  # fmt: skip


def unit_force(arm: AnyArm) -> float:
    """Return the force [N] at the tip of the stretched arm that takes the whole torque of the first motor."""
    if isinstance(arm, Robot):
        return float(arm.drive("torque_limit")[0] / reach(arm))
    return arm.torque_limit[0] / sum(arm.length)


def mass_of(arm: AnyArm) -> float:
    """Return the mass of all links [kg]."""
    return float(sum(arm.arrays.mass)) if isinstance(arm, Robot) else sum(arm.mass)


@dataclasses.dataclass(frozen=True)
class AdaptiveWeights:
    """What the filter expects and what the regulator weighs.

    Attributes:
        link_angle: link error [rad] that costs as much as the whole torque.
        link_velocity: link velocity error [rad/s] that costs as much as the whole torque.
        first_gain: share of the regulator's gain with which an episode begins.
        soft_start: how long it is that share [s], which then grows to 1 in as long again.
        motor_torque: white noise of the motor torque, share of the torque limit times √s.
        torque_doubt: share of the torque limit by which a motor's torque may be wrong after a jump of the commanded
            torque by the whole limit; it grows with the square of the jump.
        travel_walk: random walk of the force along the path, share of the unit force per √s.
        force_walk: random walk of each component of the free force, likewise.
        calm_walk: share of these walks that the forces make where nothing but noise corrects them.
        reopening: time of walk that a force is given at once where it begins to move [s].
        encoder_angle: standard deviation of a measured angle [rad].
        encoder_velocity: standard deviation of a measured velocity [rad/s].
        first_force: standard deviation of each force when an episode begins, share of the unit force.
        first_payload: of the payload at the tip, share of the mass of all links.
        first_stiffness: of the factors of joint stiffness.
        first_damping: of the factors of joint damping.
        first_friction: of the factors of dry friction.
        first_inertia: of the factors of link masses and of motor inertias.
        first_offset: of the torques beside the motors', share of the torque limit.
        first_scale: of a factor that all of the arm's constants share, as a wrong torque constant gives them.
        first_lateness: of the lateness [control periods].
        first_link_angle: of the link angles [rad].
        scale_doubt: variance that a sample of surprise a adds to that factor, over a.
        gate: squared standardised innovation above which a sample counts less.
        dead_zone: squared innovation, in variances of the noise that is read, below which constants do not learn.
        largest_swing: mean of the commands' jumps, as shares of the torque limits, from which on the loop counts as
            lost; a mean above 2 is not possible.

    Raises:
        TypeError: a weight is no number.
        ValueError: a weight lies outside `WEIGHT_RANGE`.
    """

    link_angle: float = 0.0037
    link_velocity: float = 1.57
    first_gain: float = 0.5
    soft_start: float = 0.015
    motor_torque: float = 4.9e-4
    torque_doubt: float = 0.4
    travel_walk: float = 1.5
    force_walk: float = 0.59
    calm_walk: float = 0.33
    reopening: float = 0.29
    encoder_angle: float = 2e-5
    encoder_velocity: float = 2.1e-3
    first_force: float = 2e-3
    first_payload: float = 0.125
    first_stiffness: float = 0.12
    first_damping: float = 0.3
    first_friction: float = 0.3
    first_inertia: float = 0.06
    first_offset: float = 0.01
    first_scale: float = 0.1
    first_lateness: float = 1.5
    first_link_angle: float = 1e-3
    scale_doubt: float = 1.5e-3
    gate: float = 1.5
    dead_zone: float = 16.0
    largest_swing: float = 0.5

    def __post_init__(self) -> None:
        """Check the weights."""
        low, high = WEIGHT_RANGE
        for field in dataclasses.fields(self):
            real(f"AdaptiveWeights.{field.name}", getattr(self, field.name), low=low, high=high)


STIFFNESS = (0.8, 1.0, 1.2)


@functools.lru_cache(maxsize=32)
def adaptive_weights_for(arm: AnyArm, control_period: float) -> AdaptiveWeights:
    """Return the default weights for an arm and a control period [s]; for a two-joint arm those of Table 1.

    If no factor is enough, it is the largest.
    """
    weights = AdaptiveWeights()
    if not isinstance(arm, Robot):
        return weights
    places, schedule = places_of(arm, control_period), schedule_of(arm)
    trials = [softened(weights, factor) for factor in SOFTER]
    return next((trial for trial in trials if largest_radius(places, schedule, trial) < 1.0), trials[-1])


def softened(weights: AdaptiveWeights, factor: float) -> AdaptiveWeights:
    """Return weights softened by s = `factor`."""
    link_angle, link_velocity = factor * weights.link_angle, math.sqrt(factor) * weights.link_velocity
    first_gain = min(1.0, factor * weights.first_gain)
    return dataclasses.replace(weights, link_angle=link_angle, link_velocity=link_velocity, first_gain=first_gain)


def largest_radius(places: list[Place], schedule: GainSchedule, weights: AdaptiveWeights) -> float:
    """Return the largest |λ| per control period at postures; inf where a Riccati equation has no solution."""
    costs, largest = ObserverWeights(link_angle=weights.link_angle, link_velocity=weights.link_velocity), 0.0
    for place in places:
        limit, state = per_joint_of(place.robot, "torque_limit"), state_part(len(place.robot))
        A, B = sampled_arm(place.robot, place.control_period, nearest_inertia(schedule, place.q))
        try:
            K = feedback_gain(A, B, limit, costs)
        except (np.linalg.LinAlgError, ValueError):  # scipy raises either
            return math.inf
        for stiffness in STIFFNESS:
            A, B = place.plant(stiffness)
            largest = max(largest, float(np.abs(np.linalg.eigvals(A[state, state] - B[state] @ K)).max()))
    return largest


REST = 1e-9  # m/s; below, a tip has no direction of travel
# By factor of the beliefs, the factor of a random plant that multiplies the same.
_DRAWN = {
    "stiffness": "stiffness",
    "damping": "damping",
    "friction": "dry_friction",
    "mass": "mass",
    "motor_inertia": "motor_inertia",
}


class ArmFunctions(NamedTuple):
    """Functions of the numbers (k,) of an arm of n joints whose tip moves in a space of some axes.

    Attributes:
        hold: ``hold(state, torque, force, numbers, h, substeps)`` advances copies of the arm over a control step, see
            `held_of`: state (4 n, copies) changes in place, the others are torques [N m], force lines [N] and numbers
            of each copy, by columns.
        link_torque: ``link_torque(q, dq, ddq, force, constants)`` returns M q̈ + C q̇ + g - Jᵀ F (n,) [N m], the torque
            of the joints under a tip force F (axes,) [N].
        tip_direction: ``tip_direction(q, dq, constants)`` returns v/|v| (axes,) of the tip at q (n,) [rad] and q̇ (n,)
            [rad/s], zeros at rest.
        drive: ``drive(numbers, joint)``, the `Drives` of one joint.
        constants_in: ``constants_in(numbers)``, the constants of the equations.
    """

    hold: Any
    link_torque: Any
    tip_direction: Any
    drive: Any
    constants_in: Any


def numbers_of(
    arm: AnyArm, physics: Physics, payload: float = 0.0, factors: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """Return the numbers (k,) of an arm with these equations.

    Args:
        arm: the known one.
        physics: its equations.
        payload: at the tip [kg].
        factors: of some of its constants, each (n,), by their names in `belief.FACTORS`.
    """
    drawn = dict.fromkeys(_DRAWN.values(), np.ones(physics.joints))
    drawn |= {_DRAWN[name]: values for name, values in (factors or {}).items()}
    draw = SimpleNamespace(**{name: physics.PerJoint(*values.tolist()) for name, values in drawn.items()})
    draw.viscous_friction = physics.PerJoint(*[1.0] * physics.joints)
    plant = physics.varied(physics.plant_of(arm), draw)
    numbers = physics.constants(plant, 0.0, 0.0, payload) if physics is two_joints() else (*plant, payload)
    return np.array(flat(numbers), dtype=np.float64)


def dry_friction(velocity: Any, drive: Drives) -> Any:
    """Return the torque [N m] that overcomes a motor's dry friction at a velocity [rad/s], 0 at rest."""
    return stribeck_magnitude(velocity, drive.dry_friction) * sign(velocity)


@functools.cache
def arm_functions(physics: Physics) -> ArmFunctions:
    """Return the functions of arms with these equations."""
    PerJoint, Point, advance = physics.PerJoint, physics.Point, held_of(physics)
    constants_in, axes = _constants_in(physics), physics.axes

    def hold(state: Any, torque: Any, force: Any, numbers: Any, h: Any, substeps: int) -> None:
        for copy in each(state.shape[1]):
            now = filled(physics.State, (state[i, copy] for i in range(len(state))))
            held = PerJoint(*(torque[j, copy] for j in range(physics.joints)))
            mean, change = ([force[first + i, copy] for i in range(axes)] for first in (0, axes))
            arm = constants_in([numbers[i, copy] for i in range(len(numbers))])
            for i, number in enumerate(flat(advance(now, held, mean, change, arm, h, substeps))):
                state[i, copy] = number

    def link_torque(q: Any, dq: Any, ddq: Any, force: Any, arm: Any) -> Any:
        angles = PerJoint(*q)
        inner = physics.inverse_dynamics(angles, PerJoint(*dq), PerJoint(*ddq), arm)
        return [a - b for a, b in zip(inner, physics.tip_load(angles, Point(*force), arm), strict=True)]

    def tip_direction(q: Any, dq: Any, arm: Any) -> Any:
        velocity, square = physics.tip_velocity(PerJoint(*q), PerJoint(*dq), arm), 0.0
        for v in velocity:
            square = square + v * v
        speed = root(square)
        scale = select(speed > REST, 1.0 / maximum(speed, REST), 0.0)
        return [v * scale for v in velocity]

    return ArmFunctions(hold, link_torque, tip_direction, _drive_of(physics), constants_in)


def _constants_in(physics: Physics) -> Any:
    """Return the function that gives the `Arm` of numbers (k,)."""
    if physics is two_joints():
        return lambda numbers: filled(physics.Arm, numbers)
    count = size(physics.Plant)

    def constants_in(numbers: Any) -> Any:
        given = list(numbers)
        return physics.constants(filled(physics.Plant, given[:count]), 0.0, 0.0, given[count])

    return constants_in


def _drive_of(physics: Physics) -> Any:
    """Return `ArmFunctions.drive`."""
    short = physics is two_joints()
    at = records.places(physics.Arm if short else physics.Plant)
    names = ("motor_inertia", "viscous", "stiffness", "damping", "dry_friction") if short else QUANTITIES

    def drive(numbers: Any, joint: int) -> Drives:
        wanted = flat(tuple(getattr(at, f"{name}{1 + joint}") for name in names))
        found: Drives = filled(Drives, (numbers[k] for k in wanted))
        return found

    return drive


class Belief(NamedTuple):
    """The parts of p, or where they lie in an array; the letters are those of the module's docstring.

    Attributes:
        travel_force: f_t [N].
        force: F [N].
        payload: m_p [kg].
        stiffness: k.
        damping: β.
        friction: φ.
        mass: μ.
        motor_inertia: ι.
        offset: w [N m].
        lateness: d [control periods].
    """

    travel_force: Any
    force: Any
    payload: Any
    stiffness: Any
    damping: Any
    friction: Any
    mass: Any
    motor_inertia: Any
    offset: Any
    lateness: Any


FACTORS = ("stiffness", "damping", "friction", "mass", "motor_inertia")
"""The parts that are factors of the known arm."""
CAUTIOUS = (*FACTORS, "lateness")
"""The parts that learn only from what the noise of the sensors does not explain."""

_LARGEST_FORCE = 4.0  # in unit forces
_LARGEST_OFFSET = 0.2  # share of the torque limit
_LIGHTEST, _HEAVIEST = -0.1, 2.0  # payload, in masses of the links; below zero: links lighter than known
_FACTOR_RANGE = {
    "stiffness": (0.5, 1.9),
    "damping": (0.0, 3.0),
    "friction": (0.0, 3.0),
    "mass": (0.5, 1.9),
    "motor_inertia": (0.5, 1.9),
}


@functools.cache
def belief_of(physics: Physics) -> Belief:
    """Return where the parts of p lie for arms with these equations; the forces come first, the lateness last."""
    return Belief(*consecutive(1, physics.axes, 1, *[physics.joints] * (len(FACTORS) + 1), 1))


def forces_in(belief: Belief) -> int:
    """Return how many numbers of p are forces."""
    return int(belief.force.stop)


def first_guess(arm: AnyArm) -> np.ndarray:
    """Return p_0: no load, the known arm, no lateness."""
    return _filled(arm, Belief(0.0, 0.0, 0.0, **dict.fromkeys(FACTORS, 1.0), offset=0.0, lateness=0.0))


def first_spread(arm: AnyArm, weights: AdaptiveWeights) -> np.ndarray:
    """Return the standard deviations of p when an episode begins."""
    force = weights.first_force * unit_force(arm)
    return _filled(
        arm,
        Belief(
            force,
            force,
            weights.first_payload * mass_of(arm),
            weights.first_stiffness,
            weights.first_damping,
            weights.first_friction,
            weights.first_inertia,
            weights.first_inertia,
            weights.first_offset * per_joint_of(arm, "torque_limit"),
            weights.first_lateness,
        ),
    )


def walks(arm: AnyArm, weights: AdaptiveWeights) -> np.ndarray:
    """Return how fast each number of p walks, in its unit per √s."""
    force, still = unit_force(arm), dict.fromkeys(FACTORS, 0.0)
    parts = Belief(weights.travel_walk * force, weights.force_walk * force, 0.0, **still, offset=0.0, lateness=0.0)
    return _filled(arm, parts)


def allowed(arm: AnyArm, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest p; `longest` is the highest lateness [control periods]."""
    force, mass = _LARGEST_FORCE * unit_force(arm), mass_of(arm)
    torque = _LARGEST_OFFSET * per_joint_of(arm, "torque_limit")
    low, high = ({name: ends[side] for name, ends in _FACTOR_RANGE.items()} for side in range(2))
    return (
        _filled(arm, Belief(-force, -force, _LIGHTEST * mass, **low, offset=-torque, lateness=0.0)),
        _filled(arm, Belief(force, force, _HEAVIEST * mass, **high, offset=torque, lateness=longest)),
    )


def affine_numbers(arm: AnyArm) -> tuple[np.ndarray, np.ndarray]:
    """Return a_0, the numbers of the known arm, and S (numbers of the arm, numbers of p)."""
    physics = equations_of(arm)
    base, belief = numbers_of(arm, physics), belief_of(physics)
    slopes = np.zeros((len(base), belief.lateness.stop))
    slopes[:, belief.payload] = (numbers_of(arm, physics, 1.0) - base)[:, np.newaxis]
    for name in FACTORS:
        for joint in range(physics.joints):
            doubled = numbers_of(arm, physics, factors={name: 1.0 + np.eye(physics.joints)[joint]})
            slopes[:, getattr(belief, name).start + joint] = doubled - base
    return base, slopes


def _filled(arm: AnyArm, parts: Belief) -> np.ndarray:
    """Return an array with these numbers, each repeated over its part."""
    belief = belief_of(equations_of(arm))
    array = np.empty(belief.lateness.stop)
    for where, value in zip(belief, parts, strict=True):
        array[where] = value
    return array


LONGEST_LATENESS = 3
"""Longest time from a command to the motors that the filter considers [control periods]."""
KEPT = 5
"""References kept, the present one included: the derivatives of the joint torque are differences of four of them, and
the feedforward's change takes one more."""
ORDERS = 3
"""Of a reference: q_d, q̇_d and q̈_d."""
ENOUGH = 1e6
"""Samples that are counted."""
READ = 3  # numbers of a joint kept of the last sample, see `read_noise`


class Flags(NamedTuple):
    """Single numbers of a memory, or where they stand among them.

    Attributes:
        samples: how many there have been, up to `ENOUGH`.
        surprise: ν²/s of the last samples, on average; about 1 where the filter is right.
        lost: 1 once the filter has diverged or the torques swing, else 0.
        calm: 1 where the corrections of the forces look like noise, 0 where they have a direction.
        taught: 1 if the memory that an episode begins with holds what an earlier pass has taught, else 0.
        swing: mean of the commands' jumps of the last samples, see `law.note_swing`.
    """

    samples: Any
    surprise: Any
    lost: Any
    calm: Any
    taught: Any
    swing: Any


FLAG = Flags(*range(len(Flags._fields)))
"""Where they stand."""
_FLAGS = len(FLAG)


class Memory(NamedTuple):
    """The parts of one lane's memory as arrays; zeros when an episode begins. n joints, N numbers of z.

    Attributes:
        flags: see `Flags`.
        z: prediction of (x, p) for this sample, (N,).
        P: its covariance, (N, N).
        commands: torques commanded [N m], newest first, (`LONGEST_LATENESS` + 2, n).
        references: q_d, q̇_d, q̈_d, newest first, (`KEPT`, `ORDERS`, n).
        read: what `read_noise` keeps of the last sample, (3, n).
        moves: mean of the corrections of each force [N], then that of their square [N²], (forces + 1,).
        noise: variance of the noise of the measured angles [rad²], (n,).
    """

    flags: Any
    z: Any
    P: Any
    commands: Any
    references: Any
    read: Any
    moves: Any
    noise: Any


def places(joints: int, belief: Belief) -> Memory:
    """Return the parts as places of arrays in a law's memory."""
    size = 4 * joints + belief.lateness.stop
    shapes = (
        (_FLAGS,), (size,), (size, size), (LONGEST_LATENESS + 2, joints), (KEPT, ORDERS, joints), (READ, joints),
        (forces_in(belief) + 1,), (joints,),
    )  # fmt: skip
    return Memory(*map(Cells, shapes))


def layout(joints: int, belief: Belief) -> Memory:
    """Return where the parts lie, as slices; `belief` says where the parts of p do."""
    size = 4 * joints + belief.lateness.stop
    return Memory(
        *consecutive(
            _FLAGS,
            size,
            size * size,
            (LONGEST_LATENESS + 2) * joints,
            KEPT * ORDERS * joints,
            READ * joints,
            forces_in(belief) + 1,
            joints,
        )
    )


def remembered(memory: np.ndarray, joints: int, beliefs: int, forces: int) -> Memory:
    """Return the parts of one lane's memory as views of it, each in its shape.

    Args:
        memory: of the lane.
        joints: n.
        beliefs: how many numbers p has.
        forces: how many of them are forces.
    """
    size = 4 * joints + beliefs
    z = _FLAGS
    covariance = z + size
    commands = covariance + size * size
    references = commands + (LONGEST_LATENESS + 2) * joints
    read = references + KEPT * ORDERS * joints
    moves = read + READ * joints
    noise = moves + forces + 1
    return Memory(
        memory[:z],
        memory[z:covariance],
        memory[covariance:commands].reshape((size, size)),
        memory[commands:references].reshape((LONGEST_LATENESS + 2, joints)),
        memory[references:read].reshape((KEPT, ORDERS, joints)),
        memory[read:moves].reshape((READ, joints)),
        memory[moves:noise],
        memory[noise : noise + joints],
    )
