"""The batched form of ``FuzzyArm-v0``: a `gymnasium.vector.VectorEnv` for thousands of arms.

Quantities in `info` are in SI units [m, rad, rad/s, N m, N, s], as the kernels return them.
"""

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fuzzyarm.common import checks
from fuzzyarm.envs import arguments
from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import INFO, SCALARS
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import checked_periods
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.default_reference import default_reference, is_placed
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.envs.spec_json import made_from_json
from fuzzyarm.envs.task import Termination

__all__ = ["RESET_MASK", "FuzzyArmVectorEnv", "masked", "masked_lanes", "values"]

RESET_MASK = "reset_mask"  # the reset option with the mask (num_envs,) of booleans of the lanes to reset


def masked_lanes(name: str, mask: Any, lanes: int) -> np.ndarray:
    """Return the indices (n,) of the lanes that a mask (lanes,) of booleans selects, in ascending order."""
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        kind = f"an array of {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"{name} is {kind}; needed: a NumPy array of {lanes} booleans, True for environments to reset")
    if mask.shape != (lanes,):
        raise ValueError(f"{name} has shape {mask.shape}; needed: {(lanes,)}, one boolean per environment")
    if not mask.any():
        raise ValueError(f"{name} selects no environment; at least one entry must be True")
    return np.flatnonzero(mask)


_REWARD, _TRUNCATED, _REASON = map(SCALARS.index, ("reward", "truncated", "reason"))
_FLAGS = ("torque_clipped", "truncated", "reason")
assert SCALARS[-len(_FLAGS) :] == _FLAGS
_REASON_TEXTS = np.array([reason.text for reason in Termination], dtype=object)


def _flags(scalars: np.ndarray) -> np.ndarray:
    """Return (3, lanes) booleans from the scalars (10, lanes): torque clipped, truncated, terminated."""
    return np.asarray(scalars[-len(_FLAGS) :] != 0.0)


def values(vectors: Iterable[np.ndarray], scalars: np.ndarray, flagged: np.ndarray | None = None) -> dict[str, Any]:
    """Return the entries of `info`, in SI units; `flagged` is `_flags(scalars)`, computed if None.

    `vectors` has an array (lanes, length) per name in `VECTORS`, `scalars` (10, lanes) a row per name in `SCALARS`.
    """
    clipped, _, terminated = _flags(scalars) if flagged is None else flagged
    return dict(zip(INFO, (*vectors, *scalars[:_REWARD], ~terminated, clipped), strict=True))


