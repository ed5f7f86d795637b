"""The plants of a sweep by number: their numbers, and the environment for some plants in some cases.

Plant i is a function of the configuration and of i alone. The environment draws its domain randomisation from its own
stream for seed + i; noise and delay come from another stream of the same seed. So a plant is the same whatever chunk
it is in, whichever worker runs it, under every policy and in every case: comparisons are paired.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fuzzyarm.envs.batch.randomness import uniform
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import Disturbance, TipForce
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.distributions import NOISE, QUANTITIES, Distribution, columns_of, plant_record
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, with_drives, with_mass

__all__ = ["CONTROL_PERIOD", "Plants"]

CONTROL_PERIOD = 1e-3  # s
_EXTRAS = 1  # names the stream of noise and delay, at places 0 and 1, among those of a plant's seed


@dataclasses.dataclass(frozen=True)
class Plants:
    """Some plants of a sweep."""

    config: SweepConfig
    members: Sequence[int]  # (n,) their numbers in the sweep
    values: np.ndarray  # (n,) records of `distributions.plant_record`; read-only

    @classmethod
    def draw(cls, config: SweepConfig, members: Sequence[int]) -> Plants:
        """Return the plants with these numbers."""
        plants = cls(config, members, np.empty(len(members), dtype=plant_record(config.joints)))
        # This environment only draws, so that the values are known before any episode is run.
        reference, ranges = default_reference(config.arm), config.drawn()
        drawing = FuzzyArmVectorEnv(
            len(members), **_arm_argument(config.arm), reference=reference, randomisation=ranges, threads=1
        )
        drawn = drawing.reset(seed=plants.seeds)[1].get("randomisation", {})
        found = drawn | plants._extras(ranges) | plants._cells()
        for name, (quantity, joint) in columns_of(config.joints).items():
            values = found.get(quantity, np.array(getattr(Distribution, quantity)[0]))
            plants.values[name] = values if joint is None or values.ndim < 2 else values[:, joint]
        plants.values.flags.writeable = False
        return plants

    @property
    def seeds(self) -> list[int]:
        """Seed of each plant, in the environment too."""
        return [self.config.seed + member for member in self.members]

    def environment(self, cases: Sequence[str]) -> FuzzyArmVectorEnv:
        """Return the environment of these plants in these cases: plant i in case c is lane c n + i.

        What the grid sets is in each lane's own arm and disturbance; `begin` draws the rest. All chunks of a sweep have
        the sub-step of its fastest plant.
        """
        config, cells = self.config, self._cells()
        drawn, arm = config.drawn(), config.arm
        noisy = drawn.noise[1] > 0.0 or "noise" in cells
        factors = [name for name in cells if QUANTITIES[name].arm_fields]
        ones = np.ones(len(self.members))
        columns = [cells.get("payload", 0.0 * ones), cells.get("force", ones)]
        # Lanes with equal arms or loads share the object: the environment prepares each object once.
        varied = functools.cache(lambda *values: _varied(arm, dict(zip(factors, values, strict=True))))
        loaded = functools.cache(lambda case, payload, force: _disturbance(arm, case, payload, force, noisy))
        rows = list(zip(*(cells[name].tolist() for name in factors), strict=True)) or [()] * len(self.members)
        lane_arms = [varied(*row) for row in rows] * len(cases)
        lane_loads = [loaded(case, *load) for case in cases for load in zip(*np.array(columns).tolist(), strict=True)]
        set_by_grid: dict[str, Any] = {axis.quantity: (axis.low, axis.high) for axis in config.grid}
        widest = dataclasses.replace(drawn, **set_by_grid)
        return FuzzyArmVectorEnv(
            len(lane_arms),
            disturbance=lane_loads,
            **_arm_argument(lane_arms),
            reference=default_reference(arm),
            control_period=CONTROL_PERIOD,
            substep=CONTROL_PERIOD / default_substeps(CONTROL_PERIOD, fastest_rate([arm], widest)),
            randomisation=drawn,
            threads=1,
        )

    def begin(self, envs: FuzzyArmVectorEnv) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Begin the episodes and return observations (lanes, 5 n) and info; arms start where the nominal one does."""
        arm = self.config.arm
        nominal = FuzzyArmVectorEnv(1, **_arm_argument(arm), reference=default_reference(arm), threads=1)
        _, at_rest = nominal.reset(seed=0)
        start = np.concatenate([at_rest[name][0] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
        cases = envs.num_envs // len(self.members)
        return envs.reset(seed=self.seeds * cases, options={"initial_state": start})

    def _extras(self, ranges: Distribution) -> dict[str, np.ndarray]:
        """Return noise (n,), uniform, and delay (n,), uniform among whole numbers of periods."""
        keys = np.concatenate(
            [np.random.SeedSequence((seed, _EXTRAS)).generate_state(1, np.uint64) for seed in self.seeds]
        )
        (low, high), (first, last) = ranges.noise, ranges.delay
        noise, delay = (uniform(keys, np.array([place], np.uint64)) for place in (0, 1))
        return {"noise": low + (high - low) * noise, "delay": first + np.floor((last - first + 1.0) * delay)}

    def _cells(self) -> dict[str, np.ndarray]:
        """Return what the grid sets, by quantity (n,); the second axis varies fastest."""
        cell, found = np.asarray(self.members) // self.config.plants, {}
        for axis in reversed(self.config.grid):
            found[axis.quantity] = axis.values[cell % axis.number]
            cell = cell // axis.number
        return found


@dataclasses.dataclass(frozen=True)
class _ScaledForce:
    """A tip force times a factor."""

    force: TipForce
    factor: float

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force [N] at times (...) [s], of the shape (..., 2 or 3) of reference tip velocities [m/s]."""
        return self.factor * self.force.at(time, tip_velocity)


def _arm_argument(arms: AnyArm | list[AnyArm]) -> dict[str, Any]:
    """Return the argument of an environment for an arm, or for one of each lane."""
    first = arms[0] if isinstance(arms, list) else arms
    return {"robot" if isinstance(first, Robot) else "parameters": arms}


def _varied(arm: AnyArm, factors: Mapping[str, float]) -> AnyArm:
    """Return an arm times the factors; a quantity without one stays as it is."""
    of_field = {field: factor for name, factor in factors.items() for field in QUANTITIES[name].arm_fields}
    if isinstance(arm, Robot) and "mass" in of_field:
        arm = with_mass(arm, of_field.pop("mass"))
        del of_field["inertia"]
    return with_drives(arm, **{field: factor * per_joint_of(arm, field) for field, factor in of_field.items()})


def _disturbance(arm: AnyArm, case: str, payload: float, force: float, noisy: bool) -> Disturbance:
    """Return what acts on the arm in a case with `payload` [kg] more at the tip and `force` times the tip force."""
    own = case_for(case, arm).disturbance
    tip_force = own.tip_force if own.tip_force is None or force == 1.0 else _ScaledForce(own.tip_force, force)
    # A payload of the case itself stays where the case puts it, and what is added joins it there.
    place = own.payload.at if own.payload.mass > 0.0 else "tip"
    load = own.payload if payload == 0.0 else Payload(own.payload.mass + payload, place)
    return dataclasses.replace(own, tip_force=tip_force, payload=load, encoder_noise=NOISE if noisy else None)
