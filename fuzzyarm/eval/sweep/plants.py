"""The plants of a sweep, by number: what each is made of, and the environment that holds some of them in some cases.

Plant i is a function of the configuration and of i alone. What its distribution leaves to chance, the environment
draws from its own stream for seed + i, and noise and delay follow from another stream of the same seed. So a plant is
the same whatever chunk it is in, whoever runs it, under every policy and in every case: comparisons are paired.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.randomness import uniform
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.disturbances import Disturbance, TipForce
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.sweep.config import COLUMNS, NOISE, QUANTITIES, SweepConfig, quantity_of

CONTROL_PERIOD = 1e-3  # s
FIELDS = {
    "mass": ("mass", "inertia"),
    "motor_inertia": ("motor_inertia",),
    "stiffness": ("stiffness",),
    "damping": ("damping",),
    "dry_friction": ("static_friction", "coulomb_friction"),
    "viscous_friction": ("viscous_friction",),
}
"""Fields of `ArmParameters` that a quantity is a factor of, as in `randomisation.varied`."""
EXTRAS = 1  # names the stream of noise and delay among those of a plant's seed


@dataclasses.dataclass(frozen=True)
class Plants:
    """Some plants of a sweep.

    Attributes:
        config: the sweep.
        members: (n,) their numbers in it.
        values: (n, 16) what they are made of, by `COLUMNS`.
    """

    config: SweepConfig
    members: Sequence[int]
    values: np.ndarray

    @classmethod
    def draw(cls, config: SweepConfig, members: Sequence[int]) -> Plants:
        """Return the plants with these numbers."""
        seeds = [config.seed + member for member in members]
        # The environment draws; asked for here, so that what it draws is known before anything runs.
        drawn = FuzzyArmVectorEnv(len(seeds), randomisation=config.drawn().randomisation(), threads=1).reset(
            seed=seeds
        )[1]
        randomisation = drawn.get("randomisation", {})
        columns = [_column(randomisation, column, len(seeds)) for column in COLUMNS]
        plants = cls(config, members, np.stack(columns, axis=1))
        plants._draw_extras(seeds)
        for axis, values in plants._cells().items():
            plants.values[:, [quantity_of(column) == axis for column in COLUMNS]] = values[:, np.newaxis]
        plants.values.flags.writeable = False
        return plants

    @property
    def seeds(self) -> list[int]:
        """Seed of each plant, in the environment too."""
        return [self.config.seed + member for member in self.members]

    def column(self, name: str) -> np.ndarray:
        """Return one of `COLUMNS` (n,)."""
        values: np.ndarray = self.values[:, COLUMNS.index(name)]
        return values

    def environment(self, cases: Sequence[str]) -> FuzzyArmVectorEnv:
        """Return the environment of these plants in these cases: plant i in case c is lane c n + i.

        What the grid sets is in each lane's own arm and disturbance; the rest is drawn by `begin`.
        """
        arms: dict[tuple[float, ...], ArmParameters] = {}
        tasks: dict[tuple[str, float, float], Disturbance] = {}
        cells = self._cells()
        grid = np.stack([*cells.values(), np.zeros(len(self.members))], axis=1)
        noisy = bool(self.config.drawn().noise[1] > 0.0 or "noise" in cells)
        lane_arms, lane_tasks = [], []
        for case in cases:
            for row in map(dict, (zip(cells, values, strict=False) for values in grid.tolist())):
                factors = tuple(row.get(name, 1.0) for name in FIELDS)
                load = case, row.get("payload", 0.0), row.get("force", 1.0)
                arms[factors] = arms.get(factors) or _arm(factors)
                tasks[load] = tasks.get(load) or _disturbance(*load, noisy)
                lane_arms.append(arms[factors])
                lane_tasks.append(tasks[load])
        return FuzzyArmVectorEnv(
            len(lane_arms),
            disturbance=lane_tasks,
            parameters=lane_arms,
            reference=JointReference(),
            control_period=CONTROL_PERIOD,
            randomisation=self.config.drawn().randomisation(),
            threads=1,
        )

    def begin(self, envs: FuzzyArmVectorEnv) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Begin the plants' episodes in their `environment`; every arm starts where the nominal one does."""
        _, at_rest = FuzzyArmVectorEnv(1, threads=1).reset(seed=0)
        start = np.concatenate([at_rest[name][0] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
        cases = envs.num_envs // len(self.members)
        return envs.reset(seed=self.seeds * cases, options={"initial_state": start})

    def _draw_extras(self, seeds: Sequence[int]) -> None:
        """Fill the columns of noise, uniform, and delay, uniform among whole numbers of periods."""
        ranges = self.config.drawn()
        keys = np.concatenate([np.random.SeedSequence((seed, EXTRAS)).generate_state(1, np.uint64) for seed in seeds])
        (low, high), (first, last) = ranges.noise, ranges.delay
        self.values[:, COLUMNS.index("noise")] = low + (high - low) * uniform(keys, np.zeros(1, np.uint64))
        self.values[:, COLUMNS.index("delay")] = first + np.floor(
            (last - first + 1.0) * uniform(keys, np.ones(1, np.uint64))
        )

    def _cells(self) -> dict[str, np.ndarray]:
        """Return what the grid sets, by quantity (n,): the second axis changes first, then the first."""
        if not self.config.grid:
            return {}
        first, second = self.config.grid
        cell = np.asarray(self.members) // self.config.plants
        return {first.name: first.values[cell // second.number], second.name: second.values[cell % second.number]}


@dataclasses.dataclass(frozen=True)
class ScaledForce:
    """A tip force times a factor."""

    force: TipForce
    factor: float

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) [N] at times (...) [s] for reference tip velocities (..., 2) [m/s]."""
        return self.factor * self.force.at(time, tip_velocity)


def _column(randomisation: dict[str, np.ndarray], column: str, count: int) -> np.ndarray:
    """Return what the environment drew (count,), or the nominal value where it drew nothing."""
    name = quantity_of(column)
    if name not in randomisation:
        return np.full(count, QUANTITIES[name].nominal)
    drawn = randomisation[name]
    return drawn[:, int(column[-1]) - 1] if QUANTITIES[name].per_joint else drawn


def _arm(factors: tuple[float, ...]) -> ArmParameters:
    nominal = ArmParameters()
    changed: dict[str, Any] = {
        field: tuple(factor * number for number in getattr(nominal, field))
        for fields, factor in zip(FIELDS.values(), factors, strict=True)
        for field in fields
    }
    return dataclasses.replace(nominal, **changed)


def _disturbance(case: str, payload: float, force: float, noisy: bool) -> Disturbance:
    own = CASES[case].disturbance
    tip_force = own.tip_force if own.tip_force is None or force == 1.0 else ScaledForce(own.tip_force, force)
    load = own.payload if payload == 0.0 else Payload(own.payload.mass + payload)  # the cases' are at the tip too
    return dataclasses.replace(own, tip_force=tip_force, payload=load, encoder_noise=NOISE if noisy else None)
