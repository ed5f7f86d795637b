"""A set of plants: which factors each constant of the arm may have, and what else may act.

Every factor is constant during the motion and independent of the others; masses count with the inertia of their link,
as in `DomainRandomisation`. A factor's range is one for both joints, or one for each. What may vary with time, in any
measurable way: the friction torque of a set with ``any`` friction, and the tip force within `force_swing` and
`force_course`; and at every sample the errors within `noise`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Literal

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml, record
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.scenario.randomisation import ALLOWED

__all__ = [
    "AXES", "BY_JOINT", "RANGES", "SETS", "Axis", "PlantSet", "check_set_name", "exactly", "find_set", "plants_of",
    "ranges_in_words",
]  # fmt: skip

Range = tuple[float, float]
Factor = tuple[float | Range, float | Range]
"""A range (low, high) for both joints, or a pair of ranges, one for each."""

BY_JOINT = ("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction")
"""The factors of which each joint has its own."""
RANGES = (*BY_JOINT, "force", "payload")
"""All ranges of a set."""

Axis = tuple[str, int]
"""A field of `RANGES` and a joint; 0 where the range is not by joint."""

AXES: list[Axis] = [(name, joint) for name in RANGES for joint in range(JOINTS if name in BY_JOINT else 1)]
"""All ranges of a set, joint by joint."""

LIMITS = {"force_swing": ("", 10.0), "force_course": ("N", 1e6)}
NOISIEST = 1e3  # rad, rad/s
LONGEST_LABEL = 60  # characters


@dataclasses.dataclass(frozen=True)
class PlantSet:
    """Ranges (low, high) of what is constant, and bounds of what may vary with time; the defaults are Table 1 alone.

    The range of a factor of `BY_JOINT` may be given for each joint: ``((low, high), (low, high))``.

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

    mass: Factor = (1.0, 1.0)
    motor_inertia: Factor = (1.0, 1.0)
    stiffness: Factor = (1.0, 1.0)
    damping: Factor = (1.0, 1.0)
    dry_friction: Factor = (1.0, 1.0)
    viscous_friction: Factor = (1.0, 1.0)
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
            for name in RANGES:
                object.__setattr__(self, name, _checked(name, getattr(self, name)))
            checks.choice("friction", self.friction, ("law", "any"))
            for name, (unit, high) in LIMITS.items():
                object.__setattr__(self, name, checks.real(name, getattr(self, name), unit, low=0.0, high=high))
            object.__setattr__(self, "noise", checks.reals("noise", self.noise, 2, low=0.0, high=NOISIEST))
            object.__setattr__(self, "late", checks.whole("late", self.late, high=1))
        except TypeError as error:
            raise ValueError(str(error)) from None

    def of_joint(self, name: str, joint: int) -> Range:
        """Return the range of a factor of `BY_JOINT` for a joint; any other range as it is."""
        given = getattr(self, name)
        chosen: Range = given[joint] if isinstance(given[0], tuple) else given
        return chosen

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PlantSet:
        """Return the set of a mapping of field names; the others keep Table 1. ValueError for what does not fit."""
        return record(values, cls)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain numbers and lists."""
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items()}


def _checked(name: str, given: Any) -> Any:
    """Return a range, or a pair of them, as floats."""
    low, high, unit = ALLOWED[name]
    if name in BY_JOINT and isinstance(given, list | tuple) and any(isinstance(part, list | tuple) for part in given):
        if len(given) != JOINTS:
            raise ValueError(f"{name} = {checks.shown(given)} must be one range (low, high), or one for each joint")
        parts = [
            checks.interval(f"{name}, joint {j + 1}", part, unit, low=low, high=high) for j, part in enumerate(given)
        ]
        return tuple(parts) if parts[0] != parts[1] else parts[0]
    return checks.interval(name, given, unit, low=low, high=high)


def _plain(value: Any) -> Any:
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


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


def check_set_name(name: str, plants: PlantSet) -> None:
    """Raise ValueError for a label that is no short printable ASCII text, or a name of `SETS` for other plants."""
    if not (isinstance(name, str) and 0 < len(name) <= LONGEST_LABEL and name.isascii() and name.isprintable()):
        raise ValueError(f"set_name = {checks.shown(name)} must be 1 to {LONGEST_LABEL} printable ASCII characters")
    if name in SETS and plants != SETS[name]:
        raise ValueError(f"set_name = {checks.shown(name)}, but the plants are not those of this set")


def plants_of(label: str, values: dict[str, Any]) -> PlantSet:
    """Return the set of a file; ValueError where its label is a name of `SETS` for other plants.

    Any other label is a note of the file's maker, which is neither checked nor repeated.
    """
    plants = PlantSet.from_dict(values)
    if label in SETS:
        check_set_name(label, plants)
    return plants


def ranges_in_words(plants: PlantSet, others: PlantSet | None = None) -> str:
    """Return in what a set differs from another one, or from a single arm: "mass 1 from 0.98 to 1.02 times", ..."""
    others, words = others or PlantSet(), []
    for name, joint in AXES:
        low, high = plants.of_joint(name, joint)
        if (low, high) != others.of_joint(name, joint):
            unit = " kg" if name == "payload" else " times"
            words.append(
                f"{name}{f' {joint + 1}' if name in BY_JOINT else ''} from {exactly(low)} to {exactly(high)}{unit}"
            )
    if plants.friction != others.friction:
        words.append(f"friction {plants.friction}")
    words += [
        f"{name} {exactly(getattr(plants, name))}" for name in LIMITS if getattr(plants, name) != getattr(others, name)
    ]
    if plants.noise != others.noise:
        words.append(f"encoder errors up to {exactly(plants.noise[0])} rad and {exactly(plants.noise[1])} rad/s")
    if plants.late != others.late:
        words.append(f"torques {plants.late} control period late")
    return ", ".join(words) or "the whole set"


def exactly(value: float) -> str:
    """Return the shortest decimal that is exactly a float."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


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
