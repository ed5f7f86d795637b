"""The configuration of a sweep: policies, cases, the arm, the plants drawn around it, and how results are shown."""

from __future__ import annotations

import dataclasses
import itertools
import math
import shlex
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.common.checks import choice, distinct, instance, real, shown, texts, whole
from fuzzyarm.common.documents import record
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot, robot_named, shipped_robots
from fuzzyarm.envs.scenario.cases import PAPER_CASES, case_for, find_case
from fuzzyarm.eval.sweep.distributions import DISTRIBUTIONS, Distribution, distribution_for
from fuzzyarm.eval.sweep.quantities import QUANTITIES, columns_of
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.policies import ANY_ROBOT, recorded, resolve

__all__ = ["POLICIES", "SHOWN", "Axis", "QuantityRange", "SweepConfig"]

POLICIES = ("fuzzy-4", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer")
"""The policies of a sweep if none are named."""

SHOWN = ("bound", "worst", "map")
"""Fields that decide only how results are shown: they change no episode."""

_MAP = ("stiffness_1", "payload")  # the plane of the heat maps where both vary and no other is asked for


class QuantityRange(NamedTuple):
    """A range that replaces the distribution's for one quantity.

    Attributes:
        quantity: its name.
        low: lower end.
        high: upper end.
    """

    quantity: str
    low: float
    high: float


class Axis(NamedTuple):
    """One axis of a grid: values of a quantity at equal distances, the same for all joints.

    Attributes:
        quantity: its name.
        low: the first value.
        high: the last value.
        number: number of values, at least 2.
    """

    quantity: str
    low: float
    high: float
    number: int

    @property
    def values(self) -> np.ndarray:
        """The values (number,)."""
        return np.linspace(self.low, self.high, self.number)


@dataclasses.dataclass(frozen=True)
class SweepConfig:
    """What is run, and how its results are shown.

    Attributes:
        policies: policies to run: names, controller files (.json), folders of learned policies, or code of your own as
            package.module:factory, which must act on batches.
        cases: named cases to run each plant in.
        parameters: the two-joint arm that the plants are drawn around, and that the policies are loaded for.
        robot: another robot in its place.
        plants: number of plants; with a grid, in each of its cells.
        seed: plant i of the sweep is drawn from seed + i. Sweeps whose seeds are closer than their number of plants
            have plants in common.
        distribution: what the plants are drawn from: nominal, plants, loads (plants with payload and tip force) or all
            (loads with encoder noise and delay).
        ranges: draw a quantity uniformly from this range instead of the distribution's; may be repeated.
        grid: set a quantity to NUMBER values from LOW to HIGH, in all joints alike; given twice, for the two axes of a
            grid. The other quantities are drawn.
        chunk: plants in a chunk, which one worker runs and one file holds.
        bound: an episode succeeds if it lasts to the end with tip errors below this bound [mm].
        worst: number of worst plants listed for replay, of each policy in each case.
        map: the two columns, such as payload and stiffness_1, that the heat maps of a sweep without a grid are over
            (default: stiffness_1 and payload, or the first two that vary).

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is unknown or out of range; the message names the choices.
    """

    policies: tuple[str, ...] = POLICIES
    cases: tuple[str, ...] = PAPER_CASES
    parameters: ArmParameters = dataclasses.field(default_factory=ArmParameters)
    robot: Robot | None = None
    plants: int = 1000
    seed: int = 0
    distribution: str = "loads"
    ranges: tuple[QuantityRange, ...] = ()
    grid: tuple[Axis, ...] = ()
    chunk: int = 500
    bound: float = 20.0
    worst: int = 5
    map: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check everything but the policies, which are checked when they are loaded."""
        for name in ("policies", "cases"):
            distinct(name, getattr(self, name))
        texts("map", self.map)
        for case in self.cases:
            find_case(case)
        instance("parameters", self.parameters, ArmParameters)
        if self.robot is not None:
            instance("robot", self.robot, Robot)
        for name, low in (("plants", 1), ("seed", 0), ("chunk", 1), ("worst", 0)):
            whole(name, getattr(self, name), low=low)
        real("bound", self.bound, "mm", above=0.0)
        choice("distribution", self.distribution, DISTRIBUTIONS)
        object.__setattr__(self, "ranges", _tuples("ranges", self.ranges, QuantityRange))
        object.__setattr__(self, "grid", _tuples("grid", self.grid, Axis))
        for field in ("ranges", "grid"):
            for row in getattr(self, field):
                choice(f"{field}: quantity", row.quantity, QUANTITIES)
                real(f"{field}: low of {row.quantity}", row.low)
                real(f"{field}: high of {row.quantity}", row.high)
        self._check_grid()
        self._check_map()
        self._check_variety()

    def _check_grid(self) -> None:
        names = [axis.quantity for axis in self.grid]
        if len(names) not in (0, 2) or len(set(names)) != len(names):
            raise ValueError(f"a grid is over two different quantities, not over {', '.join(names)}")
        for name, low, high, number in self.grid:
            whole(f"number of values of the grid over {name}", number, low=2)
            Distribution(**{name: (low, high)})
            if not low < high:
                raise ValueError(f"grid over {name} from {low:g} to {high:g}: low must be below high")
            values = np.linspace(low, high, number)
            if name == "delay" and not np.array_equal(values, np.round(values)):
                raise ValueError(f"grid over delay: {number} values are no whole control periods")

    def _check_map(self) -> None:
        if len(self.map) not in (0, 2) or len(set(self.map)) != len(self.map):
            raise ValueError(f"map = {list(self.map)} must be two different columns, or none")
        if self.map and self.grid:
            raise ValueError(f"map = {list(self.map)}: the heat maps of a grid are over its own two quantities")
        for column in self.map:
            choice("map", column, self.drawn().varying(self.joints) or ("nothing varies",))

    def _check_variety(self) -> None:
        """Refuse a sweep that would run the same plant again and again."""
        varying = self.drawn().varying(self.joints)
        if self.total > 1 and not (self.grid or varying):
            raise ValueError(f"plants = {self.plants} would repeat one and the same run: nothing varies")
        if self.grid and self.plants > 1 and not varying:
            raise ValueError(f"plants = {self.plants} in each cell would be one and the same: nothing else varies")

    def drawn(self) -> Distribution:
        """Return what is drawn: the distribution with the other ranges, and nothing of what the grid sets."""
        changed = {quantity: (low, high) for quantity, low, high in self.ranges}
        changed |= {axis.quantity: (QUANTITIES[axis.quantity].nominal,) * 2 for axis in self.grid}
        return dataclasses.replace(distribution_for(self.distribution, self.arm), **changed)

    @property
    def arm(self) -> AnyArm:
        """The robot, or the two-joint arm."""
        return self.parameters if self.robot is None else self.robot

    @property
    def joints(self) -> int:
        """Number of joints of the arm."""
        return joints_of(self.arm)

    @property
    def titles(self) -> dict[str, str]:
        """The titles of the cases by name, with the loads for this arm."""
        return {case: case_for(case, self.arm).title for case in self.cases}

    @property
    def labels(self) -> tuple[str, ...]:
        """What the policies are called in tables and figures."""
        return tuple(resolve(name).label for name in self.policies)

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
            # A grid sets all joints to the same value: the first column of the quantity stands for them.
            quantities = [axis.quantity for axis in self.grid]
            return tuple(
                next(column.name for column in columns_of(self.joints).values() if column.quantity == name)
                for name in quantities
            )
        varying = self.drawn().varying(self.joints)
        return self.map or (_MAP if set(_MAP) <= set(varying) else varying[:2])

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON has them; of a policy's absolute path the last part, see `policies.recorded`."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: _as_lists(value) for name, value in plain.items()} | {
            "policies": list(map(recorded, self.policies)),
            "parameters": self.parameters.to_dict(),
            "robot": None if self.robot is None else dataclasses.asdict(self.robot),
        }

    @classmethod
    def of(cls, given: dict[str, Any]) -> SweepConfig:
        """Return the configuration with some fields given; with a grid, the others vary nothing by default.

        A robot has the policies `ANY_ROBOT` by default.
        """
        defaults: dict[str, Any] = {"distribution": "nominal", "plants": 1} if given.get("grid") else {}
        if given.get("robot") is not None:
            defaults["policies"] = ANY_ROBOT
        return cls(**defaults | given)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SweepConfig:
        """Return the configuration of `to_dict`; ValueError if a field is unknown, missing or of another type."""
        missing = [field.name for field in dataclasses.fields(cls) if field.name not in values]
        if missing:
            raise ValueError(f"the fields {', '.join(missing)} are missing")
        return record(values, cls)

    def numbers(self) -> dict[str, Any]:
        """Return the fields that decide the numbers of the episodes: all but `SHOWN`."""
        return {name: value for name, value in self.to_dict().items() if name not in SHOWN}

    def command(self) -> str | None:
        """Return the command line of this configuration; None for an arm that needs a file."""
        if self.parameters != ArmParameters():
            return None
        words = ["fuzzyarm", "sweep"]
        if self.robot is not None:
            if self.robot.name not in shipped_robots() or self.robot != robot_named(self.robot.name):
                return None
            words += ["--robot", self.robot.name]
        words += [word for policy in self.policies for word in ("--policy", recorded(policy))]
        words += [word for case in self.cases for word in ("--case", case)]
        words += ["--plants", str(self.plants), "--seed", str(self.seed), "--distribution", self.distribution]
        words += [word for changed in self.ranges for word in ("--range", *map(str, changed))]
        words += [word for axis in self.grid for word in ("--grid", *map(str, axis))]
        words += ["--chunk", str(self.chunk), "--bound", str(self.bound), "--worst", str(self.worst)]
        words += ["--map", *self.map] if self.map else []
        return shlex.join(words)


def _tuples(name: str, given: Any, kind: Callable[..., Any]) -> tuple[Any, ...]:
    """Return rows as records; TypeError unless each has as many entries as the record has fields."""
    fields = kind._fields  # type: ignore[attr-defined]
    rows: Any = given if isinstance(given, list | tuple) else [None]
    if not all(isinstance(row, list | tuple) and len(row) == len(fields) for row in rows):
        raise TypeError(f"{name} = {shown(given)} must be a tuple of rows ({', '.join(fields)})")
    return tuple(itertools.starmap(kind, rows))


def _as_lists(value: Any) -> Any:
    return [_as_lists(one) for one in value] if isinstance(value, tuple) else value
