"""``FuzzyArmLearn-v0``: the arm of ``FuzzyArm-v0`` as a task for learning algorithms, single and as a batch.

An observation consists of the features of `laws.learned.features`; a trained policy computes them with the same code on
a robot. An action a in [-1, 1]ⁿ is a torque u = Γ a with the torque limits Γ of the motors. The reward is

    1 - ln(1 + d/s) / ln(1 + R/s),    d the distance of the tip from its reference, s = 0.1 mm, R = 0.2 m.

Its slope is never zero: halving the error is worth the same at 100 mm and at 1 mm.
"""

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from fuzzyarm.common import checks
from fuzzyarm.envs.arguments import arms_of, real_numbers
from fuzzyarm.envs.batch.lanes import checked_arrays
from fuzzyarm.envs.batch.layout import CLOCK, SCALARS
from fuzzyarm.envs.observation import PARTS
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.envs.spec_json import made_from_json
from fuzzyarm.envs.task import Termination
from fuzzyarm.envs.vector import RESET_MASK, FuzzyArmVectorEnv, masked_lanes
from fuzzyarm.fuzzy_policy.known_arm import joints_of
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition, FeatureDefinition, learning_features
from fuzzyarm.fuzzy_policy.laws.learned.features import FeatureLanes, Features, guided, learning_action
from fuzzyarm.policies import load_policy
from fuzzyarm.policies.spec import without_guest

__all__ = ["FuzzyArmLearnEnv", "FuzzyArmLearnVectorEnv", "learning_draws", "tracking_reward"]

EARLY_END = 0.2  # R [m]; an arm so far from its path teaches nothing about tracking
RESOLUTION = 1e-4  # s [m]; below it the reward is flat; the best fixed laws have errors of 0.2 mm under a load
BOUND = 10.0  # on the magnitude of every entry of an observation
_REFERENCES, _CIRCLES = 256, 64  # numbers of references of the family, and of copies of the default one (a fifth)
_MOST_AHEAD = 10_000  # action periods
_TIP_ERROR, _REWARD, _TRUNCATED, _REASON = map(SCALARS.index, ("tip_error", "reward", "truncated", "reason"))
_SHIELDED = 1e-3  # action period [s] with a shield, the one for which bounds on shields are proven
_MEMORY = ("memory", "base_memory", "seen", "action")


