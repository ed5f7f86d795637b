"""The Gymnasium environment ``FuzzyArm-v0``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from fuzzyarm.envs.batch.kernels import INFO, VECTORS, split
from fuzzyarm.envs.batch.lanes import MAX_ACCELERATION, Lanes
from fuzzyarm.envs.batch.tables import Task
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import REASONS

MAX_DEFAULT_SUBSTEP = 2e-4  # s; benchmarks/accuracy.py has the error it costs
RESET_OPTIONS = ("initial_state", "reference", "case", "disturbance")


class FuzzyArmEnv(gym.Env[np.ndarray, np.ndarray]):
    """Track a tip path with a two-joint arm that has elastic joints and Stribeck friction.

    ## Description
    The plant is equations (1)-(3) of the paper with Table 1: two motors, two links, joint springs and dampers,
    friction with exact stick. The agent sees the **motor** side of the joints and the reference; what counts is the
    **tip**, on the link side, which the joints' bending keeps from following the motors exactly.

    ## Action space
    `Box(2,)`: motor torques Γ [N m] within ±(500, 250). Larger finite torques are clipped and `info` says so; the
    torque is held over the control period (1 ms). Wrap with `gymnasium.wrappers.RescaleAction` for [-1, 1].

    ## Observation space
    `Box(10,)`, SI units, not normalised:

    | index | quantity | unit |
    | --- | --- | --- |
    | 0-1 | motor angles q_a, with encoder noise if the disturbance has any | rad |
    | 2-3 | motor velocities, likewise | rad/s |
    | 4-5 | reference angles q_d at the same instant | rad |
    | 6-7 | reference velocities | rad/s |
    | 8-9 | reference accelerations | rad/s² |

    ## Rewards
    From the state after the step: reward = tracking · (1 - 0.1 effort), with tracking = 1/(1 + tip error / 5 mm)
    and effort = ((Γ_1/Γ_1max)² + (Γ_2/Γ_2max)²)/2, both in `info`. Attainable range: above 0 to below 1 a step.

    ## Starting state
    At rest, the links on the reference at t = 0, the motors at the static deflection under the gravity torque of the
    *nominal* arm: a payload is felt from the first instant. No randomness unless the disturbance has encoder noise or
    a randomisation is asked for.

    ## Episode end
    Terminated when a joint angle or velocity, motor or link, leaves the box (25) (|q| <= π, |q̇| <= 15 rad/s) or is
    not finite; `info["reason"]` says which. A state that is not finite is not shown: the one before it is, with reward
    0. Truncated when the reference ends (1.5 s, 1500 steps).

    ## Info
    `time` [s], `tip`, `tip_reference` [m], `tip_error` [m], `circularity_error`, `circularity_error_motor` [m]
    (signed distance of the tip from the curve, outwards positive, with the link and with the motor angles; for a
    curve that is no circle the component along its left normal), `q_link`, `dq_link`, `q_motor`, `dq_motor`
    (noise-free) [rad, rad/s], `torque` (applied, clipped), `friction_torque` [N m], `external_force` [N],
    `in_domain`, `torque_clipped`, `reward_tracking`, `reward_effort`.

    ## Arguments
    `case` ("nominal", "machining", "payload") or a `disturbance` of your own in its place, `reference` (a
    `JointReference`, default: the paper's circle), `parameters` (an `ArmParameters`, the plant's), `control_period`
    and `substep` [s] (a whole fraction of the control period; default: the largest one up to 0.2 ms), `randomisation`
    ("nominal", "plants", "robust" or a `DomainRandomisation` of your own: what each episode draws, from its seed; then
    `info["randomisation"]` says what was drawn), `render_mode`.

    `reset(options=...)` takes, for the episode it starts, `initial_state` (8 numbers in the order of `State`),
    `reference`, and `case` or `disturbance`.

    Raises:
        ValueError: a value is unknown or out of range; the message names it and the choices.
        gymnasium.error.ResetNeeded: `step` before `reset` or after the end of an episode.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012  Gymnasium's own name and type

    def __init__(
        self,
        case: str = "nominal",
        *,
        disturbance: Disturbance | None = None,
        reference: JointReference | None = None,
        parameters: ArmParameters | None = None,
        control_period: float = 1e-3,
        substep: float | None = None,
        randomisation: str | DomainRandomisation = "nominal",
        render_mode: str | None = None,
    ) -> None:
        """Build the environment; arguments as in the class docstring."""
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"unknown render_mode {render_mode!r}; choose 'human', 'rgb_array' or None")
        self.parameters = parameters or ArmParameters()
        self.control_period, self.substeps = control_period, whole_substeps(control_period, substep)
        self.substep = control_period / self.substeps
        self.render_mode = render_mode
        drawn = find_randomisation(randomisation, self.parameters)
        self._disturbance = chosen_disturbance(case, disturbance)
        self._reference = chosen_reference(reference, drawn, self.parameters)
        self._lanes = Lanes(
            [self.parameters],
            [(self._disturbance, self._reference)],
            1,
            control_period=control_period,
            substeps=self.substeps,
            randomisation=drawn,
        )
        self._extras = drawn.varies or render_mode is not None
        self.action_space = action_space([self.parameters])
        self.observation_space = observation_space([self.parameters])
        self._ended, self._begun = True, False
        self._drawn: dict[str, Any] = {}
        self._renderer: Any = None
        self._trace: list[np.ndarray] = []  # the vectors since the reset, for the renderer

    @property
    def reference(self) -> JointReference:
        """The reference of the episode under way; before the first, the one a reset without options starts."""
        if self._reference is not None and not self._begun:
            return self._reference
        if not self._begun:
            raise ResetNeeded("each episode draws its own reference: call env.reset() first")
        return self._lanes.episode(0)[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; `options` as in the class docstring, unknown ones raise ValueError."""
        super().reset(seed=seed)
        self._ended = True  # until the end of this method: a reset that raises leaves no half-made episode to step
        self._trace.clear()
        task, initial = chosen_task(options or {}, (self._disturbance, self._reference)), None
        if options and options.get("initial_state") is not None:
            initial = initial_state(options["initial_state"], self.parameters)[np.newaxis]
        # `np_random` is the user's; the episodes draw from a stream of their own with the same seed. A generator that
        # the user has put in its place has no seed that Gymnasium knows: -1.
        seeds = None if self._begun and seed is None else [self.np_random_seed]
        if seeds is not None and seeds[0] < 0:
            seeds = [int(self.np_random.integers(2**63))]
        results = self._lanes.reset(seeds, [task] if options else None, initial)
        self._begun = True
        self._drawn = {name: value[0] for name, value in self._lanes.randomisation_info().items()}
        observations, vectors, scalars = split(results)
        inside = bool(scalars[-1, 0] == 0.0)  # a start outside the box ends with the first step
        info = dict(zip(INFO, (*vectors[:, 0], *scalars[:6, 0].tolist(), inside, False), strict=True))
        self._ended = False
        if self._extras:
            self._complete(info)
        return observations[0], info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold the torques `action` [N m] for one control period."""
        if self._ended:
            raise ResetNeeded("the episode has not begun or is over: call env.reset() before env.step()")
        observation, vectors = np.empty(10), np.empty((9, 2))
        try:
            torque1, torque2 = action.tolist()
            scalars = self._lanes.advance_one(torque1, torque2, observation, vectors)
        except (AttributeError, TypeError, ValueError):  # no array of two numbers
            torque1, torque2 = self._two_numbers(action)
            scalars = self._lanes.advance_one(torque1, torque2, observation, vectors)
        if scalars[-1] < 0:
            limit = list(self.parameters.torque_limit)
            raise ValueError(f"action = {[torque1, torque2]} N m is not finite; allowed: ±{limit} N m")
        # Written out for speed: this is half of a step's time.
        time, error, circularity, motor, tracking, effort, reward, clipped, truncated, reason = scalars
        self._ended = truncated or reason > 0
        info = {
            "time": time,
            "tip": vectors[0],
            "tip_reference": vectors[1],
            "tip_error": error,
            "circularity_error": circularity,
            "circularity_error_motor": motor,
            "q_link": vectors[4],
            "dq_link": vectors[5],
            "q_motor": vectors[2],
            "dq_motor": vectors[3],
            "torque": vectors[6],
            "friction_torque": vectors[7],
            "external_force": vectors[8],
            "in_domain": reason == 0,
            "torque_clipped": clipped,
            "reward_tracking": tracking,
            "reward_effort": effort,
        }
        if reason:
            info["reason"] = REASONS[reason]
        if self._extras:
            self._complete(info)
        return observation, reward, reason > 0, truncated, info

    def render(self) -> np.ndarray | None:
        """Return the picture (H, W, 3) in mode ``rgb_array``; in mode ``human`` the window follows by itself."""
        if self.render_mode == "rgb_array":
            return self._render_frame()
        if self.render_mode is None:
            gym.logger.warn("render() needs a render mode: gym.make('FuzzyArm-v0', render_mode='rgb_array')")
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    @staticmethod
    def _two_numbers(action: Any) -> list[float]:
        """Return what was given for an action as two numbers, or raise ValueError."""
        array = np.asarray(action)
        if array.shape != (2,):
            raise ValueError(f"action has shape {array.shape}; it must be (2,): the two motor torques [N m]")
        if array.dtype.kind not in "fiub":
            raise ValueError(f"action = {action!r} must be two real numbers, the motor torques [N m]")
        return [float(array[0]), float(array[1])]

    def _complete(self, info: dict[str, Any]) -> None:
        """Add what the episode drew, and let the renderer follow."""
        if self._lanes.randomisation.varies:
            info["randomisation"] = self._drawn.copy()
        if self.render_mode is not None:
            self._follow(info["time"], np.array([info[name] for name in VECTORS]))

    def _follow(self, time: float, vectors: np.ndarray) -> None:
        """Remember what the renderer draws, and draw it if a frame of the window is due."""
        self._time = time
        self._trace.append(vectors)
        if self.render_mode == "human" and (self._ended or (len(self._trace) - 1) % self._steps_per_frame() == 0):
            self._render_frame()

    def _steps_per_frame(self) -> int:
        fps: int = self.metadata["render_fps"]
        return max(1, round(1.0 / (fps * self.control_period)))

    def _render_frame(self) -> np.ndarray | None:
        if not self._trace:
            raise ResetNeeded("nothing to draw before the first env.reset()")
        if self._renderer is None:
            # Imported here: a training run never loads pygame.
            from fuzzyarm.envs.rendering import Renderer

            self._renderer = Renderer(self.render_mode == "human", self.metadata["render_fps"])
        _, episode = self._lanes.episode(0)
        picture: np.ndarray | None = self._renderer.draw(episode, np.array(self._trace), self._time, self.parameters)
        return picture


def whole_substeps(control_period: float, substep: float | None) -> int:
    """Return how many sub-steps make a control period; ValueError with both if it is not a whole number.

    Without a sub-step: as many as keep it at `MAX_DEFAULT_SUBSTEP` or below.
    """
    if substep is None and 0.0 < control_period <= 0.1:
        return math.ceil(control_period / MAX_DEFAULT_SUBSTEP - 1e-9)
    substep = control_period if substep is None else substep
    if not (math.isfinite(control_period) and math.isfinite(substep) and 0.0 < substep <= control_period <= 0.1):
        raise ValueError(
            f"control_period = {control_period!r} s, substep = {substep!r} s; "
            "allowed: 0 < substep <= control_period <= 0.1 s"
        )
    count = round(control_period / substep)
    if not math.isclose(count * substep, control_period, rel_tol=1e-9):
        raise ValueError(
            f"control_period = {control_period:g} s is no multiple of substep = {substep:g} s; "
            f"use substep = {control_period / max(count, 1):g} s"
        )
    return count


def chosen_disturbance(case: str, disturbance: Disturbance | None) -> Disturbance:
    """Return the disturbance itself, or that of the named case."""
    if disturbance is None:
        return find_case(case).disturbance
    if not isinstance(disturbance, Disturbance):
        raise ValueError(f"disturbance = {disturbance!r} must be a fuzzyarm.envs.scenario.disturbances.Disturbance")
    if case != "nominal":
        raise ValueError(f"give either case = {case!r} or a disturbance, not both")
    return disturbance


def chosen_reference(
    reference: JointReference | None, randomisation: DomainRandomisation, parameters: ArmParameters
) -> JointReference | None:
    """Return the reference itself, the paper's circle for this arm, or None where each episode draws its own."""
    if reference is None:
        return None if randomisation.references else JointReference(parameters=parameters)
    if not isinstance(reference, JointReference):
        raise ValueError(f"reference = {reference!r} must be a fuzzyarm.envs.scenario.reference.JointReference")
    if randomisation.references:
        raise ValueError("give either a reference or a randomisation that draws references, not both")
    return reference


def check_options(options: dict[str, Any]) -> None:
    """Raise ValueError for a reset option that does not exist."""
    unknown = sorted(set(options) - set(RESET_OPTIONS))
    if unknown:
        raise ValueError(f"unknown reset option {', '.join(unknown)}; known: {', '.join(RESET_OPTIONS)}")


def chosen_task(options: dict[str, Any], own: Task) -> Task:
    """Return the task that reset options ask for."""
    check_options(options)
    disturbance, reference = own
    if "case" in options or "disturbance" in options:
        disturbance = chosen_disturbance(options.get("case", "nominal"), options.get("disturbance"))
    if "reference" in options:
        reference = options["reference"]
        if not isinstance(reference, JointReference):
            raise ValueError(f"reference = {reference!r} must be a fuzzyarm.envs.scenario.reference.JointReference")
    return disturbance, reference


def initial_state(given: Any, parameters: ArmParameters) -> np.ndarray:
    """Return a given start (8,), checked against the box (25)."""
    p, state = parameters, np.array(given, dtype=np.float64)
    high = np.repeat([p.joint_limit, p.velocity_limit], 2, axis=0).reshape(8)
    if state.shape != (8,) or not np.all(np.abs(state) <= high):
        raise ValueError(
            f"initial_state = {np.asarray(given).tolist()} must be 8 finite numbers: motor angles, link angles "
            f"(each |q| <= {p.joint_limit} rad), motor velocities, link velocities (|dq| <= {p.velocity_limit} rad/s)"
        )
    return state


def action_space(parameters: Sequence[ArmParameters]) -> spaces.Box:
    """Return the motor torques that the strongest of these arms can give."""
    limit = np.max([arm.torque_limit for arm in parameters], axis=0).astype(np.float32)
    return spaces.Box(-limit, limit)


def observation_space(parameters: Sequence[ArmParameters]) -> spaces.Box:
    """Return what may be observed of these arms."""
    q = np.max([arm.joint_limit for arm in parameters], axis=0)
    dq = np.max([arm.velocity_limit for arm in parameters], axis=0)
    # Motor readings get room beyond the box (25): the observation that ends an episode lies outside it.
    high = np.concatenate([2.0 * q, 10.0 * dq, q, dq, np.full(2, MAX_ACCELERATION)])
    return spaces.Box(-high, high, dtype=np.float64)
