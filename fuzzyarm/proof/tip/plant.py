"""A set of plants, and its arms in ball arithmetic.

*Set.* A set defines the factors by which the arm's constants may differ from Table 1, and other disturbances. Every
factor is constant during the motion and independent of the others; the factor of a mass also scales the inertia of its
link, as in `DomainRandomisation`. Three quantities may vary with time, in any measurable way: the friction torque of a
set with ``any`` friction, the tip force within `force_swing` and `force_course`, and at every sample the encoder errors
within `noise`.

*Arms.* The links' torque R of an arm is affine in the factors π_p of its uncertain constants p:

    p = p_0 + Δp π_p,  |π_p| <= 1;      R(·; p) = R(·; p_0) + Σ Δp π_p R_p,      R_p: R with the constants ∂c/∂p,

because the constants of the links, c1..c5 of (3) for the paper's arm, are affine in the factors of the masses and in
the payload, and R is linear in them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from flint import arb

from fuzzyarm.common import checks
from fuzzyarm.common.documents import read_toml, record
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import Motor
from fuzzyarm.envs.physics.equations import AnyArm, equations_of, robot_of
from fuzzyarm.envs.physics.records import Physics, filled, flat
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import ALLOWED
from fuzzyarm.proof.tip.enclosures import NoBound, between, middle_of
from fuzzyarm.proof.tip.transition import StateLayout, layout

__all__ = [
    "AXES", "BY_JOINT", "RANGES", "SETS", "Axis", "BallPlant", "PlantSet", "check_set_name", "exactly", "find_set",
]  # fmt: skip

_Range = tuple[float, float]
_Factor = tuple[float | _Range, float | _Range]  # a range (low, high) for both joints, or a pair, one for each
BY_JOINT = ("mass", "motor_inertia", "stiffness", "damping", "dry_friction", "viscous_friction")
"""The factors with a separate value for each joint."""
RANGES = (*BY_JOINT, "force", "payload")  # all ranges of a set
Axis = tuple[str, int]  # a name of `RANGES` and the index of a joint; 0 if the range is not by joint
AXES: list[Axis] = [(name, joint) for name in RANGES for joint in range(JOINTS if name in BY_JOINT else 1)]
"""All ranges of a set, joint by joint."""

_LIMITS = {"force_swing": ("", 10.0), "force_course": ("N", 1e6)}
_NOISIEST = 1e3  # rad, rad/s
_LONGEST_LABEL = 60  # characters


@dataclasses.dataclass(frozen=True)
class PlantSet:
    """Ranges (low, high) of constants, and bounds on quantities that vary with time; by default, the arm of Table 1.

    The range of a factor of `BY_JOINT` may be given for each joint of a two-joint arm: ``((low, high), (low, high))``.
    """

    mass: _Factor = (1.0, 1.0)  # factor of each link's mass and inertia, one per link
    motor_inertia: _Factor = (1.0, 1.0)  # factor of each motor's inertia
    stiffness: _Factor = (1.0, 1.0)  # factor of each joint's stiffness
    damping: _Factor = (1.0, 1.0)  # factor of each joint's damping
    dry_friction: _Factor = (1.0, 1.0)  # factor of each motor's static and Coulomb friction
    viscous_friction: _Factor = (1.0, 1.0)  # factor of each motor's viscous friction
    payload: _Range = (0.0, 0.0)  # mass at the tip [kg], added to the case's own payload
    force: _Range = (1.0, 1.0)  # factor of the case's tip force
    # ``"law"``: stick and Stribeck friction as in the environment; ``"any"``: any torque up to the static
    friction: Literal["law", "any"] = "law"
    # largest additional change of the factor of the case's tip force, with any course in time
    force_swing: float = 0.0
    force_course: float = 0.0  # largest component along each axis of a further tip force, of any course in time [N]
    noise: _Range = (0.0, 0.0)  # largest error of a measured motor angle [rad] and velocity [rad/s]
    # whole control periods by which every torque acts late; the first torque also acts during this delay
    late: int = 0

    def __post_init__(self) -> None:
        try:
            for name in RANGES:
                object.__setattr__(self, name, _checked(name, getattr(self, name)))
            checks.choice("friction", self.friction, ("law", "any"))
            for name, (unit, high) in _LIMITS.items():
                object.__setattr__(self, name, checks.real(name, getattr(self, name), unit, low=0.0, high=high))
            object.__setattr__(self, "noise", checks.reals("noise", self.noise, 2, low=0.0, high=_NOISIEST))
            object.__setattr__(self, "late", checks.whole("late", self.late, high=1))
        except TypeError as error:
            raise ValueError(str(error)) from None

    def of_joint(self, name: str, joint: int) -> _Range:
        """Return the range `name` for a joint; one that is not given for each joint applies to all."""
        given: Any = getattr(self, name)
        return given[joint] if isinstance(given[0], tuple) else given  # type: ignore[no-any-return]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain numbers and lists."""
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items()}

    def narrowed(self, axis: Axis, part: tuple[float, float]) -> PlantSet:
        """Return the set with the range of one axis replaced by `part`."""
        name, joint = axis
        both = tuple(part if j == joint else self.of_joint(name, j) for j in range(JOINTS))
        named: dict[str, Any] = {name: both if name in BY_JOINT else part}
        return dataclasses.replace(self, **named)

    def hole(self, cells: Sequence[PlantSet]) -> PlantSet | None:
        """Return a part of the set that no cell contains; None if the cells cover the set."""
        found, hole = _hole(self._box(), np.array([cell._box() for cell in cells])), self
        if found is None:
            return None
        for axis, (low, high) in zip(AXES, found.tolist(), strict=True):
            hole = hole.narrowed(axis, (low, high))
        return hole

    def _box(self) -> np.ndarray:
        return np.array([self.of_joint(name, joint) for name, joint in AXES])

    def in_words(self, others: PlantSet | None = None) -> str:
        """Return how the set differs from another, or from Table 1: "mass 1 from 0.98 to 1.02 times", ..."""
        others, words = others or PlantSet(), []
        for name, joint in AXES:
            low, high = self.of_joint(name, joint)
            if (low, high) != others.of_joint(name, joint):
                whose, unit = f" {joint + 1}" if name in BY_JOINT else "", " kg" if name == "payload" else " times"
                words.append(f"{name}{whose} from {exactly(low)} to {exactly(high)}{unit}")
        angle, speed = map(exactly, self.noise)
        said = {"friction": f"friction {self.friction}"}
        said |= {name: f"{name} {exactly(getattr(self, name))}" for name in _LIMITS}
        said["noise"] = f"encoder errors up to {angle} rad and {speed} rad/s"
        said["late"] = f"torques {self.late} control period late"
        words += [text for name, text in said.items() if getattr(self, name) != getattr(others, name)]
        return ", ".join(words) or "the whole set"


