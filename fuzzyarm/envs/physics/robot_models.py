"""Robots from URDF and MJCF files, with a TOML overlay for what these formats lack.

The overlay is a robot file that names the model, its tip, and a drive for each joint:

    model = "ur5.urdf"                     # beside this file
    tip = "tool0"                          # a link or site of the model, or [x, y, z] in the last link's frame [m]
    fixed = ["finger_joint1"]              # joints that stay as the model has them; optional
    [joints.shoulder_pan_joint]
    motor_inertia = 0.6                    # the fields of `Drive`, and `velocity_limit`
    ...

A quantity that the model has may be left out: gravity, angle ranges (`range`), URDF's `velocity` and `effort` (torque
limit), MJCF's `actuatorfrcrange` (torque limit), and `damping`, `friction` and MJCF's `armature`, which are read as
viscous friction, Coulomb friction (static alike) and motor inertia.

MuJoCo parses both formats (extra `robots`) and computes the inertias; meshes are not opened. What else would move the
arm in MuJoCo is refused by name, see `model_physics`.
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


_GIVEN = [field.name for field in dataclasses.fields(Drive)] + ["velocity_limit"]
JointOverlay: Any = dataclasses.make_dataclass(
    "JointOverlay",
    [*((name, float | None, None) for name in _GIVEN), ("angle_range", tuple[float, float] | None, None)],
    frozen=True, kw_only=True, namespace={"__module__": __name__},
)  # fmt: skip
"""What a model lacks of one joint; None: take it from the model. Fields and units are those of `Drive` and `Joint`."""

DRIVEN = [field.name for field in dataclasses.fields(JointOverlay)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Overlay:
    """A robot file that refers to a model.

    Attributes:
        model: path of the URDF or MJCF file, from the folder of the robot file.
        tip: name of a link or site of the model, or a point [m], shape (3,), in the last link's frame.
        joints: by the joint's name in the model.
        name: of the robot; empty: the model's.
        fixed: names of joints that stay as the model has them.
        gravity: [m/s²], shape (3,), in the base frame; None: the model's.
        sources: where the numbers come from.
        assumptions: which numbers are assumed, and why so.
    """

    model: str
    tip: str | Vector
    joints: dict[str, JointOverlay]
    name: str = ""
    fixed: tuple[str, ...] = ()
    gravity: Vector | None = None
    sources: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()


def read_robot(path: str | Path) -> Robot:
    """Read a robot file: a TOML file that has all numbers (`Robot.from_toml`), or an overlay that names a model.

    Raises:
        ModuleNotFoundError: the file names a model, and MuJoCo is not installed; the message names the extra.
        ValueError: the robot is not a chain of revolute joints, a link has no inertia, a value is missing or out of
            range, or the model has what is not simulated; the message names the file, and all that is wrong by joint.
        OSError: the file or the model cannot be read.
    """
    path = Path(path)
    content = read_toml(path)
    if "model" not in content:
        return Robot.from_toml(path)
    try:
        overlay = record(content, Overlay)
        tree = read_model(path.parent / overlay.model, overlay.fixed)
        return _robot(tree, overlay)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _robot(tree: Tree, overlay: Overlay) -> Robot:
    """Return the robot; all frames are those of the model with every joint at angle 0."""
    model, data = tree.model, tree.mujoco.MjData(tree.model)
    tree.mujoco.mj_kinematics(model, data)
    numbers = [tree.mujoco.mj_name2id(model, tree.mujoco.mjtObj.mjOBJ_JOINT, name) for name in tree.joints]
    links = [int(model.jnt_bodyid[k]) for k in numbers]
    complaints, unknown = [*tree.complaints], set(overlay.joints) - set(tree.joints)
    if unknown:
        complaints.append(f"[joints] names {listed(unknown)}; the joints that move are: {', '.join(tree.joints)}")
    rotation, origin, joints = np.eye(DIMENSIONS), np.zeros(DIMENSIONS), []
    for name, k, body in zip(tree.joints, numbers, links, strict=True):
        turned = _neat(data.xmat[body].reshape(DIMENSIONS, DIMENSIONS))
        at = data.xpos[body] + turned @ model.jnt_pos[k]
        try:
            values = _values(tree, name, k, overlay)
            limits = {field: values.pop(field) for field in ("angle_range", "velocity_limit")}
            place = _vector(rotation.T @ (at - origin)), as_rows(_neat(rotation.T @ turned))
            link = _link(_moving_with(tree, data, body, links), turned, at)
            joints.append(Joint(name, *place, _vector(_neat(model.jnt_axis[k])), link, Drive(**values), **limits))
        except ValueError as error:
            if name in overlay.joints or f"joint {shown(name)}" not in " ".join(tree.complaints):
                complaints.append(f"joint {shown(name)}: {str(error).removeprefix(f'joint {shown(name)}: ')}")
        rotation, origin = turned, at
    if complaints:
        raise ValueError("; ".join(complaints))
    tip = overlay.tip
    point = _vector(rotation.T @ (_place(tree, data, tip, links) - origin)) if isinstance(tip, str) else tip
    is_off = bool(model.opt.disableflags & tree.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = overlay.gravity or _vector(model.opt.gravity * (not is_off))
    name = overlay.name or tree.name
    return Robot(name, tuple(joints), point, gravity, overlay.sources, overlay.assumptions)


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


def _stated(tree: Tree, name: str, joint: int) -> tuple[dict[str, Any], dict[str, str]]:
    """Return what a model has of a joint by the overlay's names (None: nothing), and what it has of another kind."""
    model, k, differs = tree.model, int(tree.model.jnt_dofadr[joint]), {}
    low, high = model.jnt_actfrcrange[joint].tolist()
    values = {
        "motor_inertia": float(model.dof_armature[k]) or None,
        "viscous_friction": float(model.dof_damping[k]),
        "coulomb_friction": float(model.dof_frictionloss[k]),
        "torque_limit": (high or None) if model.jnt_actfrclimited[joint] else None,
        "angle_range": tuple(model.jnt_range[joint].tolist()) if model.jnt_limited[joint] else None,
        "velocity_limit": tree.speeds.get(name) or None,
    }
    if np.any(model.dof_dampingpoly[k]):
        differs["viscous_friction"] = "its damping is a polynomial"
    if name in tree.acting:
        differs["torque_limit"] = f"law and limits of its actuator {shown(tree.acting[name])} are not read"
    elif values["torque_limit"] and low != -high:
        differs["torque_limit"] = f"its torques, {low:g} to {high:g} N m, differ in the two directions"
    return values, differs


