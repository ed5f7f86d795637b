"""The parameters that the adaptive observer estimates besides the arm's state, and its memory between samples.

    p = (f_t, F, m_p, k, β, φ, μ, ι, w, d)

The load consists of a force f_t along the reference's tip velocity, a free force F and a payload m_p, all at the tip.
k, β, φ, μ and ι are factors, one for each joint, on stiffness, damping, dry friction, link mass and inertia, and motor
inertia. w is a torque added to each motor's torque, and d the delay from a command to the motors, in control periods.

The equations of the arm are computed from a vector a that is affine in (m_p, k, β, φ, μ, ι): a = a_0 + S (p - p_0), a_0
and p_0 for the known, unloaded arm. For the two-joint arm, a contains its equations' constants. For a robot, whose
constants are not affine in its masses, a contains the entries of the `Plant`, then a mass at the tip [kg].

`AdaptiveWeights` contains the prior uncertainty of p and the cost of errors: torques relative to the arm's
`torque_limit`, joint by joint, and forces relative to `unit_force`.
"""

import dataclasses
import functools
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.arithmetic import consecutive
from fuzzyarm.common.checks import real
from fuzzyarm.envs.physics import records
from fuzzyarm.envs.physics.elementwise import root, select
from fuzzyarm.envs.physics.equations import AnyArm, equations_of, two_joints
from fuzzyarm.envs.physics.integrator import held_of
from fuzzyarm.envs.physics.records import Physics, filled, size
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import reach
from fuzzyarm.fuzzy_policy.known_arm import QUANTITIES, Drives, per_joint_of
from fuzzyarm.fuzzy_policy.laws.observer_gains import WEIGHT_RANGE
from fuzzyarm.numbers.functions import Cells, each, flat, maximum

__all__ = [
    "FACTORS", "FLAG", "KEPT", "LONGEST_DELAY", "AdaptiveWeights", "ArmFunctions", "Memory",
    "affine_numbers", "belief_of", "layout", "mass_of", "places", "prior", "unit_force",
]  # fmt: skip

LONGEST_DELAY = 3  # longest time from a command to the motors that the filter considers [control periods]
KEPT = 5
"""Number of references stored, including the current one: derivatives of the joint torque are differences of four
references, and the change of the feedforward needs one more."""
_REST = 1e-9  # m/s; a slower tip has no direction of travel


@dataclasses.dataclass(frozen=True)
class AdaptiveWeights:
    """Weights of the filter and of the regulator, each in `WEIGHT_RANGE`."""

    link_angle: float = 0.0037  # link angle error [rad] that costs as much as the torque limit
    link_velocity: float = 1.57  # link velocity error [rad/s] that costs as much as the torque limit
    first_gain: float = 0.5  # share of the regulator's gain with which an episode begins
    soft_start: float = 0.015  # time for which this share stays constant [s]; it then grows to 1 in the same time
    motor_torque: float = 4.9e-4  # white noise of the motor torque, share of the torque limit times √s
    # Error of a motor's torque, as a share of the torque limit, after a jump of the commanded torque by the whole
    # limit; the error grows with the square of the jump
    torque_doubt: float = 0.4
    travel_walk: float = 1.5  # random walk of the force along the path, share of the unit force per √s
    force_walk: float = 0.59  # random walk of each component of the free force, likewise
    calm_walk: float = 0.33  # share of these walks that is used while only noise corrects the forces
    reopening: float = 0.29  # when a force begins to move, its variance grows at once by a walk of this time [s]
    encoder_angle: float = 2e-5  # standard deviation of a measured angle [rad]
    encoder_velocity: float = 2.1e-3  # standard deviation of a measured velocity [rad/s]
    first_force: float = 2e-3  # standard deviation of each force when an episode begins, share of the unit force
    first_payload: float = 0.125  # likewise of the payload at the tip, share of the mass of all links
    first_stiffness: float = 0.12  # likewise of the factors on joint stiffness
    first_damping: float = 0.3  # likewise of the factors on joint damping
    first_friction: float = 0.3  # likewise of the factors on dry friction
    first_inertia: float = 0.06  # likewise of the factors on link masses and on motor inertias
    first_offset: float = 0.01  # likewise of the torques w added to the motors' torques, share of the torque limit
    first_scale: float = 0.1  # likewise of a factor common to the arm's constants, as caused by a wrong torque constant
    first_lateness: float = 1.5  # likewise of the delay [control periods]
    first_link_angle: float = 1e-3  # likewise of the link angles [rad]
    scale_doubt: float = 1.5e-3  # variance that a sample adds to the common factor, divided by the sample's surprise a
    gate: float = 1.5  # squared standardised innovation above which a sample counts less
    # Squared innovation, relative to the variance of the estimated noise, below which the constants do not adapt
    dead_zone: float = 16.0
    # Mean jump of the commands, relative to the torque limits, from which on the loop counts as lost; a mean above 2 is
    # not possible
    largest_swing: float = 0.5

    def __post_init__(self) -> None:
        low, high = WEIGHT_RANGE
        for field in dataclasses.fields(self):
            real(f"AdaptiveWeights.{field.name}", getattr(self, field.name), low=low, high=high)


