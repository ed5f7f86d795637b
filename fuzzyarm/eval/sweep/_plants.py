"""The plants of a sweep: their parameters, and the environment in which some of them run.

Plant i depends on the configuration and on i alone, not on its chunk, worker, policy or case: comparisons are paired.
"""

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
from fuzzyarm.eval.episodes._closed_loops import Channel
from fuzzyarm.eval.sweep._distributions import NOISE, QUANTITIES, Distribution, columns_of, plant_record
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of, with_drives, with_mass

__all__ = ["CONTROL_PERIOD", "Plants"]

CONTROL_PERIOD = 1e-3  # s
_EXTRAS = 1  # number of the stream of noise (counter 0) and delay (counter 1) among those of a plant's seed


class Plants:
    """Some plants of a sweep in some cases: of n plants, plant i in case c is lane c n + i of `envs`.

    Attributes:
        config: the configuration of the sweep.
        seeds: (n,) seed of each plant, and of its lane in each case.
        values: (n,) records of `distributions.plant_record`; read-only.
        envs: the environment, with a lane for each plant in each case.
        channel: encoder noise and delay of all lanes.
    """

    def __init__(self, config: SweepConfig, members: Sequence[int], cases: Sequence[str]) -> None:
        """Draw the plants with the indices `members` in the sweep, each to be run in all `cases`."""
        self.config, self.seeds = config, [config.seed + member for member in members]
        cells = _cells(config, members)
        self.envs = _environment(config, cells, len(members), cases)
        nominal = FuzzyArmVectorEnv(1, **_arm_argument([config.arm]), reference=default_reference(config.arm))
        _, at_rest = nominal.reset(seed=0)
        self._start = np.concatenate([at_rest[name][0] for name in ("q_motor", "q_link", "dq_motor", "dq_link")])
        drawn: dict[str, Any] = self.begin()[1].get("randomisation", {})  # a plant is the same in every case
        found = drawn | _extras(config.drawn(), self.seeds) | cells
        self.values = np.empty(len(members), dtype=plant_record(config.joints))
        for name, (quantity, joint) in columns_of(config.joints).items():
            rows = found.get(quantity, np.full(len(members), getattr(Distribution, quantity)[0]))[: len(members)]
            self.values[name] = rows if joint is None or rows.ndim < 2 else rows[:, joint]
        self.values.flags.writeable = False
        noise, delay = (np.tile(self.values[name], len(cases)) for name in ("noise", "delay"))
        self.channel = Channel(noise if noise.any() else None, delay.astype(np.int64))

    def begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every lane, with the nominal arm at rest; return observations (lanes, 5 n) and info."""
        cases = self.envs.num_envs // len(self.seeds)
        return self.envs.reset(seed=self.seeds * cases, options={"initial_state": self._start})


def _cells(config: SweepConfig, members: Sequence[int]) -> dict[str, np.ndarray]:
    """Return by quantity the values (n,) that the grid sets for the plants `members`; the last axis varies fastest."""
    cell, found = np.asarray(members) // config.plants, {}
    for axis in reversed(config.grid):
        found[axis.quantity] = axis.values[cell % axis.number]
        cell = cell // axis.number
    return found


def _extras(ranges: Distribution, seeds: Sequence[int]) -> dict[str, np.ndarray]:
    """Return ``noise`` (n,) and ``delay`` (n,), drawn uniformly from `ranges` for n seeds.

    Noise is a factor on `NOISE`; delay is in whole control periods.
    """
    keys = np.concatenate([np.random.SeedSequence((seed, _EXTRAS)).generate_state(1, np.uint64) for seed in seeds])
    (low, high), (first, last) = ranges.noise, ranges.delay
    noise, delay = (uniform(keys, np.array([place], np.uint64)) for place in (0, 1))
    return {"noise": low + (high - low) * noise, "delay": first + np.floor((last - first + 1.0) * delay)}


def _environment(
    config: SweepConfig, cells: Mapping[str, np.ndarray], count: int, cases: Sequence[str]
) -> FuzzyArmVectorEnv:
    """Return the environment of `count` plants, each in every case, with the lanes in the order of `Plants`.

    `cells` maps each quantity of the grid to its values (count,) in the plants; all other quantities are drawn. All
    chunks use the sub-step that the fastest plant of the sweep needs.
    """
    arm, drawn = config.arm, config.drawn()
    noisy = drawn.noise[1] > 0.0 or "noise" in cells
    factors = {name: values for name, values in cells.items() if QUANTITIES[name].arm_fields}
    # Lanes with equal arms or loads share the object: the environment prepares each object once.
    varied = functools.cache(lambda *values: _varied(arm, dict(zip(factors, values, strict=True))))
    loaded = functools.cache(lambda case, payload, force: _disturbance(arm, case, payload, force, noisy))
    rows = np.reshape([*factors.values()], (len(factors), count)).T.tolist()
    loads = np.stack([cells.get("payload", np.zeros(count)), cells.get("force", np.ones(count))], axis=1).tolist()
    set_by_grid: dict[str, Any] = {axis.quantity: (axis.low, axis.high) for axis in config.grid}
    widest = dataclasses.replace(drawn, **set_by_grid)
    return FuzzyArmVectorEnv(
        count * len(cases),
        disturbance=[loaded(case, *load) for case in cases for load in loads],
        **_arm_argument([varied(*row) for row in rows] * len(cases)),
        reference=default_reference(arm),
        control_period=CONTROL_PERIOD,
        substep=CONTROL_PERIOD / default_substeps(CONTROL_PERIOD, fastest_rate([arm], widest)),
        randomisation=drawn,
        threads=1,
    )


@dataclasses.dataclass(frozen=True)
class _ScaledForce:
    """The force `force` at the tip, times a factor."""

    force: TipForce
    factor: float

    def at(self, time: np.ndarray, tip_velocity: np.ndarray) -> np.ndarray:
        """Return the force [N] at times (...) [s], of the shape (..., 2 or 3) of reference tip velocities [m/s]."""
        return self.factor * self.force.at(time, tip_velocity)


def _arm_argument(arms: list[AnyArm]) -> dict[str, Any]:
    return {"robot" if isinstance(arms[0], Robot) else "parameters": arms}


def _varied(arm: AnyArm, factors: Mapping[str, float]) -> AnyArm:
    of_field = {field: factor for name, factor in factors.items() for field in QUANTITIES[name].arm_fields}
    if isinstance(arm, Robot) and "mass" in of_field:
        arm = with_mass(arm, of_field.pop("mass"))
        del of_field["inertia"]
    return with_drives(arm, **{field: factor * per_joint_of(arm, field) for field, factor in of_field.items()})


def _disturbance(arm: AnyArm, case: str, payload: float, force: float, noisy: bool) -> Disturbance:
    """Return a case's disturbance with `payload` [kg] added, its force multiplied by `force`, and noise if `noisy`."""
    own = case_for(case, arm).disturbance
    tip_force = own.tip_force if own.tip_force is None or force == 1.0 else _ScaledForce(own.tip_force, force)
    # A payload of the case keeps its position, and the added mass is placed there too.
    place = own.payload.at if own.payload.mass > 0.0 else "tip"
    load = own.payload if payload == 0.0 else Payload(own.payload.mass + payload, place)
    return dataclasses.replace(own, tip_force=tip_force, payload=load, encoder_noise=NOISE if noisy else None)
