"""The paper's arm as `Physics`: its equations are in `dynamics`, `friction`, `integrator` and `readings`."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.dynamics import Arm, Payload, Plant, loaded, lump, plant_of
from fuzzyarm.envs.physics.integrator import loaded_step, step
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.physics import VARIED, Physics
from fuzzyarm.envs.physics.readings import (
    gravity_at,
    inverse_dynamics_at,
    mass_matrix_at,
    motor_friction,
    tip_load,
    tip_point,
    tip_velocity,
)
from fuzzyarm.envs.physics.records import PerJoint

__all__ = ["Limits", "two_joints"]


class Limits(NamedTuple):
    """Limits of the joint angles [rad], of their velocities [rad/s] and of the motor torques [N m], to either side."""

    angle: PerJoint
    velocity: PerJoint
    torque: PerJoint


@functools.cache
def two_joints() -> Physics:
    """Return the equations of the arm with two joints in a plane."""
    return Physics(
        joints=2, axes=2, digest="", made_by=(two_joints, ()), Plant=Plant, Arm=Arm, Limits=Limits, plant_of=plant_of,
        step=step, loaded_step=loaded_step, tip=tip_point, tip_velocity=tip_velocity, tip_load=tip_load,
        gravity=gravity_at, motor_friction=motor_friction, inverse_dynamics=inverse_dynamics_at,
        mass_matrix=mass_matrix_at, payload_place=_payload_radius, constants=_constants, stiffness=_stiffness,
        limits=_limits, angle_range=_angle_range, varied=_varied,
    )  # fmt: skip


def _payload_radius(payload: Payload, parameters: ArmParameters) -> float:
    """Return the distance of a payload from joint 2 [m]."""
    return checks.real("payload radius", payload.radius(parameters), "m", low=0.0, high=LARGEST)


def _constants(plant: Any, payload: Any, radius: Any, tip_payload: Any) -> Arm:
    """Return the constants with a point mass [kg] on link 2 at a distance [m] from joint 2, and another at the tip."""
    arm = loaded(lump(plant), payload, radius, plant.gravity)
    both: Arm = loaded(arm, tip_payload, plant.length[1], plant.gravity)
    return both


def _stiffness(plant: Any) -> Any:
    return plant.stiffness


def _limits(plant: Any) -> Limits:
    return Limits(plant.joint_limit, plant.velocity_limit, plant.torque_limit)


def _angle_range(limits: Limits) -> tuple[PerJoint, PerJoint]:
    high = limits.angle
    return PerJoint(-high.joint1, -high.joint2), high


def _times(numbers: PerJoint, factors: PerJoint) -> PerJoint:
    return PerJoint(numbers.joint1 * factors.joint1, numbers.joint2 * factors.joint2)


def _varied(plant: Any, draw: Any) -> Any:
    """Return the plant with the factors of a draw."""
    return plant._replace(**{name: _times(getattr(plant, name), getattr(draw, VARIED[name])) for name in VARIED})
