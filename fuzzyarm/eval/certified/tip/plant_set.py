"""A set of plants: which factors each constant of the arm may have, and what else may act.

Every factor is constant during the motion and independent of the others; masses count with the inertia of their link,
as in `DomainRandomisation`. What may vary with time, in any measurable way: the friction torque of a set with ``any``
friction, and the tip force within `force_swing` and `force_course`; and at every sample the errors within `noise`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml, record
from fuzzyarm.envs.scenario.randomisation import ALLOWED

__all__ = ["SETS", "PlantSet", "find_set"]

Range = tuple[float, float]

_FACTORS = ("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction", "force")


@dataclasses.dataclass(frozen=True)
class PlantSet:
    """Ranges (low, high) of what is constant, and bounds of what may vary with time; the defaults are Table 1 alone.

    Attributes:
        mass: factor of each link's mass and inertia, one per link.
        motor_inertia: factor of each motor's inertia.
        stiffness: factor of each joint's stiffness.
        damping: factor of each joint's damping.
        dry_friction: factor of each motor's static and Coulomb friction.
        viscous_friction: factor of each motor's viscous friction.
        payload: mass at the tip [kg], added to the case's own payload.
        force: factor of the case's tip force.
        friction: ``"law"``: stick and Stribeck friction as in the environment; ``"any"``: any torque up to the static.
        force_swing: largest share of the case's tip force by which its factor may vary, in any course in time.
        force_course: largest component along x and along y of a further tip force, of any course in time [N].
        noise: largest error of a measured motor angle [rad] and velocity [rad/s].
        late: whole control periods by which every torque acts late; until the first acts, it is held from the start.
    """

    mass: Range = (1.0, 1.0)
    motor_inertia: Range = (1.0, 1.0)
    stiffness: Range = (1.0, 1.0)
    damping: Range = (1.0, 1.0)
    dry_friction: Range = (1.0, 1.0)
    viscous_friction: Range = (1.0, 1.0)
    payload: Range = (0.0, 0.0)
    force: Range = (1.0, 1.0)
    friction: Literal["law", "any"] = "law"
    force_swing: float = 0.0
    force_course: float = 0.0
    noise: Range = (0.0, 0.0)
    late: int = 0

    def __post_init__(self) -> None:
        """Check every range; ValueError names it and what is allowed."""
        try:
            for name in (*_FACTORS, "payload"):
                low, high, unit = ALLOWED[name]
                given = checks.interval(name, getattr(self, name), unit, low=low, high=high)
                object.__setattr__(self, name, given)
            checks.choice("friction", self.friction, ("law", "any"))
            for name, unit in (("force_swing", ""), ("force_course", "N")):
                object.__setattr__(self, name, checks.real(name, getattr(self, name), unit, low=0.0))
            object.__setattr__(self, "noise", checks.reals("noise", self.noise, 2, low=0.0))
            object.__setattr__(self, "late", checks.whole("late", self.late, high=1))
        except TypeError as error:
            raise ValueError(str(error)) from None

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PlantSet:
        """Return the set of a mapping of field names; the others keep Table 1. ValueError for what does not fit."""
        return record(values, cls)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain numbers and lists."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in dataclasses.asdict(self).items()}


_NEAR = PlantSet(
    mass=(0.995, 1.005), motor_inertia=(0.99, 1.01), stiffness=(0.98, 1.02), damping=(0.9, 1.1), dry_friction=(0.8, 1.2)
)

SETS: dict[str, PlantSet] = {
    "table-1": PlantSet(),
    "any-friction": PlantSet(friction="any"),
    "near": _NEAR,
    "near-late": dataclasses.replace(_NEAR, late=1),
}
"""Sets by name: the arm of Table 1 alone; with any friction torque up to the static one; K ± 2 %, B ± 10 %, m ± 0.5 %,
I_a ± 1 %, dry friction ± 20 %; the same with every torque one control period late."""


def find_set(name: str | Path) -> PlantSet:
    """Return the set of a name of `SETS`, or of a TOML file with fields of `PlantSet`.

    Raises:
        ValueError: no such name, or the file is damaged, has an unknown field or a value out of range.
        OSError: the file cannot be read.
    """
    if str(name) in SETS:
        return SETS[str(name)]
    path = Path(name)
    if path.suffix != ".toml":
        raise ValueError(f"unknown set {checks.shown(str(name))}; choose from: {', '.join(SETS)}, or name a .toml file")
    values = read_toml(path)
    try:
        return PlantSet.from_dict(values)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None
