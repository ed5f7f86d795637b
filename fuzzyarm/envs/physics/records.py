"""Records with an entry per joint, the indices of their numbers in arrays, and `Physics`, an arm's equations.

A record is a NamedTuple whose fields are numbers or further records. In an array its numbers are stored in the order of
the fields:

    class Load(NamedTuple):
        torque: PerJoint
        mass: Any

    size(Load) = 3      places(Load).mass = 2      columns(Load).torque = slice(0, 2)
    filled(Load, table[k]) = Load(PerJoint(table[k, 0], table[k, 1]), table[k, 2])
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from fuzzyarm.envs.physics.friction import DRY_TORQUES
from fuzzyarm.numbers.functions import flat, like

__all__ = [
    "JOINTS", "VARIED", "PerJoint", "Physics", "Point2", "State", "columns", "filled", "flat", "per_joint", "places",
    "point", "record_type", "size", "state_record",
]  # fmt: skip


class PerJoint(NamedTuple):
    """One number for each joint of the two-joint arm; `per_joint` returns the type for any number of joints."""

    joint1: Any
    joint2: Any


JOINTS = len(PerJoint._fields)  # number of joints of the paper's arm


class Point2(NamedTuple):
    """A vector in the plane of the two-joint arm, x down and y to the right; `point(3)` is the type for space."""

    x: Any
    y: Any


class State(NamedTuple):
    """Motor and link angles [rad], then their velocities [rad/s], of the arm with two joints; see `state_record`."""

    motor: PerJoint
    link: PerJoint
    motor_velocity: PerJoint
    link_velocity: PerJoint


def record_type(name: str, **fields: Any) -> Any:
    """Return a new record type with these fields; each is a number (``Any``) or of another record type."""
    return NamedTuple(name, list(fields.items()))


@functools.cache
def per_joint(joints: int) -> Any:
    """Return the record type of one number per joint: joint1, ...; the same class on each call, `PerJoint` for two."""
    if joints == len(PerJoint._fields):
        return PerJoint
    return record_type("PerJoint", **{f"joint{k + 1}": Any for k in range(joints)})


@functools.cache
def point(axes: int) -> Any:
    """Return the record type of a vector with 2 or 3 axes x, y, z; the same class on each call, `Point2` for two."""
    return Point2 if axes == len(Point2._fields) else record_type("Point", **dict.fromkeys("xyz"[:axes], Any))


@functools.cache
def state_record(joints: int) -> Any:
    """Return the type of `State` for a number of joints; the same class on each call."""
    if joints == len(PerJoint._fields):
        return State
    return record_type("State", **dict.fromkeys(State._fields, per_joint(joints)))


@functools.cache
def size(kind: Any) -> int:
    """Return how many numbers a record of this type contains, those of nested records included."""
    return sum(size(part) if _is_record(part) else 1 for _, part in _fields(kind))


def places(record: type, first: int = 0) -> Any:
    """Return a record of this type that has, for each number, its index in a flat array, counted from `first`."""
    values = []
    for _, kind in _fields(record):
        values.append(places(kind, first) if _is_record(kind) else first)
        first += size(kind) if _is_record(kind) else 1
    return record(*values)


def columns(record: type) -> Any:
    """Return a record of this type that has, for each field, the slice of its numbers in a flat array."""
    parts = [flat((part,)) for part in places(record)]
    return record(*(slice(part[0], part[-1] + 1) for part in parts))


def filled(record: Any, numbers: Iterable[Any]) -> Any:
    """Return a record of the type `record` with these numbers in order; rows of an array give a record of arrays."""
    return like(places(record), iter(numbers))


@functools.cache
def _fields(record: type) -> tuple[tuple[str, Any], ...]:
    """Return the name and the type of each field of a record type, in order."""
    kinds = typing.get_type_hints(record)
    return tuple((name, kinds[name]) for name in record._fields)  # type: ignore[attr-defined]


def _is_record(kind: Any) -> bool:
    return hasattr(kind, "_fields")


VARIED = {
    "mass": "mass",
    "inertia": "mass",
    "motor_inertia": "motor_inertia",
    "stiffness": "stiffness",
    "damping": "damping",
    "viscous_friction": "viscous_friction",
    **dict.fromkeys(DRY_TORQUES, "dry_friction"),
}
"""For each varied quantity of a plant, the factor of a draw that multiplies the quantity."""


@dataclasses.dataclass(frozen=True, eq=False)
class Physics:
    """The equations of motion of arms of one structure, and the records used in these equations.

    All functions are elementwise, see `elementwise`: the same code accepts numbers, arrays and tensors of lanes, and is
    compiled into kernels. Forces on the tip are a `Point` [N], torques a `PerJoint` [N m], angles a `PerJoint` [rad].
    """

    joints: int  # number n of joints
    axes: int  # of the tip's space, 2 or 3
    digest: str  # text that distinguishes the compiled functions of these equations from others
    # a function and its arguments; the call returns this object, and copies and pickles contain only these two
    made_by: tuple[Callable[..., Physics], tuple[Any, ...]]
    Plant: Any  # record of the parameters of an arm: what domain randomisation multiplies, and limits
    Arm: Any  # record of the constants that the equations use
    Limits: Any  # record of the limits of angles [rad], velocities [rad/s] and torques [N m]
    plant_of: Callable[..., Any]  # returns the `Plant` (floats) of an arm's parameters
    step: Callable[..., Any]  # ``step(state, torque, force, arm, h)``, the `State` a sub-step h [s] later
    # ``loaded_step(state, torque, load, arm, h)``, the same with torques on the links instead of the tip force
    loaded_step: Callable[..., Any]
    tip: Callable[..., Any]  # ``tip(angles, arm)``, the `Point` of the tip [m]
    tip_velocity: Callable[..., Any]  # ``tip_velocity(angles, rates, arm)``, the `Point` of its velocity [m/s]
    tip_load: Callable[..., Any]  # ``tip_load(angles, force, arm)``, J(q)ᵀ F of a force on the tip
    gravity: Callable[..., Any]  # ``gravity(angles, arm)``, g(q)
    motor_friction: Callable[..., Any]  # ``motor_friction(state, torque, bias, arm)``, Γ_f of the motors
    # ``inverse_dynamics(angles, rates, accelerations, arm)``, M(q) q̈ + C(q, q̇) q̇ + g(q)
    inverse_dynamics: Callable[..., Any]
    mass_matrix: Callable[..., Any]  # ``mass_matrix(angles, arm)``, M(q) [kg m²], a tuple of rows
    # returns the place of a payload on an arm with given parameters, as one number for `constants`
    payload_place: Callable[..., float]
    # ``constants(plant, payload, place, tip_payload)``, the `Arm` of the plant with a point mass [kg] at a place
    # and another one at the tip
    constants: Callable[..., Any]
    stiffness: Callable[..., Any]  # ``stiffness(plant)``, of the joints [N m/rad]
    limits: Callable[..., Any]  # ``limits(plant)``
    angle_range: Callable[..., Any]  # ``angle_range(limits)``, the lowest and the highest angles
    varied: Callable[..., Any]  # ``varied(plant, draw)``, the plant with the factors of a `randomisation.draw_record`
    PerJoint: Any = dataclasses.field(init=False)  # record of one number for each joint
    Point: Any = dataclasses.field(init=False)  # record of a vector in the tip's space
    State: Any = dataclasses.field(init=False)  # record of motor and link angles and their velocities

    def __post_init__(self) -> None:
        """Set the records for these joints and axes as attributes, because torch cannot compile a cache look-up."""
        for name, kind in (("PerJoint", per_joint), ("State", state_record)):
            object.__setattr__(self, name, kind(self.joints))
        object.__setattr__(self, "Point", point(self.axes))

    def __reduce__(self) -> tuple[Callable[..., Physics], tuple[Any, ...]]:
        """Return `made_by`, from which copies and pickles rebuild the object; its functions cannot be pickled."""
        return self.made_by