def masked(entries: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Return the entries and, for each key, such as ``tip``, the mask (lanes,) under ``_tip``, as Gymnasium does."""
    return {**entries, **{f"_{key}": mask for key in entries}}


def _partial_info(
    vectors: Iterable[np.ndarray], scalars: np.ndarray, drawn: dict[str, np.ndarray], mask: np.ndarray
) -> dict[str, Any]:
    """Return the info of the lanes in a mask (lanes,), in SI units; the rows of other lanes are zero.

    `vectors` and `scalars` are as for `values`; `drawn` has the episodes' random draws by quantity.
    """
    which = np.flatnonzero(mask)
    info: dict[str, Any] = {name: _rows_of(which, rows) for name, rows in values(vectors, scalars).items()}
    if drawn:
        info["randomisation"] = masked({name: _rows_of(which, rows) for name, rows in drawn.items()}, mask)
    return masked(info, mask)


def _rows_of(which: np.ndarray, rows: np.ndarray) -> np.ndarray:
    some = np.zeros_like(rows)
    some[which] = rows[which]
    return some


def _reasons(scalars: np.ndarray) -> dict[str, Any]:
    """Return the info entry `reason` and its mask `_reason` from scalars (10, lanes); {} if no lane has terminated."""
    terminated = scalars[_REASON] != 0.0
    if not terminated.any():
        return {}
    texts = np.empty(len(terminated), dtype=object)  # filled with None
    texts[terminated] = _REASON_TEXTS[scalars[_REASON, terminated].astype(int)]
    return masked({"reason": texts}, terminated)


def _final_info(
    observation: np.ndarray,
    vectors: Iterable[np.ndarray],
    scalars: np.ndarray,
    drawn: dict[str, np.ndarray],
    ended: np.ndarray,
) -> dict[str, Any]:
    """Return the entries `final_obs` and `final_info` and their masks, for the lanes where `ended` (lanes,) is true.

    `vectors` and `scalars` are as for `values`; `drawn` has the episodes' random draws by quantity.
    """
    final_obs = np.empty(len(ended), dtype=object)  # filled with None
    for lane in np.flatnonzero(ended):
        final_obs[lane] = observation[lane].copy()
    info = {**_partial_info(vectors, scalars, drawn, ended), **_reasons(scalars)}
    return masked({"final_obs": final_obs, "final_info": info}, ended)


_MOST_LANES, _MOST_THREADS = 2**22, 1024  # a lane takes 600 bytes
_OVER = "over"  # key in a saved state: which lanes have ended and wait for a reset


class FuzzyArmVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """A batch of `FuzzyArmEnv`: lane i equals the single environment with the same seed, bit for bit.

    Create it with ``gym.make_vec("FuzzyArm-v0", num_envs=1024)``. Spaces, reward, episode ends and the keys of `info`
    are those of `FuzzyArmEnv`; every value of `info` is an array with a row per lane, with a mask ``_key`` as in
    Gymnasium. A lane that ends begins its next episode within the same step (``AutoresetMode.SAME_STEP``): the
    observation and `info` are then the new episode's first, and those of the last instant are in ``info["final_obs"]``
    (an array of objects) and ``info["final_info"]``, masked by ``_final_obs``, ``_final_info``.

    Two other modes can be chosen, by text or as an `AutoresetMode`. ``"NextStep"``: the step after an episode's end
    begins that lane's next episode, ignores its action and gives the reward 0. ``"Disabled"``: call
    ``reset(options={"reset_mask": mask})`` with a mask (num_envs,) of booleans that selects the ended lanes; a step
    before that raises. A mask works in every mode: the lanes outside it continue and have no `info`.

    Arguments are those of `FuzzyArmEnv`. `case`, `disturbance`, `reference`, `parameters` and `robot` may each be one
    value for all lanes or a sequence with one per lane, and so may `case`, `disturbance`, `reference` and
    `initial_state` in ``reset(options=...)``, for the episodes that it begins. `threads` threads share a step (default:
    one per 1,024 lanes, at most one per core); results do not depend on it.

    ``reset(seed=s)`` seeds lane i with s + i; a sequence gives each lane its own seed, and where it contains None, the
    random stream of that lane continues. All lanes use the sub-step that the arm with the fastest mode needs.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a value is unknown or out of range, or a sequence does not have one entry per lane; the message
            names the lane if there are several.
        gymnasium.error.ResetNeeded: `step` before `reset`, or while a lane has ended that is not reset automatically.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012  Gymnasium's name and type

    @made_from_json
    def __init__(
        self,
        num_envs: int = 1,
        case: str | Sequence[str] = "nominal",
        *,
        disturbance: Disturbance | Sequence[Disturbance] | None = None,
        reference: Reference | Sequence[Reference] | None = None,
        parameters: ArmParameters | Sequence[ArmParameters] | None = None,
        robot: str | os.PathLike[str] | Robot | Sequence[str | os.PathLike[str] | Robot] | None = None,
        control_period: float = 1e-3,
        substep: float | None = None,
        randomisation: str | DomainRandomisation = "nominal",
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: None = None,
    ) -> None:
        if not isinstance(autoreset_mode, AutoresetMode):
            known = [mode.value for mode in AutoresetMode]
            autoreset_mode = AutoresetMode(checks.choice("autoreset_mode", autoreset_mode, known))
        self._mode = autoreset_mode
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        if threads is not None:
            checks.whole("threads", threads, low=1, high=_MOST_THREADS)
        if render_mode is not None:
            raise ValueError(
                f"render_mode = {checks.shown(render_mode)}: a vector environment cannot render; use gymnasium.make "
                "for a single environment"
            )
        self.num_envs = checks.whole("num_envs", num_envs, low=1, high=_MOST_LANES)
        plants = arguments.arms_of(robot, parameters, self.num_envs)
        drawn = self._randomisation = find_randomisation(randomisation, plants[0])
        self.control_period, self.substeps = checked_periods(control_period, substep, fastest_rate(plants, drawn))
        self._disturbances = arguments.each_lane(
            arguments.chosen_disturbance,
            arguments.per_lane("case", case, num_envs),
            arguments.per_lane("disturbance", disturbance, num_envs),
            plants,
        )
        self._references = self._own_references(reference, plants)
        self.lanes = Lanes(
            plants,
            arguments.each_lane(Scenario, self._disturbances, self._references),
            self.num_envs,
            control_period=self.control_period,
            substeps=self.substeps,
            randomisation=self._randomisation,
            threads=threads,
        )
        self._plants = plants
        self.single_action_space = arguments.action_space(plants)
        self.single_observation_space = arguments.observation_space(plants)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._everywhere = np.ones(self.num_envs, dtype=bool)
        self._share_mask()
        self._begun = False
        self._over: np.ndarray | None = None  # the lanes (n,) that have ended and wait for a reset

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every lane, or in those of a mask; seeds and options as in the class docstring."""
        begun, self._begun = self._begun, False  # until the end: after a reset that raises, step must raise too
        options = {} if options is None else dict(checks.instance("options", options, dict))
        which = None
        if RESET_MASK in options:
            which = masked_lanes(RESET_MASK, options.pop(RESET_MASK), self.num_envs)
        if which is not None and not begun and len(which) < self.num_envs:
            raise ResetNeeded("no episode has begun: call envs.reset() without a reset_mask first")
        arguments.check_options(options)
        given = options.pop("initial_state", None)
        initial = None if given is None else arguments.initial_states(given, self._plants, self.num_envs)
        seeds, scenarios = arguments.seeds_of(seed, self.num_envs), self._scenarios(options)
        if seeds is not None and not isinstance(seed, Sequence | np.ndarray):
            super().reset(seed=seeds[0])
        if which is None:
            observation, vectors, scalars = self.lanes.reset(seeds, scenarios, initial)
            self._begun, self._over = True, None
            return observation, self._info(vectors, scalars)
        if scenarios is not None and len(scenarios) > 1:
            scenarios = [scenarios[lane] for lane in which]
        seeds = None if seeds is None else [seeds[lane] for lane in which]
        results = self.lanes.reset(seeds, scenarios, None if initial is None else initial[which], which)
        layout = self.lanes.layout
        _, vectors, scalars = layout.split(np.zeros(layout.size(self.num_envs)), self.num_envs)
        _, vectors[:, which], scalars[:, which] = results
        mask = np.isin(np.arange(self.num_envs), which)
        waiting = np.setdiff1d([] if self._over is None else self._over, which)
        self._begun, self._over = True, waiting if len(waiting) else None
        drawn = self.lanes.randomisation_info()
        return self.lanes.observation(), _partial_info(layout.each(vectors), scalars, drawn, mask)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold the torques `actions` (num_envs, joints) [N m] for a control period; return as `VectorEnv` does."""
        if not self._begun:
            raise ResetNeeded("no episode has begun: call envs.reset() before envs.step()")
        given = checks.array_of("actions", actions)
        needed = self.lanes.action_shape
        if given.shape != needed:
            raise ValueError(f"actions have shape {given.shape}; needed: {needed}, motor torques [N m]")
        torque = arguments.real_numbers("actions", given)
        if self._over is not None:
            return self._step_after_ends(torque, self._over)
        observation, vectors, scalars = self.lanes.step(torque)
        self._judge(scalars)
        reward, flagged = scalars[_REWARD], _flags(scalars)
        _, truncated, terminated = flagged
        if np.count_nonzero(flagged[1:]) == 0:
            return observation, reward, terminated, truncated, self._info(vectors, scalars, flagged)
        ended = terminated | truncated
        which = np.flatnonzero(ended)
        if self._mode is not AutoresetMode.SAME_STEP:
            self._over = which
            return observation, reward, terminated, truncated, {**self._info(vectors, scalars), **_reasons(scalars)}
        final = _final_info(
            observation, self.lanes.layout.each(vectors), scalars, self.lanes.randomisation_info(), ended
        )
        reward = reward.copy()
        observation[which], vectors[:, which], scalars[:, which] = self.lanes.restart(which)
        return observation, reward, terminated, truncated, {**self._info(vectors, scalars), **final}

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The autoreset mode, which TorchRL reads under this name; see the class."""
        return self._mode

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the state of every lane, including its random stream, as arrays by name, for `set_state`.

        Raises:
            gymnasium.error.ResetNeeded: no episode has begun.
            ValueError: a lane is in a scenario that was chosen by reset options.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun: call envs.reset() before envs.get_state()")
        state = self.lanes.get_state()
        return state if self._over is None else {**state, _OVER: np.isin(np.arange(self.num_envs), self._over)}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state of an environment with the same arguments; call `step` next, not `reset`.

        Raises:
            TypeError: the state is not a dictionary.
            ValueError: the state belongs to an environment with other arguments or is impossible. The environment is
                unchanged.
        """
        mask = checks.instance("state", state, dict).get(_OVER)
        if mask is not None and self._mode is AutoresetMode.SAME_STEP:
            raise ValueError(
                "some environments of the state are awaiting a reset, but this autoreset_mode resets at once; use the "
                "autoreset_mode with which the state was saved"
            )
        over = None if mask is None else masked_lanes(_OVER, mask, self.num_envs)
        self.lanes.set_state(state, over)
        self._begun, self._over = True, over

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads that compute the steps, each for some of the lanes."""
        self.lanes.close()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled state; pickling removes the write protection of arrays, which is set again."""
        self.__dict__.update(state)
        self._share_mask()

    def _share_mask(self) -> None:
        self._everywhere.flags.writeable = False  # one mask serves every key of every info
        self._masks = {f"_{key}": self._everywhere for key in INFO}

    def _judge(self, scalars: np.ndarray) -> None:
        """Change rewards and episode ends in the scalars (10, lanes) of a step, if a task defines its own."""

    def _info(self, vectors: np.ndarray, scalars: np.ndarray, flagged: np.ndarray | None = None) -> dict[str, Any]:
        info = values(self.lanes.layout.each(vectors), scalars, flagged)
        info.update(self._masks)
        if self._randomisation.varies:
            drawn = masked(self.lanes.randomisation_info(), self._everywhere)
            info.update(masked({"randomisation": drawn}, self._everywhere))
        return info

    def _step_after_ends(
        self, torque: np.ndarray, over: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step, but begin the next episode in the lanes `over` (n,); ResetNeeded if there is no autoreset."""
        if self._mode is AutoresetMode.DISABLED:
            lanes = ", ".join(map(str, over[:8])) + (", ..." if len(over) > 8 else "")
            raise ResetNeeded(
                f"the episode is over in environments {lanes}: call envs.reset(options={{{RESET_MASK!r}: terminated | "
                "truncated}) before envs.step()"
            )
        observation, vectors, scalars = self.lanes.step_or_restart(torque, over)
        self._judge(scalars)
        info = self._info(vectors, scalars)
        # An episode that has just begun has earned nothing, and ends with its first step at the earliest.
        scalars = scalars.copy()
        scalars[[[_REWARD], [_TRUNCATED], [_REASON]], over] = 0.0
        reward, (_, truncated, terminated) = scalars[_REWARD], _flags(scalars)
        ended = np.flatnonzero(terminated | truncated)
        self._over = ended if len(ended) else None
        return observation, reward, terminated, truncated, {**info, **_reasons(scalars)}

    def _own_references(self, given: Any, plants: list[AnyArm]) -> list[Reference | None]:
        """Return the given references, or the default ones: one object for all plants with the same links."""
        circles: dict[Any, Reference] = {}

        def chosen(one: Any, arm: AnyArm) -> Reference | None:
            if one is not None or self._randomisation.references:
                return arguments.chosen_reference(one, self._randomisation, arm)
            links = (arm.length, arm.joint_limit, arm.velocity_limit) if isinstance(arm, ArmParameters) else arm.digest
            if links not in circles or is_placed(circles[links]):  # such a reference fits one arm only
                circles[links] = default_reference(arm)
            return circles[links]

        return arguments.each_lane(chosen, arguments.per_lane("reference", given, self.num_envs), plants)

    def _scenarios(self, options: dict[str, Any]) -> list[Scenario] | None:
        """Return the scenarios requested by reset options; None if there are no options."""
        if not options:
            return None

        def chosen(arm: AnyArm, disturbance: Disturbance, reference: Reference | None, *values: Any) -> Scenario:
            return arguments.chosen_scenario(
                dict(zip(options, values, strict=True)), Scenario(disturbance, reference), arm
            )

        given = [arguments.per_lane(name, value, self.num_envs) for name, value in options.items()]
        return arguments.each_lane(chosen, self._plants, self._disturbances, self._references, *given)
