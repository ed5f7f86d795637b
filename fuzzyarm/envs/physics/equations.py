"""The equations of motion of any arm, and those of the paper's two-joint arm.

The modules `dynamics`, `friction` and `integrator` define those of this arm. All are elementwise, see `elementwise`.
"""

import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml
from fuzzyarm.envs.physics import dynamics
from fuzzyarm.envs.physics.dynamics import Arm, Payload, Plant
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.integrator import loaded_step, step
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.ranges import Ranges
from fuzzyarm.envs.physics.records import VARIED, PerJoint, Physics, Point2
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots

__all__ = [
    "IN_FOLDER", "AnyArm", "argument_of", "bounds_of", "chosen_arm", "common_equations", "corners_of", "equations_of",
    "robot_of", "tip_point", "two_joints",
]  # fmt: skip

AnyArm = ArmParameters | Robot  # the two-joint arm by its parameters, or any serial robot
_PAPER = "paper"  # name of the two-joint arm of Table 1 among the robots
IN_FOLDER = "robot.toml"  # the file of the arm in a folder of `fuzzyarm tune`


class _Ranges(NamedTuple):
    """Limits of an arm of n joints: lowest and highest angles [rad], speeds [rad/s] and torques [N m], each (n,)."""

    low: np.ndarray
    high: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


def equations_of(arm: AnyArm) -> Physics:
    """Return the equations of motion of an arm; arms of one structure share one object."""
    if isinstance(arm, ArmParameters):
        return two_joints()
    from fuzzyarm.envs.physics._serial import physics_of  # the paper's arm needs no recursion

    return physics_of(arm)


def bounds_of(arm: AnyArm) -> _Ranges:
    """Return an arm's angle limits [rad], speed limits [rad/s] and torque limits [N m], each of shape (joints,)."""
    physics = equations_of(arm)
    limits = physics.limits(physics.plant_of(arm))
    low, high = physics.angle_range(limits)
    return _Ranges(*(np.array(part) for part in (low, high, limits.velocity, limits.torque)))


def chosen_arm(robot: Any, parameters: Any) -> AnyArm:
    """Return the arm given by the arguments ``robot`` and ``parameters`` of an environment; both None: Table 1.

    `robot` is the name of a shipped robot, the path of the TOML file of a robot or of a two-joint arm, a folder of
    `fuzzyarm tune`, a `Robot`, or `ArmParameters`. `parameters` are those of the two-joint arm.
    """
    if robot is None:
        return ArmParameters() if parameters is None else checks.instance("parameters", parameters, ArmParameters)
    if parameters is not None:
        raise ValueError(
            f"give either robot = {checks.shown(getattr(robot, 'name', robot))} or parameters of the two-joint arm, "
            "not both"
        )
    if isinstance(robot, Robot | ArmParameters):
        return robot
    if not isinstance(robot, str | os.PathLike):
        raise TypeError(
            f"robot is of type {type(robot).__name__}; give a name, the path of a TOML file, a Robot or ArmParameters"
        )
    return _named(os.fspath(robot))


def corners_of(robot: Any) -> dict[str, AnyArm]:
    """Return, by description, the arms at the ends of the ranges in the file ``robot``, see `Ranges.corners`.

    Args:
        robot: as for `chosen_arm`. The mapping is empty unless this is a file with a table ``[ranges]``.
    """
    if not isinstance(robot, str | os.PathLike) or robot in (_PAPER, *shipped_robots()):
        return {}
    path = Path(robot) / IN_FOLDER if (Path(robot) / IN_FOLDER).is_file() else Path(robot)
    arm = _named(str(path))
    return Ranges.taken(read_toml(path)).corners(arm)


def argument_of(arm: AnyArm) -> dict[str, Any]:
    """Return {name: arm}, the argument by which an environment takes the arm: ``parameters`` or ``robot``."""
    return {"parameters": arm} if isinstance(arm, ArmParameters) else {"robot": arm}


def _named(robot: str) -> AnyArm:
    if robot == _PAPER:
        return ArmParameters()
    if robot in shipped_robots():
        return robot_named(robot)
    if os.path.isfile(Path(robot) / IN_FOLDER):
        robot = str(Path(robot) / IN_FOLDER)
    if Path(robot).suffix == ".toml":
        if {"joints", "model", "name", "tip"}.isdisjoint(read_toml(Path(robot))):
            return ArmParameters.from_toml(robot)
        from fuzzyarm.envs.physics._robot_models import read_robot  # the paper's arm needs no reader

        return read_robot(robot)
    raise ValueError(
        f"unknown robot {checks.shown(robot)}; choose from: {', '.join(shipped_robots())}, or give a .toml file or a "
        "folder written by fuzzyarm tune"
    )


def robot_of(arm: AnyArm) -> Robot:
    """Return an arm as a robot."""
    return Robot.of(arm) if isinstance(arm, ArmParameters) else arm