class FuzzyArmLearnVectorEnv(FuzzyArmVectorEnv):
    """A batch of `FuzzyArmLearnEnv`: each lane equals the single environment with the lane's seed, bit for bit.

    Create it with ``gym.make_vec("FuzzyArmLearn-v0", num_envs=64)``. Arguments are those of `FuzzyArmLearnEnv` and the
    `num_envs`, `threads` and `autoreset_mode` of `FuzzyArmVectorEnv`. The infos are also those of `FuzzyArmVectorEnv`.

    Attributes:
        features: definition of an observation, for the bundle of a trained policy.
        action: definition of an action, for the same bundle.
    """

    @made_from_json
    def __init__(
        self,
        num_envs: int = 1,
        case: str | Sequence[str] | None = None,
        *,
        history: int = 0,
        preview: Sequence[int] = (),
        early_end: float = EARLY_END,
        features: FeatureDefinition | None = None,
        action: ActionDefinition | None = None,
        shield: str | None = None,
        disturbance: Disturbance | Sequence[Disturbance] | None = None,
        reference: Reference | Sequence[Reference] | None = None,
        parameters: ArmParameters | None = None,
        robot: str | os.PathLike[str] | Robot | None = None,
        randomisation: str | DomainRandomisation | None = None,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: None = None,
    ) -> None:
        """Build the batch; `FuzzyArmLearnEnv` and `FuzzyArmVectorEnv` explain the arguments."""
        (arm,) = arms_of(robot, parameters, 1)
        law = ""
        if shield is not None:
            if action is not None:
                raise ValueError("give either shield or action, not both")
            law, margin = without_guest(f"shield:{checks.instance('shield', shield, str).replace(':', ':any:')}")
            if not margin:
                raise ValueError(
                    f"shield = {shield!r} must be a law and a margin [N m] per joint, such as fuzzy-4-tip:4,2"
                )
            action = ActionDefinition(margin, period=_SHIELDED)
        self.action = learning_action(arm) if action is None else checks.instance("action", action, ActionDefinition)
        if features is None:
            features = learning_features(joints_of(arm), checks.whole("history", history, high=100))
        elif history:
            raise ValueError(f"give either history = {history} or features, not both")
        for ahead in preview:
            checks.whole("preview: entry", ahead, low=1, high=_MOST_AHEAD)
        self.features, self._preview = features, np.array(preview, dtype=int)
        self.early_end = checks.real("early_end", early_end, "m", low=RESOLUTION)
        own = case is not None or disturbance is not None or reference is not None
        super().__init__(
            num_envs,
            ("nominal" if own else "machining") if case is None else case,
            disturbance=disturbance,
            reference=reference,
            parameters=parameters,
            robot=robot,
            control_period=self.action.period,
            randomisation=("nominal" if own else learning_draws(arm)) if randomisation is None else randomisation,
            threads=threads,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )
        base = None
        if named := law or self.action.base:
            base = load_policy(named, control_period=self.action.period, robot=arm)
        seen = Features(features, self.action.period, arm)
        self._arms = FeatureLanes(seen, guided(base, named, beside=bool(law)))
        joints, size = joints_of(arm), seen.size + 3 * joints_of(arm) * len(preview)
        if len(self.action.scale) != joints:
            raise ValueError(f"scale = {list(self.action.scale)} must be {joints} numbers, one for each joint")
        self._units = np.repeat([1.0, features.velocity_scale, features.acceleration_scale], joints)
        self._memory = np.zeros((num_envs, seen.memory_size))
        self._base_memory = np.zeros((num_envs, 0 if base is None else base.memory_size))
        self._seen, self._action = np.zeros((num_envs, PARTS * joints)), np.zeros((num_envs, joints))
        unit = np.ones(joints, dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-unit, unit)
        self.single_observation_space = gym.spaces.Box(-BOUND, BOUND, (size,), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every lane, or in those of a mask in `options`, see `FuzzyArmVectorEnv.reset`."""
        observation, info = super().reset(seed=seed, options=options)
        mask = None if options is None else options.get(RESET_MASK)
        which = slice(None) if mask is None else masked_lanes(RESET_MASK, mask, self.num_envs)
        self._begin(which)
        self._seen = np.ascontiguousarray(observation)
        return self._features(), _flat(info)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold `actions` (num_envs, joints), clipped to [-1, 1], for one action period; return Gymnasium's results."""
        given = np.clip(real_numbers("actions", actions), -1.0, 1.0)
        if given.shape != self._action.shape:
            raise ValueError(f"actions have shape {given.shape}; needed: {self._action.shape}")
        begun, smoothing = self._over, self.action.smoothing  # these lanes begin an episode and do not step
        self._action = smoothing * self._action + (1.0 - smoothing) * given
        torque = np.array(self.action.scale) * self._action
        self._arms.act(self._seen, self._action, torque, self._memory, self._base_memory)
        rows = self._rows + np.array([[[1]], [[0]]])  # after this step, in the schedule of the motion that it may end
        observation, reward, terminated, truncated, info = super().step(torque)
        if "final_obs" in info:
            begun = np.flatnonzero(terminated | truncated)
            self._seen = observation.copy()
            self._seen[begun] = np.stack(info["final_obs"][begun])
            last = self._features(rows)
            for lane in begun:
                info["final_obs"][lane] = last[lane].copy()
            info["final_info"] = _flat(info["final_info"])
        if begun is not None:
            self._begin(begun)
        self._seen = observation
        return self._features(), reward, terminated, truncated, _flat(info)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the state of every lane as arrays by name, for `set_state`; errors as for `FuzzyArmVectorEnv`."""
        return {**super().get_state(), **{name: getattr(self, f"_{name}").copy() for name in _MEMORY}}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state of an environment with the same arguments; errors as for `FuzzyArmVectorEnv`."""
        own = checked_arrays(state, {name: getattr(self, f"_{name}") for name in _MEMORY})
        super().set_state({name: value for name, value in state.items() if name not in own})
        for name, array in own.items():
            setattr(self, f"_{name}", array)

    def _judge(self, scalars: np.ndarray) -> None:
        error, reason = scalars[_TIP_ERROR], scalars[_REASON]
        reason[(error > self.early_end) & (reason == 0.0)] = Termination.LOST
        terminated = reason != 0.0
        scalars[_TRUNCATED, terminated] = 0.0
        scalars[_REWARD] = np.where(terminated, 0.0, tracking_reward(error, self.early_end))

    def _begin(self, which: Any) -> None:
        """Clear the memory of the lanes `which`, an index array or a slice, for a new episode."""
        self._memory[which], self._base_memory[which], self._action[which] = 0.0, 0.0, 0.0

    @property
    def _rows(self) -> np.ndarray:
        """The lanes' current rows in the table of references, and the last rows of their motions: (2, num_envs, 1)."""
        clock = self.lanes.clock
        return np.stack([clock[CLOCK.row], clock[CLOCK.last]])[..., np.newaxis]

    def _features(self, rows: np.ndarray | None = None) -> np.ndarray:
        """Return the observations (num_envs, size), float32; previews begin at `rows`, by default those of `_rows`."""
        seen = self._arms.see(self._seen, self._memory)
        if len(self._preview):  # the last reference holds after the motion has ended
            row, last = self._rows if rows is None else rows
            ahead = self.lanes.table[np.minimum(row + self._preview, last), : len(self._units)] / self._units
            seen = np.hstack([seen, ahead.reshape(self.num_envs, -1)])
        return np.asarray(np.clip(seen, -BOUND, BOUND), dtype=np.float32)


def tracking_reward(error: np.ndarray, lost: float = EARLY_END) -> np.ndarray:
    """Return rewards 1 - ln(1 + d/s)/ln(1 + R/s) for tip errors d (lanes,) [m], R = `lost` [m] and s = 0.1 mm."""
    reward: np.ndarray = 1.0 - np.log1p(error / RESOLUTION) / math.log1p(lost / RESOLUTION)
    return reward


def learning_draws(arm: AnyArm) -> DomainRandomisation:
    """Return the randomisation of ``FuzzyArmLearn-v0`` for an arm.

    This is ``robust`` (plants, load, force, initial state) with 256 references of `reference_family`, and with the
    default reference in one of five episodes.
    """
    references = (*reference_family(arm, _REFERENCES), *[default_reference(arm)] * _CIRCLES)
    return dataclasses.replace(find_randomisation("robust", arm), references=references)


def _flat(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info whose nested mapping `randomisation` is flattened to ``drawn_NAME``, as some libraries need."""
    drawn = info.pop("randomisation", {})
    info.pop("_randomisation", None)
    renamed = {("_drawn" if name.startswith("_") else "drawn_") + name: value for name, value in drawn.items()}
    return {**info, **renamed}


class FuzzyArmLearnEnv(gym.Env[np.ndarray, np.ndarray]):
    """The arm of ``FuzzyArm-v0`` as a task for learning algorithms with default settings.

    ## Description
    The plant, its sensors, limits and disturbances are those of `FuzzyArmEnv`. An action is a fraction of the torque
    limits, held for 2 ms. Errors of the motors are compressed so that even small ones fill an observation's range. The
    reward distinguishes 1 mm from 0.1 mm as well as 100 mm from 10 mm. Every episode draws plant, load, initial state
    and path, so memorising one circle does not help.

    ## Action space
    `Box(-1, 1, (2,))`: u = (500, 250) a N m, the limits of the motors; larger numbers are clipped.

    ## Observation space
    `Box(-10, 10, (10,))`, with e = q_d - q of the motors and f(x) = asinh(x)/3:

    | index | quantity | |
    | --- | --- | --- |
    | 0-1 | f(e / 1 mrad) | errors of the motor angles, encoder noise included |
    | 2-3 | f(ė / 20 mrad/s) | errors of the motor velocities |
    | 4-5 | q_d [rad] | reference angles |
    | 6-7 | q̇_d / (5 rad/s) | reference velocities |
    | 8-9 | q̈_d / (50 rad/s²) | reference accelerations |

    `history=k` appends f of the last k errors, the last k actions and f(∫e / 0.1 mrad s), where the integral leaks with
    a time constant of 0.1 s.
    `preview=(j, ...)` appends the scaled references j periods later, for each j.

    ## Rewards
    1 - ln(1 + d / 0.1 mm) / ln(1 + R / 0.1 mm), with d the tip error after the step and R = 0.2 m: 1 on the path, 0
    at R.

    ## Starting state
    At rest near the reference, each joint within ± 10 mrad of it, drawn from the seed.

    ## Episode end
    Terminated with the reward 0 if d > R or if `FuzzyArmEnv` terminates; truncated at the end of the reference.

    ## Info
    The info of `FuzzyArmEnv`, including its `reward_tracking` and `reward_effort`, which are not parts of this reward.
    The entries of `randomisation` are flattened to `drawn_mass` and so on.

    ## Arguments
    `history` (default none, since it improved no training run), `preview` in action periods (default none, as for the
    fixed laws in comparisons), `early_end` R [m], and `features` and `action`, definitions from a policy's bundle that
    replace the registered ones. `shield="fuzzy-4-tip:4,2"` makes the learner a guest of that law, u = u_f + (4, 2) a
    held for 1 ms; a bound on the tip error then holds whatever the learner does. `case`, `disturbance`, `reference`,
    `parameters`, `robot` and `randomisation` are as for `FuzzyArmEnv`. By default the case is machining and episodes
    are drawn from `learning_draws`; with your own case, disturbance or reference, nothing is drawn unless
    `randomisation` is given.

    Examples:
        >>> env = FuzzyArmLearnEnv(case="payload")
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(np.zeros(2))
        >>> observation.shape, 0.0 < reward < 1.0, terminated
        ((10,), True, False)
    """

    metadata = {"render_modes": []}  # noqa: RUF012  Gymnasium's own name and type

    @made_from_json
    def __init__(self, case: str | None = None, *, render_mode: None = None, **arguments: Any) -> None:
        """Build the environment; arguments as in the class docstring."""
        for name in ("num_envs", "threads", "autoreset_mode"):
            if name in arguments:
                raise TypeError(f"{name} applies only to vector environments: leave it out, or use gymnasium.make_vec")
        self._lane = FuzzyArmLearnVectorEnv(
            1, case, autoreset_mode=AutoresetMode.DISABLED, render_mode=render_mode, threads=1, **arguments
        )
        self.observation_space = self._lane.single_observation_space
        self.action_space = self._lane.single_action_space
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; return the first observation and the info. Options are those of `FuzzyArmEnv.reset`."""
        super().reset(seed=None if seed is None else checks.whole("seed", seed))
        observation, info = self._lane.reset(seed=seed, options=options)
        self._over = False
        return observation[0], _first(info)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold `action`, in [-1, 1]ⁿ, for one action period; return Gymnasium's five results."""
        if self._over:
            raise ResetNeeded("the episode has not begun or is over: call env.reset() before env.step()")
        observation, reward, terminated, truncated, info = self._lane.step(np.asarray(action)[np.newaxis])
        self._over = bool(terminated[0] or truncated[0])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)


def _first(info: dict[str, Any]) -> dict[str, Any]:
    """Return the info of a batch with one lane as that lane's own info, with plain numbers and copied arrays."""
    one: dict[str, Any] = {}
    for name, value in info.items():
        if not name.startswith("_"):
            one[name] = value[0].copy() if value.ndim > 1 else value.tolist()[0]
    return one
