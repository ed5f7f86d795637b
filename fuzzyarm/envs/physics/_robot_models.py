"""Robots from URDF and MJCF files, with a TOML overlay for what these formats lack.

    model = "ur5.urdf"                     # beside this file
    tip = "tool0"                          # a link or site of the model, or [x, y, z] in the last link's frame [m]
    fixed = ["finger_joint1"]              # joints locked at their angles in the model; optional
    [joints.shoulder_pan_joint]
    motor_inertia = 0.6                    # the fields of `Drive`, and `velocity_limit`

Quantities that the model provides may be omitted: gravity, angle ranges (`range`), URDF's `velocity` and `effort`
(torque limit), MJCF's `actuatorfrcrange` (torque limit), and `damping`, `friction` and MJCF's `armature`, which are
read as viscous friction, Coulomb friction (also as static friction) and motor inertia.

MuJoCo parses both formats (extra `robots`) and computes the inertias; meshes are not opened. Any other element that
would move the arm in MuJoCo is refused by name, see `_unknown_forces`.
"""

import dataclasses
import itertools
import math
import re
import warnings
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.checks import listed, shown
from fuzzyarm.common.documents import read_bytes, read_toml, record
from fuzzyarm.envs.physics.joint import DIMENSIONS, Drive, Joint, Link, Vector, as_rows
from fuzzyarm.envs.physics.robot import Robot

__all__ = ["read_model", "read_robot", "robot_of_model"]

_MASSLESS = 1e-9  # kg
_SWITCHES = ("CONSTRAINT", "FRICTIONLOSS", "LIMIT", "DAMPER", "ACTUATION")  # disable flags of the effects that are read
_GAZEBO = re.compile(
    r"<((?:springStiffness|dampingFactor|turnGravityOff)(?!\s*>\s*(?:[0.]+|false)\s*<)|gravity(?=\s*>\s*(?:0|false)))\s*>"
)
_WAY_OUT = "give the link an <inertial> element with mass and moments in the model"
_LARGEST_MODEL = 2**22  # bytes
_SPEED = re.compile(r"<limit\s[^>]*\bvelocity\s*=\s*[\"']\s*([\d.][\d.eE+-]*)\s*[\"']")

_Part = tuple[float, np.ndarray, np.ndarray]  # mass [kg], mass center [m] and inertia [kg m²]