def common_equations(arms: Sequence[AnyArm]) -> Physics:
    """Return the equations of motion that these arms share; ValueError if their equations differ."""
    first, *others = map(equations_of, arms)
    if any(other is not first for other in others):
        same = "equal joint axes and rotations, and zeros in the same other parameters"
        raise ValueError(f"the arms of a batch must have the same structure: {same}; make one batch for each structure")
    return first


class _Limits(NamedTuple):
    """Symmetric limits of the joint angles [rad], their velocities [rad/s] and the motor torques [N m]."""

    angle: PerJoint
    velocity: PerJoint
    torque: PerJoint


@functools.cache
def two_joints() -> Physics:
    """Return the equations of the arm with two joints in a plane."""
    return Physics(
        joints=2, axes=2, digest="", made_by=(two_joints, ()), Plant=Plant, Arm=Arm, Limits=_Limits,
        plant_of=dynamics.plant_of, step=step, loaded_step=loaded_step, tip=tip_point, tip_velocity=_tip_velocity,
        tip_load=_tip_load, gravity=_gravity, motor_friction=dynamics.motor_friction,
        inverse_dynamics=_inverse_dynamics, mass_matrix=_mass_matrix, payload_place=_payload_radius,
        constants=_constants, stiffness=lambda plant: plant.stiffness,
        limits=lambda plant: _Limits(plant.joint_limit, plant.velocity_limit, plant.torque_limit),
        angle_range=lambda limits: (PerJoint(*(-high for high in limits.angle)), limits.angle), varied=_varied,
    )  # fmt: skip


def tip_point(angles: PerJoint, arm: Arm) -> Point2:
    """Return the tip [m] of the two-joint arm at joint angles [rad], by equation (26)."""
    sin1, cos1, sin12, cos12 = _directions(angles)
    return Point2(arm.length1 * cos1 + arm.length2 * cos12, arm.length1 * sin1 + arm.length2 * sin12)


def _tip_velocity(angles: PerJoint, rates: PerJoint, arm: Arm) -> Point2:
    first, second = arm.length1 * rates.joint1, arm.length2 * (rates.joint1 + rates.joint2)
    sin1, cos1, sin12, cos12 = _directions(angles)
    return Point2(-sin1 * first - sin12 * second, cos1 * first + cos12 * second)


def _tip_load(angles: PerJoint, force: Point2, arm: Arm) -> PerJoint:
    return PerJoint(*dynamics.tip_force_torque(*_directions(angles), force.x, force.y, arm))


def _gravity(angles: PerJoint, arm: Arm) -> PerJoint:
    sin1, _, sin12, _ = _directions(angles)
    return PerJoint(*dynamics.gravity_torque(sin1, sin12, arm))


def _mass_matrix(angles: PerJoint, arm: Arm) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    m11, m12, m22 = dynamics.mass_matrix(sine_cosine(angles.joint2)[1], arm)
    return (m11, m12), (m12, m22)


def _inverse_dynamics(angles: PerJoint, rates: PerJoint, accelerations: PerJoint, arm: Arm) -> PerJoint:
    sin2, cos2 = sine_cosine(angles.joint2)
    m11, m12, m22 = dynamics.mass_matrix(cos2, arm)
    coriolis1, coriolis2 = dynamics.coriolis_torque(sin2, *rates, arm)
    (gravity1, gravity2), (ddq1, ddq2) = _gravity(angles, arm), accelerations
    return PerJoint(m11 * ddq1 + m12 * ddq2 + coriolis1 + gravity1, m12 * ddq1 + m22 * ddq2 + coriolis2 + gravity2)


def _directions(angles: PerJoint) -> tuple[Any, Any, Any, Any]:
    """Return sin q1, cos q1, sin q12 and cos q12, with q12 = q1 + q2."""
    return (*sine_cosine(angles.joint1), *sine_cosine(angles.joint1 + angles.joint2))


def _payload_radius(payload: Payload, parameters: ArmParameters) -> float:
    return checks.real("payload radius", payload.radius(parameters), "m", low=0.0, high=LARGEST)


def _constants(plant: Any, payload: Any, radius: Any, tip_payload: Any) -> Arm:
    """Return the `Arm` with the mass `payload` [kg] at `radius` [m] from joint 2, and `tip_payload` [kg] at the tip."""
    arm = dynamics.loaded(dynamics.lump(plant), payload, radius, plant.gravity)
    return dynamics.loaded(arm, tip_payload, plant.length[1], plant.gravity)


def _varied(plant: Any, draw: Any) -> Any:
    pairs = {name: zip(getattr(plant, name), getattr(draw, factor), strict=True) for name, factor in VARIED.items()}
    return plant._replace(**{name: PerJoint(*(number * by for number, by in pair)) for name, pair in pairs.items()})
