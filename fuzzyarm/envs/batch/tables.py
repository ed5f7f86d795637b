"""The schedules of all episodes that a batch of lanes may be in, below each other as the kernels read them.

Which schedule each lane of a batch is in: its own, or for an episode one that a reset asked for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.layout import CLOCK, START, Noise, Start
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics.equations import AnyArm, bounds_of, equations_of, robot_of
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.reference import Reference

__all__ = ["MAX_ACCELERATION", "Assignment", "Tables", "check_reference", "distinct", "tabulated"]


MAX_ACCELERATION = 1e4  # rad/s², bound of the observation space for the reference's acceleration
CHECKED_INSTANTS = 501  # evenly spaced, at which a reference is checked against a plant

Item = TypeVar("Item")


@dataclasses.dataclass(frozen=True)
class Tables:
    """Scenarios and their schedules: one for a scenario with a reference, one per member of the family for others.

    Attributes:
        references: of each schedule.
        schedules: one after the other.
        starts: (schedules, numbers of `Start`).
        table: (rows, numbers of `Row`), the schedules below each other.
        firsts: (scenarios,) the first schedule of each scenario.
    """

    references: tuple[Reference, ...]
    schedules: tuple[Schedule, ...]
    starts: np.ndarray
    table: np.ndarray
    firsts: np.ndarray

    @classmethod
    def build(
        cls, scenarios: Sequence[Scenario], family: tuple[Reference, ...], control_period: float, axes: int
    ) -> Tables:
        """Tabulate the scenarios' schedules every `control_period` [s], in so many coordinates of the tip."""
        references: list[Reference] = []
        schedules: list[Schedule] = []
        starts, firsts, row = [], [], 0
        for disturbance, reference in scenarios:
            firsts.append(len(schedules))
            mass = checks.real("payload mass", disturbance.payload.mass, "kg", low=0.0, high=LARGEST)
            given = disturbance.encoder_noise
            noise = Noise(0.0, 0.0) if given is None else Noise(given.position, given.velocity)
            for member in family if reference is None else (reference,):
                schedule = Schedule.build(member, disturbance, control_period, axes)
                last = row + schedule.steps
                start = Start(row, last, mass, noise, float(reference is None))
                starts.append(np.hstack(start))
                references.append(member)
                schedules.append(schedule)
                row = last + 1
        table = np.concatenate([schedule.table for schedule in schedules])
        return cls(tuple(references), tuple(schedules), np.array(starts), table, np.array(firsts))

    def followed_by(self, other: Tables) -> Tables:
        """Return these tables with others below; the schedules of these keep their places."""
        moved = other.starts.copy()
        moved[:, [START.first, START.last]] += len(self.table)
        return Tables(
            self.references + other.references,
            self.schedules + other.schedules,
            np.concatenate([self.starts, moved]),
            np.concatenate([self.table, other.table]),
            np.concatenate([self.firsts, other.firsts + len(self.schedules)]),
        )

    def only(self, scenarios: np.ndarray) -> Tables:
        """Return the tables of some of the scenarios, their numbers (n,) in ascending order."""
        stops = np.append(self.firsts[1:], len(self.schedules))
        places = [np.arange(self.firsts[number], stops[number]) for number in scenarios]
        kept = np.concatenate(places)
        schedules = tuple(self.schedules[place] for place in kept)
        starts, lengths = self.starts[kept], np.array([len(schedule.table) for schedule in schedules])
        rows = np.cumsum(lengths) - lengths
        starts[:, START.last] += rows - starts[:, START.first]
        starts[:, START.first] = rows
        firsts = np.cumsum([0, *map(len, places[:-1])])
        table = np.concatenate([schedule.table for schedule in schedules])
        return Tables(tuple(self.references[place] for place in kept), schedules, starts, table, firsts)

    def keeping(self, first: int, start_of: np.ndarray) -> tuple[Tables, np.ndarray, np.ndarray]:
        """Return the tables of the first scenarios and of those that some lanes are in.

        Args:
            first: how many scenarios to keep anyhow.
            start_of: (n,) the first schedule of the scenario that each of these lanes is in.

        Returns:
            The tables, the lanes' `start_of` (n,) in them, and by how many rows (n,) their schedules have moved.
        """
        scenario_of = np.searchsorted(self.firsts, start_of)
        kept = np.union1d(np.arange(first), scenario_of)
        tables = self if len(kept) == len(self.firsts) else self.only(kept)
        after = tables.firsts[np.searchsorted(kept, scenario_of)]
        moved = tables.starts[after, START.first] - self.starts[start_of, START.first]
        return tables, after, moved.astype(np.int64)


def tabulated(
    scenarios: Sequence[Scenario],
    plants: Sequence[AnyArm],
    plant_of: np.ndarray,
    family: tuple[Reference, ...],
    control_period: float,
) -> tuple[Tables, np.ndarray, np.ndarray]:
    """Return tables of scenarios, and by lane the schedule (n,) it begins with and its payload's place (n,).

    Args:
        scenarios: one for all n lanes, or one per lane.
        plants: the arms.
        plant_of: (n,) the number of each lane's among them.
        family: the references that episodes are drawn from where the scenario has none.
        control_period: [s].

    Raises:
        ValueError: a reference does not fit the plant of its lane, or a payload has no place on it.
    """
    kinds, scenario_of = distinct(scenarios, len(plant_of))
    for number, (_, reference) in enumerate(kinds):
        for plant in np.unique(plant_of[scenario_of == number]):
            for member in family if reference is None else (reference,):
                check_reference(member, plants[plant])
    tables = Tables.build(kinds, family, control_period, equations_of(plants[0]).axes)
    places = list(zip(scenario_of.tolist(), plant_of.tolist(), strict=True))
    known: dict[tuple[int, int], float] = {}
    for number, plant in places:
        if (number, plant) not in known:
            disturbance, _ = kinds[number]
            arm = plants[plant]
            known[number, plant] = equations_of(arm).payload_place(disturbance.payload, arm)
    return tables, tables.firsts[scenario_of], np.array([known[place] for place in places])


