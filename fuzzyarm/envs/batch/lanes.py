"""Arms in the middle of their episodes, one per lane: the single and the batched environment are shells around this."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from fuzzyarm.envs.batch.kernels import KEY, LIMITS, ROWS, VECTORS, WIDTH, advance, advance_one, begin
from fuzzyarm.envs.batch.randomness import key_of
from fuzzyarm.envs.batch.schedule import COLUMNS, Schedule
from fuzzyarm.envs.batch.tables import Tables
from fuzzyarm.envs.physics.compiled import announced_compilation, direct
from fuzzyarm.envs.physics.dynamics import plant_of
from fuzzyarm.envs.physics.integrator import BLOCK
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, Draw
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.scenario import Scenario

MAX_ACCELERATION = 1e4  # rad/s², bound of the observation space for the reference's acceleration
LANES_PER_THREAD = 1024  # from about here on a thread is worth the handing over

Item = TypeVar("Item")


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
        # A float and nothing near it: the kernels are compiled for one signature, see `direct`.
        self.count, self.period, self.substeps, self.randomisation = (
            count,
            float(control_period),
            substeps,
            randomisation,
        )
        self.parameters, self._plant_of = distinct(plants, count)
        self._plants = np.array([np.hstack(plant_of(arm)) for arm in self.parameters])
        self._ranges = randomisation.ranges
        self._values = np.full((ROWS, count), np.nan)
        self._clock = np.zeros((4, count), dtype=np.int64)
        self._clock[KEY] = np.random.SeedSequence().generate_state(count, np.uint64).view(np.int64)
        self.drawn = np.empty((len(Draw._fields), count if randomisation.varies else 0))
        self._drawn_info: dict[str, np.ndarray] = {}
        self._own, self._own_start_of = self._tabulated(scenarios)
        self._tables, self._start_of = self._own, self._own_start_of
        self._bind()
        self.threads = threads or max(1, min(_cores(), count // LANES_PER_THREAD))
        self._pool: ThreadPoolExecutor | None = None
        self._pool_owner = 0

    def reset(
        self,
        seeds: Sequence[int | None] | None = None,
        scenarios: Sequence[Scenario] | None = None,
        initial: np.ndarray | None = None,
    ) -> np.ndarray:
        """Begin an episode in every lane and return the results (38 count,), see `lane_kernels.split`.

        Args:
            seeds: of each lane's random stream; None: it goes on.
            scenarios: what to do this time in place of the lanes' own scenarios; one for all lanes, or one per lane.
            initial: states (count, 8) to start from; None: at rest on the reference.

        Raises:
            ValueError: a reference does not fit the plant of its lane.
        """
        if scenarios is None:
            self._tables, self._start_of = self._own, self._own_start_of
        else:
            extra, start_of = self._tabulated(scenarios)
            # Below the lanes' own: lanes that begin anew by themselves are back at those.
            self._tables, self._start_of = self._own.followed_by(extra), start_of + len(self._own.schedules)
        self._bind()
        for lane, seed in enumerate(seeds or ()):
            if seed is not None:
                self._clock[KEY, lane] = key_of(seed).view(np.int64)
        return self._begin(np.arange(self.count), initial)

    def restart(self, which: np.ndarray) -> np.ndarray:
        """Begin an episode in the lanes `which` (n,), each in its own scenario; return their results (38 n,)."""
        self._start_of[which] = self._own_start_of[which]
        return self._begin(which)

    def close(self) -> None:
        """End the threads; a later step begins new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _begin(self, which: np.ndarray, initial: np.ndarray | None = None) -> np.ndarray:
        results = np.empty(WIDTH * len(which))
        if initial is None:
            initial = np.full((len(which), 8), np.nan)
        self.drawn = self.drawn.copy()  # infos given out before show the old one
        with announced_compilation():
            begin(
                which,
                self._plants,
                self._plant_of,
                self._tables.starts,
                self._start_of[which],
                self._ranges,
                initial,
                self._values,
                self._clock,
                self.drawn,
                self._tables.table,
                self.period,
                results,
            )
            self._compile()
        self._bind()
        if self.randomisation.varies:
            self._drawn_info = _described(self.drawn)
        return results

    def step(self, action: np.ndarray) -> np.ndarray:
        """Hold torques for one control period and return the results (38 count,), see `lane_kernels.split`.

        Args:
            action: (count, 2) [N m], an array of this call's own; clipped to the plants' limits.

        Raises:
            ValueError: a torque is not finite; no lane has moved then.
        """
        results = np.empty(WIDTH * self.count)
        if self.threads == 1:
            bad = self.advance(action, 0, self.count, results)
        else:
            share = -(-self.count // (self.threads * BLOCK)) * BLOCK  # whole blocks to each thread
            starts = range(0, self.count, share)
            parts = [
                self._workers().submit(self.advance, action, start, min(start + share, self.count), results)
                for start in starts
            ]
            bad = max(part.result() for part in parts)
        if bad >= 0:
            limit = self._values[LIMITS + 4 : LIMITS + 6, bad].tolist()
            raise ValueError(f"action {action[bad].tolist()} N m of lane {bad} is not finite; allowed: ±{limit} N m")
        return results

    def randomisation_info(self) -> dict[str, np.ndarray]:
        """Return what the episodes drew, by quantity: (count, 2) for one value per joint, else (count,); read-only."""
        return self._drawn_info

    def schedule(self, lane: int) -> tuple[JointReference, Schedule]:
        """Return the reference and the tables of the episode that a lane is in."""
        place = int(self._start_of[lane])
        if self._tables.starts[place, 6] > 0.0:
            place += int(self.drawn[-1, lane])
        return self._tables.references[place], self._tables.schedules[place]

    def get_state(self) -> dict[str, np.ndarray]:
        """Return copies of all that changes from step to step, as arrays by name, for `set_state`.

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
            "values": self._values.copy(),
            "clock": self._clock.copy(),
            "drawn": self.drawn.copy(),
            "made_of": self._digest(),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Go on where `get_state` was called, of these lanes or of others made of the same.

        Raises:
            ValueError: the state is of other plants, scenarios, randomisations, periods, or number of lanes.
        """
        if not np.array_equal(state["made_of"], self._digest()):
            raise ValueError(
                "the state is of lanes with other plants, scenarios, randomisation, periods or another number"
            )
        self._tables, self._start_of = self._own, self._own_start_of
        self._values, self._clock = state["values"].copy(), state["clock"].copy()
        self.drawn = state["drawn"].copy()
        if self.randomisation.varies:
            self._drawn_info = _described(self.drawn)
        self._bind()

    def _digest(self) -> np.ndarray:
        """Return 32 bytes (uint8) that tell lanes apart that are made differently."""
        parts = (self._plants, self._plant_of, self._ranges, self._own.starts, self._own.table, self._own_start_of)
        period = np.array([self.period, self.substeps, self.count], dtype=np.float64)
        content = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in (*parts, period)))
        return np.frombuffer(content.digest(), dtype=np.uint8)

    def _tabulated(self, scenarios: Sequence[Scenario]) -> tuple[Tables, np.ndarray]:
        """Return the tables of the scenarios, and the episode that each lane begins with."""
        kinds, scenario_of = distinct(scenarios, self.count)
        for number, (_, reference) in enumerate(kinds):
            for plant in np.unique(self._plant_of[scenario_of == number]):
                for member in self.randomisation.references if reference is None else (reference,):
                    check_reference(member, self.parameters[plant])
        tables = Tables.build(kinds, self.randomisation.references, self.period)
        return tables, tables.firsts[scenario_of]

    def _compile(self) -> None:
        """Have the step compiled now: no step has to wait for it, and it is for floats, whatever torques come first."""
        if (advance_one if self.count == 1 else advance).signatures:
            return
        anything = np.zeros((ROWS, 1)), np.zeros((4, 1), dtype=np.int64), np.zeros((2, COLUMNS))
        if self.count == 1:
            outcome = np.empty(10), np.empty((len(VECTORS), 2))
            advance_one(*anything, self.period, self.substeps, 0.0, 0.0, *outcome)
        else:
            advance(*anything, self.period, self.substeps, np.empty((0, 2)), 0, 0, np.empty(0))

    def _bind(self) -> None:
        """Make `advance(action, start, stop, results)` and `advance_one(torque1, torque2, observation, vectors)`."""
        own = self._values, self._clock, self._tables.table, self.period, self.substeps
        self.advance = functools.partial(direct(advance), *own)
        self.advance_one = functools.partial(direct(advance_one), *own)

    def _workers(self) -> ThreadPoolExecutor:
        # Threads do not survive a fork: a forked process makes its own.
        if self._pool is None or self._pool_owner != os.getpid():
            self._pool, self._pool_owner = ThreadPoolExecutor(self.threads), os.getpid()
        return self._pool

    def __getstate__(self) -> dict[str, object]:
        """Leave the threads behind when copied or pickled."""
        return {**self.__dict__, "_pool": None, "advance": None, "advance_one": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the state and bind anew."""
        self.__dict__.update(state)
        with announced_compilation():
            self._compile()
        self._bind()


def _described(drawn: np.ndarray) -> dict[str, np.ndarray]:
    """Return views of the draws (17, lanes) of all lanes by quantity."""
    row = Draw(*range(len(drawn)))
    described = {
        "mass": drawn[row.mass1 : row.mass2 + 1].T,
        "motor_inertia": drawn[row.motor_inertia1 : row.motor_inertia2 + 1].T,
        "stiffness": drawn[row.stiffness1 : row.stiffness2 + 1].T,
        "damping": drawn[row.damping1 : row.damping2 + 1].T,
        "dry_friction": drawn[row.dry_friction1 : row.dry_friction2 + 1].T,
        "viscous_friction": drawn[row.viscous_friction1 : row.viscous_friction2 + 1].T,
        "payload": drawn[row.payload],
        "force": drawn[row.force],
        "angle": drawn[row.angle1 : row.angle2 + 1].T,
        "reference": drawn[row.reference],
    }
    for array in described.values():
        array.flags.writeable = False  # every step's info shows the same arrays
    return described


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def distinct(items: Sequence[Item], count: int) -> tuple[list[Item], np.ndarray]:
    """Return the distinct items, by identity, and the place of each lane's among them; one item is for all lanes."""
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


def check_reference(reference: JointReference, parameters: ArmParameters) -> None:
    """Raise ValueError unless the plant can follow the reference, which was validated for its own arm."""
    if reference.parameters.length != parameters.length:
        raise ValueError(
            f"reference was made for links of {reference.parameters.length} m, the plant has "
            f"{parameters.length} m: build it with parameters=..."
        )
    motion = reference.sample(np.linspace(0.0, reference.duration, 501))
    for name, unit, values, limit in (
        ("angle", "rad", motion.q, parameters.joint_limit),
        ("velocity", "rad/s", motion.dq, parameters.velocity_limit),
        ("acceleration", "rad/s²", motion.ddq, (MAX_ACCELERATION, MAX_ACCELERATION)),
    ):
        peak = np.abs(values).max(axis=0)
        if np.any(peak > limit):
            raise ValueError(
                f"reference {name} reaches {peak.tolist()} {unit}; this plant allows {limit} {unit}: "
                "raise its duration or move its path"
            )