def _hole(box: np.ndarray, parts: np.ndarray) -> np.ndarray | None:
    """Return a box (n, 2) within `box` that lies in none of the closed boxes `parts` (m, n, 2), or None.

    The box is divided at an end of a part that lies inside it; a box without such an end lies in one part or in none.
    """
    low, high = box.T
    near = parts[((parts[..., 0] <= high) & (parts[..., 1] >= low)).all(axis=1)]
    if ((near[..., 0] <= low) & (near[..., 1] >= high)).all(axis=1).any():
        return None
    inside = (near > low[:, np.newaxis]) & (near < high[:, np.newaxis])
    if not inside.any():
        return box
    part, axis, end = np.argwhere(inside)[0]
    lower, upper = box.copy(), box.copy()
    lower[axis, 1] = upper[axis, 0] = near[part, axis, end]
    first = _hole(lower, near)
    return _hole(upper, near) if first is None else first


def _checked(name: str, given: Any) -> Any:
    """Return `given`, one range or one per joint, as floats; TypeError or ValueError if the field `name` forbids it."""
    low, high, unit = ALLOWED[name]
    if name in BY_JOINT and isinstance(given, list | tuple) and any(isinstance(part, list | tuple) for part in given):
        if len(given) != JOINTS:
            raise ValueError(
                f"{name} = {checks.shown(given)} must be one range (low, high), or one range for each joint"
            )
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
"""Sets by name: the arm of Table 1 alone; with any friction torque up to static friction; arms near Table 1; the same
with every torque one control period late."""


