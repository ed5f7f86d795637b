"""What a URDF or MJCF model says of the motion beyond its chain of joints: inertias, and what is refused by name."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from fuzzyarm.common.checks import shown

__all__ = ["inertias", "is_opened", "unknown_forces"]

MASSLESS = 1e-9  # kg
SWITCHES = ("CONSTRAINT", "FRICTIONLOSS", "LIMIT", "DAMPER", "ACTUATION")  # of numbers that are read
GAZEBO = re.compile(
    r"<((?:springStiffness|dampingFactor|turnGravityOff)(?!\s*>\s*(?:[0.]+|false)\s*<)|gravity(?=\s*>\s*(?:0|false)))\s*>"
)
WAY_OUT = "give the link an <inertial> element with mass and moments in the model"


def unknown_forces(
    spec: Any, mujoco: Any, chain: list[Any], moving: list[Any], fixed: Collection[str], text: str
) -> list[str]:
    """Return a complaint for each thing that moves the arm in MuJoCo or Gazebo, and has no equation here."""
    option, bit, trn, wrap = spec.option, mujoco.mjtDisableBit, mujoco.mjtTrn, mujoco.mjtWrap.mjWRAP_JOINT
    off = [one for one in SWITCHES if option.disableflags & getattr(bit, f"mjDSBL_{one}")]
    pulling = [one for one in spec.tendons if any(k.type != wrap or k.target.name not in fixed for k in one.path)]
    elsewhere = [one for one in spec.actuators if one.trntype in (trn.mjTRN_SITE, trn.mjTRN_SLIDERCRANK)]
    rotors = [one for one in spec.actuators if np.any([one.armature, *one.damping])]
    found = [
        *(f"option {name}" for name in ("density", "viscosity", "disableactuator") if getattr(option, name)),
        *(f"the disabled flag {one.lower()}" for one in off),
        *(["compiler settotalmass"] if spec.compiler.settotalmass > 0.0 else []),
        *(["flex"] if spec.flexes else []),
        *(f"gravcomp of link {shown(body.name)}" for body in moving if body.gravcomp),
        *(f"stiffness of joint {shown(one.name)}" for one in chain if np.any(one.stiffness)),
        *(f"springdamper of joint {shown(one.name)}" for one in chain if np.all(one.springdamper)),
        *(f"margin of joint {shown(one.name)}" for one in chain if one.margin),
        *(f"tendon {shown(one.name)}" for one in pulling),
        *(f"actuator {shown(one.name)}" for one in elsewhere),
        *(f"armature or damping of actuator {shown(one.name)}" for one in rotors),
        *(f"{name} of <gazebo>" for name in GAZEBO.findall(text)),
    ]
    return [f"{one} has no equation here: take it out of the model" for one in found]


def inertias(spec: Any, mujoco: Any, parts: dict[str, list[Any]]) -> Iterator[str]:
    """Yield complaints about links without inertia, and give these one, so that the model can be compiled.

    `parts` has, by the joint's name, the bodies that it turns up to the next joint.
    """
    always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    low, high = spec.compiler.inertiagrouprange
    for joint, bodies in parts.items():
        heavy = False
        for body in bodies:
            given = body.explicitinertial and not always
            shapes = [one for one in body.geoms if not given and low <= one.group <= high and _has_mass(one)]
            heavy = heavy or bool(shapes) or (given and body.mass > MASSLESS)
            if any(map(is_opened, shapes)):
                yield f"link {shown(body.name)} takes its inertia from a mesh, and meshes are not opened: {WAY_OUT}"
                _put_inertia(spec, mujoco, body)
        if not heavy:
            yield f"joint {shown(joint)} turns link {shown(bodies[0].name)}, which has no inertia: {WAY_OUT}"
            _put_inertia(spec, mujoco, bodies[0])


def is_opened(geom: Any) -> bool:
    """Return whether the shape of a geom is in a file."""
    return bool(geom.meshname) or geom.type.name in ("mjGEOM_MESH", "mjGEOM_HFIELD", "mjGEOM_SDF")


def _has_mass(geom: Any) -> bool:
    return bool(geom.density != 0.0 if math.isnan(geom.mass) else geom.mass != 0.0)


def _put_inertia(spec: Any, mujoco: Any, body: Any) -> None:
    body.explicitinertial, body.mass, body.inertia = True, 1.0, (1.0, 1.0, 1.0)
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
