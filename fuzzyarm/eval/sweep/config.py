"""What a sweep runs: quantities that differ between plants, distributions of them by name, a grid, and the rest."""

from __future__ import annotations

import dataclasses
import math
import numbers
import shlex
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES, find_case
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.envs.scenario.randomisation import RANDOMISATIONS, DomainRandomisation, Range

POLICIES = ("fuzzy-4", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer")
"""What is swept if not told otherwise."""
NOISE = EncoderNoise(position=1e-5, velocity=1e-3)
"""The encoder noise that the factor ``noise`` is of [rad, rad/s]."""
LONGEST_DELAY = 100  # control periods


class Quantity(NamedTuple):
    """One that differs between plants: words for an axis, its unit, its nominal value, and whether joints differ."""

    label: str
    unit: str
    nominal: float
    per_joint: bool


QUANTITIES = {
    "mass": Quantity("link mass and inertia", "× nominal", 1.0, True),
    "motor_inertia": Quantity("motor inertia", "× nominal", 1.0, True),
    "stiffness": Quantity("joint stiffness", "× nominal", 1.0, True),
    "damping": Quantity("joint damping", "× nominal", 1.0, True),
    "dry_friction": Quantity("dry friction", "× nominal", 1.0, True),
    "viscous_friction": Quantity("viscous friction", "× nominal", 1.0, True),
    "payload": Quantity("payload beside the case's", "kg", 0.0, False),
    "force": Quantity("tip force", "× the case's", 1.0, False),
    "noise": Quantity("encoder noise", f"× ({NOISE.position:g} rad, {NOISE.velocity:g} rad/s)", 0.0, False),
    "delay": Quantity("control delay", "control periods", 0.0, False),
}
COLUMNS = tuple(
    column for name, one in QUANTITIES.items() for column in ([f"{name}_1", f"{name}_2"] if one.per_joint else [name])
)
"""The numbers that make a plant, one per joint where joints differ."""

MAP = ("stiffness_1", "payload")
"""What heat maps are over where both vary and nothing else is asked for."""


@dataclasses.dataclass(frozen=True)
class Distribution:
    """Ranges (low, high), each quantity uniform in its own and independent of the others; see `DomainRandomisation`.

    Attributes:
        mass, motor_inertia, stiffness, damping, dry_friction, viscous_friction: factors, a draw per joint.
        payload: mass at the tip beside the case's own [kg].
        force: factor of the case's tip force.
        noise: factor of the encoder noise `NOISE`.
        delay: whole control periods from a command to the motors.

    Raises:
        ValueError: a range is no pair low <= high, or leaves what is allowed for it.
    """

    mass: Range = (1.0, 1.0)
    motor_inertia: Range = (1.0, 1.0)
    stiffness: Range = (1.0, 1.0)
    damping: Range = (1.0, 1.0)
    dry_friction: Range = (1.0, 1.0)
    viscous_friction: Range = (1.0, 1.0)
    payload: Range = (0.0, 0.0)
    force: Range = (1.0, 1.0)
    noise: Range = (0.0, 0.0)
    delay: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every range."""
        self.randomisation()
        for name, highest in (("noise", 1e6), ("delay", float(LONGEST_DELAY))):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high <= highest:
                raise ValueError(
                    f"{name} from {low:g} to {high:g} is out of range; allowed: 0 <= low <= high <= {highest:g}"
                )
        if any(end != int(end) for end in self.delay):
            raise ValueError(f"delay from {self.delay[0]:g} to {self.delay[1]:g} must be whole control periods")

    def randomisation(self) -> DomainRandomisation:
        """Return what the environment draws of it: all but noise and delay."""
        ranges = {name: getattr(self, name) for name in QUANTITIES if name not in ("noise", "delay")}
        return DomainRandomisation(**ranges)

    @property
    def varying(self) -> tuple[str, ...]:
        """Columns of the plants that differ."""
        return tuple(column for column in COLUMNS if np.ptp(getattr(self, quantity_of(column))) > 0.0)


def _distributions() -> dict[str, Distribution]:
    drawn = RANDOMISATIONS["plants"](ArmParameters())
    plants = Distribution(**{name: getattr(drawn, name) for name, quantity in QUANTITIES.items() if quantity.per_joint})
    loads = dataclasses.replace(plants, payload=(0.0, 5.0), force=(0.5, 1.5))
    return {
        "nominal": Distribution(),
        "plants": plants,
        "loads": loads,
        "all": dataclasses.replace(loads, noise=(0.0, 2.0), delay=(0.0, 2.0)),
    }


DISTRIBUTIONS = _distributions()
"""By name: nothing varies; the environment's ``plants``; those with loads; those with encoder noise and delay."""


class Axis(NamedTuple):
    """One axis of a grid: `number` values of a quantity, evenly from `low` to `high`, the same for both joints."""

    name: str
    low: float
    high: float
    number: int

    @property
    def values(self) -> np.ndarray:
        """The values (number,)."""
        return np.linspace(self.low, self.high, self.number)


@dataclasses.dataclass(frozen=True)
class SweepConfig:
    """What is run, and how its results are looked at.

    Attributes:
        policies: names, controller files or folders of learned policies.
        cases: names of cases.
        plants: how many; with a grid, in each of its cells.
        seed: plant i of the sweep is drawn from seed + i. Sweeps whose seeds are closer than their number of plants
            have plants in common.
        distribution: one of `DISTRIBUTIONS`.
        ranges: (quantity, low, high), in place of the distribution's.
        grid: none or two axes; their quantities are set, the others drawn.
        chunk: plants in a chunk, the unit that is run by one worker and kept in one file.
        bound: an episode succeeds if it goes on to the end and its tip error stays below this [mm].
        worst: how many of the worst plants are kept for replay, of each policy in each case.
        map: the two columns that the heat maps of a sweep without a grid are over; empty: `MAP`, or the first two
            that vary.

    Raises:
        ValueError: a value is unknown or out of range; the message names the choices.
    """

    policies: tuple[str, ...] = POLICIES
    cases: tuple[str, ...] = tuple(CASES)
    plants: int = 1000
    seed: int = 0
    distribution: str = "loads"
    ranges: tuple[tuple[str, float, float], ...] = ()
    grid: tuple[Axis, ...] = ()
    chunk: int = 500
    bound: float = 20.0
    worst: int = 5
    map: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check everything but the policies, which loading checks."""
        for name in ("policies", "cases"):
            given = getattr(self, name)
            if not given or len(set(given)) != len(given):
                raise ValueError(f"{name} = {list(given)} must be one or more different names")
        for case in self.cases:
            find_case(case)
        for name, low in (("plants", 1), ("seed", 0), ("chunk", 1), ("worst", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < low:
                raise ValueError(f"{name} = {value!r} is out of range; allowed: {low}, {low + 1}, {low + 2}, ...")
        if not (_is_number(self.bound) and self.bound > 0.0):
            raise ValueError(f"bound = {self.bound!r} mm is out of range; allowed: (0, inf) mm")
        if self.distribution not in DISTRIBUTIONS:
            raise ValueError(
                f"unknown distribution {self.distribution!r}; choose from: {', '.join(DISTRIBUTIONS)}, "
                "and change its ranges with --range"
            )
        self._check_grid()
        drawn = self.drawn()
        if len(self.map) not in (0, 2) or len(set(self.map)) != len(self.map):
            raise ValueError(f"map = {list(self.map)} must be two different columns, or none")
        columns = COLUMNS if self.grid else drawn.varying
        for column in self.map:
            if column not in columns or self.grid:
                what = (
                    "a grid has its own two" if self.grid else f"choose from: {', '.join(columns) or 'nothing varies'}"
                )
                raise ValueError(f"map over {column!r}: {what}")
        if self.total > 1 and not (self.grid or drawn.varying):
            raise ValueError(f"plants = {self.plants} would repeat one and the same run: nothing varies")
        if self.grid and self.plants > 1 and not drawn.varying:
            raise ValueError(f"plants = {self.plants} in each cell would be one and the same: nothing else varies")

    def _check_grid(self) -> None:
        names = [axis.name for axis in self.grid]
        for name in [*names, *(name for name, _, _ in self.ranges)]:
            if name not in QUANTITIES:
                raise ValueError(f"unknown quantity {name!r}; choose from: {', '.join(QUANTITIES)}")
        if len(names) not in (0, 2) or len(set(names)) != len(names):
            raise ValueError(f"a grid is over two different quantities, not over {', '.join(names)}")
        for axis in self.grid:
            if isinstance(axis.number, bool) or not isinstance(axis.number, int) or axis.number < 2:
                raise ValueError(f"grid over {axis.name}: {axis.number!r} values; allowed: 2, 3, 4, ...")
            Distribution(**{axis.name: (axis.low, axis.high)})
            if not axis.low < axis.high:
                raise ValueError(f"grid over {axis.name} from {axis.low:g} to {axis.high:g}: low must be below high")
            if axis.name == "delay" and not np.array_equal(axis.values, np.round(axis.values)):
                raise ValueError(f"grid over delay: {axis.number} values are no whole control periods")

    def drawn(self) -> Distribution:
        """Return what is drawn: the distribution with its ranges changed, and nothing of what the grid sets."""
        changed = {name: (low, high) for name, low, high in self.ranges}
        changed |= {axis.name: (QUANTITIES[axis.name].nominal,) * 2 for axis in self.grid}
        return dataclasses.replace(DISTRIBUTIONS[self.distribution], **changed)

    @property
    def cells(self) -> int:
        """Number of cells of the grid, 1 without one."""
        return math.prod(axis.number for axis in self.grid)

    @property
    def total(self) -> int:
        """Number of plants."""
        return self.plants * self.cells

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.total // self.chunk)

    def members(self, number: int) -> range:
        """Return the plants of a chunk."""
        return range(number * self.chunk, min((number + 1) * self.chunk, self.total))

    @property
    def plane(self) -> tuple[str, ...]:
        """The two columns of the heat maps; fewer if fewer vary."""
        if self.grid:
            return tuple(axis.name if axis.name in COLUMNS else f"{axis.name}_1" for axis in self.grid)
        varying = self.drawn().varying
        return self.map or (MAP if set(MAP) <= set(varying) else varying[:2])

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON has them."""
        plain = dataclasses.asdict(self)
        return {name: _as_lists(value) for name, value in plain.items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SweepConfig:
        """Return the configuration of `to_dict`; ValueError if a field is unknown, missing or of another type."""
        known = {field.name for field in dataclasses.fields(cls)}
        if set(values) != known:
            raise ValueError(f"fields {', '.join(sorted(set(values) ^ known))} are unknown or missing")
        given = {name: _as_tuples(value) for name, value in values.items()}
        try:
            return cls(**given | {"grid": tuple(Axis(*axis) for axis in given["grid"])})
        except TypeError as error:
            raise ValueError(f"a field is of a wrong type: {error}") from None

    def numbers(self) -> dict[str, Any]:
        """Return the fields that decide the numbers of the episodes, not only how they are looked at."""
        return {name: value for name, value in self.to_dict().items() if name not in ("bound", "worst", "map")}

    def command(self) -> str:
        """Return the command line of this configuration."""
        words = ["fuzzyarm", "sweep"]
        words += [word for policy in self.policies for word in ("--policy", policy)]
        words += [word for case in self.cases for word in ("--case", case)]
        words += ["--plants", str(self.plants), "--seed", str(self.seed), "--distribution", self.distribution]
        words += [word for name, low, high in self.ranges for word in ("--range", name, str(low), str(high))]
        words += [
            word
            for axis in self.grid
            for word in ("--grid", axis.name, str(axis.low), str(axis.high), str(axis.number))
        ]
        words += ["--chunk", str(self.chunk), "--bound", str(self.bound), "--worst", str(self.worst)]
        words += ["--map", *self.map] if self.map else []
        return shlex.join(words)


def quantity_of(column: str) -> str:
    """Return the quantity that a column of the plants belongs to."""
    return column if column in QUANTITIES else column[:-2]


def column_label(column: str, *, both_joints: bool = False) -> str:
    """Return words for an axis over a column, with its unit."""
    quantity = QUANTITIES[quantity_of(column)]
    joints = "both joints" if both_joints else f"joint {column[-1]}"
    return f"{quantity.label}{f', {joints}' if quantity.per_joint else ''} [{quantity.unit}]"


def _is_number(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)


def _as_lists(value: Any) -> Any:
    return [_as_lists(one) for one in value] if isinstance(value, tuple) else value


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(one) for one in value) if isinstance(value, list) else value
