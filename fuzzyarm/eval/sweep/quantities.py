"""The quantities in which the plants of a sweep differ, and the columns of numbers that make a plant."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.robot import MOST_JOINTS
from fuzzyarm.envs.scenario.disturbances import EncoderNoise

__all__ = ["LONGEST_DELAY", "NOISE", "QUANTITIES", "Column", "Quantity", "column_label", "columns_of", "plant_record"]

NOISE = EncoderNoise(position=1e-5, velocity=1e-3)
"""The encoder noise that the quantity ``noise`` is a factor of [rad, rad/s]."""

LONGEST_DELAY = 100.0  # control periods
LARGEST_NOISE = 1e6  # times `NOISE`


class Quantity(NamedTuple):
    """A quantity that differs between plants.

    Attributes:
        label: what it is called on an axis.
        unit: of its values.
        nominal: the value that changes nothing.
        arm_fields: fields of `ArmParameters`, or of a robot's links and drives, that it is a factor of, as in
            `Physics.varied`; empty for a quantity that is no property of the arm.
        highest: largest value allowed, where `DomainRandomisation` does not say it.
    """

    label: str
    unit: str
    nominal: float
    arm_fields: tuple[str, ...] = ()
    highest: float | None = None

    @property
    def per_joint(self) -> bool:
        """Whether every joint has a value of its own."""
        return bool(self.arm_fields)


def _factor(label: str, *arm_fields: str) -> Quantity:
    return Quantity(label, "× nominal", 1.0, arm_fields)


_NOISE_UNIT = f"× ({NOISE.position:g} rad, {NOISE.velocity:g} rad/s)"
QUANTITIES = {
    "mass": _factor("link mass and inertia", "mass", "inertia"),
    "motor_inertia": _factor("motor inertia", "motor_inertia"),
    "stiffness": _factor("joint stiffness", "stiffness"),
    "damping": _factor("joint damping", "damping"),
    "dry_friction": _factor("dry friction", "static_friction", "coulomb_friction"),
    "viscous_friction": _factor("viscous friction", "viscous_friction"),
    "payload": Quantity("payload beside the case's", "kg", 0.0),
    "force": Quantity("tip force", "× the case's", 1.0),
    "noise": Quantity("encoder noise", _NOISE_UNIT, 0.0, highest=LARGEST_NOISE),
    "delay": Quantity("control delay", "control periods", 0.0, highest=LONGEST_DELAY),
}
"""All quantities by name."""


class Column(NamedTuple):
    """One number of a plant: a quantity, for one of the joints if it has a value per joint.

    Attributes:
        name: of the column, the quantity's with the number of the joint: ``stiffness_1``.
        quantity: its key in `QUANTITIES`.
        joint: index of the joint, from 0; None for a quantity without a value per joint.
    """

    name: str
    quantity: str
    joint: int | None


@functools.cache
def columns_of(joints: int) -> dict[str, Column]:
    """Return the numbers that make a plant of an arm of so many joints, by name."""
    columns = []
    for name, quantity in QUANTITIES.items():
        if quantity.per_joint:
            columns += [Column(f"{name}_{joint + 1}", name, joint) for joint in range(joints)]
        else:
            columns.append(Column(name, name, None))
    return {column.name: column for column in columns}


def plant_record(joints: int) -> np.dtype[np.void]:
    """Return a plant as a record of an array: ``plants["stiffness_1"]`` is the column of that name, (plants,)."""
    return np.dtype([(name, np.float64) for name in columns_of(joints)])


def column_label(name: str, *, together: int | None = None) -> str:
    """Return words for an axis over a column, with its unit.

    Args:
        name: of the column.
        together: how many joints the arm has, if the axis sets them all to the same value.
    """
    column = columns_of(MOST_JOINTS)[name]
    quantity, joint = QUANTITIES[column.quantity], ""
    if column.joint is not None:
        alike = "both joints" if together == JOINTS else "all joints"
        joint = f", {alike}" if together else f", joint {column.joint + 1}"
    return f"{quantity.label}{joint} [{quantity.unit}]"
