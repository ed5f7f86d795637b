"""What the adaptive observer estimates beside the arm's state: load, constants of the arm, lateness.

    p = (f_t, F, m_p, k, β, φ, μ, ι, w, d)

The load is a force f_t along the reference's tip velocity, a free force F at the tip and a payload m_p there. k, β, φ,
μ and ι are factors, one for each joint, of stiffness, damping, dry friction, link mass and inertia, and motor inertia.
w is a torque that acts beside that of each motor, and d the time from a command to the motors, in control periods.

The numbers of the arm, see `arm`, are affine in (m_p, k, β, φ, μ, ι): a = a_0 + S (p - p_0).

A lane remembers it from one sample to the next, with what else the law needs, in a fixed number of numbers: `Memory`.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.slices import consecutive
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.arm import numbers_of
from fuzzyarm.fuzzy_policy.laws.adaptive.weights import AdaptiveWeights, mass_of, unit_force
from fuzzyarm.numbers.functions import Cells

__all__ = [
    "CAUTIOUS", "ENOUGH", "FACTORS", "FLAG", "KEPT", "LONGEST_LATENESS", "ORDERS", "Belief", "Flags", "Memory",
    "affine_numbers", "allowed", "belief_of", "first_guess", "first_spread", "forces_in", "layout", "places",
    "remembered", "walks",
]  # fmt: skip


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
