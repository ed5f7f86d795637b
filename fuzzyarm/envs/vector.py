"""The batched form of ``FuzzyArm-v0``: a `gymnasium.vector.VectorEnv` for thousands of arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fuzzyarm.common import checks
from fuzzyarm.envs.arguments import (
    STATE_SIZE,
    action_space,
    check_options,
    checked_arm,
    chosen_disturbance,
    chosen_reference,
    chosen_scenario,
    initial_state,
    observation_space,
    real_numbers,
)
from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import INFO, SCALARS, split
from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.periods import checked_periods
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.scenario.scenario import Scenario
from fuzzyarm.envs.termination import Termination

__all__ = ["FuzzyArmVectorEnv"]

REWARD, CLIPPED, OVER, REASON = map(SCALARS.index, ("reward", "torque_clipped", "truncated", "reason"))
MOST_LANES, MOST_THREADS = 2**22, 1024  # a lane takes 600 bytes
REASON_TEXTS = np.array([reason.text for reason in Termination], dtype=object)


class FuzzyArmVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """A batch of `FuzzyArmEnv`: lane i is the single environment with the same seed, bit for bit, whatever the batch.

    ``gym.make_vec("FuzzyArm-v0", num_envs=1024)`` gives it. Spaces, reward, episode ends and the keys of `info` are
    those of `FuzzyArmEnv`; every value of `info` is an array with a row per lane, beside a mask ``_key`` as Gymnasium
    has it. A lane that ends begins its next episode within the same step (``AutoresetMode.SAME_STEP``): the
    observation and `info` are then the new episode's first, and those of the last instant are in
    ``info["final_obs"]`` (an array of objects) and ``info["final_info"]``, masked by ``_final_obs``, ``_final_info``.

    Arguments are those of `FuzzyArmEnv`. `case`, `disturbance`, `reference` and `parameters` may each be one for all
    lanes or a sequence of one per lane, and so may `case`, `disturbance`, `reference` and `initial_state` in
    ``reset(options=...)``, which hold for the episodes that reset begins. `threads` is how many threads share a step
    (default: one per 1024 lanes, at most one per core); results do not depend on it.

    ``reset(seed=s)`` seeds lane i with s + i; a sequence gives each lane its own seed, None in it lets the stream of
    that lane continue.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a value is unknown or out of range, or a sequence has not one entry per lane; the message names
            the lane if there are several.
        gymnasium.error.ResetNeeded: `step` before `reset`.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012  Gymnasium's name and type

    def __init__(
        self,
        num_envs: int = 1,
        case: str | Sequence[str] = "nominal",
        *,
        disturbance: Disturbance | Sequence[Disturbance] | None = None,
        reference: JointReference | Sequence[JointReference] | None = None,
        parameters: ArmParameters | Sequence[ArmParameters] | None = None,
        control_period: float = 1e-3,
        substep: float | None = None,
        randomisation: str | DomainRandomisation = "nominal",
        threads: int | None = None,
        render_mode: None = None,
    ) -> None:
        """Build the environment; arguments as in the class docstring."""
        if threads is not None:
            checks.whole("threads", threads, low=1, high=MOST_THREADS)
        if render_mode is not None:
            raise ValueError(
                f"render_mode = {checks.shown(render_mode)}: a batch draws nothing; use gym.make('FuzzyArm-v0', ...)"
            )
        self.num_envs = checks.whole("num_envs", num_envs, low=1, high=MOST_LANES)
        self.control_period, self.substeps = checked_periods(control_period, substep)
        plants = _each(checked_arm, self._per_lane("parameters", ArmParameters() if parameters is None else parameters))
        self._randomisation = find_randomisation(randomisation, plants[0])
        self._disturbances = _each(
            chosen_disturbance, self._per_lane("case", case), self._per_lane("disturbance", disturbance)
        )
        self._references = self._own_references(reference, plants)
        self._lanes = Lanes(
            plants,
            _each(Scenario, self._disturbances, self._references),
            self.num_envs,
            control_period=self.control_period,
            substeps=self.substeps,
            randomisation=self._randomisation,
            threads=threads,
        )
        self._plants = plants
        self.single_action_space = action_space(plants)
        self.single_observation_space = observation_space(plants)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._everywhere = np.ones(self.num_envs, dtype=bool)
        self._share_mask()
        self._begun = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every lane; seeds and options as in the class docstring."""
        self._begun = False  # until the end of this method: after a reset that raises, step must raise too
        options = {} if options is None else options
        check_options(options)
        given = options.get("initial_state")
        initial = None if given is None else self._initial_states(given)
        scenarios = self._scenarios({name: value for name, value in options.items() if name != "initial_state"})
        observation, vectors, scalars = split(self._lanes.reset(self._seeds(seed), scenarios, initial))
        self._begun = True
        return observation, self._info(vectors, scalars)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold the torques `actions` (num_envs, 2) [N m] for one control period."""
        if not self._begun:
            raise ResetNeeded("no episode has begun: call envs.reset() before envs.step()")
        given = np.asarray(actions)
        if given.shape != (self.num_envs, JOINTS):
            needed = (self.num_envs, JOINTS)
            raise ValueError(f"actions have shape {given.shape}; needed: {needed}, motor torques [N m]")
        torque = real_numbers("actions", given)
        observation, vectors, scalars = split(self._lanes.step(torque))
        reward, terminated, truncated = scalars[REWARD], scalars[REASON] != 0.0, scalars[OVER] != 0.0
        ended = terminated | truncated
        if np.count_nonzero(ended) == 0:
            return observation, reward, terminated, truncated, self._info(vectors, scalars)
        final, reward = self._final(observation, vectors, scalars, ended), reward.copy()
        which = np.flatnonzero(ended)
        observation[which], vectors[:, which], scalars[:, which] = split(self._lanes.restart(which))
        return observation, reward, terminated, truncated, {**self._info(vectors, scalars), **final}

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the state of every lane, including its random stream, as arrays by name, for `set_state`.

        Raises:
            gymnasium.error.ResetNeeded: no episode has begun.
            ValueError: a lane is in a scenario that reset options asked for.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun: call envs.reset() before envs.get_state()")
        return self._lanes.get_state()

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state of an environment with the same arguments; call `step` next, not `reset`.

        Raises:
            TypeError: the state is no dictionary.
            ValueError: the state is of an environment made with other arguments, or no state that an episode has. The
                environment is as before.
        """
        self._lanes.set_state(state)
        self._begun = True

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self._lanes.close()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled state; pickling removes the write protection of arrays, which is set again."""
        self.__dict__.update(state)
        self._share_mask()

    def _share_mask(self) -> None:
        self._everywhere.flags.writeable = False  # one mask serves every key of every info
        self._masks = {f"_{key}": self._everywhere for key in INFO}

    def _info(self, vectors: np.ndarray, scalars: np.ndarray) -> dict[str, Any]:
        """Return info of every lane."""
        info = _values(vectors, scalars)
        info.update(self._masks)
        if self._randomisation.varies:
            drawn = _masked(self._lanes.randomisation_info(), self._everywhere)
            info.update(_masked({"randomisation": drawn}, self._everywhere))
        return info

    def _final(
        self, observation: np.ndarray, vectors: np.ndarray, scalars: np.ndarray, ended: np.ndarray
    ) -> dict[str, Any]:
        """Return the last observation and info of the episodes that ended; other lanes' rows are zero."""
        final_obs = np.full(self.num_envs, None, dtype=object)
        for lane in np.flatnonzero(ended):
            final_obs[lane] = observation[lane].copy()
        final_info = _values(np.where(ended[:, np.newaxis], vectors, 0.0), np.where(ended, scalars, 0.0))
        final_info["in_domain"] &= ended
        if self._randomisation.varies:
            drawn = self._lanes.randomisation_info()
            last = {
                name: np.where(ended if rows.ndim == 1 else ended[:, np.newaxis], rows, 0.0)
                for name, rows in drawn.items()
            }
            final_info["randomisation"] = _masked(last, ended)
        final_info = _masked(final_info, ended)
        terminated = scalars[REASON] != 0.0
        if terminated.any():
            reasons = np.full(self.num_envs, None, dtype=object)
            reasons[terminated] = REASON_TEXTS[scalars[REASON, terminated].astype(int)]
            final_info.update(_masked({"reason": reasons}, terminated))
        return _masked({"final_obs": final_obs, "final_info": final_info}, ended)

    def _per_lane(self, name: str, value: Any) -> list[Any]:
        """Return a list of one entry for all lanes, or of one per lane."""
        if isinstance(value, str) or not isinstance(value, Sequence):
            return [value]
        if len(value) != self.num_envs:
            raise ValueError(f"{name} has {len(value)} entries for {self.num_envs} lanes; give one, or one per lane")
        return list(value)

    def _own_references(self, given: Any, plants: list[ArmParameters]) -> list[JointReference | None]:
        """Return the given references, or the paper's circle: one object for all plants with the same links."""
        circles: dict[Any, JointReference] = {}

        def chosen(one: Any, arm: ArmParameters) -> JointReference | None:
            if one is not None or self._randomisation.references:
                return chosen_reference(one, self._randomisation, arm)
            links = arm.length, arm.joint_limit, arm.velocity_limit
            circles[links] = circles.get(links) or JointReference(parameters=arm)
            return circles[links]

        return _each(chosen, self._per_lane("reference", given), plants)

    def _scenarios(self, options: dict[str, Any]) -> list[Scenario] | None:
        """Return the scenarios that reset options ask for, None if they ask for none."""
        if not options:
            return None

        def chosen(disturbance: Disturbance, reference: JointReference | None, *values: Any) -> Scenario:
            return chosen_scenario(dict(zip(options, values, strict=True)), Scenario(disturbance, reference))

        given = [self._per_lane(name, value) for name, value in options.items()]
        return _each(chosen, self._disturbances, self._references, *given)

    def _initial_states(self, given: Any) -> np.ndarray:
        """Return checked starts (num_envs, 8) from one (8,) or one per lane."""
        states = real_numbers("initial_state", given)
        one, all_lanes = (STATE_SIZE,), (self.num_envs, STATE_SIZE)
        if states.shape not in (one, all_lanes):
            raise ValueError(f"initial_state has shape {states.shape}; allowed: {one} or {all_lanes}")
        rows = [states] if states.ndim == 1 else list(states)
        checked = _each(initial_state, rows, self._plants)
        return np.array(checked * self.num_envs if len(checked) == 1 else checked)

    def _seeds(self, seed: Any) -> list[int | None] | None:
        """Return a seed per lane; None for all, or for one, lets the random stream go on."""
        if seed is None:
            return None
        if isinstance(seed, Sequence | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(f"{len(seed)} seeds for {self.num_envs} lanes; give one, or one per lane")
            return _each(_seed, list(seed))
        first = _seed(seed)
        super().reset(seed=first)
        return [first + lane for lane in range(self.num_envs)]


def _each(make: Callable[..., Any], *columns: Sequence[Any]) -> list[Any]:
    """Return make(*row) for each lane's row of the columns; a column of one entry is for all lanes.

    An error names its lane, if there are several.
    """
    count = max(map(len, columns))
    rows = zip(*(list(column) * count if len(column) == 1 else column for column in columns), strict=True)
    made = []
    for lane, row in enumerate(rows):
        try:
            made.append(make(*row))
        except (TypeError, ValueError) as error:
            raise type(error)(f"lane {lane}: {error}" if count > 1 else str(error)) from None
    return made


def _seed(given: Any) -> Any:
    return None if given is None else checks.whole("seed", given)


def _values(vectors: np.ndarray, scalars: np.ndarray) -> dict[str, Any]:
    """Return the numbers of `info` by name."""
    values = (*vectors, *scalars[:REWARD], scalars[REASON] == 0.0, scalars[CLIPPED] != 0.0)
    return dict(zip(INFO, values, strict=True))


def _masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Return the values with the mask of lanes that have them beside each, as Gymnasium's vector infos do."""
    return {**values, **{f"_{key}": mask for key in values}}