class _Model:
    """A URDF or MJCF model of a chain of joints; `complaints` lists its problems, by joint where possible."""

    def __init__(self, mujoco: Any, text: str, fixed: Collection[str]) -> None:
        """Compile the text of a URDF or MJCF file with the named joints fixed; ValueError if it is neither."""
        self.mujoco, self.text, self.fixed = mujoco, text, fixed
        try:
            self.spec = mujoco.MjSpec.from_string(text)
        except ValueError as error:
            message = " ".join(str(error).split())
            if "multiple parents" in message:
                message = f"two joints lead to one link, which makes a closed chain: {message}"
            raise ValueError(message) from None
        spec, known = self.spec, {joint.name for joint in self.spec.joints}
        if unknown := set(fixed) - known:
            raise ValueError(f"`fixed` contains {listed(unknown)}, but the joints of the model are: {listed(known)}")
        self.chain = [joint for joint in spec.joints if joint.name not in fixed]
        if not self.chain:
            raise ValueError(
                "the model has no moving joint outside `fixed`; give a model with one, or list fewer joints in `fixed`"
            )
        if not all(joint.name for joint in self.chain):
            raise ValueError("a joint has no name; name each joint of the model")
        self.parts = {joint.name: list(self._carried(joint.parent)) for joint in self.chain}  # bodies of each joint
        self.joints, self.name = tuple(self.parts), spec.modelname
        self.complaints = [
            *(*self._couplings(), *self._misplaced(), *self._unlike()),
            *(*self._inertias(), *self._unknown_forces()),
        ]
        at_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
        self.acting = {one.target: one.name for one in spec.actuators if one.trntype in at_joint}
        self.speeds = dict(_speeds(text))
        try:
            self.model = self._compiled()
        except ValueError as error:
            raise ValueError("; ".join((*self.complaints, " ".join(str(error).split())))) from None
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.numbers = [self._number("mjOBJ_JOINT", name) for name in self.joints]
        self.links = [int(self.model.jnt_bodyid[k]) for k in self.numbers]

    def _number(self, kind: str, name: str) -> int:
        return int(self.mujoco.mj_name2id(self.model, getattr(self.mujoco.mjtObj, kind), name))

    def _carried(self, body: Any) -> Iterator[Any]:
        """Yield a body and all bodies fixed to it."""
        yield body
        for child in body.bodies:
            if all(joint.name in self.fixed for joint in child.joints):
                yield from self._carried(child)

    def _couplings(self) -> Iterator[str]:
        """Yield complaints about mimic joints and closed chains."""
        for equality in self.spec.equalities:
            names = [name for name in (equality.name1, equality.name2) if name]
            free, couples = set(names) - set(self.fixed), equality.type == self.mujoco.mjtEq.mjEQ_JOINT
            if couples and free:
                yield (
                    f"joint {shown(names[0])} mimics {shown(names[-1])}; each joint needs a drive of its own: list "
                    f"{listed(map(repr, free))} under `fixed` in the robot file, or remove the coupling from the model"
                )
            elif not couples:
                yield (
                    f"a constraint between {listed(map(repr, names))} closes the chain, but the chain of a serial "
                    "robot must be open: remove the constraint from the model"
                )

    def _misplaced(self) -> Iterator[str]:
        """Yield complaints about joints that do not follow the previous joint in a chain."""
        for before, after in itertools.pairwise(self.chain):
            above = after.parent.parent
            while above is not None and not any(joint.name not in self.fixed for joint in above.joints):
                above = above.parent
            if after.parent == before.parent or above != before.parent:
                yield (
                    f"joint {shown(after.name)} does not follow joint {shown(before.name)} in a chain; list the joints "
                    "outside the arm under `fixed` in the robot file, and give each joint a body of its own"
                )

    def _unlike(self) -> Iterator[str]:
        """Yield complaints about joints that are not revolute, or whose angle in the model's own pose is not 0."""
        for joint in self.chain:
            if joint.type != self.mujoco.mjtJoint.mjJNT_HINGE:
                kind = "prismatic" if joint.type == self.mujoco.mjtJoint.mjJNT_SLIDE else "not revolute"
                yield (
                    f"joint {shown(joint.name)} is {kind}; all joints must be revolute: list it under `fixed` in the "
                    "robot file, or use a model without it"
                )
            if joint.ref != 0.0:
                yield f"joint {shown(joint.name)} has ref = {joint.ref}; define its frame at angle 0, with ref = 0"

    def _inertias(self) -> Iterator[str]:
        """Yield complaints about links without inertia, and give these links a placeholder inertia."""
        compiler, rule = self.spec.compiler, self.mujoco.mjtInertiaFromGeom
        always, (low, high) = compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_TRUE, compiler.inertiagrouprange
        for joint, bodies in self.parts.items():
            heavy, without = False, list[Any]()
            for body in bodies:
                given = body.explicitinertial and not always
                shapes = [one for one in body.geoms if not given and low <= one.group <= high and _has_mass(one)]
                heavy = heavy or bool(shapes) or (given and body.mass > _MASSLESS)
                if any(map(_is_opened, shapes)):
                    link = f"link {shown(body.name)}"
                    yield f"the inertia of {link} is defined by a mesh, and meshes are not read: {_WAY_OUT}"
                    without.append(body)
            if not heavy:
                yield f"joint {shown(joint)} turns link {shown(bodies[0].name)}, which has no inertia: {_WAY_OUT}"
                without.append(bodies[0])
            for body in without:
                body.explicitinertial, body.mass, body.inertia = True, 1.0, (1.0, 1.0, 1.0)
                compiler.inertiafromgeom = rule.mjINERTIAFROMGEOM_AUTO

    def _unknown_forces(self) -> list[str]:
        """Return a complaint for each element that moves the arm in MuJoCo or Gazebo but is not modelled here."""
        spec, chain, moving = self.spec, self.chain, itertools.chain(*self.parts.values())
        option, bit, trn = spec.option, self.mujoco.mjtDisableBit, self.mujoco.mjtTrn
        off = [one for one in _SWITCHES if option.disableflags & getattr(bit, f"mjDSBL_{one}")]
        pulling = [one for one in spec.tendons if not all(map(self._is_fixed, one.path))]
        elsewhere = [one for one in spec.actuators if one.trntype in (trn.mjTRN_SITE, trn.mjTRN_SLIDERCRANK)]
        rotors = [one for one in spec.actuators if np.any([one.armature, *one.damping])]
        found = [
            *(f"option {name}" for name in ("density", "viscosity", "disableactuator") if getattr(option, name)),
            *(f"the flag that disables {one.lower()}" for one in off),
            *(["compiler settotalmass"] if spec.compiler.settotalmass > 0.0 else []),
            *(["flex"] if spec.flexes else []),
            *(f"gravcomp of link {shown(body.name)}" for body in moving if body.gravcomp),
            *(f"stiffness of joint {shown(one.name)}" for one in chain if np.any(one.stiffness)),
            *(f"springdamper of joint {shown(one.name)}" for one in chain if np.all(one.springdamper)),
            *(f"margin of joint {shown(one.name)}" for one in chain if one.margin),
            *(f"tendon {shown(one.name)}" for one in pulling),
            *(f"actuator {shown(one.name)}" for one in elsewhere),
            *(f"armature or damping of actuator {shown(one.name)}" for one in rotors),
            *(f"{name} of <gazebo>" for name in _GAZEBO.findall(self.text)),
        ]
        return [f"{one} is not simulated: remove it from the model" for one in found]

    def _is_fixed(self, wrapped: Any) -> bool:
        return bool(wrapped.type == self.mujoco.mjtWrap.mjWRAP_JOINT and wrapped.target.name in self.fixed)

    def _compiled(self) -> Any:
        """Return the compiled model of bodies, primitive shapes and moving joints, with all orientations resolved."""
        spec = self.spec
        for parts in (
            *(spec.keys, spec.sensors, spec.actuators, spec.tendons, spec.equalities, spec.excludes, spec.pairs),
            *(spec.skins, spec.flexes, [geom for geom in spec.geoms if _is_opened(geom)], spec.meshes, spec.hfields),
            *(spec.materials, spec.textures, [joint for joint in spec.joints if joint.name in self.fixed]),
        ):
            for part in list(parts):
                spec.delete(part)
        for part in (*spec.geoms, *spec.sites):
            part.material = ""
        spec.compiler.fusestatic = False
        return spec.compile()

    def _carrier(self, body: int) -> int:
        """Return the index of the link to which the body with this index is fixed; 0 is the base."""
        while body and body not in self.links:
            body = int(self.model.body_parentid[body])
        return body

    def moving_with(self, link: int) -> list[_Part]:
        """Return the mass, mass center and inertia, in the base frame, of each body that is fixed to a link."""
        parts, model, data = list[_Part](), self.model, self.data
        for k in range(1, model.nbody):
            mass = float(model.body_mass[k])
            if mass > 0.0 and self._carrier(k) == link:
                turn = data.ximat[k].reshape(DIMENSIONS, DIMENSIONS)
                parts.append((mass, data.xipos[k], turn @ np.diag(model.body_inertia[k]) @ turn.T))
        return parts

    def place(self, name: str) -> np.ndarray:
        """Return a link or site's position (3,) [m] in the base frame; ValueError unless it moves with the last joint.

        All joints are at angle 0.
        """
        site = self._number("mjOBJ_SITE", name)
        body = int(self.model.site_bodyid[site]) if site >= 0 else self._number("mjOBJ_BODY", name)
        if body < 0:
            raise ValueError(f"tip = {shown(name)} is not a link or site of the model; give one, or a point [x, y, z]")
        if self._carrier(body) != self.links[-1]:
            raise ValueError(
                f"tip = {shown(name)} does not move with the last joint, {self.joints[-1]}; give a link or site that "
                "does, or a point [x, y, z]"
            )
        point: np.ndarray = self.data.site_xpos[site] if site >= 0 else self.data.xpos[body]
        return point

    def _stated(self, name: str, joint: int) -> tuple[dict[str, Any], dict[str, str]]:
        """Return a joint's values in the model by quantity (None: absent), and why some quantities cannot be read."""
        model, k, differs = self.model, int(self.model.jnt_dofadr[joint]), {}
        low, high = model.jnt_actfrcrange[joint].tolist()
        values = {
            "motor_inertia": float(model.dof_armature[k]) or None,
            "viscous_friction": float(model.dof_damping[k]),
            "coulomb_friction": float(model.dof_frictionloss[k]),
            "torque_limit": (high or None) if model.jnt_actfrclimited[joint] else None,
            "angle_range": tuple(model.jnt_range[joint].tolist()) if model.jnt_limited[joint] else None,
            "velocity_limit": self.speeds.get(name) or None,
        }
        if np.any(model.dof_dampingpoly[k]):
            differs["viscous_friction"] = "its damping is a polynomial"
        if name in self.acting:
            differs["torque_limit"] = f"the law and limits of its actuator {shown(self.acting[name])} are not read"
        elif values["torque_limit"] and low != -high:
            differs["torque_limit"] = f"its torques, {low:g} to {high:g} N m, are not the same in both directions"
        return values, differs

    def stated(self, name: str, joint: int) -> dict[str, Any]:
        """Return the model's values for joint `name`, such as "torque_limit"; None: the value is absent or unreadable.

        `joint` is the joint's number in MuJoCo.
        """
        values, differs = self._stated(name, joint)
        return values | dict.fromkeys(differs)

    def places(self) -> list[str]:
        """Return the names of the links and sites that move with the last joint, the farthest out first."""
        spec, last = self.model, self.links[-1]
        bodies = [spec.body(k).name for k in range(1, spec.nbody) if self._carrier(k) == last]
        sites = [spec.site(k).name for k in range(spec.nsite) if self._carrier(int(spec.site_bodyid[k])) == last]
        return [name for name in (*sites, *reversed(bodies)) if name]

    def values(self, name: str, number: int, given: Any) -> dict[str, Any]:
        """Return joint `name`'s values, `given` in the robot file or else the model's; ValueError lists missing ones.

        `number` is the joint's number in MuJoCo.
        """
        if given is None:
            raise ValueError(
                f"the robot file gives it no drive, and a model no stiffness: add [joints.{name}] to the robot file"
            )
        values, differs = self._stated(name, number)
        given = {field: value for field, value in dataclasses.asdict(given).items() if value is not None}
        values |= dict.fromkeys(differs) | given
        if "static_friction" not in given:  # then this velocity has no effect
            values |= {"static_friction": values["coulomb_friction"], "stribeck_velocity": 0.1} | given
        lacking = [field for field in _DRIVEN if values.get(field) is None]
        if lacking:
            reasons = [differs[field] for field in lacking if field in differs]
            if absent := ", ".join(field for field in lacking if field not in differs):
                reasons.append(f"the model has no {absent}")
            raise ValueError(f"{', '.join(reasons)}; add {', '.join(lacking)} to [joints.{name}] in the robot file")
        return values