def check_set_name(name: str, plants: PlantSet) -> None:
    """Raise ValueError if `name` is not short printable ASCII, or is a name in `SETS` but `plants` differ."""
    if not (isinstance(name, str) and 0 < len(name) <= _LONGEST_LABEL and name.isascii() and name.isprintable()):
        raise ValueError(f"set_name = {checks.shown(name)} must be 1 to {_LONGEST_LABEL} printable ASCII characters")
    if name in SETS and plants != SETS[name]:
        raise ValueError(
            f"set_name = {checks.shown(name)}, but the ranges are not those of this set; choose another name"
        )


def exactly(value: float) -> str:
    """Return a short decimal that is read back as exactly this float."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def find_set(name: str | Path) -> PlantSet:
    """Return a set by its name in `SETS` or from a TOML file of `PlantSet`'s fields, else raise ValueError."""
    if str(name) in SETS:
        return SETS[str(name)]
    path = Path(name)
    if path.suffix != ".toml":
        raise ValueError(
            f"unknown set of plants {checks.shown(str(name))}; choose from: {', '.join(SETS)}, or give a .toml file"
        )
    values = read_toml(path)
    try:
        return record(values, PlantSet)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


_ROUNDED = 2.0**-46  # relative error of the links' constants, which the environment computes in floats


@dataclasses.dataclass(frozen=True)
class _Parameter:
    """An uncertain constant: p_0 ± `half`."""

    kind: str  # "mass", "payload", "force", "stiffness", "damping", "motor_inertia", "viscous_friction", "dry_friction"
    joint: int  # index of the joint that has this constant; 0 for the payload and the force
    half: float  # half the width of its range, in its unit; relative to the middle for dry friction and the force
    arm: Any = None  # constants ∂c/∂p times `half`, for a mass or the payload


