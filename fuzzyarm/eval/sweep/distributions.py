"""The quantities in which plants differ, the distributions they are drawn from, and the columns of their numbers."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from fuzzyarm.common.checks import interval
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import MOST_JOINTS
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, Range, find_randomisation

__all__ = [
    "DISTRIBUTIONS", "NOISE", "QUANTITIES", "Distribution", "column_label", "columns_of", "distribution_for",
    "plant_record",
]  # fmt: skip

NOISE = EncoderNoise(position=1e-5, velocity=1e-3)
"""The encoder noise that the quantity ``noise`` is a factor of [rad, rad/s]."""
_HEAVIEST = 5.0  # kg, the payload of the paper's case


class _Quantity(NamedTuple):
    """A quantity that differs between plants, as axes name it."""

    label: str
    unit: str = "× nominal"
    arm_fields: tuple[str, ...] = ()  # fields of `ArmParameters`, or of a robot, that it is a factor of for each joint


QUANTITIES = {
    "mass": _Quantity("link mass and inertia", arm_fields=("mass", "inertia")),
    "motor_inertia": _Quantity("motor inertia", arm_fields=("motor_inertia",)),
    "stiffness": _Quantity("joint stiffness", arm_fields=("stiffness",)),
    "damping": _Quantity("joint damping", arm_fields=("damping",)),
    "dry_friction": _Quantity("dry friction", arm_fields=("static_friction", "coulomb_friction")),
    "viscous_friction": _Quantity("viscous friction", arm_fields=("viscous_friction",)),
    "payload": _Quantity("payload beside the case's", "kg"),
    "force": _Quantity("tip force", "× the case's"),
    "noise": _Quantity("encoder noise", f"× ({NOISE.position:g} rad, {NOISE.velocity:g} rad/s)"),
    "delay": _Quantity("control delay", "control periods"),
}
"""All quantities by name."""


class _Column(NamedTuple):
    """One number of a plant: a quantity, and the joint, from 0, that it is of; None for a quantity of no joint."""

    quantity: str
    joint: int | None


@functools.cache
def columns_of(joints: int) -> dict[str, _Column]:
    """Return the numbers that make a plant of so many joints by name: ``stiffness_1``, ``stiffness_2``, ``payload``."""
    columns = dict[str, _Column]()
    for name, quantity in QUANTITIES.items():
        if quantity.arm_fields:
            columns |= {f"{name}_{joint + 1}": _Column(name, joint) for joint in range(joints)}
        else:
            columns[name] = _Column(name, None)
    return columns


def plant_record(joints: int) -> np.dtype[np.void]:
    """Return a plant as a record of an array: ``plants["stiffness_1"]`` is the column of that name, (plants,)."""
    return np.dtype([(name, np.float64) for name in columns_of(joints)])


def column_label(name: str, *, together: int | None = None) -> str:
    """Return words for an axis over a column, with its unit; `together`: of how many joints, if all have one value."""
    column = columns_of(MOST_JOINTS)[name]
    quantity, joint = QUANTITIES[column.quantity], ""
    if column.joint is not None:
        alike = "both joints" if together == JOINTS else "all joints"
        joint = f", {alike}" if together else f", joint {column.joint + 1}"
    return f"{quantity.label}{joint} [{quantity.unit}]"


@dataclasses.dataclass(frozen=True)
class Distribution(DomainRandomisation):
    """The environment's domain randomisation, and two quantities that the environment does not draw.

    Attributes:
        noise: factor of the encoder noise `NOISE`, 0 to 1e6.
        delay: whole control periods from a command to the motors, 0 to 100.

    Raises:
        TypeError: a range is no pair of numbers.
        ValueError: the pair is not low <= high, or exceeds what is allowed for it.
    """

    noise: Range = (0.0, 0.0)
    delay: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every range."""
        super().__post_init__()
        interval("noise", self.noise, low=0.0, high=1e6)
        first, last = interval("delay", self.delay, low=0.0, high=100.0)
        if not (first.is_integer() and last.is_integer()):
            raise ValueError(f"delay from {first:g} to {last:g} must be whole control periods")

    def quantities(self) -> dict[str, Range]:
        """Return the range of each of `QUANTITIES`."""
        return {name: getattr(self, name) for name in QUANTITIES}

    def varying(self, joints: int) -> tuple[str, ...]:
        """Return the columns in which plants of so many joints differ."""
        different = {name for name, (low, high) in self.quantities().items() if low < high}
        return tuple(name for name, column in columns_of(joints).items() if column.quantity in different)


def distribution_for(name: str, arm: AnyArm) -> Distribution:
    """Return the distribution called `name` for an arm: payloads up to that of its case ``payload`` [kg]."""
    found = DISTRIBUTIONS[name]
    low, high = found.payload
    scale = case_for("payload", arm).disturbance.payload.mass / _HEAVIEST
    return dataclasses.replace(found, payload=(scale * low, scale * high))


_PLANTS = Distribution(**vars(find_randomisation("plants", ArmParameters())))
_LOADS = dataclasses.replace(_PLANTS, payload=(0.0, _HEAVIEST), force=(0.5, 1.5))
DISTRIBUTIONS = {
    "nominal": Distribution(),
    "plants": _PLANTS,
    "loads": _LOADS,
    "all": dataclasses.replace(_LOADS, noise=(0.0, 2.0), delay=(0.0, 2.0)),
}
"""Those of the two-joint arm by name: ``nominal`` varies nothing; ``plants`` is the environment's randomisation of that
name; ``loads`` adds payload and tip force; ``all`` adds encoder noise and delay."""