def unit_force(arm: AnyArm) -> float:
    """Return the force [N] at the tip, across the stretched arm, that loads the first motor with its torque limit."""
    if isinstance(arm, Robot):
        return float(arm.drive("torque_limit")[0] / reach(arm))
    return arm.torque_limit[0] / sum(arm.length)


def mass_of(arm: AnyArm) -> float:
    """Return the mass of all links [kg]."""
    return float(sum(arm.arrays.mass)) if isinstance(arm, Robot) else sum(arm.mass)


class _Belief(NamedTuple):
    """A value for each part of the estimated parameters p, such as its slice; forces come first, the delay last."""

    travel_force: Any  # f_t [N]
    force: Any  # F [N], (axes,)
    payload: Any  # m_p [kg]
    stiffness: Any  # k (n,)
    damping: Any  # β (n,)
    friction: Any  # φ (n,)
    mass: Any  # μ (n,)
    motor_inertia: Any  # ι (n,)
    offset: Any  # w [N m], (n,)
    lateness: Any  # d [control periods]


FACTORS = ("stiffness", "damping", "friction", "mass", "motor_inertia")  # the parts that are factors on constants


@functools.cache
def belief_of(physics: Physics) -> _Belief:
    """Return the slices of the parts of p in an array, for arms with these equations."""
    return _Belief(*consecutive(1, physics.axes, 1, *[physics.joints] * (len(FACTORS) + 1), 1))


class _Prior(NamedTuple):
    """The prior of the estimated parameters p; each part is an array (size of p,)."""

    guess: Any  # p_0: no load, the known arm, no delay
    spread: Any  # standard deviations when an episode begins
    walk: Any  # random walk of each entry, per √s
    low: Any
    high: Any


def prior(arm: AnyArm, weights: AdaptiveWeights) -> _Prior:
    """Return the prior of the estimated parameters p for an arm."""
    w, limit, mass, unit = weights, per_joint_of(arm, "torque_limit"), mass_of(arm), unit_force(arm)
    first, force, torque = w.first_force * unit, 4.0 * unit, 0.2 * limit
    parts = _Belief(  # p_0, deviation, walk, lowest, highest; a negative payload: links lighter than modelled
        travel_force=(0.0, first, w.travel_walk * unit, -force, force),
        force=(0.0, first, w.force_walk * unit, -force, force),
        payload=(0.0, w.first_payload * mass, 0.0, -0.1 * mass, 2.0 * mass),
        stiffness=(1.0, w.first_stiffness, 0.0, 0.5, 1.9),
        damping=(1.0, w.first_damping, 0.0, 0.0, 3.0),
        friction=(1.0, w.first_friction, 0.0, 0.0, 3.0),
        mass=(1.0, w.first_inertia, 0.0, 0.5, 1.9),
        motor_inertia=(1.0, w.first_inertia, 0.0, 0.5, 1.9),
        offset=(0.0, w.first_offset * limit, 0.0, -torque, torque),
        lateness=(0.0, w.first_lateness, 0.0, 0.0, float(LONGEST_DELAY)),
    )
    belief = belief_of(equations_of(arm))
    arrays = np.empty((len(_Prior._fields), belief.lateness.stop))
    for part, values in zip(belief, parts, strict=True):
        for array, value in zip(arrays, values, strict=True):
            array[part] = value
    return _Prior(*arrays)