def _values(tree: Tree, name: str, number: int, overlay: Overlay) -> dict[str, Any]:
    """Return the numbers of a joint, the overlay's before the model's; ValueError with all that neither has."""
    if name not in overlay.joints:
        raise ValueError(
            f"it has no drive, and the format knows no joint stiffness: add [joints.{name}] to the overlay"
        )
    values, differs = _stated(tree, name, number)
    given = {field: value for field, value in dataclasses.asdict(overlay.joints[name]).items() if value is not None}
    values |= dict.fromkeys(differs) | given
    if "static_friction" not in given:  # then this velocity has no effect
        values |= {"static_friction": values["coulomb_friction"], "stribeck_velocity": 0.1} | given
    lacking = [field for field in DRIVEN if values.get(field) is None]
    absent = ", ".join(field for field in lacking if field not in differs)
    reasons = [differs[field] for field in lacking if field in differs] + [f"the model has no {absent}"] * bool(absent)
    if lacking:
        raise ValueError(f"{', '.join(reasons)}; add {', '.join(lacking)} to [joints.{name}] in the overlay")
    return values


def _link(parts: list[Part], rotation: np.ndarray, origin: Any) -> Link:
    """Return parts that move together, given in the base frame, as one link in its joint's frame."""
    mass = sum(part[0] for part in parts)
    center = sum(m * at for m, at, _ in parts) / mass
    total = np.zeros((DIMENSIONS, DIMENSIONS))
    for m, at, inertia in parts:
        arm = at - center
        total += inertia + m * (arm @ arm * np.eye(DIMENSIONS) - np.outer(arm, arm))
    turned = rotation.T @ total @ rotation
    turned = np.where(np.abs(turned) > NEGLIGIBLE * np.abs(turned).max(), 0.5 * (turned + turned.T), 0.0)
    return Link(mass, _vector(rotation.T @ (center - origin)), as_rows(turned))


def _neat(values: np.ndarray) -> np.ndarray:
    """Return entries of rotations and axes within rounding of 0, 1 or -1 as exactly that."""
    near = np.rint(values)
    return np.where(np.abs(values - near) <= ROUNDING, near, values) + 0.0


def _vector(values: np.ndarray) -> Vector:
    """Return three numbers, negligible ones as 0."""
    x, y, z = np.where(np.abs(values) > NEGLIGIBLE, values, 0.0).tolist()
    return x, y, z
