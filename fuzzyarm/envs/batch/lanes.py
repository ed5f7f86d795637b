"""Batched simulation state behind both environments: one arm per lane, each in its own episode."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.batch.beginning import begin
from fuzzyarm.envs.batch.kernels import advance, observe_again, prepare
from fuzzyarm.envs.batch.layout import CLOCK, LANE, START, WIDTH, Clock, Lane, split
from fuzzyarm.envs.batch.randomness import key_before, key_of
from fuzzyarm.envs.batch.saved_state import check_contents, checked_arrays, digest
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.batch.tables import Tables, distinct, tabulated
from fuzzyarm.envs.batch.workers import Workers
from fuzzyarm.envs.physics.compiled import announced_compilation
from fuzzyarm.envs.physics.dynamics import State, plant_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import JOINTS, size
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, Draw, by_quantity
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.scenario import Scenario

__all__ = ["Lanes"]

_TORQUE_LIMIT = list(LANE.limits.torque)


class Lanes:
    """A batch of arms, each with its own plant, scenario and random stream.

    Args:
        plants: one arm for all lanes, or one per lane.
        scenarios: one for all lanes, or one per lane. Lanes with the same scenario share its table.
        count: number of lanes.
        control_period: [s].
        substeps: in a control period.
        randomisation: what each episode draws.
        threads: how many a step may use; None: one per 1024 lanes, at most one per core.

    Raises:
        ValueError: a reference does not fit the plant of its lane.
    """

    def __init__(
        self,
        plants: Sequence[ArmParameters],
        scenarios: Sequence[Scenario],
        count: int,
        *,
        control_period: float,
        substeps: int,
        randomisation: DomainRandomisation,
        threads: int | None = None,
    ) -> None:
        """Lay out the lanes; no episode begins before `reset`."""
        # The kernels have one signature: the period must be a float, whatever kind of number was given.
        self.period, self.substeps = float(control_period), substeps
        self.count, self.randomisation = count, randomisation
        self.parameters, self._plant_of = distinct(plants, count)
        self._plants = np.array([np.hstack(plant_of(arm)) for arm in self.parameters])
        self._ranges = randomisation.ranges
        self.values = np.full((size(Lane), count), np.nan)
        self.clock = np.zeros((size(Clock), count), dtype=np.int64)
        self.clock[CLOCK.key] = np.random.SeedSequence().generate_state(count, np.uint64).view(np.int64)
        self.drawn = np.empty((size(Draw), count if randomisation.varies else 0))
        self._drawn_info: dict[str, np.ndarray] = {}
        self._own, self._own_start_of, self._own_radius_of = self._tabulated(scenarios, np.arange(count))
        self._tables = self._own
        self._start_of, self._radius_of = self._own_start_of.copy(), self._own_radius_of.copy()
        self._workers = Workers(count, threads)
        self.threads = self._workers.threads

    def reset(
        self,
        seeds: Sequence[int | None] | None = None,
        scenarios: Sequence[Scenario] | None = None,
        initial: np.ndarray | None = None,
        which: np.ndarray | None = None,
    ) -> np.ndarray:
        """Begin an episode in n lanes and return their results (WIDTH n,), see `layout.split`.

        Args:
            seeds: of each of these lanes' random streams; None: the stream continues.
            scenarios: what to do this time in place of the lanes' own scenarios; one for all n lanes, or one per lane.
            initial: states (n, 8) to start from; None: at rest on the reference.
            which: (n,) the lanes, in ascending order; None: all of them.

        Raises:
            ValueError: a reference does not fit the plant of its lane, or there is not one entry per lane.
        """
        lanes = np.arange(self.count) if which is None else which
        if seeds is not None and len(seeds) != len(lanes):
            raise ValueError(f"{len(seeds)} seeds for {len(lanes)} lanes; give one per lane")
        if initial is not None:
            initial = np.array(initial, dtype=np.float64, order="C")
            if initial.shape != (len(lanes), size(State)):
                raise ValueError(f"initial has shape {initial.shape}; needed: {(len(lanes), size(State))}")
        if scenarios is None:
            self._leave(lanes)
        else:
            extra, start_of, radius_of = self._tabulated(scenarios, lanes)
            self._leave(lanes)
            # These tables come after the lanes' own, to which a lane returns at its next automatic reset.
            self._start_of[lanes], self._radius_of[lanes] = start_of + len(self._tables.schedules), radius_of
            self._tables = self._tables.followed_by(extra)
        for lane, seed in zip(lanes, seeds or (), strict=seeds is not None):
            if seed is not None:
                self.clock[CLOCK.key, lane] = key_of(seed).view(np.int64)
        with announced_compilation():
            prepare(self.count)
            return self._begin(lanes, initial)

    def restart(self, which: np.ndarray) -> np.ndarray:
        """Begin an episode in the lanes `which` (n,), each in its own scenario; return their results (WIDTH n,).

        Raises:
            IndexError: there is no such lane.
            ValueError: `which` is no row of whole numbers.
        """
        if which.dtype != np.int64 or which.ndim != 1:
            raise ValueError(f"lanes of {which.dtype} {which.shape}; needed: a row of whole numbers")
        self._start_of[which], self._radius_of[which] = self._own_start_of[which], self._own_radius_of[which]
        return self._begin(which)

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, int]:
        """The first arguments of `kernels.advance` and `kernels.advance_one`, with their shapes."""
        return self.values, self.clock, self._tables.table, self.period, self.substeps

    @property
    def longest_episode(self) -> int:
        """Control steps of the longest of the lanes' own schedules."""
        return max(schedule.steps for schedule in self._own.schedules)

    def close(self) -> None:
        """End the threads; a later step starts new ones."""
        self._workers.close()

    def _begin(self, which: np.ndarray, initial: np.ndarray | None = None) -> np.ndarray:
        self.drawn = self.drawn.copy()  # infos returned earlier keep the old array
        places = self._start_of[which], self._radius_of[which]
        results = self._begin_in(which, self._tables, places, (self.values, self.clock, self.drawn), initial)
        if self.randomisation.varies:
            self._drawn_info = by_quantity(self.drawn)
        return results

    def _begin_in(
        self,
        which: np.ndarray,
        tables: Tables,
        places: tuple[np.ndarray, np.ndarray],
        arrays: Iterable[np.ndarray],
        initial: np.ndarray | None = None,
    ) -> np.ndarray:
        """Begin episodes in these arrays, see `beginning.begin`; `places` are its `start_of` and `radius_of`."""
        results = np.empty(WIDTH * len(which))
        if initial is None:
            initial = np.full((len(which), size(State)), np.nan)
        arms, ends = (self._plants, self._plant_of), (tables.table, self.period, results)
        begin(which, *arms, tables.starts, *places, self._ranges, initial, *arrays, *ends)
        return results

    def step(self, action: np.ndarray) -> np.ndarray:
        """Hold torques for one control period and return the results (WIDTH count,), see `layout.split`.

        Args:
            action: (count, 2) [N m], an array that the caller does not reuse; clipped to the plants' limits.

        Raises:
            ValueError: a torque is not finite; no lane has moved then.
        """
        if action.shape != (self.count, JOINTS):
            raise ValueError(f"action has shape {action.shape}; needed: {(self.count, JOINTS)}")
        results = np.empty(WIDTH * self.count)
        arrays = self.arrays
        if self.threads == 1:
            bad = advance(*arrays, action, 0, self.count, results)
        else:
            bad = max(self._workers.run(lambda start, stop: advance(*arrays, action, start, stop, results)))
        if bad >= 0:
            limit = self.values[_TORQUE_LIMIT, bad].tolist()
            raise ValueError(f"action {action[bad].tolist()} N m of lane {bad} is not finite; allowed: ±{limit} N m")
        return results

    def step_or_restart(self, action: np.ndarray, over: np.ndarray) -> np.ndarray:
        """Do what `step` does, except in the lanes `over` (n,): there the next episode begins, whatever the action."""
        action[over] = 0.0
        # The kernel moves every lane, and a lane must be before its last row for that; here it moves in vain.
        ends = self.clock[CLOCK.row, over]
        self.clock[CLOCK.row, over] = self.clock[CLOCK.first, over]
        try:
            results = self.step(action)
        except ValueError:
            self.clock[CLOCK.row, over] = ends
            raise
        observation, vectors, scalars = split(results)
        observation[over], vectors[:, over], scalars[:, over] = split(self.restart(over))
        return results

    def observation(self) -> np.ndarray:
        """Return anew the observation (count, 10) that the last step or reset of each lane returned."""
        results = np.empty(WIDTH * self.count)
        observe_again(self.values, self.clock, self._tables.table, results)
        return split(results)[0]

    def randomisation_info(self) -> dict[str, np.ndarray]:
        """Return what the episodes drew, by quantity: (count, 2) for one value per joint, else (count,); read-only."""
        return self._drawn_info

    def schedule(self, lane: int) -> tuple[JointReference, Schedule]:
        """Return the reference and the tables of the episode that a lane is in."""
        place = int(self._start_of[lane])
        if self._tables.starts[place, START.family] > 0.0:
            place += int(self.drawn[-1, lane])
        return self._tables.references[place], self._tables.schedules[place]

    def get_state(self) -> dict[str, np.ndarray]:
        """Return copies of the complete simulation state as arrays by name, for `set_state`.

        Raises:
            ValueError: a lane is in a scenario that was given to `reset`, which only that call knows.
        """
        visiting = np.flatnonzero(self._start_of >= len(self._own.schedules))
        if len(visiting):
            raise ValueError(
                f"lane {visiting[0]} is in a scenario that reset options asked for, which is not part of the state; "
                "reset without options first"
            )
        return {
            "values": self.values.copy(),
            "clock": self.clock.copy(),
            "drawn": self.drawn.copy(),
            "made_of": self._digest(),
        }

    def set_state(self, state: dict[str, np.ndarray], over: np.ndarray | None = None) -> None:
        """Restore a state that `get_state` returned for these lanes or for lanes with the same configuration.

        Args:
            state: arrays by name.
            over: (n,) the lanes whose episode has ended, which `restart` must begin anew before a step moves them.

        Raises:
            TypeError: the state is no dictionary.
            ValueError: the state is of other plants, scenarios, randomisations, periods, or number of lanes; or an
                array is of another type or shape, or not such as an episode of these lanes has. Nothing has changed.
        """
        own = {"values": self.values, "clock": self.clock, "drawn": self.drawn, "made_of": self._digest()}
        made_of = checks.instance("state", state, dict).get("made_of")
        if not (isinstance(made_of, np.ndarray) and np.array_equal(made_of, own["made_of"])):
            raise ValueError(
                "the state is of lanes with other plants, scenarios, randomisation, periods or another number"
            )
        arrays = checked_arrays(state, own)
        check_contents(arrays, self._begun_with(arrays["clock"][CLOCK.key]), over)
        self._return_to_own()
        self.values, self.clock, self.drawn = arrays["values"], arrays["clock"], arrays["drawn"]
        if self.randomisation.varies:
            self._drawn_info = by_quantity(self.drawn)

    def _begun_with(self, keys: np.ndarray) -> dict[str, np.ndarray]:
        """Return ``values``, ``clock`` and ``drawn`` where the lanes' own episodes with these keys (count,) begin."""
        begun = {"values": self.values.copy(), "clock": self.clock.copy(), "drawn": self.drawn.copy()}
        begun["clock"][CLOCK.key] = key_before(keys.view(np.uint64)).view(np.int64)
        self._begin_in(np.arange(self.count), self._own, (self._own_start_of, self._own_radius_of), begun.values())
        return begun

    def _digest(self) -> np.ndarray:
        """Return the digest (32 bytes, uint8) of the configuration of the lanes."""
        own = self._own.starts, self._own.table, self._own_start_of, self._own_radius_of
        period = np.array([self.period, self.substeps, self.count], dtype=np.float64)
        return digest((self._plants, self._plant_of, self._ranges, *own, period))

    def _tabulated(self, scenarios: Sequence[Scenario], lanes: np.ndarray) -> tuple[Tables, np.ndarray, np.ndarray]:
        return tabulated(scenarios, self.parameters, self._plant_of[lanes], self.randomisation.references, self.period)

    def _leave(self, lanes: np.ndarray) -> None:
        """Put these lanes into their own scenarios, and drop the tables that no lane is in any longer."""
        if len(lanes) == self.count:
            self._return_to_own()
            return
        self._start_of[lanes], self._radius_of[lanes] = self._own_start_of[lanes], self._own_radius_of[lanes]
        visiting = np.flatnonzero(self._start_of >= len(self._own.schedules))
        own, places = len(self._own.firsts), self._start_of[visiting]
        self._tables, self._start_of[visiting], moved = self._tables.keeping(own, places)
        self.clock[[[CLOCK.row], [CLOCK.first], [CLOCK.last]], visiting] += moved

    def _return_to_own(self) -> None:
        """Put every lane into its own scenario."""
        self._tables = self._own
        self._start_of, self._radius_of = self._own_start_of.copy(), self._own_radius_of.copy()

    def __setstate__(self, state: dict[str, object]) -> None:
        """Take the state of a copy, which may be the first in its process."""
        self.__dict__.update(state)
        with announced_compilation():
            prepare(self.count)