def _numbers_of(arm: AnyArm, payload: float = 0.0, factors: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
    """Return the vector a (k,) of an arm with a payload [kg].

    `factors` (n,), by their names in `FACTORS`, multiply the arm's constants.
    """
    physics = equations_of(arm)
    drawn = dict.fromkeys((*FACTORS, "viscous_friction"), np.ones(physics.joints)) | dict(factors or {})
    drawn["dry_friction"] = drawn.pop("friction")
    draw = SimpleNamespace(**{name: physics.PerJoint(*values.tolist()) for name, values in drawn.items()})
    plant = physics.varied(physics.plant_of(arm), draw)
    numbers = physics.constants(plant, 0.0, 0.0, payload) if physics is two_joints() else (*plant, payload)
    return np.array(flat(numbers), dtype=np.float64)


def affine_numbers(arm: AnyArm) -> tuple[np.ndarray, np.ndarray]:
    """Return a_0 (k,) and S (k, size of p): the arm's constants for p are a_0 + S (p - p_0)."""
    base, belief = _numbers_of(arm), belief_of(equations_of(arm))
    slopes = np.zeros((len(base), belief.lateness.stop))
    slopes[:, belief.payload] = (_numbers_of(arm, 1.0) - base)[:, np.newaxis]
    for name in FACTORS:
        part = getattr(belief, name)
        for joint, unit in enumerate(np.eye(part.stop - part.start)):
            slopes[:, part.start + joint] = _numbers_of(arm, factors={name: 1.0 + unit}) - base
    return base, slopes


class ArmFunctions:
    """Functions of the vector a (k,) of an arm's constants, for n joints and a tip in a plane or in space."""

    def __init__(self, physics: Physics) -> None:
        self._physics, self._advance, self._planar = physics, held_of(physics), physics is two_joints()
        self._record = physics.Arm if self._planar else physics.Plant
        short = "motor_inertia", "viscous", "stiffness", "damping", "dry_friction"
        at, names = records.places(self._record), short if self._planar else QUANTITIES
        drives = (tuple(getattr(at, f"{name}{1 + joint}") for name in names) for joint in range(physics.joints))
        self._drives = [flat(drive) for drive in drives]  # indices of each joint's entries

    def constants_in(self, numbers: Any) -> Any:
        """Return the constants of the arm's equations for the vector a (k,), here `numbers`."""
        given, count = list(numbers), size(self._record)
        known = filled(self._record, given[:count])
        return known if self._planar else self._physics.constants(known, 0.0, 0.0, given[count])

    def drive(self, numbers: Any, joint: int) -> Drives:
        """Return the parameters of a joint's motor and spring from `numbers`, the vector a."""
        found: Drives = filled(Drives, (numbers[k] for k in self._drives[joint]))
        return found

    def hold(self, state: Any, torque: Any, force: Any, numbers: Any, h: Any, substeps: int) -> None:
        """Advance `state` in place by `substeps` of h [s]; the arrays are those of `filter._Copies`."""
        physics, axes = self._physics, self._physics.axes
        for copy in each(state.shape[1]):
            now = filled(physics.State, (state[i, copy] for i in range(len(state))))
            held = physics.PerJoint(*(torque[j, copy] for j in range(physics.joints)))
            mean, change = ([force[first + i, copy] for i in range(axes)] for first in (0, axes))
            arm = self.constants_in([numbers[i, copy] for i in range(len(numbers))])
            for i, number in enumerate(flat(self._advance(now, held, mean, change, arm, h, substeps))):
                state[i, copy] = number

    def link_torque(self, q: Any, dq: Any, ddq: Any, force: Any, arm: Any) -> list[Any]:
        """Return M q̈ + C q̇ + g - Jᵀ F (n,) [N m], the torque of the joints under a tip force F (axes,) [N]."""
        PerJoint = self._physics.PerJoint
        inner = self._physics.inverse_dynamics(PerJoint(*q), PerJoint(*dq), PerJoint(*ddq), arm)
        outer = self._physics.tip_load(PerJoint(*q), self._physics.Point(*force), arm)
        return [a - b for a, b in zip(inner, outer, strict=True)]

    def tip_direction(self, q: Any, dq: Any, arm: Any) -> list[Any]:
        """Return v/|v| (axes,) of the tip at q (n,) [rad] and q̇ (n,) [rad/s], zeros at rest."""
        PerJoint, square = self._physics.PerJoint, 0.0
        velocity = self._physics.tip_velocity(PerJoint(*q), PerJoint(*dq), arm)
        for v in velocity:
            square = square + v * v
        speed = root(square)
        scale = select(speed > _REST, 1.0 / maximum(speed, _REST), 0.0)
        return [v * scale for v in velocity]


class _Flags(NamedTuple):
    """The scalars in a filter's memory, or their indices."""

    samples: Any  # number of samples so far, up to 1e6
    surprise: Any  # mean of ν²/s over the last samples; about 1 if the filter is right
    lost: Any  # 1 once the filter has diverged or the torques swing, else 0
    calm: Any  # 1 where the corrections of the forces look like noise, 0 where they have a direction
    taught: Any  # 1 if the episode began with a memory learned in an earlier pass, else 0
    swing: Any  # mean jump of the commands over the last samples, see `filter`


FLAG = _Flags(*range(len(_Flags._fields)))  # indices of the flags


class Memory(NamedTuple):
    """The parts of a filter's memory as arrays, zeros when an episode begins; n joints, N entries of z = (x, p)."""

    flags: Any  # see `_Flags`
    z: Any  # prediction for this sample, (N,)
    P: Any  # its covariance, (N, N)
    commands: Any  # torques commanded [N m], newest first, (`LONGEST_DELAY` + 2, n)
    references: Any  # q_d, q̇_d, q̈_d, newest first, (`KEPT`, 3, n)
    read: Any  # θ, θ̇ and e of the last sample, see `filter`, (3, n)
    moves: Any  # mean correction of each force [N], then the mean squared correction [N²], (forces + 1,)
    noise: Any  # variance of the noise of the measured angles [rad²], (n,)


def places(physics: Physics) -> Memory:
    """Return a `Memory` with a placeholder (`Cells`) for the array of each part."""
    joints, belief = physics.joints, belief_of(physics)
    N = 4 * joints + belief.lateness.stop
    lists = (LONGEST_DELAY + 2, joints), (KEPT, 3, joints), (3, joints)
    return Memory(*map(Cells, ((len(FLAG),), (N,), (N, N), *lists, (belief.force.stop + 1,), (joints,))))


def layout(physics: Physics) -> Memory:
    """Return the slices of the parts of a `Memory` in a lane's array."""
    return Memory(*consecutive(*(part.size for part in places(physics))))
