"""The paper's arm as `Physics`, and what can be read off it: the tip, torques of gravity, forces and motions.

Its equations are in `dynamics`, `friction` and `integrator`. Elementwise source, see `elementwise`.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

from fuzzyarm.common import checks
from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import Arm, Payload, Plant
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.integrator import loaded_step, step
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.physics import VARIED, Physics
from fuzzyarm.envs.physics.records import PerJoint, Point

__all__ = ["Limits", "tip_point", "two_joints"]


class Limits(NamedTuple):
    """Limits of the joint angles [rad], of their velocities [rad/s] and of the motor torques [N m], to either side."""

    angle: PerJoint
    velocity: PerJoint
    torque: PerJoint


@functools.cache
def two_joints() -> Physics:
    """Return the equations of the arm with two joints in a plane."""
    return Physics(
        joints=2, axes=2, digest="", made_by=(two_joints, ()), Plant=Plant, Arm=Arm, Limits=Limits,
        plant_of=dynamics.plant_of, step=step, loaded_step=loaded_step, tip=tip_point, tip_velocity=_tip_velocity,
        tip_load=_tip_load, gravity=_gravity, motor_friction=dynamics.motor_friction,
        inverse_dynamics=_inverse_dynamics, mass_matrix=_mass_matrix, payload_place=_payload_radius,
        constants=_constants, stiffness=lambda plant: plant.stiffness,
        limits=lambda plant: Limits(plant.joint_limit, plant.velocity_limit, plant.torque_limit),
        angle_range=lambda limits: (PerJoint(*(-high for high in limits.angle)), limits.angle), varied=_varied,
    )  # fmt: skip


def tip_point(angles: PerJoint, arm: Arm) -> Point:
    """Return the tip [m] of (26) at joint angles [rad]."""
    sin1, cos1, sin12, cos12 = _directions(angles)
    return Point(arm.length1 * cos1 + arm.length2 * cos12, arm.length1 * sin1 + arm.length2 * sin12)


def _tip_velocity(angles: PerJoint, rates: PerJoint, arm: Arm) -> Point:
    first, second = arm.length1 * rates.joint1, arm.length2 * (rates.joint1 + rates.joint2)
    sin1, cos1, sin12, cos12 = _directions(angles)
    return Point(-sin1 * first - sin12 * second, cos1 * first + cos12 * second)


def _tip_load(angles: PerJoint, force: Point, arm: Arm) -> PerJoint:
    return PerJoint(*dynamics.tip_force_torque(*_directions(angles), force.x, force.y, arm))


def _gravity(angles: PerJoint, arm: Arm) -> PerJoint:
    sin1, _, sin12, _ = _directions(angles)
    return PerJoint(*dynamics.gravity_torque(sin1, sin12, arm))


def _mass_matrix(angles: PerJoint, arm: Arm) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    m11, m12, m22 = dynamics.mass_matrix(sine_cosine(angles.joint2)[1], arm)
    return (m11, m12), (m12, m22)


def _inverse_dynamics(angles: PerJoint, rates: PerJoint, accelerations: PerJoint, arm: Arm) -> PerJoint:
    (m11, m12), (_, m22) = _mass_matrix(angles, arm)
    coriolis1, coriolis2 = dynamics.coriolis_torque(sine_cosine(angles.joint2)[0], *rates, arm)
    (gravity1, gravity2), (ddq1, ddq2) = _gravity(angles, arm), accelerations
    return PerJoint(m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1, m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2)


def _directions(angles: PerJoint) -> tuple[Any, Any, Any, Any]:
    """Return sin q1, cos q1, sin q12 and cos q12."""
    return (*sine_cosine(angles.joint1), *sine_cosine(angles.joint1 + angles.joint2))


def _payload_radius(payload: Payload, parameters: ArmParameters) -> float:
    """Return the distance of a payload from joint 2 [m]."""
    return checks.real("payload radius", payload.radius(parameters), "m", low=0.0, high=LARGEST)


def _constants(plant: Any, payload: Any, radius: Any, tip_payload: Any) -> Arm:
    """Return the constants with a point mass [kg] on link 2 at a distance [m] from joint 2, and another at the tip."""
    arm = dynamics.loaded(dynamics.lump(plant), payload, radius, plant.gravity)
    return dynamics.loaded(arm, tip_payload, plant.length[1], plant.gravity)


def _varied(plant: Any, draw: Any) -> Any:
    """Return the plant with the factors of a draw."""
    pairs = {name: zip(getattr(plant, name), getattr(draw, factor), strict=True) for name, factor in VARIED.items()}
    return plant._replace(**{name: PerJoint(*(number * by for number, by in pair)) for name, pair in pairs.items()})
