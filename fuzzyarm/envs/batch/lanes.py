"""Batched simulation state behind both environments: one arm per lane, each in its own episode.

A saved state may come from a file, and kernels use its entries as indices; it is therefore checked.
"""

import hashlib
import operator
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.batch._kernels import kernels_of
from fuzzyarm.envs.batch.layout import CLOCK, START, Clock, ResultsMemory, StepRoom, by_rows, in_blocks
from fuzzyarm.envs.batch.randomness import key_before, key_of
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.batch.tables import Assignment, Tables, distinct, tabulated
from fuzzyarm.envs.batch.workers import Workers
from fuzzyarm.envs.physics.equations import AnyArm, common_equations
from fuzzyarm.envs.physics.records import flat, size
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, by_quantity, draw_record
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.numbers.machine import WIDE, Call

__all__ = ["Lanes", "checked_arrays"]

_SavedArrays = dict[str, np.ndarray]
"""Arrays of a state by name: ``values``, ``clock`` and ``drawn`` of the lanes, and ``made_of``; see `Lanes`."""


def checked_arrays(state: Any, like: _SavedArrays) -> _SavedArrays:
    """Return copies of the arrays named in `like`; types and shapes must be those in `like`, and floats finite."""
    checks.instance("state", state, dict)
    arrays: _SavedArrays = {}
    for name, own in like.items():
        given = state.get(name)
        if not isinstance(given, np.ndarray) or given.dtype != own.dtype or given.shape != own.shape:
            found = f"{given.dtype} of shape {given.shape}" if isinstance(given, np.ndarray) else checks.shown(given)
            raise ValueError(f"state[{name!r}] is {found}; it must be an array of {own.dtype} of shape {own.shape}")
        if given.dtype.kind == "f" and not np.isfinite(given).all():
            raise ValueError(f"state[{name!r}] contains numbers that are not finite")
        arrays[name] = np.array(given, order="C")
    return arrays


