"""URDF and MJCF files as MuJoCo reads them: the chain of joints of a serial robot, checked, without its shapes."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

from fuzzyarm.common.checks import listed, shown
from fuzzyarm.common.documents import read_bytes

__all__ = ["Tree", "read_model"]

LARGEST_MODEL = 2**22  # bytes
MASSLESS = 1e-9  # kg


class Tree(NamedTuple):
    """A compiled model and the names of the joints that move, from the base to the tip."""

    mujoco: Any
    model: Any
    joints: tuple[str, ...]
    name: str


def read_model(path: Path, fixed: Collection[str]) -> Tree:
    """Return the model in a URDF or MJCF file.

    Args:
        path: of the file.
        fixed: names of joints that stay as the model has them.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed; the message names the extra.
        ValueError: it is no such file, or no chain of revolute joints, or a link has no inertia.
        OSError: the file cannot be read.
    """
    mujoco, text = _mujoco(), _text(path)
    try:
        spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise ValueError(_explained(str(error), text)) from None
    unknown = set(fixed) - {joint.name for joint in spec.joints}
    if unknown:
        raise ValueError(f"`fixed` names {listed(unknown)}; {_known(spec)}")
    _refuse_couplings(spec, mujoco, fixed)
    chain = _chain(spec, fixed)
    for joint in chain:
        _check(joint, mujoco)
    return Tree(mujoco, _compiled(spec), tuple(joint.name for joint in chain), spec.modelname)


def _refuse_couplings(spec: Any, mujoco: Any, fixed: Collection[str]) -> None:
    """Raise ValueError for mimic joints and closed chains."""
    for equality in spec.equalities:
        names = [name for name in (equality.name1, equality.name2) if name]
        if equality.type == mujoco.mjtEq.mjEQ_JOINT:
            free = [name for name in names if name not in fixed]
            if free:
                raise ValueError(
                    f"joint {shown(names[0])} mimics {shown(names[-1])}; each joint needs a drive of its own: put "
                    f"{listed(map(repr, free))} under `fixed` in the overlay, or take the coupling out of the model"
                )
        else:
            raise ValueError(
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
    for before, after in itertools.pairwise(chain):
        above = after.parent.parent
        while above is not None and not any(joint.name not in fixed for joint in above.joints):
            above = above.parent
        if after.parent == before.parent or above is None or above != before.parent:
            raise ValueError(
                f"joint {shown(after.name)} does not follow joint {shown(before.name)} in a chain; put what is not "
                "part of the arm under `fixed` in the overlay, and give each joint a body of its own"
            )
    return chain


def _check(joint: Any, mujoco: Any) -> None:
    """Raise ValueError for a joint that is not revolute, or whose link has no inertia."""
    name = shown(joint.name)
    if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
        kind = "prismatic" if joint.type == mujoco.mjtJoint.mjJNT_SLIDE else "neither revolute nor prismatic"
        raise ValueError(
            f"joint {name} is {kind}; all joints must be revolute: put it under `fixed` in the overlay, or take a "
            "model without it"
        )
    if joint.ref != 0.0:
        raise ValueError(f"joint {name} has ref = {joint.ref}; give its frame at angle 0, with ref 0")
    if not joint.parent.explicitinertial or joint.parent.mass <= MASSLESS:
        raise ValueError(
            f"joint {name} turns link {shown(joint.parent.name)}, which has no inertia: give the link an <inertial> "
            "element with mass and moments in the model"
        )


def _compiled(spec: Any) -> Any:
    """Return the model without shapes, tendons, actuators and sensors, all orientations resolved."""
    for parts in (
        *(spec.keys, spec.sensors, spec.actuators, spec.tendons, spec.equalities, spec.excludes, spec.pairs),
        *(spec.skins, spec.flexes, spec.geoms, spec.meshes, spec.hfields, spec.materials, spec.textures),
    ):
        for part in list(parts):
            spec.delete(part)
    spec.compiler.fusestatic = False
    try:
        return spec.compile()
    except ValueError as error:
        raise ValueError(" ".join(str(error).split())) from None


def _mujoco() -> Any:
    try:
        import mujoco
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            'URDF and MJCF files are read by MuJoCo; install it with: pip install "fuzzyarm[robots]"'
        ) from None
    return mujoco


def _text(path: Path) -> str:
    """Return the text of a model; ValueError if it is not Unicode, or would have MuJoCo open further files."""
    try:
        text = read_bytes(path, largest=LARGEST_MODEL).decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError("not a URDF or MJCF file: it is not UTF-8") from None
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


def _closing_joint(text: str) -> str:
    """Return the name of the first joint of a URDF whose child link is already that of another joint."""
    children = set()
    for joint in re.findall(r"<joint\s.*?</joint", re.sub("<!--.*?-->", "", text, flags=re.DOTALL), re.DOTALL):
        name, child = (re.search(f"{place}=\\s*[\"']([^\"']*)", joint) for place in (r"\sname\s*", r"<child\s+link\s*"))
        if name and child:
            if child[1] in children:
                return name[1]
            children.add(child[1])
    return ""


def _known(spec: Any) -> str:
    return f"the joints of the model are: {listed(joint.name for joint in spec.joints)}"
