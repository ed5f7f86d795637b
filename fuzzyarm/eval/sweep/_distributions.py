"""The quantities in which plants differ, their distributions, and their columns in arrays of plants."""

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

__all__ = ["DISTRIBUTIONS", "NOISE", "QUANTITIES", "Distribution", "column_label", "columns_of", "plant_record"]

NOISE = EncoderNoise(position=1e-5, velocity=1e-3)
"""The encoder noise that a plant's ``noise`` multiplies [rad, rad/s]."""
_HEAVIEST = 5.0  # kg, the payload of the paper's case


class _Quantity(NamedTuple):
    """A quantity in which plants differ, with its label and unit for the axes of plots."""

    label: str
    unit: str = "× nominal"
    arm_fields: tuple[str, ...] = ()  # fields of `ArmParameters`, or of a robot, that it multiplies, for each joint


QUANTITIES = {
    "mass": _Quantity("link mass and inertia", arm_fields=("mass", "inertia")),
    "motor_inertia": _Quantity("motor inertia", arm_fields=("motor_inertia",)),
    "stiffness": _Quantity("joint stiffness", arm_fields=("stiffness",)),
    "damping": _Quantity("joint damping", arm_fields=("damping",)),
    "dry_friction": _Quantity("dry friction", arm_fields=("static_friction", "coulomb_friction")),
    "viscous_friction": _Quantity("viscous friction", arm_fields=("viscous_friction",)),
    "payload": _Quantity("payload added to the case's", "kg"),
    "force": _Quantity("tip force", "× the case's"),
    "noise": _Quantity("encoder noise", f"× ({NOISE.position:g} rad, {NOISE.velocity:g} rad/s)"),
    "delay": _Quantity("control delay", "control periods"),
}
"""All quantities by name."""


@functools.cache
def columns_of(joints: int) -> dict[str, tuple[str, int | None]]:
    """Return the columns of a plant with this many joints: ``stiffness_1``, ``stiffness_2``, ``payload``, ...

    Each name maps to its quantity and joint, counted from 0; the joint is None for a quantity of the whole arm.
    """
    columns = dict[str, tuple[str, int | None]]()
    for name, quantity in QUANTITIES.items():
        if quantity.arm_fields:
            columns |= {f"{name}_{joint + 1}": (name, joint) for joint in range(joints)}
        else:
            columns[name] = name, None
    return columns


def plant_record(joints: int) -> np.dtype[np.void]:
    """Return the type of an array of plants: ``plants["stiffness_1"]`` is a column of values (plants,)."""
    return np.dtype([(name, np.float64) for name in columns_of(joints)])


def column_label(name: str, *, together: int | None = None) -> str:
    """Return the label, with unit, of a plot's axis for a column of `columns_of`.

    `together` is the number of joints if all joints share the value, as on a grid. If it is None, the label names the
    column's joint.
    """
    quantity, joint = columns_of(MOST_JOINTS)[name]
    label, unit, _ = QUANTITIES[quantity]
    if joint is None:
        return f"{label} [{unit}]"
    which = f"joint {joint + 1}" if together is None else "both joints" if together == JOINTS else "all joints"
    return f"{label}, {which} [{unit}]"


@dataclasses.dataclass(frozen=True)
class Distribution(DomainRandomisation):
    """Ranges from which plants are drawn: the environment's domain randomisation, encoder noise and control delay.

    Ranges are pairs (low, high): `noise` of a factor on `NOISE`, within 0 to 1e6; `delay` of the torques' delay, within
    0 to 100 whole control periods.

    Raises:
        TypeError: a range is not a pair of numbers.
        ValueError: a pair is not low <= high, or exceeds its limits.
    """

    noise: Range = (0.0, 0.0)
    delay: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        interval("noise", self.noise, low=0.0, high=1e6)
        first, last = interval("delay", self.delay, low=0.0, high=100.0)
        if not (first.is_integer() and last.is_integer()):
            raise ValueError(f"delay = ({first:g}, {last:g}) must be two whole numbers of control periods")

    def quantities(self) -> dict[str, Range]:
        """Return the ranges by the names of `QUANTITIES`."""
        return {name: getattr(self, name) for name in QUANTITIES}

    def varying(self, joints: int) -> tuple[str, ...]:
        """Return the columns in which plants with this many joints differ."""
        ranges = self.quantities()
        return tuple(name for name, (quantity, _) in columns_of(joints).items() if np.ptp(ranges[quantity]) > 0.0)

    def scaled_to(self, arm: AnyArm) -> Distribution:
        """Return the distribution for another arm: its payloads [kg] scale with that of the arm's case ``payload``."""
        (low, high), own = self.payload, case_for("payload", arm).disturbance.payload.mass
        scale = own / _HEAVIEST
        return dataclasses.replace(self, payload=(scale * low, scale * high))


_PLANTS = Distribution(**vars(find_randomisation("plants", ArmParameters())))
_LOADS = dataclasses.replace(_PLANTS, payload=(0.0, _HEAVIEST), force=(0.5, 1.5))
DISTRIBUTIONS = {
    "nominal": Distribution(),
    "plants": _PLANTS,
    "loads": _LOADS,
    "all": dataclasses.replace(_LOADS, noise=(0.0, 2.0), delay=(0.0, 2.0)),
}
"""The distributions of the two-joint arm by name. ``nominal`` varies nothing, ``plants`` is the environment's
randomisation of that name, ``loads`` adds payload and tip force, and ``all`` adds encoder noise and delay."""
