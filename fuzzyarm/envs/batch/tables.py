"""The schedules of all possible episodes of a batch, stacked as the kernels read them."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.layout import CLOCK, START, Noise, Start
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of, equations_of, robot_of
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.reference import Reference

__all__ = ["MAX_ACCELERATION", "Assignment", "Tables", "distinct", "tabulated"]

MAX_ACCELERATION = 1e4  # rad/s², bound on the reference's acceleration in the observation space
_CHECKED_INSTANTS = 501  # evenly spaced instants at which a reference is checked against a plant

_Item = TypeVar("_Item")


class _Plan(NamedTuple):
    """A reference, its schedule, and the initial data of an episode; `Tables` sets its `first` and `last` row."""

    reference: Reference
    schedule: Schedule
    start: Start


class Tables:
    """Schedules of scenarios, each with one episode, or one per member of a family of references.

    Attributes:
        scenarios: the episodes of each scenario; `episodes`: all episodes in order.
        firsts: (scenarios,) the number of the first episode of each scenario.
        starts: (episodes, entries of `Start`), the initial data of each episode.
        table: (rows, entries of `Row`), the stacked schedules.
    """

    def __init__(self, scenarios: Sequence[list[_Plan]]) -> None:
        self.scenarios, self.episodes = list(scenarios), list(itertools.chain(*scenarios))
        self.firsts = np.cumsum([0, *map(len, scenarios[:-1])])
        self.table = np.concatenate([episode.schedule.table for episode in self.episodes])
        stops = np.cumsum([len(episode.schedule.table) for episode in self.episodes])
        self.starts = np.array([np.hstack(episode.start) for episode in self.episodes])
        self.starts[:, START.first], self.starts[:, START.last] = np.append(0, stops[:-1]), stops - 1
        for shared in (self.table, self.starts):
            shared.flags.writeable = False

    def first_rows(self, scenarios: np.ndarray) -> np.ndarray:
        """Return the index in `table` of the first row of each scenario, (n,), for scenario numbers (n,)."""
        return np.asarray(self.starts[self.firsts[scenarios], START.first], dtype=np.int64)


class Assignment:
    """The number of each lane's scenario: its own, or for one episode a scenario requested by a reset.

    It is built from the result of `tabulated` for the lanes' own scenarios, `own`. `tables` lists these first, then
    the other scenarios in use.
    """

    def __init__(self, own: tuple[Tables, np.ndarray, np.ndarray]) -> None:
        self.own, *self._own = own
        self.all_return()

    @property
    def own_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each lane's own scenario: the first episode's row in `own.starts`, and the payload place; (lanes,)."""
        scenarios, places = self._own
        return self.own.firsts[scenarios], places

    def all_return(self) -> None:
        """Put every lane back into its own scenario."""
        self.tables = self.own
        self._scenario_of, self._place_of = self._own  # shared until a lane visits another scenario

    def back(self, lanes: np.ndarray) -> None:
        """Put these lanes (n,) back into their own scenarios; tables that are no longer used are kept."""
        if self.tables is not self.own:
            self._scenario_of[lanes], self._place_of[lanes] = (part[lanes] for part in self._own)

    def leave(self, lanes: np.ndarray, clock: np.ndarray) -> None:
        """Put these lanes (n,) back into their own scenarios; tables that are no longer used are dropped.

        The row numbers of the other lanes in `clock` (entries, lanes) are updated.
        """
        if len(lanes) == len(self._scenario_of):
            self.all_return()
            return
        self.back(lanes)
        visiting = self.visiting()
        visited, before = self._scenario_of[visiting], self.tables
        kept = np.union1d(np.arange(len(self.own.scenarios)), visited)
        if len(kept) < len(before.scenarios):
            self.tables = Tables([before.scenarios[number] for number in kept])
            after = self._scenario_of[visiting] = np.searchsorted(kept, visited)
            moved = self.tables.first_rows(after) - before.first_rows(visited)
            clock[[[CLOCK.row], [CLOCK.first], [CLOCK.last]], visiting] += moved

    def visit(self, lanes: np.ndarray, scenarios: tuple[Tables, np.ndarray, np.ndarray]) -> None:
        """Put these lanes (n,) into other scenarios, given as a result of `tabulated`."""
        if self.tables is self.own:
            self._scenario_of, self._place_of = (part.copy() for part in self._own)
        tables, scenario_of, self._place_of[lanes] = scenarios
        self._scenario_of[lanes] = scenario_of + len(self.tables.scenarios)
        self.tables = Tables([*self.tables.scenarios, *tables.scenarios])

    def visiting(self) -> np.ndarray:
        """Return the indices (n,) of lanes that are in a scenario requested by a reset."""
        return np.flatnonzero(self._scenario_of >= len(self.own.scenarios))

    def places(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return, for lanes (n,), the row in `starts` of the scenario's first episode and its `payload_place`, (n,)."""
        return self.tables.firsts[self._scenario_of[lanes]], self._place_of[lanes]


def tabulated(
    scenarios: Sequence[Scenario],
    plants: Sequence[AnyArm],
    plant_of: np.ndarray,
    family: tuple[Reference, ...],
    control_period: float,
) -> tuple[Tables, np.ndarray, np.ndarray]:
    """Return tables with a row every `control_period` [s]; each lane's scenario number and payload place, both (n,).

    There is one scenario for all n lanes or one per lane; `plant_of` (n,) is the number of each lane's plant. Episodes
    without a reference draw one from `family`.
    """
    kinds, scenario_of = distinct(scenarios, len(plant_of))
    pairs, pair_of = np.unique(np.stack([scenario_of, plant_of]), axis=1, return_inverse=True)
    for number, plant in pairs.T:
        reference = kinds[number][1]
        _shared(_check_all, family if reference is None else (reference,), plants[plant])
    tables = _shared(_tables, tuple(kinds), family, control_period, equations_of(plants[0]).axes)
    place_of = [
        equations_of(plants[plant]).payload_place(kinds[number][0].payload, plants[plant]) for number, plant in pairs.T
    ]
    return tables, scenario_of, np.array(place_of)[pair_of.ravel()]


def _shared(compute: Callable[..., Any], *arguments: Any) -> Any:
    """Return compute(*arguments). If all arguments are immutable, all batches share one result.

    Tabulating the 320 references of the learning task takes a second and 30 MB.
    """
    return (compute if _constant(arguments) else compute.__wrapped__)(*arguments)  # type: ignore[attr-defined]


def _constant(value: Any) -> bool:
    """Return whether a value consists only of numbers, strings, None, tuples and frozen data classes."""
    if isinstance(value, tuple):
        return all(map(_constant, value))
    if frozen := getattr(value, "__dataclass_params__", None):
        parts = (getattr(value, field.name) for field in dataclasses.fields(value))
        return frozen.frozen and all(map(_constant, parts))
    return value is None or isinstance(value, (bool, int, float, str))


@functools.lru_cache(maxsize=4)
def _check_all(references: tuple[Reference, ...], arm: AnyArm) -> None:
    """Raise ValueError unless the arm can follow all these references."""
    for reference in {id(one): one for one in references}.values():
        _check_reference(reference, arm)


@functools.lru_cache(maxsize=2)
def _tables(kinds: tuple[Scenario, ...], family: tuple[Reference, ...], control_period: float, axes: int) -> Tables:
    """Return the tables of scenarios, with a row every `control_period` [s] and `axes` coordinates of the tip."""
    return Tables([_episodes(one, family, control_period, axes) for one in kinds])


def _episodes(scenario: Scenario, family: Sequence[Reference], control_period: float, axes: int) -> list[_Plan]:
    """Return a scenario's episodes: one if it has a reference, else one per reference in `family`; see `_tables`."""
    (disturbance, reference), given = scenario, scenario[0].encoder_noise
    mass = checks.real("payload mass", disturbance.payload.mass, "kg", low=0.0, high=LARGEST)
    noise = Noise(0.0, 0.0) if given is None else Noise(given.position, given.velocity)
    start = Start(0, 0, mass, noise, float(reference is None))
    members = family if reference is None else (reference,)
    once = {id(one): one for one in members}
    schedules = {key: Schedule.build(one, disturbance, control_period, axes) for key, one in once.items()}
    return [_Plan(one, schedules[id(one)], start) for one in members]


def distinct(items: Sequence[_Item], count: int) -> tuple[list[_Item], np.ndarray]:
    """Return the distinct items, by identity, and each lane's item number (count,); a single item serves all lanes."""
    if len(items) not in (1, count):
        raise ValueError(f"{len(items)} entries were given for {count} environments; give one, or one for each")
    if len(items) == 1:
        return list(items), np.broadcast_to(np.int32(0), count)
    keys = [tuple(map(id, item)) if isinstance(item, tuple) else id(item) for item in items]
    kinds = dict(zip(keys, items, strict=True))
    places = {key: place for place, key in enumerate(kinds)}
    return list(kinds.values()), np.array([places[key] for key in keys], dtype=np.int32)


def _check_reference(reference: Reference, arm: AnyArm) -> None:
    """Raise ValueError unless the arm can follow the reference, which may have been made for another arm."""
    bounds = bounds_of(arm)
    if reference.joints != len(bounds.low):
        raise ValueError(
            f"the reference moves {reference.joints} joints, but the plant has {len(bounds.low)}: build a reference "
            "for the plant"
        )
    made_for = getattr(reference, "parameters", getattr(reference, "robot", arm))
    if isinstance(made_for, ArmParameters) and isinstance(arm, ArmParameters):
        if made_for.length != arm.length:
            raise ValueError(
                f"the reference was made for links of {made_for.length} m, but the plant has links of {arm.length} m: "
                "build the reference with the plant's `parameters`"
            )
    elif made_for != arm and not _same_frames(robot_of(made_for), robot_of(arm)):
        raise ValueError(
            f"the reference was made for {robot_of(made_for).name}, but the plant {robot_of(arm).name} has other joint "
            "frames or another tip: build the reference with the plant's `robot`"
        )
    motion = reference.sample(np.linspace(0.0, reference.duration, _CHECKED_INSTANTS))
    fastest = np.full_like(bounds.low, MAX_ACCELERATION)
    for name, unit, values, low, high in (
        ("angle", "rad", motion.q, bounds.low, bounds.high),
        ("velocity", "rad/s", motion.dq, -bounds.velocity, bounds.velocity),
        ("acceleration", "rad/s²", motion.ddq, -fastest, fastest),
    ):
        if np.any((values < low) | (values > high)):
            symmetric = np.array_equal(low, -high)
            peak, lowest = np.abs(values).max(axis=0).tolist(), values.min(axis=0).tolist()
            found = peak if symmetric else f"{lowest} to {values.max(axis=0).tolist()}"
            allowed = tuple(high.tolist()) if symmetric else f"{low.tolist()} to {high.tolist()}"
            raise ValueError(
                f"the joint {name} of the reference reaches {found} {unit}; this plant allows {allowed} {unit}: raise "
                "the duration of the reference or move its path"
            )


def _same_frames(one: Robot, other: Robot) -> bool:
    """Return whether two robots with equally many joints have the same joint frames and the same tip."""
    names = ("position", "rotation", "axis", "tip")
    return all(np.array_equal(getattr(one.arrays, name), getattr(other.arrays, name)) for name in names)
