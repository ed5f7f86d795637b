"""What the adaptive observer needs of the arm: functions of the numbers that its beliefs change.

These numbers are affine in the beliefs, see `belief.affine_numbers`. For the two-joint arm they are the constants of
its equations. The constants of a robot are not affine in its masses; its numbers are those of the `Plant`, then a mass
at the tip [kg], and the constants follow from them.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.elementwise import root, select, sign
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.hold import held_of
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import filled, places, size
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.known_arm import QUANTITIES, Drives
from fuzzyarm.numbers.functions import each, flat, like, maximum

__all__ = ["ArmFunctions", "arm_functions", "dry_friction", "numbers_of"]

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
            now = like(places(physics.State), (state[i, copy] for i in range(len(state))))
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
        return lambda numbers: like(places(physics.Arm), iter(numbers))
    count = size(physics.Plant)

    def constants_in(numbers: Any) -> Any:
        given = list(numbers)
        return physics.constants(like(places(physics.Plant), iter(given[:count])), 0.0, 0.0, given[count])

    return constants_in


def _drive_of(physics: Physics) -> Any:
    """Return `ArmFunctions.drive`."""
    short = physics is two_joints()
    at = places(physics.Arm if short else physics.Plant)
    names = ("motor_inertia", "viscous", "stiffness", "damping", "dry_friction") if short else QUANTITIES

    def drive(numbers: Any, joint: int) -> Drives:
        wanted = flat(tuple(getattr(at, f"{name}{1 + joint}") for name in names))
        found: Drives = filled(Drives, (numbers[k] for k in wanted))
        return found

    return drive