def _is_opened(geom: Any) -> bool:
    """Return whether the shape of a geom (a body's shape in MuJoCo) is read from a file, such as a mesh."""
    return bool(geom.meshname) or geom.type.name in ("mjGEOM_MESH", "mjGEOM_HFIELD", "mjGEOM_SDF")


def _has_mass(geom: Any) -> bool:
    return bool(geom.density != 0.0 if math.isnan(geom.mass) else geom.mass != 0.0)


def read_model(path: Path, fixed: Collection[str]) -> _Model:
    """Return the model in a URDF or MJCF file, with the joints of these names fixed."""
    try:
        import mujoco
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'URDF and MJCF files are read by MuJoCo; install it with: pip install "fuzzyarm[robots]"'
        ) from None
    text = _text(path)
    warn = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # otherwise MuJoCo writes its log into the working folder
    try:
        with warnings.catch_warnings(action="ignore"):
            return _Model(mujoco, text, fixed)
    finally:
        mujoco.set_mju_user_warning(warn)


def _text(path: Path) -> str:
    """Return the text of a model without comments; ValueError if it is not UTF-8 or includes other model files."""
    try:
        text = read_bytes(path, largest=_LARGEST_MODEL).decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError("the model is not a URDF or MJCF file, because it is not UTF-8 text") from None
    text = re.sub("<!--.*?-->", lambda found: "\n" * found[0].count("\n"), text, flags=re.DOTALL)
    found = re.search(r"<\s*(include|model)\s[^>]*\bfile\s*=", text)
    if found:
        raise ValueError(f"the model's <{found[1]}> refers to another file, which is not supported; merge both files")
    return text


