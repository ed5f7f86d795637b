"""What the adaptive observer needs of the arm: compiled functions of the numbers that its beliefs change.

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
from numba.extending import register_jitable

from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.friction import stribeck_magnitude
from fuzzyarm.envs.physics.physics import Physics
from fuzzyarm.envs.physics.records import flat, in_list, in_rows, places, reader, size, writer
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.fuzzy_policy.known_arm import Drives
from fuzzyarm.fuzzy_policy.laws.adaptive.hold import hold_of

__all__ = ["ArmFunctions", "arm_functions", "dry_friction", "numbers_of"]

REST = 1e-9  # m/s; below, a tip has no direction of travel
# How the constants of the two-joint arm are called where it is not as in `Drives`.
_SHORT = {"viscous_friction": "viscous", "coulomb_friction": "coulomb", "static_friction": "static"}
_SHARED = "stribeck_velocity"  # of both joints of that arm
# By factor of the beliefs, the factor of a random plant that multiplies the same.
_DRAWN = {
    "stiffness": "stiffness",
    "damping": "damping",
    "friction": "dry_friction",
    "mass": "mass",
    "motor_inertia": "motor_inertia",
}


class ArmFunctions(NamedTuple):
    """Compiled functions of the numbers (k,) of an arm of n joints whose tip moves in a space of some axes.

    Attributes:
        hold: ``hold(state, torque, force, numbers, h, substeps)``, that of `hold_of` with the numbers of each copy of
            the arm (k, copies) in place of its constants.
        link_torque: ``link_torque(q, dq, ddq, force, numbers, torque)`` fills `torque` (n,) with M q̈ + C q̇ + g - Jᵀ F
            [N m], the torque of the joints under a tip force F (axes,) [N].
        tip_direction: ``tip_direction(q, dq, numbers, direction)`` fills `direction` (axes,) with v/|v| of the tip at
            q (n,) [rad] and q̇ (n,) [rad/s], zeros at rest.
        drive: ``drive(numbers, joint)``, the `Drives` of one joint.
    """

    hold: Any
    link_torque: Any
    tip_direction: Any
    drive: Any


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


@register_jitable
def dry_friction(velocity: float, drive: Drives) -> float:
    """Return the torque [N m] that overcomes a motor's dry friction at a velocity [rad/s], 0 at rest."""
    slip = stribeck_magnitude(velocity, drive.coulomb_friction, drive.static_friction, drive.stribeck_velocity)
    torque: float = slip * np.sign(velocity)
    return torque


@functools.cache
def arm_functions(physics: Physics) -> ArmFunctions:
    """Return the functions of arms with these equations."""
    joints, axes, Point = physics.joints, physics.axes, physics.Point
    inverse_dynamics, tip_load, tip_velocity = physics.inverse_dynamics, physics.tip_load, physics.tip_velocity
    per_joint, point, constants_in = reader(physics.PerJoint, in_list), reader(Point, in_list), _constants_in(physics)

    @register_jitable
    def link_torque(
        q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, force: np.ndarray, numbers: np.ndarray, torque: np.ndarray
    ) -> None:
        arm, angles = constants_in(numbers), per_joint(q, 0)
        inner = inverse_dynamics(angles, per_joint(dq, 0), per_joint(ddq, 0), arm)
        outer = tip_load(angles, point(force, 0), arm)
        for j in range(joints):
            torque[j] = inner[j] - outer[j]

    @register_jitable
    def tip_direction(q: np.ndarray, dq: np.ndarray, numbers: np.ndarray, direction: np.ndarray) -> None:
        velocity = tip_velocity(per_joint(q, 0), per_joint(dq, 0), constants_in(numbers))
        square = 0.0
        for i in range(axes):
            square += velocity[i] * velocity[i]
        speed = np.sqrt(square)
        scale = 1.0 / speed if speed > REST else 0.0
        for i in range(axes):
            direction[i] = velocity[i] * scale

    return ArmFunctions(_hold_of(physics), link_torque, tip_direction, _drive_of(physics))


def _constants_in(physics: Physics) -> Any:
    """Return the compiled function that gives the `Arm` of numbers (k,)."""
    if physics is two_joints():
        arm_in = reader(physics.Arm, in_list)

        @register_jitable
        def constants_in(numbers: np.ndarray) -> Any:
            return arm_in(numbers, 0)

    else:
        plant_in, constants, payload = reader(physics.Plant, in_list), physics.constants, size(physics.Plant)

        @register_jitable
        def constants_in(numbers: np.ndarray) -> Any:
            return constants(plant_in(numbers, 0), 0.0, 0.0, numbers[payload])

    return constants_in


def _hold_of(physics: Physics) -> Any:
    """Return `ArmFunctions.hold`."""
    plain = hold_of(physics)
    if physics is two_joints():
        return plain
    constants_in, write, count = _constants_in(physics), writer(physics.Arm, in_rows), size(physics.Arm)

    @register_jitable
    def hold(
        state: np.ndarray, torque: np.ndarray, force: np.ndarray, numbers: np.ndarray, h: float, substeps: int
    ) -> None:
        constants = np.empty((count, numbers.shape[1]))
        for copy in range(numbers.shape[1]):
            write(constants, copy, constants_in(numbers[:, copy]))
        plain(state, torque, force, constants, h, substeps)

    return hold


def _drive_of(physics: Physics) -> Any:
    """Return `ArmFunctions.drive`."""
    short = physics is two_joints()
    at = places(physics.Arm if short else physics.Plant)

    def name(part: str, joint: int) -> str:
        return part if short and part == _SHARED else f"{_SHORT.get(part, part) if short else part}{joint}"

    where = np.array([[getattr(at, name(part, 1 + j)) for j in range(physics.joints)] for part in Drives._fields])
    inertia, viscous, stiffness, damping, coulomb, static, stribeck = where

    @register_jitable
    def drive(numbers: np.ndarray, joint: int) -> Drives:
        return Drives(
            numbers[inertia[joint]],
            numbers[viscous[joint]],
            numbers[stiffness[joint]],
            numbers[damping[joint]],
            numbers[coulomb[joint]],
            numbers[static[joint]],
            numbers[stribeck[joint]],
        )

    return drive
