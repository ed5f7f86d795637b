"""The parameters that a log of the motors may tell, as a vector θ, and those that it never tells.

Lengths, masses and gravity are kept: the motors feel of the links only m1 r1² + I1 + m2 L1², m2 r2² + I2, m1 r1 + m2 L1
and m2 r2, four numbers of the eight that describe two links in a plane. A ruler and a scale tell the other four; then
mass centers and moments of inertia follow.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import Arm, Plant, lump, plant_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, flat

__all__ = ["KEPT", "RIGID", "UNKNOWNS", "Unknown", "arm_of", "bounds_of", "constants_of", "names", "start_of"]

_SMALLEST = 1e-9  # share of the scale of a parameter that must be positive


class Unknown(NamedTuple):
    """One number of the arm that a log may tell: a field of `ArmParameters`, and the joint (None: both)."""

    field: str
    joint: int | None

    @property
    def name(self) -> str:
        """The field with the place in it, as messages of `ArmParameters` have it."""
        return self.field if self.joint is None else f"{self.field}[{self.joint}]"

    @property
    def unit(self) -> str:
        """Its unit."""
        fields = {field.name: field for field in dataclasses.fields(ArmParameters)}
        return str(fields[self.field].metadata["unit"])


RIGID = ("inertia", "mass_center", "motor_inertia", "viscous_friction", "coulomb_friction")
"""Fields that a slow, strong motion tells already, if it moves both joints; a log that does not is refused."""

UNKNOWNS = (
    *(Unknown(field, joint) for field in (*RIGID, "static_friction", "stiffness", "damping") for joint in (0, 1)),
    Unknown("stribeck_velocity", None),
)
"""In the order of θ, shape (17,)."""

KEPT = tuple(f.name for f in dataclasses.fields(ArmParameters) if f.name not in {one.field for one in UNKNOWNS})
"""Fields that no log of the motors tells: they keep the values of the start."""


def names() -> tuple[str, ...]:
    """Return the names of the entries of θ."""
    return tuple(one.name for one in UNKNOWNS)


def start_of(arm: ArmParameters) -> np.ndarray:
    """Return θ of an arm, shape (17,), each entry in its unit."""
    return np.array([_entry(getattr(arm, one.field), one.joint) for one in UNKNOWNS])


def _entry(value: Any, joint: int | None) -> float:
    return float(value if joint is None else value[joint])


def bounds_of(arm: ArmParameters, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest θ, each of shape (17,): none below 0, centers within link or start."""
    low, high = _SMALLEST * scale, np.full(len(UNKNOWNS), np.inf)
    for k, one in enumerate(UNKNOWNS):
        if one.field == "mass_center" and one.joint is not None:
            high[k] = max(arm.length[one.joint], arm.mass_center[one.joint])
    return low, high


def arm_of(theta: np.ndarray, arm: ArmParameters) -> ArmParameters:
    """Return an arm with the entries of θ (17,), the rest as in `arm`; static friction is at least Coulomb's.

    Raises:
        ValueError: the entries are those of no arm.
    """
    values: dict[str, Any] = {}
    for one, number in zip(UNKNOWNS, theta.tolist(), strict=True):
        if one.joint is None:
            values[one.field] = number
        else:
            values[one.field] = (*values.get(one.field, ()), number)
    pairs = zip(values["static_friction"], values["coulomb_friction"], strict=True)
    values["static_friction"] = tuple(max(static, coulomb) for static, coulomb in pairs)
    return dataclasses.replace(arm, **values)


def constants_of(theta: np.ndarray, arm: ArmParameters) -> np.ndarray:
    """Return the constants of the equations, rows of `dynamics.Arm`, (21, lanes), for θ of shape (17, lanes)."""
    fields: dict[str, Any] = plant_of(arm)._asdict()
    for field in dict.fromkeys(one.field for one in UNKNOWNS):
        rows = [row for one, row in zip(UNKNOWNS, theta, strict=True) if one.field == field]
        fields[field] = PerJoint(*rows) if len(rows) > 1 else rows[0]
    constants: Arm = lump(Plant(**fields))
    return np.stack([np.broadcast_to(np.asarray(row, dtype=float), theta.shape[1:]) for row in flat(constants)])
