"""The parts of a serial robot as data: links, drives, and joints; see `robot`.

A value out of range raises ValueError, which names the joint if the value belongs to one.
"""

import dataclasses
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.parameters import LARGEST, keep_quantities, quantity

__all__ = ["DIMENSIONS", "DRIVE_UNITS", "Drive", "Joint", "Link", "Vector", "as_rows", "as_vector"]

Vector = tuple[float, float, float]  # three coordinates

_Matrix = tuple[Vector, Vector, Vector]  # three rows of three numbers

DIMENSIONS = 3  # of space
_LARGEST_ANGLE = 100.0  # rad, of a joint's range
_ROUNDING = 1e-9  # of a unit vector or a rotation in a file with ten digits
_TRIANGLE_ROUNDING = 1e-6  # share of the largest principal moment; published moments are rounded


@dataclasses.dataclass(frozen=True)
class Link:
    """The inertia of one link, in the frame of the joint that turns it.

    Attributes:
        mass: m [kg], above 0.
        center: mass center c [m], shape (3,).
        inertia: about the mass center, in axes parallel to the joint frame [kg m²], shape (3, 3): symmetric, positive
            definite, and no principal moment above the sum of the other two.
    """

    mass: float
    center: Vector
    inertia: _Matrix

    def __post_init__(self) -> None:
        checks.keep(self, "mass", checks.real("mass", self.mass, "kg", above=0.0, high=LARGEST))
        checks.keep(self, "center", as_vector("center", self.center, "m"))
        inertia = _matrix("inertia", self.inertia, "kg m^2")
        checks.keep(self, "inertia", inertia)
        tensor = np.array(inertia)
        _require(
            bool(np.abs(tensor - tensor.T).max() <= _ROUNDING * np.abs(tensor).max()),
            f"inertia = {checks.shown(inertia)} kg m^2 is not symmetric; it must be [[xx, xy, xz], [xy, yy, yz], ...]",
        )
        low, middle, high = np.linalg.eigvalsh(tensor).tolist()
        _require(
            low > 0.0,
            f"inertia has the principal moment {low:.6g} kg m^2; allowed: above 0 (for a thin or point-like link, "
            "give the small moment that it has)",
        )
        _require(
            low + middle >= (1.0 - _TRIANGLE_ROUNDING) * high,
            f"inertia has the principal moments {low:.6g}, {middle:.6g} and {high:.6g} kg m^2, the last of which is "
            "above the sum of the others, which is impossible; it must be taken about the mass center, in axes of the "
            "joint frame",
        )


@dataclasses.dataclass(frozen=True)
class Drive:
    """Motor, gear and elastic joint; all quantities as seen from the joint's side of the gear.

    Attributes:
        motor_inertia: I_a [kg m²], inertia of the rotor times the gear ratio squared, above 0.
        stiffness: k_t [N m/rad], above 0.
        damping: b_t of the spring [N m s/rad].
        viscous_friction: f_v of the motor [N m s/rad].
        static_friction: Γ_fs of the motor [N m], at least the Coulomb friction.
        coulomb_friction: Γ_fc of the motor [N m].
        stribeck_velocity: v_s [rad/s], above 0.
        torque_limit: largest torque of the motor [N m], above 0.
    """

    motor_inertia: float = quantity("kg m^2", above=0.0)
    stiffness: float = quantity("N m/rad", above=0.0)
    damping: float = quantity("N m s/rad", low=0.0)
    viscous_friction: float = quantity("N m s/rad", low=0.0)
    static_friction: float = quantity("N m", low=0.0)
    coulomb_friction: float = quantity("N m", low=0.0)
    stribeck_velocity: float = quantity("rad/s", above=0.0)
    torque_limit: float = quantity("N m", above=0.0)

    def __post_init__(self) -> None:
        if checks.is_real(self.motor_inertia) and self.motor_inertia == 0.0:
            raise ValueError(
                "motor_inertia = 0.0 kg m^2: the motor's equation of motion needs an inertia above 0; give the rotor's "
                "inertia times the gear ratio squared; allowed: (0, 1e+12] kg m^2"
            )
        keep_quantities(self, wrong_type=ValueError)
        _require(
            self.static_friction >= self.coulomb_friction,
            f"static_friction = {self.static_friction} N m is below coulomb_friction = {self.coulomb_friction} N m: "
            "Stribeck friction needs static >= Coulomb",
        )


