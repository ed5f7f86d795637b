"""Robots from URDF and MJCF files, with a TOML overlay for what these formats lack.

The overlay is a robot file that names the model, its tip, and a drive for each joint:

    model = "ur5.urdf"                     # beside this file
    tip = "tool0"                          # a link or site of the model, or [x, y, z] in the last link's frame [m]
    fixed = ["finger_joint1"]              # joints that stay as the model has them; optional
    [joints.shoulder_pan_joint]
    motor_inertia = 0.6                    # the fields of `Drive`, and `velocity_limit`
    ...

A quantity that the model has may be left out: angle ranges (`range`), URDF's `effort` (torque limit), and `damping`,
`friction` and MJCF's `armature`, which are read as viscous friction, Coulomb friction (static alike) and motor inertia.

MuJoCo parses both formats (extra `robots`). Only the tree of bodies, joints and inertias is used; meshes are not
opened.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import listed, shown
from fuzzyarm.common.documents import read_toml, record
from fuzzyarm.envs.physics.joint import DIMENSIONS, Drive, Joint, Link, Vector, as_rows
from fuzzyarm.envs.physics.model_tree import Tree, read_model
from fuzzyarm.envs.physics.robot import Robot

__all__ = ["JointOverlay", "Overlay", "read_robot"]

ROUNDING = 1e-9  # of rotations and axes in models: 1.570796327 is meant to be a right angle
NEGLIGIBLE = 1e-9  # m, and share of the largest moment of inertia: what such angles leave of a zero

Part = tuple[float, np.ndarray, np.ndarray]  # mass [kg], mass center [m] and inertia [kg m²]


@dataclasses.dataclass(frozen=True, kw_only=True)
class JointOverlay:
    """What a model lacks of one joint; None: take it from the model. Fields and units are those of `Drive`, `Joint`."""

    stiffness: float
    damping: float
    motor_inertia: float | None = None
    viscous_friction: float | None = None
    coulomb_friction: float | None = None
    static_friction: float | None = None
    stribeck_velocity: float = 0.1
    torque_limit: float | None = None
    velocity_limit: float | None = None
    angle_range: tuple[float, float] | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Overlay:
    """A robot file that refers to a model.

    Attributes:
        model: path of the URDF or MJCF file, from the folder of the robot file.
        tip: name of a link or site of the model, or a point [m], shape (3,), in the last link's frame.
        joints: by the joint's name in the model.
        name: of the robot; empty: the model's.
        fixed: names of joints that stay as the model has them.
        gravity: [m/s²], shape (3,), in the base frame.
        sources: where the numbers come from.
        assumptions: which numbers are assumed, and why so.
    """

    model: str
    tip: str | Vector
    joints: dict[str, JointOverlay]
    name: str = ""
    fixed: tuple[str, ...] = ()
    gravity: Vector = (0.0, 0.0, -9.81)
    sources: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def read_robot(path: str | Path) -> Robot:
    """Read a robot file: a TOML file that has all numbers (`Robot.from_toml`), or an overlay that names a model.

    Raises:
        ModuleNotFoundError: the file names a model, and MuJoCo is not installed; the message names the extra.
        ValueError: the robot is not a chain of revolute joints, a link has no inertia, or a value is missing or out of
            range; the message names the file and the joint.
        OSError: the file or the model cannot be read.
    """
    path = Path(path)
    content = read_toml(path)
    if "model" not in content:
        return Robot.from_toml(path)
    try:
        overlay = record(content, Overlay)
        tree = read_model(path.parent / overlay.model, overlay.fixed)
        _check_names(tree, overlay)
        return _robot(tree, overlay)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _check_names(tree: Tree, overlay: Overlay) -> None:
    """Raise ValueError unless the overlay has a table for each joint that moves, and for no other."""
    unknown = set(overlay.joints) - set(tree.joints)
    if unknown:
        raise ValueError(f"[joints] names {listed(unknown)}; the joints that move are: {', '.join(tree.joints)}")
    for name in tree.joints:
        if name not in overlay.joints:
            raise ValueError(
                f"joint {shown(name)} has no drive, and the format knows no joint stiffness: add [joints.{name}] to "
                "the overlay"
            )


def _robot(tree: Tree, overlay: Overlay) -> Robot:
    """Return the robot; all frames are those of the model with every joint at angle 0."""
    model, data = tree.model, tree.mujoco.MjData(tree.model)
    tree.mujoco.mj_kinematics(model, data)
    numbers = [tree.mujoco.mj_name2id(model, tree.mujoco.mjtObj.mjOBJ_JOINT, name) for name in tree.joints]
    links = [int(model.jnt_bodyid[k]) for k in numbers]
    rotation, origin, joints = np.eye(DIMENSIONS), np.zeros(DIMENSIONS), []
    for name, k, body in zip(tree.joints, numbers, links, strict=True):
        turned = _neat(data.xmat[body].reshape(DIMENSIONS, DIMENSIONS))
        at = data.xpos[body] + turned @ model.jnt_pos[k]
        given = _Given(name, overlay.joints[name], model, k)
        joints.append(
            Joint(
                name=name,
                position=_vector(rotation.T @ (at - origin)),
                rotation=as_rows(_neat(rotation.T @ turned)),
                axis=_vector(_neat(model.jnt_axis[k])),
                link=_link(name, _moving_with(tree, data, body, links), turned, at),
                drive=given.drive(),
                angle_range=given.angle_range(),
                velocity_limit=given.value("velocity_limit", None),
            )
        )
        rotation, origin = turned, at
    tip = overlay.tip
    point = _vector(rotation.T @ (_place(tree, data, tip, links) - origin)) if isinstance(tip, str) else tip
    name = overlay.name or tree.name
    return Robot(name, tuple(joints), point, overlay.gravity, overlay.sources, overlay.assumptions)


def _carrier(tree: Tree, body: int, links: list[int]) -> int:
    """Return the link of the chain that a body is fixed to, or 0, the base."""
    while body and body not in links:
        body = int(tree.model.body_parentid[body])
    return body


def _moving_with(tree: Tree, data: Any, link: int, links: list[int]) -> list[Part]:
    """Return the bodies that are fixed to a link, in the base frame."""
    parts = []
    for k in range(1, tree.model.nbody):
        mass = float(tree.model.body_mass[k])
        if mass > 0.0 and _carrier(tree, k, links) == link:
            turn = data.ximat[k].reshape(DIMENSIONS, DIMENSIONS)
            parts.append((mass, data.xipos[k], turn @ np.diag(tree.model.body_inertia[k]) @ turn.T))
    return parts


def _place(tree: Tree, data: Any, name: str, links: list[int]) -> np.ndarray:
    """Return the point of a link or site in the base frame; ValueError unless it moves with the last joint."""
    kinds = tree.mujoco.mjtObj
    site = tree.mujoco.mj_name2id(tree.model, kinds.mjOBJ_SITE, name)
    body = (
        int(tree.model.site_bodyid[site]) if site >= 0 else tree.mujoco.mj_name2id(tree.model, kinds.mjOBJ_BODY, name)
    )
    if body < 0:
        raise ValueError(f"tip = {shown(name)} is no link or site of the model; give one, or a point [x, y, z]")
    if _carrier(tree, body, links) != links[-1]:
        raise ValueError(f"tip = {shown(name)} does not move with the last joint, {tree.joints[-1]}")
    point: np.ndarray = data.site_xpos[site] if site >= 0 else data.xpos[body]
    return point


class _Given:
    """What overlay and model say of one joint; the overlay comes first."""

    def __init__(self, name: str, overlay: JointOverlay, model: Any, joint: int) -> None:
        self.name, self.overlay, self.model, self.joint = name, overlay, model, joint
        self.velocity = int(model.jnt_dofadr[joint])

    def value(self, field: str, in_model: float | None) -> float:
        """Return a number; ValueError where neither has it."""
        given: float | None = getattr(self.overlay, field)
        value = in_model if given is None else given
        if value is None:
            raise ValueError(f"joint {shown(self.name)}: the model has no {field}; {self._way_out(field)}")
        return float(value)

    def drive(self) -> Drive:
        """Return the drive."""
        k, now = self.velocity, self.overlay
        dry = self.value("coulomb_friction", self.model.dof_frictionloss[k])
        torque = self.model.jnt_actfrcrange[self.joint][-1] if self.model.jnt_actfrclimited[self.joint] else None
        values = {
            "motor_inertia": self.value("motor_inertia", self.model.dof_armature[k]),
            "viscous_friction": self.value("viscous_friction", np.ravel(self.model.dof_damping[k])[0]),
            "coulomb_friction": dry,
            "static_friction": dry if now.static_friction is None else now.static_friction,
            "torque_limit": self.value("torque_limit", torque),
        }
        try:
            return Drive(
                stiffness=now.stiffness, damping=now.damping, stribeck_velocity=now.stribeck_velocity, **values
            )
        except ValueError as error:
            raise ValueError(f"joint {shown(self.name)}: {error}") from None

    def angle_range(self) -> tuple[float, float]:
        """Return the range [rad]."""
        low, high = self.model.jnt_range[self.joint].tolist()
        if self.overlay.angle_range is not None:
            return self.overlay.angle_range
        if not self.model.jnt_limited[self.joint]:
            raise ValueError(
                f"joint {shown(self.name)}: the model does not limit its angle; {self._way_out('angle_range')}"
            )
        return low, high

    def _way_out(self, field: str) -> str:
        return f"add {field} to [joints.{self.name}] in the overlay"


def _link(name: str, parts: list[Part], rotation: np.ndarray, origin: Any) -> Link:
    """Return parts that move together, given in the base frame, as one link in its joint's frame."""
    mass = sum(part[0] for part in parts)
    center = sum(m * at for m, at, _ in parts) / mass
    total = np.zeros((DIMENSIONS, DIMENSIONS))
    for m, at, inertia in parts:
        arm = at - center
        total += inertia + m * (arm @ arm * np.eye(DIMENSIONS) - np.outer(arm, arm))
    turned = rotation.T @ total @ rotation
    turned = np.where(np.abs(turned) > NEGLIGIBLE * np.abs(turned).max(), 0.5 * (turned + turned.T), 0.0)
    try:
        return Link(mass, _vector(rotation.T @ (center - origin)), as_rows(turned))
    except ValueError as error:
        raise ValueError(f"joint {shown(name)}: {error}") from None


def _neat(values: np.ndarray) -> np.ndarray:
    """Return entries of rotations and axes within rounding of 0, 1 or -1 as exactly that."""
    near = np.rint(values)
    return np.where(np.abs(values - near) <= ROUNDING, near, values) + 0.0


def _vector(values: np.ndarray) -> Vector:
    """Return three numbers, negligible ones as 0."""
    x, y, z = np.where(np.abs(values) > NEGLIGIBLE, values, 0.0).tolist()
    return x, y, z