_Outcome: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Observations, vectors and scalars of lanes, see `Layout.split`."""

_ACTION = 2  # index of the action among the arguments of `Kernels.step`


class Lanes:
    """A batch of arms, each with its own plant, scenario and random stream.

    `plants` and `scenarios` have one entry for all lanes or one per lane; lanes with the same scenario share its table.
    The control period [s] has `substeps` sub-steps. A step uses `threads` threads; None: one per 1,024 lanes, at most
    one per core. ValueError if a reference does not fit the plant of its lane.
    """

    def __init__(
        self,
        plants: Sequence[AnyArm],
        scenarios: Sequence[Scenario],
        count: int,
        *,
        control_period: float,
        substeps: int,
        randomisation: DomainRandomisation,
        threads: int | None = None,
    ) -> None:
        self.period, self.substeps = float(control_period), substeps
        self._periods = np.array([control_period, control_period / substeps, substeps], dtype=np.float64)
        self.count, self.randomisation = count, randomisation
        self.parameters, self._plant_of = distinct(plants, count)
        self.physics = common_equations(self.parameters)
        self.kernels, self.action_shape = kernels_of(self.physics), (count, self.physics.joints)
        self.layout = self.kernels.layout
        self._plants = np.array([flat(self.physics.plant_of(arm)) for arm in self.parameters])
        self._ranges = randomisation.ranges(self.physics.joints)
        self.values = np.full((-(-count // WIDE), size(self.layout.Lane), WIDE), np.nan)
        self.clock = np.zeros((size(Clock), count), dtype=np.int64)
        self.clock[CLOCK.key] = np.random.SeedSequence().generate_state(count, np.uint64).view(np.int64)
        self.drawn = np.empty((size(draw_record(self.physics.joints)), count if randomisation.varies else 0))
        self._drawn_info: dict[str, np.ndarray] = {}
        self._assigned = Assignment(self._tabulated(scenarios, np.arange(count)))
        self._workers = Workers(count, threads)
        self.threads = self._workers.threads
        self._memory = ResultsMemory(self.layout.size(count))

    def reset(
        self,
        seeds: Sequence[int | None] | None = None,
        scenarios: Sequence[Scenario] | None = None,
        initial: np.ndarray | None = None,
        which: np.ndarray | None = None,
    ) -> _Outcome:
        """Begin an episode in n lanes and return their observations, vectors and scalars, see `Layout.split`.

        The lanes are `which` (n,), in ascending order, or all. A seed of None continues a lane's random stream.
        Scenarios, one for all or one for each of the n lanes, replace the lanes' own in this episode only. The initial
        states are (n, 4 × joints), by default at rest on the reference.
        """
        lanes = np.arange(self.count) if which is None else which
        others = None if scenarios is None else self._tabulated(scenarios, lanes)
        self._assigned.leave(lanes, self.clock)
        if others is not None:
            self._assigned.visit(lanes, others)  # a lane returns to its own scenario at its next automatic reset
        for lane, seed in zip(lanes, seeds or (), strict=seeds is not None):
            if seed is not None:
                self.clock[CLOCK.key, lane] = key_of(seed).view(np.int64)
        self.kernels.prepare(self.count)
        return self._begin(lanes, initial)

    def restart(self, which: np.ndarray) -> _Outcome:
        """Begin an episode in the lanes `which` (n,), each in its own scenario; return the same as `reset`."""
        self._assigned.back(which)
        return self._begin(which)

    def bound(self, action: np.ndarray, out: np.ndarray) -> Call:
        """Return a call that steps all lanes under torques (lanes, joints) [N m], filling `out`; see `Layout.split`."""
        arrays = self.values, self.clock.view(np.float64), action, *self.layout.arrays(out, self.count)
        return self.kernels.step.bound(arrays, self._periods, (self._assigned.tables.table,))

    @property
    def table(self) -> np.ndarray:
        """The stacked schedules (rows, entries of a row) of all episodes."""
        return self._assigned.tables.table

    def numbers(self, rows: slice) -> np.ndarray:
        """Return a copy of these rows (rows, lanes) of the lanes' data, see `Layout.Lane`."""
        return by_rows(self.values[:, rows], self.count)

    def torque_limit(self, lane: int) -> list[float]:
        """Return the torque limits (joints,) [N m] of the motors in a lane; its episode must have begun."""
        return [float(self.values[lane // WIDE, row, lane % WIDE]) for row in self.layout.LANE.limits.torque]

    @property
    def longest_episode(self) -> int:
        """The number of control steps in the longest of the lanes' own schedules."""
        return max(episode.schedule.steps for episode in self._assigned.own.episodes)

    def close(self) -> None:
        """End the threads; a later step starts new ones."""
        self._workers.close()

    def _begin(self, which: np.ndarray, initial: np.ndarray | None = None) -> _Outcome:
        self.drawn = self.drawn.copy()  # infos returned earlier keep the old array
        places, arrays = self._assigned.places(which), (self.values, self.clock, self.drawn)
        results = self._begin_in(which, self._assigned.tables, places, arrays, initial)
        if self.randomisation.varies:
            self._drawn_info = by_quantity(self.drawn, self.physics.joints)
        return results

    def _begin_in(
        self,
        which: np.ndarray,
        tables: Tables,
        places: tuple[np.ndarray, np.ndarray],
        arrays: tuple[np.ndarray, np.ndarray, np.ndarray],
        initial: np.ndarray | None = None,
    ) -> _Outcome:
        """Begin episodes in lanes `which` (n,) at `Assignment.places` in `tables`; return the same as `reset`.

        `arrays` are (values, clock, draws) of all lanes, changed in place; `initial` is as for `reset`.
        """
        count, all_values, clock, drawn = len(which), *arrays
        results, given = np.empty(self.layout.size(count)), np.stack([self._plant_of[which], *places], axis=1) + 0.0
        initial = (
            np.full((count, size(self.physics.State)), np.nan) if initial is None else np.array(initial, order="C")
        )
        values = np.empty((-(-count // WIDE), *all_values.shape[1:]))
        clocks, draws = np.ascontiguousarray(clock[:, which]), np.empty((len(drawn), count))
        begun = values, clocks.view(np.float64), draws, given, initial, *self.layout.arrays(results, count)
        self.kernels.begin(
            begun, np.ascontiguousarray(self._ranges).ravel(), (self._plants, tables.starts, tables.table)
        )
        all_values[which // WIDE, :, which % WIDE] = values.swapaxes(1, 2).reshape(-1, values.shape[1])[:count]
        clock[:, which] = clocks
        if drawn.shape[1]:
            drawn[:, which] = draws
        return self.layout.split(results, count)

    def step(self, action: np.ndarray) -> _Outcome:
        """Hold torques for one control period and return observations, vectors and scalars, see `Layout.split`.

        The action (count, joints) [N m] is clipped to the plants' limits; the caller must not reuse this array.
        ValueError for a torque that is not finite; then no lane has moved.
        """
        if action.shape != self.action_shape:
            raise ValueError(f"action has shape {action.shape}; needed: {self.action_shape}")
        action = np.ascontiguousarray(action, dtype=np.float64)
        if not np.isfinite(action).all():
            bad = int(np.argmin(np.isfinite(action).all(axis=1)))
            found, limit = action[bad].tolist(), self.torque_limit(bad)
            raise ValueError(
                f"environment {bad}: action = {found} N m is not finite; give finite torques (clipped to ±{limit} N m)"
            )
        room = self._memory.room()
        self._workers.run(self._step_in(room, action))
        return self.layout.split(room.array(), self.count)

    def _step_in(self, room: StepRoom, action: np.ndarray) -> Call:
        """Return the kernel call that steps all lanes and writes their results into `room`."""
        lasting, kept = (self.values, self.clock, self.table), room.kept
        if kept is None or not all(map(operator.is_, lasting, kept[1:])):
            kept = room.kept = self.bound(action, room.array()), *lasting
            kept[0].release()  # otherwise the room would never be free
        call: Call = kept[0]
        call.on(_ACTION, action)
        return call

    def step_or_restart(self, action: np.ndarray, over: np.ndarray) -> _Outcome:
        """Step like `step`, but begin the next episode in lanes with the indices `over` (n,), whatever their action."""
        action[over] = 0.0
        # The kernel steps every lane, and no lane may be in its last row; `restart` then overwrites this step.
        ends = self.clock[CLOCK.row, over]
        self.clock[CLOCK.row, over] = self.clock[CLOCK.first, over]
        try:
            observation, vectors, scalars = self.step(action)
        except ValueError:
            self.clock[CLOCK.row, over] = ends
            raise
        observation[over], vectors[:, over], scalars[:, over] = self.restart(over)
        return observation, vectors, scalars

    def observation(self) -> np.ndarray:
        """Return the current observations (count, 5 joints) of all lanes, without a step."""
        seen = np.empty((self.count, self.layout.observed))
        self.kernels.observe((self.values, self.clock.view(np.float64), seen), np.empty(0), (self.table,))
        return seen

    def randomisation_info(self) -> dict[str, np.ndarray]:
        """Return the latest draws by quantity, read-only: (lanes, joints) if one per joint, else (lanes,)."""
        return self._drawn_info

    def schedule(self, lane: int) -> tuple[Reference, Schedule]:
        """Return the reference and the schedule of the current episode of a lane."""
        tables, (starts, _) = self._assigned.tables, self._assigned.places(np.array([lane]))
        place = int(starts[0])
        if tables.starts[place, START.family] > 0.0:
            place += int(self.drawn[-1, lane])
        return tables.episodes[place][:2]

    def get_state(self) -> dict[str, np.ndarray]:
        """Return copies of the complete simulation state as arrays by name, for `set_state`."""
        visiting = self._assigned.visiting()
        if len(visiting):
            raise ValueError(
                f"environment {visiting[0]} runs a scenario from reset options, and a state does not contain "
                "scenarios; reset this environment without options before get_state"
            )
        return {
            "values": by_rows(self.values, self.count),
            "clock": self.clock.copy(),
            "drawn": self.drawn.copy(),
            "made_of": self._digest(),
        }

    def set_state(self, state: dict[str, np.ndarray], over: np.ndarray | None = None) -> None:
        """Restore a state that `get_state` returned for lanes with the same configuration.

        The episodes of the lanes `over` (n,) have ended: call `restart` for them before a step. ValueError, with
        nothing changed, if the state belongs to another configuration or is impossible for these lanes.
        """
        values = by_rows(self.values, self.count)
        own = {"values": values, "clock": self.clock, "drawn": self.drawn, "made_of": self._digest()}
        made_of = checks.instance("state", state, dict).get("made_of")
        if not (isinstance(made_of, np.ndarray) and np.array_equal(made_of, own["made_of"])):
            raise ValueError(
                "the state belongs to environments with other plants, scenarios, randomisation or control periods, or "
                "to another number of them; make them with the same arguments as for the saved state"
            )
        arrays = checked_arrays(state, own)
        self._check_contents(arrays, over)
        self._assigned.all_return()
        self.values, self.clock, self.drawn = in_blocks(arrays["values"]), arrays["clock"], arrays["drawn"]
        if self.randomisation.varies:
            self._drawn_info = by_quantity(self.drawn, self.physics.joints)

    def _check_contents(self, arrays: _SavedArrays, over: np.ndarray | None) -> None:
        """Raise ValueError unless the lanes can reach the state `arrays`.

        Only episodes in the lanes with the indices `over` (n,) may have ended; None: no lanes. Everything except the
        arm's state and the current instant is determined by the key of the episode.
        """
        clock, begun = arrays["clock"], (self.values.copy(), self.clock.copy(), self.drawn.copy())
        values, expected, drawn = begun
        expected[CLOCK.key] = key_before(clock[CLOCK.key].view(np.uint64)).view(np.int64)
        self._begin_in(np.arange(self.count), self._assigned.own, self._assigned.own_places, begun)
        row, first, last = clock[CLOCK.row], clock[CLOCK.first], clock[CLOCK.last]
        latest = last - 1
        if over is not None:
            latest[over] += 1
        wrong = (first != expected[CLOCK.first]) | (last != expected[CLOCK.last]) | (row < first) | (row > latest)
        if wrong.any():
            lane = int(np.argmax(wrong))
            begins, ends = expected[CLOCK.first, lane], expected[CLOCK.last, lane]
            raise ValueError(
                f"state['clock'] is impossible: environment {lane} is at row {row[lane]} of the time table, in an "
                f"episode from row {first[lane]} to row {last[lane]}; allowed: row {begins} to {latest[lane]}, in an "
                f"episode from row {begins} to row {ends}. Pass a state from get_state unchanged"
            )
        if not np.array_equal(arrays["drawn"], drawn):
            raise ValueError(
                "state['drawn'] does not match the random keys in state['clock']; pass a state from get_state unchanged"
            )
        changing = size(self.physics.State)
        if not np.array_equal(arrays["values"][changing:], by_rows(values, self.count)[changing:]):
            raise ValueError(
                "state['values'] does not match the random keys in state['clock']; pass a state from get_state "
                "unchanged"
            )

    def _digest(self) -> np.ndarray:
        """Return the digest (32 bytes, uint8) of the configuration of the lanes."""
        own = self._assigned.own.starts, self._assigned.own.table, *self._assigned.own_places
        period = np.array([self.period, self.substeps, self.count], dtype=np.float64)
        equations = np.frombuffer(self.physics.digest.encode(), dtype=np.uint8)
        parts = equations, self._plants, self._plant_of.astype(np.int64), self._ranges, *own, period
        content = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts))
        return np.frombuffer(content.digest(), dtype=np.uint8)

    def _tabulated(self, scenarios: Sequence[Scenario], lanes: np.ndarray) -> tuple[Tables, np.ndarray, np.ndarray]:
        return tabulated(scenarios, self.parameters, self._plant_of[lanes], self.randomisation.references, self.period)

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore a copy or pickle; compile the kernels if this process has not compiled them yet."""
        self.__dict__.update(state)
        self.kernels.prepare(self.count)