DRIVE_UNITS: dict[str, str] = {field.name: field.metadata["unit"] for field in dataclasses.fields(Drive)}
"""The fields of `Drive` with their units."""


@dataclasses.dataclass(frozen=True)
class Joint:
    """One revolute joint, the link that it turns, and its drive.

    Attributes:
        name: the joint's name.
        position: d [m], shape (3,), origin of the joint frame in the frame of the link before it.
        rotation: A, shape (3, 3), the joint frame's axes as columns in the frame of the link before, at angle 0.
        axis: u, shape (3,), unit vector in the joint frame.
        link: the link that the joint turns; its frame is the joint frame, turned by the angle.
        drive: motor, gear and spring.
        angle_range: (lowest, highest) link angle [rad].
        velocity_limit: largest speed [rad/s], above 0.
    """

    name: str
    position: Vector
    rotation: _Matrix
    axis: Vector
    link: Link
    drive: Drive
    angle_range: tuple[float, float]
    velocity_limit: float

    def __post_init__(self) -> None:
        _require(
            isinstance(self.name, str) and self.name != "" and self.name.isprintable(),
            f"name = {checks.shown(self.name)} must be one line of text",
        )
        try:
            self._check()
        except (TypeError, ValueError) as error:
            raise ValueError(f"joint {checks.shown(self.name)}: {error}") from None

    def _check(self) -> None:
        checks.instance("link", self.link, Link)
        checks.instance("drive", self.drive, Drive)
        checks.keep(self, "position", as_vector("position", self.position, "m"))
        axis = np.array(as_vector("axis", self.axis))
        _require(
            bool(abs(np.linalg.norm(axis) - 1.0) <= _ROUNDING),
            f"axis = {checks.shown(self.axis)} has length {np.linalg.norm(axis):.10g}; it must be a unit vector",
        )
        checks.keep(self, "axis", tuple((axis / np.linalg.norm(axis)).tolist()))
        rotation = np.array(_matrix("rotation", self.rotation))
        _require(
            bool(np.abs(rotation.T @ rotation - np.eye(DIMENSIONS)).max() <= _ROUNDING and np.linalg.det(rotation) > 0),
            f"rotation = {checks.shown(self.rotation)} is not a rotation: its columns must be orthogonal unit vectors, "
            "right-handed",
        )
        checks.keep(self, "rotation", as_rows(rotation))
        low, high = checks.interval("angle_range", self.angle_range, "rad", low=-_LARGEST_ANGLE, high=_LARGEST_ANGLE)
        _require(low < high, f"angle_range = {checks.shown(self.angle_range)} rad is empty; needed: low < high")
        checks.keep(self, "angle_range", (low, high))
        speed = checks.real("velocity_limit", self.velocity_limit, "rad/s", above=0.0, high=LARGEST)
        checks.keep(self, "velocity_limit", speed)


def as_vector(name: str, values: Any, unit: str = "") -> Vector:
    """Return three finite numbers, at most `LARGEST` in magnitude, as a tuple; errors as in `checks.reals`."""
    x, y, z = checks.reals(name, values, DIMENSIONS, unit, low=-LARGEST, high=LARGEST)
    return x, y, z


def _matrix(name: str, values: Any, unit: str = "") -> _Matrix:
    return as_rows(checks.finite_array(name, values, (DIMENSIONS, DIMENSIONS), unit, largest=LARGEST))


def as_rows(matrix: np.ndarray) -> _Matrix:
    """Return an array (3, 3) of numbers as a tuple of rows."""
    x, y, z = (tuple(row) for row in matrix.tolist())
    return x, y, z


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)
