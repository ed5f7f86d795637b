"""The plants of a sweep by number: their parameters, and the environment for some plants in some cases.

Plant i is a function of the configuration and of i alone. The environment draws its domain randomisation from its own
stream for seed + i; noise and delay come from another stream of the same seed. So a plant is the same whatever chunk
it is in, whichever worker runs it, under every policy and in every case: comparisons are paired.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.randomness import uniform
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import Disturbance, TipForce
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.quantities import NOISE, QUANTITIES, columns_of, plant_record
from fuzzyarm.fuzzy_policy.known_arm import with_drives, with_mass

__all__ = ["CONTROL_PERIOD", "Plants"]

CONTROL_PERIOD = 1e-3  # s
_EXTRAS = 1  # names the stream of noise and delay among those of a plant's seed
_NOISE_WORD, _DELAY_WORD = np.zeros(1, np.uint64), np.ones(1, np.uint64)  # their places in that stream

Values = Mapping[str, float]
"""Values that the grid sets for one plant, by quantity; the others are drawn."""


@dataclasses.dataclass(frozen=True)
class Plants:
    """Some plants of a sweep.

    Attributes:
        config: the sweep.
        members: (n,) their numbers in it.
        values: (n,) what they are made of, records of `quantities.plant_record`; read-only.
    """

    config: SweepConfig
    members: Sequence[int]
    values: np.ndarray

    @classmethod
    def draw(cls, config: SweepConfig, members: Sequence[int]) -> Plants:
        """Return the plants with these numbers."""
        seeds = [config.seed + member for member in members]
        # This environment only draws, so that the values are known before any episode is run.
        drawing = FuzzyArmVectorEnv(
            len(seeds),
            **_arm_argument(config.arm),
            reference=default_reference(config.arm),
            randomisation=config.drawn().randomisation(),
            threads=1,
        )
        drawn = drawing.reset(seed=seeds)[1].get("randomisation", {})
        plants = cls(config, members, np.empty(len(seeds), dtype=plant_record(config.joints)))
        extras, cells = plants._draw_extras(), plants._cells()
        for name, column in columns_of(config.joints).items():
            if column.quantity in drawn:
                values = drawn[column.quantity]
                plants.values[name] = values if column.joint is None else values[:, column.joint]
            else:
                plants.values[name] = extras.get(name, QUANTITIES[column.quantity].nominal)
            if column.quantity in cells:
                plants.values[name] = cells[column.quantity]
        plants.values.flags.writeable = False
        return plants

    @property
    def seeds(self) -> list[int]:
        """Seed of each plant, in the environment too."""
        return [self.config.seed + member for member in self.members]

    def environment(self, cases: Sequence[str]) -> FuzzyArmVectorEnv:
        """Return the environment of these plants in these cases: plant i in case c is lane c n + i.

        What the grid sets is in each lane's own arm and disturbance; `begin` draws the rest.
        """
        cells = self._cells()
        noisy = bool(self.config.drawn().noise[1] > 0.0 or "noise" in cells)
        # Lanes with equal arms or loads share the object: the environment prepares each object once.
        arms: dict[tuple[float, ...], AnyArm] = {}
        loads: dict[tuple[str, float, float], Disturbance] = {}
        lane_arms, lane_loads = [], []
        for case in cases:
            for i in range(len(self.members)):
                values = {name: float(column[i]) for name, column in cells.items()}
                factors = tuple(values.get(name, 1.0) for name, quantity in QUANTITIES.items() if quantity.per_joint)
                if factors not in arms:
                    arms[factors] = _varied(self.config.arm, values)
                load = case, values.get("payload", 0.0), values.get("force", 1.0)
                if load not in loads:
                    loads[load] = _disturbance(self.config.arm, *load, noisy)
                lane_arms.append(arms[factors])
                lane_loads.append(loads[load])
        return FuzzyArmVectorEnv(
            len(lane_arms),
            disturbance=lane_loads,
            **_arm_argument(lane_arms),
            reference=default_reference(self.config.arm),
            control_period=CONTROL_PERIOD,
            substep=CONTROL_PERIOD / default_substeps(CONTROL_PERIOD, self._fastest_rate()),
            randomisation=self.config.drawn().randomisation(),
            threads=1,
        )

    def begin(self, envs: FuzzyArmVectorEnv) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Begin the plants' episodes in their `environment`; every arm starts where the nominal one does."""
        nominal = FuzzyArmVectorEnv(
            1,
            **_arm_argument(self.config.arm),
            reference=default_reference(self.config.arm),
            threads=1,
        )
        _, at_rest = nominal.reset(seed=0)
        start = np.concatenate([at_rest[name][0] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
        cases = envs.num_envs // len(self.members)
        return envs.reset(seed=self.seeds * cases, options={"initial_state": start})

    def _fastest_rate(self) -> float:
        """Return the rate [rad/s] of the fastest plant that the whole sweep may have: chunks have one sub-step."""
        grid = {axis.quantity: (axis.low, axis.high) for axis in self.config.grid}
        return fastest_rate([self.config.arm], dataclasses.replace(self.config.drawn(), **grid).randomisation())

    def _draw_extras(self) -> dict[str, np.ndarray]:
        """Return noise (n,), uniform, and delay (n,), uniform among whole numbers of periods."""
        ranges = self.config.drawn()
        keys = np.concatenate(
            [np.random.SeedSequence((seed, _EXTRAS)).generate_state(1, np.uint64) for seed in self.seeds]
        )
        (low, high), (first, last) = ranges.noise, ranges.delay
        return {
            "noise": low + (high - low) * uniform(keys, _NOISE_WORD),
            "delay": first + np.floor((last - first + 1.0) * uniform(keys, _DELAY_WORD)),
        }

    def _cells(self) -> dict[str, np.ndarray]:
        """Return what the grid sets, by quantity (n,); the second axis varies fastest."""
        if not self.config.grid:
            return {}
        first, second = self.config.grid
        cell = np.asarray(self.members) // self.config.plants
        return {
            first.quantity: first.values[cell // second.number],
            second.quantity: second.values[cell % second.number],
        }


@dataclasses.dataclass(frozen=True)
class ScaledForce:
    """A tip force times a factor.

    Attributes:
        force: the tip force.
        factor: what it is multiplied by.
    """

    force: TipForce
    factor: float

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force [N] at times (...) [s], of the shape (..., 2 or 3) of reference tip velocities [m/s]."""
        return self.factor * self.force.at(time, tip_velocity)


def _arm_argument(arms: AnyArm | list[AnyArm]) -> dict[str, Any]:
    """Return the argument of an environment for an arm, or for one of each lane."""
    first = arms[0] if isinstance(arms, list) else arms
    return {"robot" if isinstance(first, Robot) else "parameters": arms}


def _varied(arm: AnyArm, factors: Values) -> AnyArm:
    """Return an arm times the factors; a quantity without one stays as it is."""
    of_field = {field: factor for name, factor in factors.items() for field in QUANTITIES[name].arm_fields}
    if isinstance(arm, ArmParameters):
        changed = {
            field: tuple(factor * number for number in getattr(arm, field)) for field, factor in of_field.items()
        }
        return dataclasses.replace(arm, **changed)  # type: ignore[arg-type]
    drives = {name: factor for name, factor in of_field.items() if name not in ("mass", "inertia")}
    heavier = with_mass(arm, of_field.get("mass", 1.0))
    return with_drives(heavier, **{name: factor * arm.drive(name) for name, factor in drives.items()})


def _disturbance(arm: AnyArm, case: str, payload: float, force: float, noisy: bool) -> Disturbance:
    """Return what acts on the arm in a case with `payload` [kg] more at the tip and `force` times the tip force."""
    own = case_for(case, arm).disturbance
    tip_force = own.tip_force if own.tip_force is None or force == 1.0 else ScaledForce(own.tip_force, force)
    # A payload of the case itself stays where the case puts it, and what is added joins it there.
    place = own.payload.at if own.payload.mass > 0.0 else "tip"
    load = own.payload if payload == 0.0 else Payload(own.payload.mass + payload, place)
    return dataclasses.replace(own, tip_force=tip_force, payload=load, encoder_noise=NOISE if noisy else None)