@dataclasses.dataclass(frozen=True)
class BallPlant:
    """All arms of a set: the constants of the arm in its middle, in floats and balls, and the uncertain constants."""

    physics: Physics  # the equations of the arms
    middle: Any  # constants in floats, of the arm in the middle
    exact: Any  # balls that enclose the exact constants of that arm
    parameters: tuple[_Parameter, ...]  # the uncertain constants
    # lowest and highest factor of the dry friction of each motor, relative to the middle
    share: tuple[tuple[float, float], ...]

    @property
    def layout(self) -> StateLayout:
        """The `StateLayout` for the joints and tip axes of these arms."""
        return layout(self.physics.joints, self.physics.axes)

    @classmethod
    def of(cls, parameters: AnyArm, disturbance: Disturbance, plants: PlantSet) -> BallPlant:
        """Return the arms of the set `plants` around the arm `parameters`, with the payload of `disturbance`."""
        physics = equations_of(parameters)
        joints, nominal = range(physics.joints), physics.plant_of(parameters)
        if len(joints) != JOINTS and any(isinstance(getattr(plants, name)[0], tuple) for name in BY_JOINT):
            raise NoBound(
                f"the set has ranges for {JOINTS} joints, but the arm has {len(joints)}; give one range that all share"
            )
        ranges = {name: [plants.of_joint(name, joint) for joint in joints] for name in BY_JOINT}
        middles = {name: [0.5 * sum(part) for part in parts] for name, parts in ranges.items()}
        share = tuple(map(_share, ranges["dry_friction"]))
        uncertain = [
            _Parameter("dry_friction", joint, max(1.0 - low, high - 1.0))
            for joint, (low, high) in enumerate(share)
            if low < high
        ]
        middle = physics.varied(nominal, _factors(physics, middles))
        for name in sorted(set(BY_JOINT) - {"mass", "dry_friction"}):
            halves = [
                _half(part) * value for part, value in zip(ranges[name], robot_of(parameters).drive(name), strict=True)
            ]
            uncertain += [_Parameter(name, joint, float(half)) for joint, half in enumerate(halves) if half]
        carried = disturbance.payload.mass, physics.payload_place(disturbance.payload, parameters)
        given = [*carried, 0.5 * sum(plants.payload)]
        exact = physics.constants(_in_balls(middle), *map(arb, given))
        rounded, floats = between(1.0 - _ROUNDED, 1.0 + _ROUNDED), physics.constants(middle, *given)
        links = [name for name in exact._fields if name.rstrip("0123456789") not in Motor._fields]
        wide = {name: (getattr(exact, name) * rounded).union(arb(getattr(floats, name))) for name in links}
        exact = exact._replace(**wide)
        masses = _mass_units(physics, _in_balls(nominal), plants, disturbance)
        floats = filled(type(exact), (middle_of(x) for x in flat(exact)))
        return cls(physics, floats, exact, (*uncertain, *masses), share)

    def half(self, kind: str) -> list[float]:
        """Return half the width of a constant's range for each joint; 0 if the constant is certain."""
        widths = [0.0] * self.physics.joints
        for parameter in self.parameters:
            if parameter.kind == kind:
                widths[parameter.joint] = parameter.half
        return widths


def _factors(physics: Physics, by_name: dict[str, list[Any]]) -> Any:
    """Return the factors for `Physics.varied`: an attribute for each name in `by_name`, with a value for each joint."""
    return SimpleNamespace(**{name: physics.PerJoint(*values) for name, values in by_name.items()})


def _share(bounds: tuple[float, float]) -> tuple[float, float]:
    """Return both ends of a range of the dry friction's factor, relative to its middle, rounded outwards."""
    middle = 0.5 * sum(bounds)
    low, high = (x / middle if middle else 1.0 for x in bounds)
    return (low - 2.0**-50, high + 2.0**-50 * high) if low < high else (low, high)


def _half(bounds: tuple[float, float]) -> float:
    return 0.5 * (bounds[1] - bounds[0]) + 2.0**-50 * max(1.0, bounds[1]) if bounds[0] < bounds[1] else 0.0


def _in_balls(plant: Any) -> Any:
    return filled(type(plant), map(arb, flat(plant)))


def _mass_units(physics: Physics, plant: Any, plants: PlantSet, disturbance: Disturbance) -> Iterator[_Parameter]:
    """Yield the uncertain masses, payload and tip force of the nominal arm `plant` (in balls), with ∂c/∂p · `half`."""
    joints = range(physics.joints)

    def weighing(share: list[Any], tip: Any) -> Any:
        draw = dict.fromkeys(BY_JOINT, [arb(1)] * len(joints)) | {"mass": share}
        return physics.constants(physics.varied(plant, _factors(physics, draw)), arb(0), arb(0), tip)

    for joint in joints:
        if half := _half(plants.of_joint("mass", joint)):
            yield _Parameter("mass", joint, half, weighing([arb(half if j == joint else 0.0) for j in joints], arb(0)))
    massless = [arb(0)] * len(joints)
    if half := _half(plants.payload):
        yield _Parameter("payload", 0, half, weighing(massless, arb(half)))
    if (half := _half(plants.force)) and disturbance.tip_force is not None:
        yield _Parameter("force", 0, half / (0.5 * sum(plants.force)), weighing(massless, arb(0)))
