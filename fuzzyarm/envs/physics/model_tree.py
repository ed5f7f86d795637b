"""URDF and MJCF files as MuJoCo reads them: the chain of joints of a serial robot, and what is wrong with it."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from fuzzyarm.common.checks import listed, shown
from fuzzyarm.common.documents import read_bytes
from fuzzyarm.envs.physics.model_physics import inertias, is_opened, unknown_forces

__all__ = ["Tree", "read_model"]

LARGEST_MODEL = 2**22  # bytes
SPEED = re.compile(r"<limit\s[^>]*\bvelocity\s*=\s*[\"']\s*([\d.][\d.eE+-]*)\s*[\"']")


class Tree(NamedTuple):
    """A compiled model, the names of the joints that move, from the base to the tip, and what is wrong with them."""

    mujoco: Any
    model: Any
    joints: tuple[str, ...]
    name: str
    acting: dict[str, str]  # by joint, the name of an actuator
    speeds: dict[str, float]  # by joint, the largest of a URDF [rad/s]
    complaints: tuple[str, ...]


def read_model(path: Path, fixed: Collection[str]) -> Tree:
    """Return the model in a URDF or MJCF file.

    Args:
        path: of the file.
        fixed: names of joints that stay as the model has them.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed; the message names the extra.
        ValueError: it is no such file, no joint moves, or one that moves has no name.
        OSError: the file cannot be read.
    """
    mujoco, text = _mujoco(), _text(path)
    warn = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # or MuJoCo writes its log into the working folder
    try:
        with warnings.catch_warnings(action="ignore"):
            return _tree(mujoco, text, fixed)
    finally:
        mujoco.set_mju_user_warning(warn)


def _tree(mujoco: Any, text: str, fixed: Collection[str]) -> Tree:
    try:
        spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise ValueError(_explained(str(error), text)) from None
    unknown = set(fixed) - {joint.name for joint in spec.joints}
    if unknown:
        known = listed(joint.name for joint in spec.joints)
        raise ValueError(f"`fixed` names {listed(unknown)}; the joints of the model are: {known}")
    chain = _chain(spec, fixed)
    parts = {joint.name: list(_carried(joint.parent, fixed)) for joint in chain}
    moving = [body for bodies in parts.values() for body in bodies]
    complaints = [
        *_couplings(spec, mujoco, fixed),
        *_misplaced(chain, fixed),
        *_unlike(chain, mujoco),
        *inertias(spec, mujoco, parts),
        *unknown_forces(spec, mujoco, chain, moving, fixed, text),
    ]
    at_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    acting = {one.target: one.name for one in spec.actuators if one.trntype in at_joint}
    speeds = {name: float(found[1]) for name, joint in _joints(text) if (found := SPEED.search(joint))}
    try:
        model = _compiled(spec, fixed)
    except ValueError as error:
        raise ValueError("; ".join((*complaints, " ".join(str(error).split())))) from None
    return Tree(mujoco, model, tuple(parts), spec.modelname, acting, speeds, tuple(complaints))


def _carried(body: Any, fixed: Collection[str]) -> Iterator[Any]:
    """Yield a body, and those that move as one with it."""
    yield body
    for child in body.bodies:
        if all(joint.name in fixed for joint in child.joints):
            yield from _carried(child, fixed)


def _couplings(spec: Any, mujoco: Any, fixed: Collection[str]) -> Iterator[str]:
    """Yield complaints about mimic joints and closed chains."""
    for equality in spec.equalities:
        names = [name for name in (equality.name1, equality.name2) if name]
        if equality.type == mujoco.mjtEq.mjEQ_JOINT:
            free = [name for name in names if name not in fixed]
            if free:
                yield (
                    f"joint {shown(names[0])} mimics {shown(names[-1])}; each joint needs a drive of its own: put "
                    f"{listed(map(repr, free))} under `fixed` in the overlay, or take the coupling out of the model"
                )
        else:
            yield (
                f"a constraint between {listed(map(repr, names))} closes the chain; a serial robot has none: take "
                "it out of the model"
            )


def _chain(spec: Any, fixed: Collection[str]) -> list[Any]:
    """Return the joints that move, from the base to the tip."""
    chain = [joint for joint in spec.joints if joint.name not in fixed]
    if not chain:
        raise ValueError("the model has no joint that moves")
    if not all(joint.name for joint in chain):
        raise ValueError("a joint has no name; give each joint of the model one")
    return chain


def _misplaced(chain: list[Any], fixed: Collection[str]) -> Iterator[str]:
    """Yield complaints about joints that do not follow the one before."""
    for before, after in itertools.pairwise(chain):
        above = after.parent.parent
        while above is not None and not any(joint.name not in fixed for joint in above.joints):
            above = above.parent
        if after.parent == before.parent or above is None or above != before.parent:
            yield (
                f"joint {shown(after.name)} does not follow joint {shown(before.name)} in a chain; put what is not "
                "part of the arm under `fixed` in the overlay, and give each joint a body of its own"
            )


def _unlike(chain: list[Any], mujoco: Any) -> Iterator[str]:
    """Yield complaints about joints that are not revolute, or whose angle is not that of this package."""
    for joint in chain:
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            kind = "prismatic" if joint.type == mujoco.mjtJoint.mjJNT_SLIDE else "neither revolute nor prismatic"
            yield (
                f"joint {shown(joint.name)} is {kind}; all joints must be revolute: put it under `fixed` in the "
                "overlay, or take a model without it"
            )
        if joint.ref != 0.0:
            yield f"joint {shown(joint.name)} has ref = {joint.ref}; give its frame at angle 0, with ref 0"


def _compiled(spec: Any, fixed: Collection[str]) -> Any:
    """Return the model of bodies, primitive shapes and joints that move, all orientations resolved."""
    for parts in (
        *(spec.keys, spec.sensors, spec.actuators, spec.tendons, spec.equalities, spec.excludes, spec.pairs),
        *(spec.skins, spec.flexes, [geom for geom in spec.geoms if is_opened(geom)], spec.meshes, spec.hfields),
        *(spec.materials, spec.textures, [joint for joint in spec.joints if joint.name in fixed]),
    ):
        for part in list(parts):
            spec.delete(part)
    for part in (*spec.geoms, *spec.sites):
        part.material = ""
    spec.compiler.fusestatic = False
    return spec.compile()


def _mujoco() -> Any:
    try:
        import mujoco
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'URDF and MJCF files are read by MuJoCo; install it with: pip install "fuzzyarm[robots]"'
        ) from None
    return mujoco


def _text(path: Path) -> str:
    """Return the text of a model without comments; ValueError if it is not Unicode, or MuJoCo would open more files."""
    try:
        text = read_bytes(path, largest=LARGEST_MODEL).decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError("not a URDF or MJCF file: it is not UTF-8") from None
    text = re.sub("<!--.*?-->", lambda found: "\n" * found[0].count("\n"), text, flags=re.DOTALL)
    found = re.search(r"<\s*(include|model)\s[^>]*\bfile\s*=", text)
    if found:
        raise ValueError(f"it has an element <{found[1]}>; write the whole model into one file, without it")
    return text


def _explained(message: str, text: str) -> str:
    """Return an error of the parser in one line; for a closed chain with the joint that closes it."""
    if "multiple parents" in message:
        return (
            f"joint {shown(_closing_joint(text))} closes the chain: its link has two joints to it; take one of them "
            "out of the model"
        )
    return " ".join(message.split())


def _joints(text: str) -> Iterator[tuple[str, str]]:
    """Yield name and text of each joint of a URDF."""
    for joint in re.findall(r"<joint\s.*?</joint", text, re.DOTALL):
        if name := re.search(r"\sname\s*=\s*[\"']([^\"']*)", joint):
            yield name[1], joint


def _closing_joint(text: str) -> str:
    """Return the name of the first joint of a URDF whose child link is already that of another joint."""
    children = set()
    for name, joint in _joints(text):
        if child := re.search(r"<child\s+link\s*=\s*[\"']([^\"']*)", joint):
            if child[1] in children:
                return name
            children.add(child[1])
    return ""
