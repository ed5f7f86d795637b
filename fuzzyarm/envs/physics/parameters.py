"""The arm of Table 1: every physical constant, its unit and its allowed range."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.ranges import Ranges

__all__ = ["LARGEST", "ArmParameters", "keep_quantities", "quantity"]

_Pair = tuple[float, float]

LARGEST = 1e12
"""Largest allowed value of a constant in its unit: far above real arms, but products of constants do not overflow."""

# The mass matrix counts as singular if its determinant is below this share of the product of its diagonal
_SINGULAR_SHARE = 1e-6


def quantity(
    unit: str, default: Any = dataclasses.MISSING, symbol: str = "", *, count: int | None = None, **bounds: float
) -> Any:
    """Return a dataclass field of one real number, or of `count` numbers, with bounds as in `checks.real`.

    The metadata of the field are unit, symbol and range; the upper end of the range is `LARGEST` by default.
    """
    metadata = {"unit": unit, "symbol": symbol, "count": count, "bounds": {"high": LARGEST} | bounds}
    return dataclasses.field(default=default, metadata=metadata)


def keep_quantities(record: Any, prefix: str = "", wrong_type: type[Exception] = TypeError) -> None:
    """Check each `quantity` of a frozen record and keep it as a float or a tuple of floats.

    Raises:
        ValueError: a value is out of range; the message names the field after the prefix, the value and the range.
        `wrong_type`: a value is not a real number. Use ValueError for records from files.
    """
    for field in dataclasses.fields(record):
        if "unit" in field.metadata:
            name, value, count = prefix + field.name, getattr(record, field.name), field.metadata["count"]
            unit, bounds = field.metadata["unit"], field.metadata["bounds"]
            try:
                one = None if count else checks.real(name, value, unit, **bounds)
                checks.keep(record, field.name, checks.reals(name, value, count, unit, **bounds) if count else one)
            except TypeError as error:
                raise wrong_type(str(error)) from None


def _pair(unit: str, default: _Pair, symbol: str, **bounds: float) -> Any:
    return quantity(unit, default, symbol, count=2, **bounds)


@dataclasses.dataclass(frozen=True)
class ArmParameters:
    """Physical constants of the two-joint arm; the defaults are Table 1 of the paper.

    Each pair is ``(joint 1, joint 2)``. `torque_limit` is not printed in the paper: 500 and 250 N m leave room
    above the 334 and 131 N m observed in the machining case. `joint_limit` and `velocity_limit` are
    the box (25) on which the Takagi-Sugeno model is exact. A mass center may lie beyond the end of its link: fits find
    only the product of center and mass.

    Raises:
        ValueError: a value is not finite, lies outside its range, or the mass matrix is not positive definite
            for every q2; the message names the field, the value and the range.

    Examples:
        >>> ArmParameters(mass=(12.0, 8.0)).mass
        (12.0, 8.0)
    """

    length: _Pair = _pair("m", (0.5, 0.5), "L_1, L_2", above=0.0)
    mass: _Pair = _pair("kg", (15.0, 9.0), "m_1, m_2", above=0.0)
    inertia: _Pair = _pair("kg m^2", (0.31, 0.19), "I_1, I_2", low=0.0)
    mass_center: _Pair = _pair("m", (0.25, 0.25), "r_1, r_2", above=0.0)
    viscous_friction: _Pair = _pair("N m s/rad", (0.14, 0.14), "f_v1, f_v2", low=0.0)
    gravity: float = quantity("m/s^2", 9.81, "g", low=0.0)
    motor_inertia: _Pair = _pair("kg m^2", (2.71, 0.50), "I_a1, I_a2", above=0.0)
    stiffness: _Pair = _pair("N m/rad", (6.4e4, 1.2e4), "k_t1, k_t2", above=0.0)
    damping: _Pair = _pair("N m s/rad", (20.4, 3.8), "b_t1, b_t2", low=0.0)
    static_friction: _Pair = _pair("N m", (6.0, 3.0), "Gamma_fs1, Gamma_fs2", low=0.0)
    coulomb_friction: _Pair = _pair("N m", (4.0, 2.0), "Gamma_fc1, Gamma_fc2", low=0.0)
    stribeck_velocity: float = quantity("rad/s", 0.1, "v_s", above=0.0)
    torque_limit: _Pair = _pair("N m", (500.0, 250.0), "Gamma_max", above=0.0)
    joint_limit: _Pair = _pair("rad", (math.pi, math.pi), "|q| <=", above=0.0, high=math.pi)
    velocity_limit: _Pair = _pair("rad/s", (15.0, 15.0), "|dq/dt| <=", above=0.0)

    def __post_init__(self) -> None:
        keep_quantities(self, wrong_type=ValueError)
        for joint in range(2):
            static, coulomb = self.static_friction[joint], self.coulomb_friction[joint]
            if not static >= coulomb:
                raise ValueError(
                    f"static_friction[{joint}] = {static} N m is below coulomb_friction[{joint}] = {coulomb} N m: "
                    "Stribeck friction needs static >= Coulomb"
                )
        # det M_b(q2) = (c1 - c3) c3 - c2^2 cos^2 q2 has its minimum at q2 = 0: one check covers the whole range.
        (m1, m2), (r1, r2), (i1, i2), length1 = self.mass, self.mass_center, self.inertia, self.length[0]
        diagonal = (m1 * r1 * r1 + i1 + m2 * length1 * length1) * (m2 * r2 * r2 + i2)
        share = 1.0 - (m2 * length1 * r2) * (m2 * length1 * r2) / diagonal if diagonal > 0.0 else 0.0
        if not share > _SINGULAR_SHARE:
            raise ValueError(
                f"inertia = {self.inertia} kg m^2 with mass_center = {self.mass_center} m makes the mass matrix "
                f"singular at q2 = 0: its determinant is {share:.3g} times the product of its diagonal; it must be "
                f"above {_SINGULAR_SHARE:g} times that product. Raise the inertia"
            )

    @classmethod
    def from_toml(cls, path: str | Path) -> ArmParameters:
        """Read an arm from a TOML file with any of the fields (default: Table 1); a table `[ranges]` is only checked.

        Raises:
            ValueError: the file is not TOML, or contains an unknown field or a value out of range.
            OSError: the file cannot be read.
        """
        values = read_toml(Path(path))
        try:
            ranges = Ranges.taken(values)
            arm = cls.from_dict(values)
            ranges.corners(arm)
            return arm
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> ArmParameters:
        """Build an arm from a mapping of field names to values; ValueError for an unknown name lists the known ones."""
        known = [field.name for field in dataclasses.fields(cls)]
        unknown = set(map(str, checks.instance("values", values, dict))) - set(known)
        if unknown:
            raise ValueError(f"unknown arm field {checks.listed(unknown)}; known: {', '.join(known)}")
        arguments: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
        return cls(**arguments)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain numbers and lists, ready for JSON or TOML."""
        return {
            name: list(value) if isinstance(value, tuple) else value for name, value in dataclasses.asdict(self).items()
        }

    def drive(self, name: str) -> np.ndarray:
        """Return the two values (2,) of the field `name`, one for each joint."""
        return np.array(getattr(self, name))

    def with_drives(self, motor_inertia: _Pair | None = None, stiffness: _Pair | None = None) -> ArmParameters:
        """Return the arm with these rotor inertias [kg m²] and stiffnesses [N m/rad] (None: its own).

        The links' inertias change as in `Robot.with_drives`.
        """
        rotors, changed = motor_inertia or self.motor_inertia, stiffness or self.stiffness
        lighter1, lighter2 = (old - new for old, new in zip(self.motor_inertia, rotors, strict=True))
        inertia = self.inertia[0] + lighter1 - lighter2, self.inertia[1] + lighter2
        return dataclasses.replace(self, inertia=inertia, motor_inertia=rotors, stiffness=changed)

    def write_toml(self, path: str | Path) -> None:
        """Write the text of `to_toml` to a file, atomically."""
        write_atomically(Path(path), self.to_toml())

    def to_toml(self) -> str:
        """Return a TOML text that `from_toml` reads back to an equal arm; a comment in each line states the unit."""
        lines = ["# Two-joint arm with elastic joints; pairs are [joint 1, joint 2]."]
        for field, value in zip(dataclasses.fields(self), self.to_dict().values(), strict=True):
            lines.append(f"{field.name} = {value}  # {field.metadata['symbol']}, {field.metadata['unit']}")
        return "\n".join(lines) + "\n"
