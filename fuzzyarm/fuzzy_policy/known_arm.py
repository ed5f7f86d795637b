"""The arm that a law knows (the two-joint arm or any robot), as numbers for compiled code."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import shown
from fuzzyarm.envs.physics import dynamics, rigid_body
from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.friction import DRY_TORQUES, DryFriction
from fuzzyarm.envs.physics.joint import as_rows
from fuzzyarm.envs.physics.records import filled, flat
from fuzzyarm.envs.physics.robot import Robot

__all__ = [
    "QUANTITIES", "Drives", "checked_arm", "joints_of", "numbers_of", "per_joint_of", "travel_of",
    "with_drives", "with_mass", "without_dry_friction",
]  # fmt: skip


class Drives(NamedTuple):
    """Quantities of motors and springs; each is a tuple with a value for every joint, or the value of one joint."""

    motor_inertia: Any
    viscous_friction: Any
    stiffness: Any
    damping: Any
    dry_friction: DryFriction


QUANTITIES = (*Drives._fields[:-1], *DryFriction._fields)  # names of the quantities in `Drives`, in order


def checked_arm(name: str, arm: Any) -> AnyArm:
    """Return an arm or a robot; TypeError for anything else."""
    if not isinstance(arm, AnyArm):
        raise TypeError(
            f"{name} = {shown(arm)} must be a fuzzyarm.envs.physics.parameters.ArmParameters or a "
            "fuzzyarm.envs.physics.robot.Robot"
        )
    return arm


def joints_of(arm: AnyArm) -> int:
    """Return an arm's number of joints n."""
    return len(arm) if isinstance(arm, Robot) else len(arm.length)


def per_joint_of(arm: AnyArm, name: str) -> np.ndarray:
    """Return a quantity of the joints' drives (n,) by its name in `Drive`."""
    if isinstance(arm, Robot):
        return arm.drive(name)
    return np.broadcast_to(np.array(getattr(arm, name), dtype=float), (joints_of(arm),)).copy()


def _constants_of(arm: AnyArm) -> np.ndarray:
    """Return the constants (k,) in the record `Physics.Arm` of an arm without a payload."""
    physics = equations_of(arm)
    return np.array(flat(physics.constants(physics.plant_of(arm), 0.0, 0.0, 0.0)), dtype=np.float64)


def numbers_of(arm: AnyArm) -> tuple[Any, Drives]:
    """Return the `Physics.Arm` without a payload and the `Drives` of an arm as records of floats."""
    drives: Drives = filled(Drives, (tuple(per_joint_of(arm, name).tolist()) for name in QUANTITIES))
    return filled(equations_of(arm).Arm, _constants_of(arm).tolist()), drives


def travel_of(arm: AnyArm, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Return the unit vector (..., axes) of the tip's velocity at q and q̇ (..., n) [rad, rad/s], zeros at rest."""
    if isinstance(arm, Robot):
        jacobian = rigid_body.tip_jacobian(arm, q)[..., : equations_of(arm).axes, :]
    else:
        jacobian = dynamics.tip_jacobian(q, arm.length)
    velocity = np.sum(jacobian * dq[..., np.newaxis, :], axis=-1)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    direction: np.ndarray = np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0.0)
    return direction


def with_drives(arm: AnyArm, **quantities: np.ndarray) -> AnyArm:
    """Return the arm with `quantities` of its drives replaced, each (n,), in the SI units of `Drive`."""
    if isinstance(arm, Robot):
        joints = []
        for k, joint in enumerate(arm.joints):
            drive = dataclasses.replace(joint.drive, **{name: float(q[k]) for name, q in quantities.items()})
            joints.append(dataclasses.replace(joint, drive=drive))
        return dataclasses.replace(arm, joints=tuple(joints))
    parts: dict[str, Any] = {name: tuple(q.tolist()) for name, q in quantities.items()}
    return dataclasses.replace(arm, **parts)


def with_mass(robot: Robot, factor: float) -> Robot:
    """Return the robot with the mass and inertia of its links multiplied by `factor`."""
    joints = []
    for joint in robot.joints:
        mass, inertia = factor * joint.link.mass, as_rows(factor * np.array(joint.link.inertia))
        joints.append(dataclasses.replace(joint, link=dataclasses.replace(joint.link, mass=mass, inertia=inertia)))
    return dataclasses.replace(robot, joints=tuple(joints))


def without_dry_friction(arm: AnyArm) -> AnyArm:
    """Return the same arm without dry friction."""
    none = np.zeros(joints_of(arm))
    return with_drives(arm, **dict.fromkeys(DRY_TORQUES, none))
