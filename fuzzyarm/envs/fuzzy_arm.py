"""The Gymnasium environment ``FuzzyArm-v0``.

`FuzzyArmEnv.step` passes an action to machine code that is recorded from `Kernels.step`. There, `control_step` defines
the control step, and `Physics.step` (`integrator.step` for two joints) the equations of motion.
"""

import dataclasses
import os
from ctypes import c_double
from math import isfinite
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from fuzzyarm.common import checks
from fuzzyarm.envs import arguments
from fuzzyarm.envs._film import Film
from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import CLOCK, INFO, SCALARS, VECTORS
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import checked_periods
from fuzzyarm.envs.physics.equations import AnyArm, chosen_arm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.envs.spec_json import Spec, made_from_json
from fuzzyarm.envs.task import Termination

__all__ = ["FuzzyArmEnv"]

_COUNTS = {2: "two", 3: "three"}
_BOUND = ("_call", "_run", "_call_at", "_sent", "_observation", "_scalars", "_vectors")
_NOT_FINITE = float(Termination.NOT_FINITE)
_DOUBLE, _SINGLE = np.dtype(np.float64), np.dtype(np.float32)


class FuzzyArmEnv(gym.Env[np.ndarray, np.ndarray]):
    """Track a tip path with a two-joint arm that has elastic joints and Stribeck friction.

    This task is for controllers in SI units. Learners use ``FuzzyArmLearn-v0``, the same arm with scaled observations
    and actions and a reward that distinguishes 1 mm from 0.1 mm.

    ## Description
    The plant is equations (1)-(3) of the paper with Table 1: two motors, two links, joint springs and dampers,
    friction with exact stick. The agent observes the **motor** side of the joints and the reference. The reward
    depends on the **tip**, on the link side: the joints are elastic, so the tip does not follow the motors exactly.

    ## Action space
    `Box(2,)`: motor torques Γ [N m] within ±(500, 250). Larger finite torques are clipped, which `info` reports; the
    torque is held over the control period (1 ms). For actions in [-1, 1], fractions of `observation.ACTION_SCALE`, wrap
    the environment with `gymnasium.wrappers.RescaleAction`.

    ## Observation space
    `Box(10,)`, SI units, not normalised; `observation.OBSERVATION_SCALE` has typical magnitudes:

    | index | quantity | unit |
    | --- | --- | --- |
    | 0-1 | motor angles q_a, with encoder noise if the disturbance has any | rad |
    | 2-3 | motor velocities, also with noise | rad/s |
    | 4-5 | reference angles q_d at the same instant | rad |
    | 6-7 | reference velocities | rad/s |
    | 8-9 | reference accelerations | rad/s² |

    ## Rewards
    Computed from the state after the step: reward = tracking · (1 - 0.1 effort), with tracking = 1/(1 + tip error /
    5 mm) and effort = ((Γ_1/Γ_1max)² + (Γ_2/Γ_2max)²)/2, both in `info`. Each reward is at least 0 and below 1.

    ## Starting state
    The arm is at rest, with the links on the reference at t = 0 and the motors at the static deflection under the
    gravity torque of the *nominal* arm, so a payload moves the arm from the first instant. Nothing is random unless the
    disturbance has encoder noise or a domain randomisation is chosen.

    ## Episode end
    The episode is terminated when an angle or velocity of a motor or link leaves the box (25) (|q| <= π, |q̇| <= 15
    rad/s) or is not finite; `info["reason"]` gives the reason, see `Termination`. If the state becomes infinite or nan,
    the observation and `info` repeat the last finite state, and the reward is 0. The episode is truncated when the
    reference ends, after 1.5 s or 1500 steps; this is `spec.max_episode_steps`, or if references are drawn, the length
    of the longest. No `TimeLimit` is needed; ``gym.make("FuzzyArm-v0", max_episode_steps=100)`` adds one.

    ## Info
    `time` [s], `tip`, `tip_reference` [m], `tip_error` [m], `circularity_error`, `circularity_error_motor` [m]
    (signed distance of the tip from the curve, positive outwards, from link and from motor angles; for a curve that is
    not a circle, the component along its left normal), `q_link`, `dq_link`, `q_motor`, `dq_motor` (noise-free) [rad,
    rad/s], `torque` (applied, clipped), `friction_torque` [N m], `external_force` [N], `in_domain`, `torque_clipped`,
    `reward_tracking`, `reward_effort`.

    ## Arguments
    `case` ("nominal", "machining", "payload") or your own `disturbance` instead, `reference` (default: the
    paper's circle), `parameters` (an `ArmParameters`, the plant's), or `robot` instead (another serial robot, by name,
    TOML file or as a `Robot`: then there are n joints, 5 n observed numbers and a tip with three coordinates, and loads
    and default reference fit the robot), `control_period` and `substep` [s] (a whole fraction of the control period;
    default: the largest one up to 0.2 ms that resolves the fastest mode of the arm and of all plants that can be drawn,
    see `fastest_mode`), `randomisation` ("nominal", "plants", "robust" or a `DomainRandomisation`: what each episode
    draws from its seed; `info["randomisation"]` reports the draws), `render_mode` ("human", a window with 50 pictures a
    second, or "rgb_array"; then ``metadata["render_fps"]`` is one over the control period).

    `reset(options=...)` accepts `initial_state` (4 n numbers in the order of `State`), `reference`, and `case` or
    `disturbance`; they apply to the episode that it begins.

    Raises:
        TypeError: an argument is of the wrong kind.
        ValueError: a value is unknown or out of range; the message names it and the choices.
        gymnasium.error.ResetNeeded: `step` before `reset` or after the end of an episode.

    Examples:
        >>> env = FuzzyArmEnv(case="machining")
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(np.zeros(2))
        >>> observation.shape, terminated, truncated
        ((10,), False, False)
        >>> env.close()
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012  Gymnasium's own name and type

    @made_from_json
    def __init__(
        self,
        case: str = "nominal",
        *,
        disturbance: Disturbance | None = None,
        reference: Reference | None = None,
        parameters: ArmParameters | None = None,
        robot: str | os.PathLike[str] | AnyArm | None = None,
        control_period: float = 1e-3,
        substep: float | None = None,
        randomisation: str | DomainRandomisation = "nominal",
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            checks.choice("render_mode", render_mode, self.metadata["render_modes"])
        self.parameters: Any = chosen_arm(robot, parameters)
        drawn = find_randomisation(randomisation, self.parameters)
        rate = fastest_rate([self.parameters], drawn)
        self.control_period, self.substeps = checked_periods(control_period, substep, rate)
        self.substep = self.control_period / self.substeps
        self.render_mode = render_mode
        if render_mode == "rgb_array":  # RecordVideo of Gymnasium takes a picture after every step
            self.metadata = {**self.metadata, "render_fps": 1.0 / self.control_period}
        self._disturbance = arguments.chosen_disturbance(case, disturbance, self.parameters)
        self._reference = arguments.chosen_reference(reference, drawn, self.parameters)
        self._lanes = Lanes(
            [self.parameters],
            [Scenario(self._disturbance, self._reference)],
            1,
            control_period=self.control_period,
            substeps=self.substeps,
            randomisation=drawn,
        )
        layout = self._lanes.layout
        self._torque, self._out = np.zeros(self._lanes.action_shape), np.zeros(layout.size(1))
        self._even = layout.physics.joints == layout.physics.axes
        self._parts = tuple(layout.parts)
        self._places: tuple[Any, ...] = tuple(range(len(VECTORS))) if self._even else self._parts  # indices are faster
        self._extras = drawn.varies or render_mode is not None
        self.action_space = arguments.action_space([self.parameters])
        self.observation_space = arguments.observation_space([self.parameters])
        self._spec: EnvSpec | None = None
        self._ended, self._begun = True, False
        self._drawn: dict[str, Any] = {}
        self._film = Film(render_mode == "human", self.metadata["render_fps"], control_period, self.parameters)

    @property
    def spec(self) -> EnvSpec | None:
        """The spec from `gym.make`, with the number of steps of the longest episode; None without `gym.make`."""
        return self._spec

    @spec.setter
    def spec(self, made_from: EnvSpec | None) -> None:
        # If the number of steps were registered instead, gym.make would wrap every arm in a TimeLimit, which would cost
        # time and cut short references that are longer than the paper's.
        if made_from is not None:
            own = {one.name: getattr(made_from, one.name) for one in dataclasses.fields(EnvSpec) if one.init}
            made_from = Spec(**own)
            made_from.max_episode_steps = made_from.max_episode_steps or self._lanes.longest_episode
        self._spec = made_from

    @property
    def reference(self) -> Reference:
        """The reference of the current episode; before the first episode, the one that a reset without options uses."""
        if self._reference is not None and not self._begun:
            return self._reference
        if not self._begun:
            raise ResetNeeded("there is no reference yet, because each episode draws its own: call env.reset()")
        return self._lanes.schedule(0)[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; the class docstring lists the `options`, and an unknown option raises ValueError."""
        super().reset(seed=None if seed is None else checks.whole("seed", seed))
        self._ended = True  # until the end of this method: after a reset that raises, step must raise too
        self._film.rewind()
        own = Scenario(self._disturbance, self._reference)
        scenario, initial = arguments.chosen_scenario({} if options is None else options, own, self.parameters), None
        if options and options.get("initial_state") is not None:
            initial = arguments.initial_state(options["initial_state"], self.parameters)[np.newaxis]
        # `np_random` belongs to the user; the episodes draw from a separate stream with the same seed. Gymnasium
        # reports the seed -1 for a generator that the user has assigned to `np_random`.
        seeds = None if self._begun and seed is None else [self.np_random_seed]
        if seeds is not None and seeds[0] < 0:
            seeds = [int(self.np_random.integers(2**63))]
        results = self._lanes.reset(seeds, [scenario] if options else None, initial)
        self._begun = True
        self._bind()
        self._drawn = {name: value[0] for name, value in self._lanes.randomisation_info().items()}
        observations, vectors, scalars = results
        numbers = dict(zip(SCALARS, scalars[:, 0].tolist(), strict=True))
        info = dict(zip(VECTORS, (vectors[part, 0] for part in self._parts), strict=True)) | numbers
        # If the initial state is outside the box, the episode ends with the first step.
        info["in_domain"], info["torque_clipped"] = numbers["reason"] == Termination.NONE, False
        info = {name: info[name] for name in INFO}
        self._ended = False
        if self._extras:
            self._complete(info)
        return observations[0], info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold the motor torques `action` (joints,) [N m] for a control period; return as `gymnasium.Env` does."""
        if self._ended:
            raise ResetNeeded("the episode has not begun or is over: call env.reset() before env.step()")
        # The numbers are named one by one, without dict(zip(...)) or a starred call, for speed: half of a step's time.
        try:
            kind = action.dtype  # float arrays need no check; strings and dates are refused
            self._sent[:] = action.tolist() if kind is _DOUBLE or kind is _SINGLE else self._numbers(action)
        except (AttributeError, MemoryError, TypeError, ValueError):  # not an array with one number per joint
            self._sent[:] = self._numbers(action)
        self._run(self._call_at)
        time, error, circularity, motor, tracking, effort, reward, clipped, over, reason = self._scalars[:]
        observation, vectors = self._observation.copy(), self._vectors.copy()
        inside, truncated = reason == 0.0, over != 0.0
        if reason == _NOT_FINITE:
            self._refuse_nonfinite()
        self._ended = truncated or not inside
        tip, tip_reference, q_motor, dq_motor, q_link, dq_link, applied, friction, force = self._places
        info = {
            "time": time,
            "tip": vectors[tip],
            "tip_reference": vectors[tip_reference],
            "tip_error": error,
            "circularity_error": circularity,
            "circularity_error_motor": motor,
            "q_link": vectors[q_link],
            "dq_link": vectors[dq_link],
            "q_motor": vectors[q_motor],
            "dq_motor": vectors[dq_motor],
            "torque": vectors[applied],
            "friction_torque": vectors[friction],
            "external_force": vectors[force],
            "in_domain": inside,
            "torque_clipped": clipped != 0.0,
            "reward_tracking": tracking,
            "reward_effort": effort,
        }
        if not inside:
            info["reason"] = Termination(int(reason)).text
        if self._extras:
            self._complete(info)
        return observation, reward, not inside, truncated, info

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes to copy or pickle: all except the machine code and what is bound to it."""
        return {name: value for name, value in self.__dict__.items() if name not in _BOUND}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self._begun:
            self._bind()

    def _bind(self) -> None:
        """Bind the machine code of a step to its input and output arrays, and make views of its results."""
        self._call = self._lanes.bound(self._torque, self._out)
        self._run, self._call_at = self._call.entry
        self._sent: Any = (c_double * self._torque.size).from_buffer(self._torque)  # type: ignore[arg-type]
        observation, vectors, scalars = self._lanes.layout.split(self._out, 1)
        self._observation, self._scalars = observation[0], (c_double * len(scalars)).from_buffer(scalars)  # type: ignore[arg-type]
        self._vectors = vectors.reshape(len(VECTORS), -1) if self._even else vectors[:, 0]

    def _refuse_nonfinite(self) -> None:
        """Raise ValueError if the action was not finite, and set the clock back, because the arm has not moved."""
        torque = self._sent[:]
        if not all(map(isfinite, torque)):
            self._lanes.clock[CLOCK.row] -= 1
            limit = self._lanes.torque_limit(0)
            raise ValueError(f"action = {torque} N m is not finite; give finite torques (clipped to ±{limit} N m)")

    def render(self) -> np.ndarray | None:
        """Return the picture (H, W, 3) in mode ``rgb_array``, else None; in mode ``human``, `step` shows pictures."""
        if self.render_mode == "rgb_array":
            return self._film.picture(self._lanes.schedule(0)[1])
        if self.render_mode is None:
            gym.logger.warn("render() needs a render mode, as in gym.make('FuzzyArm-v0', render_mode='rgb_array')")
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        self._film.close()

    def _numbers(self, action: Any) -> tuple[float, ...]:
        """Return the torques of an action [N m] as floats; ValueError unless it has one real number per joint."""
        array, joints = checks.array_of("action", action), self._lanes.physics.joints
        words = _COUNTS.get(joints, str(joints))
        if array.shape != (joints,):
            raise ValueError(f"action has shape {array.shape}; it must be ({joints},): the {words} motor torques [N m]")
        try:
            numbers = tuple(arguments.real_numbers("action", array).tolist())
        except TypeError as error:
            raise ValueError(f"action = {checks.shown(action)} must be {words} real numbers [N m]: {error}") from None
        return numbers

    def _complete(self, info: dict[str, Any]) -> None:
        """Add the episode's draws to `info`, and the vectors in `info` to the trace from which pictures are drawn."""
        if self._lanes.randomisation.varies:
            info["randomisation"] = self._drawn.copy()
        if self.render_mode is not None:
            vectors = np.zeros((len(VECTORS), self._lanes.layout.longest))
            for row, name in zip(vectors, VECTORS, strict=True):
                row[: len(info[name])] = info[name]
            self._film.follow(info["time"], vectors, self._lanes.schedule(0)[1], self._ended)
