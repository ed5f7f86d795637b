"""The configuration of a sweep: policies, cases, the arm, the plants drawn around it, and how results are shown."""

from __future__ import annotations

import dataclasses
import itertools
import json
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
from fuzzyarm.eval.sweep._distributions import DISTRIBUTIONS, QUANTITIES, Distribution
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.policies import ANY_ROBOT, recorded, resolve

__all__ = ["SHOWN", "SweepConfig"]

SHOWN = ("bound", "worst", "map")
"""Fields that only decide how results are shown, and on which no episode depends."""
_OPTIONS = {"policies": "policy", "cases": "case", "ranges": "range"}  # fields whose option has another name


class _QuantityRange(NamedTuple):
    """A range [low, high] that replaces the distribution's for one quantity."""

    quantity: str
    low: float
    high: float


class _Axis(NamedTuple):
    """One axis of a grid: `number` values of a quantity from `low` to `high`, the same for all joints."""

    quantity: str
    low: float
    high: float
    number: int

    @property
    def values(self) -> np.ndarray:
        """The evenly spaced values (number,) of the quantity, from `low` to `high`."""
        return np.linspace(self.low, self.high, self.number)


@dataclasses.dataclass(frozen=True)
class SweepConfig:
    """The configuration of a sweep: what is run, and how its results are shown.

    Attributes:
        policies: policies to run: names, controller files (.json), folders of learned policies, or your own code as
            package.module:factory, which must act on batches.
        cases: named cases to run each plant in.
        parameters: the two-joint arm that the plants are drawn around, and that the policies are loaded for.
        robot: another robot, instead of the two-joint arm.
        plants: number of plants; with a grid, in each of its cells.
        seed: plant i of the sweep is drawn from seed + i. Two sweeps share plants if their seeds differ by less than
            their number of plants.
        distribution: the distribution of the plants: nominal, plants, loads (plants with payload and tip force) or all
            (loads with encoder noise and delay).
        ranges: draw a quantity uniformly from this range instead of the distribution's; may be repeated.
        grid: set a quantity to NUMBER values from LOW to HIGH, equal in all joints; give it twice for a two-dimensional
            grid. The other quantities are drawn.
        chunk: number of plants in a chunk; one worker runs a chunk, and one file contains it.
        bound: an episode succeeds if it lasts to the end with tip errors below this bound [mm].
        worst: number of worst plants listed for replay, of each policy in each case.
        map: the two columns, such as payload and stiffness_1, that are the axes of the heat maps of a sweep without a
            grid (default: stiffness_1 and payload, or the first two that vary).

    Raises:
        TypeError: a value is of the wrong type.
        ValueError: a value is unknown or out of range; the message names the choices.
    """

    policies: tuple[str, ...] = ("fuzzy-4", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer")
    cases: tuple[str, ...] = PAPER_CASES
    parameters: ArmParameters = dataclasses.field(default_factory=ArmParameters)
    robot: Robot | None = None
    plants: int = 1000
    seed: int = 0
    distribution: str = "loads"
    ranges: tuple[_QuantityRange, ...] = ()
    grid: tuple[_Axis, ...] = ()
    chunk: int = 500
    bound: float = 20.0
    worst: int = 5
    map: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        distinct("policies", self.policies)
        for case in distinct("cases", self.cases):
            find_case(case)
        instance("parameters", self.parameters, ArmParameters)
        if self.robot is not None:
            instance("robot", self.robot, Robot)
        for name, low in (("plants", 1), ("seed", 0), ("chunk", 1), ("worst", 0)):
            whole(name, getattr(self, name), low=low)
        real("bound", self.bound, "mm", above=0.0)
        choice("distribution", self.distribution, DISTRIBUTIONS)
        for field, kind in (("ranges", _QuantityRange), ("grid", _Axis)):
            object.__setattr__(self, field, _rows(field, getattr(self, field), kind))
        self._check_grid()
        self._check_map()
        if self.plants > 1 and not self.drawn().varying(self.joints):
            where, what = (" in each cell of the grid", "nothing else") if self.grid else ("", "nothing")
            raise ValueError(
                f"plants = {self.plants}{where} would repeat one run, because {what} varies; use plants = 1"
            )

    def _check_grid(self) -> None:
        names = [axis.quantity for axis in self.grid]
        if len(names) not in (0, 2) or len(set(names)) != len(names):
            raise ValueError(f"a grid needs two different quantities, not {', '.join(names)}")
        for axis in self.grid:
            name, low, high, number = axis
            whole(f"number of values of the grid over {name}", number, low=2)
            dataclasses.replace(Distribution(), **dict[str, Any]({name: (low, high)}))
            if not low < high:
                raise ValueError(f"grid over {name} from {low:g} to {high:g}: low must be below high")
            if name == "delay" and not np.array_equal(axis.values, np.round(axis.values)):
                raise ValueError(f"grid over delay: all {number} values must be whole numbers of control periods")

    def _check_map(self) -> None:
        texts("map", self.map)
        if len(self.map) not in (0, 2) or len(set(self.map)) != len(self.map):
            raise ValueError(f"map = {list(self.map)} must name two different columns, or be empty")
        if self.map and self.grid:
            raise ValueError(
                f"map = {list(self.map)} cannot be combined with a grid, whose two quantities are the axes of the heat "
                "maps; leave out map"
            )
        for column in self.map:
            choice("map", column, self.drawn().varying(self.joints) or ("none, because nothing varies; leave out map",))

    def drawn(self) -> Distribution:
        """Return the distribution of the plants: `ranges` replace its own; quantities set by the grid are nominal."""
        changed: dict[str, Any] = {quantity: (low, high) for quantity, low, high in self.ranges}
        changed |= {axis.quantity: getattr(Distribution, axis.quantity) for axis in self.grid}
        return dataclasses.replace(DISTRIBUTIONS[self.distribution].scaled_to(self.arm), **changed)

    @property
    def arm(self) -> AnyArm:
        """The arm that plants are drawn around: the robot, or else the two-joint arm."""
        return self.parameters if self.robot is None else self.robot

    @property
    def joints(self) -> int:
        """Number of joints of the arm."""
        return joints_of(self.arm)

    @property
    def titles(self) -> dict[str, str]:
        """The titles of the cases by name; they state the loads for this arm."""
        return {case: case_for(case, self.arm).title for case in self.cases}

    @property
    def labels(self) -> list[str]:
        """The labels of the policies in tables and figures."""
        return [resolve(name).label for name in self.policies]

    @property
    def total(self) -> int:
        """Number of plants in the sweep, in all cells of the grid together."""
        return self.plants * math.prod(axis.number for axis in self.grid)

    @property
    def chunks(self) -> int:
        """Number of chunks into which the plants are divided."""
        return -(-self.total // self.chunk)

    def members(self, number: int) -> range:
        """Return the indices of the plants in the chunk `number`, counted from 0."""
        return range(number * self.chunk, min((number + 1) * self.chunk, self.total))

    @property
    def plane(self) -> tuple[str, ...]:
        """The two quantities on the heat maps' axes; fewer if fewer vary. On a grid joint 1 represents all joints."""
        if self.grid:
            names = [axis.quantity for axis in self.grid]
            return tuple(f"{name}_1" if QUANTITIES[name].arm_fields else name for name in names)
        varying, usual = self.drawn().varying(self.joints), ("stiffness_1", "payload")
        return self.map or (usual if set(usual) <= set(varying) else varying[:2])

    def to_dict(self) -> dict[str, Any]:
        """Return all fields for JSON; paths of policies as in `policies.recorded`."""
        policies = tuple(map(recorded, self.policies))
        plain: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(self) | {"policies": policies}))
        return plain

    @classmethod
    def of(cls, given: dict[str, Any]) -> SweepConfig:
        """Return the configuration with the fields `given`; the defaults of the other fields fit these.

        With a grid, by default only its quantities vary and a cell has one plant; with a robot the policies are
        `ANY_ROBOT`.
        """
        defaults: dict[str, Any] = {"distribution": "nominal", "plants": 1} if given.get("grid") else {}
        if given.get("robot") is not None:
            defaults["policies"] = ANY_ROBOT
        return cls(**defaults | given)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SweepConfig:
        """Return the configuration that `to_dict` wrote; ValueError for an unknown, missing or mistyped field."""
        missing = [field.name for field in dataclasses.fields(cls) if field.name not in values]
        if missing:
            raise ValueError(f"missing fields: {', '.join(missing)}")
        return record(values, cls)

    def command(self) -> str | None:
        """Return the command line of this configuration; None if its arm can only be given by a file."""
        if self.parameters != ArmParameters():
            return None
        words = ["fuzzyarm", "sweep"]
        if self.robot is not None:
            if self.robot.name not in shipped_robots() or self.robot != robot_named(self.robot.name):
                return None
            words += ["--robot", self.robot.name]
        for name, value in self.to_dict().items():
            for given in value if isinstance(value, list) else [value]:
                if name not in ("parameters", "robot", "map"):
                    words += [f"--{_OPTIONS.get(name, name)}", *map(str, given if isinstance(given, list) else [given])]
        return shlex.join([*words, "--map", *self.map] if self.map else words)


def _rows(name: str, given: Any, kind: Callable[..., Any]) -> tuple[Any, ...]:
    """Return the `given` rows of the field `name` as checked records of type `kind`; TypeError for a wrong length."""
    fields = kind._fields  # type: ignore[attr-defined]
    rows: Any = given if isinstance(given, list | tuple) else [None]
    if not all(isinstance(row, list | tuple) and len(row) == len(fields) for row in rows):
        raise TypeError(f"{name} = {shown(given)} must be a tuple of rows ({', '.join(fields)})")
    for quantity, low, high, *_ in rows:
        choice(f"{name}: quantity", quantity, QUANTITIES)
        real(f"{name}: low of {quantity}", low)
        real(f"{name}: high of {quantity}", high)
    return tuple(itertools.starmap(kind, rows))