def _speeds(text: str) -> Iterator[tuple[str, float]]:
    """From the text of a URDF file, yield the name and velocity limit [rad/s] of each joint that has both."""
    for joint in re.findall(r"<joint\s.*?</joint", text, re.DOTALL):
        name, speed = re.search(r"\sname\s*=\s*[\"']([^\"']*)", joint), _SPEED.search(joint)
        if name and speed:
            yield name[1], float(speed[1])


_ROUNDING = 1e-9  # of rotations and axes in models: 1.570796327 is meant to be a right angle
_NEGLIGIBLE = 1e-9  # m, and share of the largest moment of inertia: what such angles give in place of a zero

_GIVEN = [field.name for field in dataclasses.fields(Drive)] + ["velocity_limit"]
_JointOverlay: Any = dataclasses.make_dataclass(
    "_JointOverlay",
    [*((name, float | None, None) for name in _GIVEN), ("angle_range", tuple[float, float] | None, None)],
    frozen=True, kw_only=True, namespace={"__module__": __name__},
)  # fmt: skip
"""The overlay's values for one joint; None: the model's value. Fields and units are those of `Drive` and `Joint`."""

_DRIVEN = [field.name for field in dataclasses.fields(_JointOverlay)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Overlay:
    """The content of a robot file that names a URDF or MJCF model and adds values to it."""

    model: str  # path of the URDF or MJCF file, from the folder of the robot file
    tip: str | Vector  # name of a link or site of the model, or a point [m], shape (3,), in the last link's frame
    joints: dict[str, _JointOverlay]  # by the joint's name in the model
    name: str = ""  # of the robot; empty: the model's
    fixed: tuple[str, ...] = ()  # names of joints that stay at rest as in the model
    gravity: Vector | None = None  # [m/s²], shape (3,), in the base frame; None: the model's
    sources: tuple[str, ...] = ()  # where the values come from
    assumptions: tuple[str, ...] = ()  # which values are assumed, and why


def read_robot(path: str | Path) -> Robot:
    """Read a robot file: a TOML file that states all values (`Robot.from_toml`), or an overlay that names a model.

    Raises:
        ModuleNotFoundError: the file names a model, and MuJoCo is not installed.
        ValueError: the robot is not a chain of revolute joints, a link has no inertia, a value is missing or out of
            range, or the model has unsupported elements; the message names the file and all problems by joint.
        OSError: the file or the model cannot be read.
    """
    path = Path(path)
    content = read_toml(path)
    if "model" not in content:
        return Robot.from_toml(path)
    try:
        overlay = record(content, _Overlay)
        return _robot(read_model(path.parent / overlay.model, overlay.fixed), overlay)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def robot_of_model(
    tree: _Model, tip: Any, joints: Mapping[str, Any], sources: tuple[str, ...], assumptions: tuple[str, ...]
) -> Robot:
    """Return the robot of a model, with `tip` and `joints` as in a robot file.

    The texts `sources` state where the values come from, `assumptions` which are assumed.
    """
    overlay = {"model": "", "tip": tip, "joints": joints, "sources": sources, "assumptions": assumptions}
    return _robot(tree, record(overlay, _Overlay))


def _robot(tree: _Model, overlay: _Overlay) -> Robot:
    """Return the robot of a model and its overlay; all frames are those of the model with every joint at angle 0."""
    model, data, complaints = tree.model, tree.data, tree.complaints
    known = " ".join(complaints)
    if unknown := set(overlay.joints) - set(tree.joints):
        complaints.append(f"[joints] contains {listed(unknown)}, but the moving joints are: {', '.join(tree.joints)}")
    rotation, origin, joints = np.eye(DIMENSIONS), np.zeros(DIMENSIONS), []
    for name, k, body in zip(tree.joints, tree.numbers, tree.links, strict=True):
        turned = _neat(data.xmat[body].reshape(DIMENSIONS, DIMENSIONS))
        at = data.xpos[body] + turned @ model.jnt_pos[k]
        try:
            values = tree.values(name, k, overlay.joints.get(name))
            limits = {field: values.pop(field) for field in ("angle_range", "velocity_limit")}
            place = _vector(rotation.T @ (at - origin)), as_rows(_neat(rotation.T @ turned))
            link = _link(tree.moving_with(body), turned, at)
            joints.append(Joint(name, *place, _vector(_neat(model.jnt_axis[k])), link, Drive(**values), **limits))
        except ValueError as error:
            if name in overlay.joints or f"joint {shown(name)}" not in known:
                complaints.append(f"joint {shown(name)}: {str(error).removeprefix(f'joint {shown(name)}: ')}")
        rotation, origin = turned, at
    if complaints:
        raise ValueError("; ".join(complaints))
    tip = overlay.tip
    point = _vector(rotation.T @ (tree.place(tip) - origin)) if isinstance(tip, str) else tip
    is_off = bool(model.opt.disableflags & tree.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = overlay.gravity or _vector(model.opt.gravity * (not is_off))
    return Robot(overlay.name or tree.name, tuple(joints), point, gravity, overlay.sources, overlay.assumptions)


def _link(parts: list[_Part], rotation: np.ndarray, origin: Any) -> Link:
    """Return parts that move together, given in the base frame, as one link in the frame `rotation`, `origin`."""
    mass = sum(part[0] for part in parts)
    center = sum(m * at for m, at, _ in parts) / mass
    total = np.zeros((DIMENSIONS, DIMENSIONS))
    for m, at, inertia in parts:
        arm = at - center
        total += inertia + m * (arm @ arm * np.eye(DIMENSIONS) - np.outer(arm, arm))
    turned = rotation.T @ total @ rotation
    turned = np.where(np.abs(turned) > _NEGLIGIBLE * np.abs(turned).max(), 0.5 * (turned + turned.T), 0.0)
    return Link(mass, _vector(rotation.T @ (center - origin)), as_rows(turned))


def _neat(values: np.ndarray) -> np.ndarray:
    """Return rotations or axes in which each entry within rounding of 0, 1 or -1 is replaced by that number."""
    near = np.rint(values)
    return np.where(np.abs(values - near) <= _ROUNDING, near, values) + 0.0


def _vector(values: np.ndarray) -> Vector:
    """Return a vector (3,) with negligible components set to 0."""
    x, y, z = np.where(np.abs(values) > _NEGLIGIBLE, values, 0.0).tolist()
    return x, y, z