def distinct(items: Sequence[Item], count: int) -> tuple[list[Item], np.ndarray]:
    """Return the distinct items, by identity, and the number (count,) of each lane's among them.

    A single item is for all lanes.

    Raises:
        ValueError: there are neither one nor `count` items.
    """
    if len(items) not in (1, count):
        raise ValueError(f"{len(items)} entries for {count} lanes; give one, or one per lane")
    if len(items) == 1:
        return list(items), np.zeros(count, dtype=np.int64)
    places: dict[object, int] = {}
    kinds: list[Item] = []
    place_of = np.empty(count, dtype=np.int64)
    for lane, item in enumerate(items):
        key = tuple(map(id, item)) if isinstance(item, tuple) else id(item)
        if key not in places:
            places[key] = len(kinds)
            kinds.append(item)
        place_of[lane] = places[key]
    return kinds, place_of


def check_reference(reference: Reference, arm: AnyArm) -> None:
    """Raise ValueError unless the arm can follow the reference, which was validated for its own arm."""
    bounds = bounds_of(arm)
    if reference.joints != len(bounds.low):
        raise ValueError(f"reference moves {reference.joints} joints, the plant has {len(bounds.low)}: build it for it")
    made_for = getattr(reference, "parameters", getattr(reference, "robot", arm))
    if isinstance(made_for, ArmParameters) and isinstance(arm, ArmParameters):
        if made_for.length != arm.length:
            raise ValueError(
                f"reference was made for links of {made_for.length} m, the plant has "
                f"{arm.length} m: build it with parameters=..."
            )
    elif made_for != arm and not _same_frames(robot_of(made_for), robot_of(arm)):
        raise ValueError(
            f"reference was made for {robot_of(made_for).name}, the plant is {robot_of(arm).name}, whose joints or tip "
            "are elsewhere: build it with robot=..."
        )
    motion = reference.sample(np.linspace(0.0, reference.duration, CHECKED_INSTANTS))
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
                f"reference {name} reaches {found} {unit}; this plant allows {allowed} {unit}: "
                "raise its duration or move its path"
            )


def _same_frames(one: Robot, other: Robot) -> bool:
    """Return whether the joints and the tip of two robots with as many joints are at the same places."""
    names = ("position", "rotation", "axis", "tip")
    return all(np.array_equal(getattr(one.arrays, name), getattr(other.arrays, name)) for name in names)


class Assignment:
    """The schedules of the lanes, by number.

    Args:
        own: tables of the lanes' own scenarios, and by lane the schedule (lanes,) its episodes begin with and its
            payload's place (lanes,), see `tables.tabulated`.

    Attributes:
        own: those tables.
        own_places: schedule and payload's place by lane, in the lanes' own scenarios.
        tables: those of all scenarios that a lane is in; the lanes' own come first.
    """

    def __init__(self, own: tuple[Tables, np.ndarray, np.ndarray]) -> None:
        """Begin with every lane in its own scenario."""
        self.own, *self.own_places = own
        self.all_return()

    def all_return(self) -> None:
        """Put every lane into its own scenario."""
        self.tables = self.own
        self._start_of, self._place_of = self.own_places

    def back(self, lanes: np.ndarray) -> None:
        """Put these lanes (n,) into their own scenarios; their last ones keep their tables."""
        self._start_of[lanes], self._place_of[lanes] = (places[lanes] for places in self.own_places)

    def leave(self, lanes: np.ndarray, clock: np.ndarray) -> None:
        """Put these lanes (n,) into their own scenarios, and drop the tables that no lane is in any longer.

        The rows in `clock` (numbers of `Clock`, lanes) move with the tables.
        """
        if len(lanes) == len(self._start_of):
            self.all_return()
            return
        self.back(lanes)
        visiting = self.visiting()
        own, places = len(self.own.firsts), self._start_of[visiting]
        self.tables, self._start_of[visiting], moved = self.tables.keeping(own, places)
        clock[[[CLOCK.row], [CLOCK.first], [CLOCK.last]], visiting] += moved

    def visit(self, lanes: np.ndarray, scenarios: tuple[Tables, np.ndarray, np.ndarray]) -> None:
        """Put these lanes (n,) into other scenarios, given as the lanes' own ones were."""
        tables, start_of, place_of = scenarios
        if self._start_of is self.own_places[0]:
            self._start_of, self._place_of = (places.copy() for places in self.own_places)
        self._start_of[lanes], self._place_of[lanes] = start_of + len(self.tables.schedules), place_of
        self.tables = self.tables.followed_by(tables)

    def visiting(self) -> np.ndarray:
        """Return the lanes (n,) that are in another scenario than their own."""
        return np.flatnonzero(self._start_of >= len(self.own.schedules))

    def places(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return schedules (n,) and payload's places (n,) of these lanes (n,)."""
        return self._start_of[lanes], self._place_of[lanes]
