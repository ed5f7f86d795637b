"""The Gymnasium environment ``FuzzyArm-v0``."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from fuzzyarm.envs.disturbances import Disturbance, find_case
from fuzzyarm.envs.dynamics import arm_constants, gravity_torque
from fuzzyarm.envs.episode import Episode
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.envs.reference import JointReference
from fuzzyarm.envs.task import SLOTS, WIDTH, control_step, measure

MAX_ACCELERATION = 1e4  # rad/s², bound of the observation space for the reference's acceleration
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
    *nominal* arm: a payload is felt from the first instant. No randomness unless the disturbance has encoder noise.

    ## Episode end
    Terminated when a joint angle or velocity, motor or link, leaves the box (25) (|q| <= π, |q̇| <= 15 rad/s) or is
    not finite; `info["reason"]` says which. Truncated when the reference ends (1.5 s, 1500 steps).

    ## Info
    `time` [s], `tip`, `tip_reference` [m], `tip_error` [m], `circularity_error`, `circularity_error_motor` [m]
    (signed distance of the tip from the curve, outwards positive, with the link and with the motor angles; for a
    curve that is no circle the component along its left normal), `q_link`, `dq_link`, `q_motor`, `dq_motor`
    (noise-free) [rad, rad/s], `torque` (applied, clipped), `friction_torque` [N m], `external_force` [N],
    `in_domain`, `torque_clipped`, `reward_tracking`, `reward_effort`.

    ## Arguments
    `case` ("nominal", "machining", "payload") or a `disturbance` of your own in its place, `reference` (a
    `JointReference`, default: the paper's circle), `parameters` (an `ArmParameters`, the plant's), `control_period`
    and `substep` [s] (a whole fraction of the control period; default: the largest one up to 0.2 ms), `render_mode`.

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
        render_mode: str | None = None,
    ) -> None:
        """Build the environment; arguments as in the class docstring."""
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"unknown render_mode {render_mode!r}; choose 'human', 'rgb_array' or None")
        self.parameters = parameters or ArmParameters()
        self.control_period, self.substeps = control_period, whole_substeps(control_period, substep)
        self.substep = control_period / self.substeps
        self.render_mode = render_mode
        self._default = _chosen(case, disturbance), reference or JointReference(parameters=self.parameters)
        self._check_reference(self._default[1])
        p = self.parameters
        torque_limit = np.array(p.torque_limit)
        self._torque_limit = torque_limit
        self._limits = np.array([*p.joint_limit, *p.velocity_limit, *p.torque_limit])[:, np.newaxis]
        self.action_space = spaces.Box(-torque_limit.astype(np.float32), torque_limit.astype(np.float32))
        # Motor readings get room beyond the box (25): the observation that ends an episode lies outside it.
        q, dq, acceleration = np.array(p.joint_limit), np.array(p.velocity_limit), np.full(2, MAX_ACCELERATION)
        high = np.concatenate([2.0 * q, 10.0 * dq, q, dq, acceleration])
        self.observation_space = spaces.Box(-high, high, dtype=np.float64)
        self._observation_high = high[:4]
        self._episode: Episode | None = None
        self._done = True
        self._renderer: Any = None
        self._trace: list[np.ndarray] = []  # what was measured since the reset, for the renderer

    @property
    def reference(self) -> JointReference:
        """The reference that `reset` starts without an option."""
        return self._default[1]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; `options` as in the class docstring, unknown ones raise ValueError."""
        super().reset(seed=seed)
        self._done = True  # until the end of this method: a reset that raises leaves no half-made episode to step
        self._trace.clear()
        options = options or {}
        unknown = sorted(set(options) - set(RESET_OPTIONS))
        if unknown:
            raise ValueError(f"unknown reset option {', '.join(unknown)}; known: {', '.join(RESET_OPTIONS)}")
        disturbance, reference = self._default
        if "case" in options or "disturbance" in options:
            disturbance = _chosen(options.get("case", "nominal"), options.get("disturbance"))
        if "reference" in options:
            reference = options["reference"]
            self._check_reference(reference)
        # The noise has a generator of its own, spawned from the environment's: one seed, one tree.
        noise = self.np_random.spawn(1)[0]
        self._episode = Episode.build(reference, disturbance, self.control_period, noise)
        self._arm = np.array(arm_constants(self.parameters, disturbance.payload))[:, np.newaxis]
        self._state = self._initial_state(options.get("initial_state"))
        self._index, self._done = 0, False
        self._row = np.empty((1, WIDTH))
        rest, no_force = np.zeros((2, 1)), np.zeros((4, 1))
        measure(self._state, rest, rest, no_force, self._arm, self._limits, self._episode.targets[0], self._row)
        self._trace.append(self._row[0].copy())
        if self.render_mode == "human":
            self._render_frame()
        return self._observation(), self._info(clipped=False)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold the torques `action` [N m] for one control period."""
        if self._done or self._episode is None:
            raise ResetNeeded("the episode has not begun or is over: call env.reset() before env.step()")
        torque, clipped = self._torque(action)
        index, episode = self._index, self._episode
        before = self._state.copy()
        self._row = np.empty((1, WIDTH))
        control_step(
            self._state,
            torque,
            episode.biases[index],
            episode.forces[index],
            self._arm,
            self._limits,
            episode.targets[index + 1],
            self.substep,
            self.substeps,
            self._row,
        )
        self._index = index + 1
        terminated, reward = bool(self._row[0, SLOTS.in_domain] == 0.0), float(self._row[0, SLOTS.reward])
        truncated = not terminated and self._index == episode.steps
        reason = None
        if terminated:
            reason, reward = self._leave(before, torque, reward)
        self._done = terminated or truncated
        if self.render_mode is not None:
            self._trace.append(self._row[0].copy())
        info = self._info(clipped)
        if reason:
            info["reason"] = reason
        if self.render_mode == "human" and (self._done or self._index % self._steps_per_frame() == 0):
            self._render_frame()
        return self._observation(), reward, terminated, truncated, info

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

    def _torque(self, action: np.ndarray) -> tuple[np.ndarray, bool]:
        """Return the clipped torque (2, 1) and whether clipping changed it."""
        torque = np.asarray(action, dtype=np.float64)
        if torque.shape != (2,):
            raise ValueError(f"action has shape {torque.shape}; it must be (2,): the two motor torques [N m]")
        first, second = torque.tolist()
        if not (math.isfinite(first) and math.isfinite(second)):
            raise ValueError(
                f"action = {torque.tolist()} N m is not finite; allowed: ±{self._torque_limit.tolist()} N m"
            )
        limit1, limit2 = self.parameters.torque_limit
        clipped1, clipped2 = min(max(first, -limit1), limit1), min(max(second, -limit2), limit2)
        return np.array([[clipped1], [clipped2]]), clipped1 != first or clipped2 != second

    def _leave(self, before: np.ndarray, torque: np.ndarray, reward: float) -> tuple[str, float]:
        """Return why the episode terminated and its last reward; a state that is not finite is replaced by the last."""
        if np.isfinite(self._state).all():
            q, dq = np.abs(self._state[:4, 0]).max(), np.abs(self._state[4:, 0]).max()
            return f"left the joint domain: max |q| = {q:.3g} rad, max |dq| = {dq:.3g} rad/s", reward
        assert self._episode is not None
        bias, force = self._episode.biases[self._index - 1], self._episode.forces[self._index - 1]
        measure(before, torque, bias, force, self._arm, self._limits, self._episode.targets[self._index], self._row)
        self._row[0, SLOTS.in_domain] = 0.0
        return "the state is not finite", 0.0

    def _observation(self) -> np.ndarray:
        assert self._episode is not None
        observation = np.empty(10)
        observation[:4] = self._row[0, SLOTS.motor]
        if self._episode.noise is not None:
            observation[:4] += self._episode.noise[self._index]
        np.clip(observation[:4], -self._observation_high, self._observation_high, out=observation[:4])
        observation[4:] = self._episode.references[self._index]
        return observation

    def _info(self, clipped: bool) -> dict[str, Any]:
        row = self._row[0]
        motor, link = row[SLOTS.motor], row[SLOTS.link]
        return {
            "time": self._index * self.control_period,
            "tip": row[SLOTS.tip],
            "tip_reference": row[SLOTS.tip_reference],
            "tip_error": float(row[SLOTS.tip_error]),
            "circularity_error": float(row[SLOTS.circularity_error]),
            "circularity_error_motor": float(row[SLOTS.circularity_error_motor]),
            "q_link": link[:2],
            "dq_link": link[2:],
            "q_motor": motor[:2],
            "dq_motor": motor[2:],
            "torque": row[SLOTS.torque],
            "friction_torque": row[SLOTS.friction_torque],
            "external_force": row[SLOTS.external_force],
            "in_domain": bool(row[SLOTS.in_domain] != 0.0),
            "torque_clipped": clipped,
            "reward_tracking": float(row[SLOTS.reward_tracking]),
            "reward_effort": float(row[SLOTS.reward_effort]),
        }

    def _initial_state(self, given: Any) -> np.ndarray:
        """Return the state (8, 1) at the start: the given one, checked, or rest under the nominal gravity torque."""
        p = self.parameters
        if given is not None:
            state = np.array(given, dtype=np.float64)
            high = np.repeat([p.joint_limit, p.velocity_limit], 2, axis=0).reshape(8)
            if state.shape != (8,) or not np.all(np.abs(state) <= high):
                raise ValueError(
                    f"initial_state = {np.asarray(given).tolist()} must be 8 finite numbers: motor angles, link angles "
                    f"(each |q| <= {p.joint_limit} rad), motor velocities, link velocities "
                    f"(|dq| <= {p.velocity_limit} rad/s)"
                )
            return state[:, np.newaxis]
        assert self._episode is not None
        q = self._episode.references[0, :2]
        gravity = gravity_torque(np.sin(q[0]), np.sin(q[0] + q[1]), arm_constants(p))
        motor = q + np.array(gravity) / np.array(p.stiffness)
        return np.concatenate([motor, q, np.zeros(4)])[:, np.newaxis]

    def _check_reference(self, reference: Any) -> None:
        if not isinstance(reference, JointReference):
            raise ValueError(f"reference = {reference!r} must be a fuzzyarm.envs.reference.JointReference")
        # The reference was validated for its own arm: this plant must at least have the same links.
        if reference.parameters.length != self.parameters.length:
            raise ValueError(
                f"reference was made for links of {reference.parameters.length} m, the plant has "
                f"{self.parameters.length} m: build it with parameters=..."
            )
        motion = reference.sample(np.linspace(0.0, reference.duration, 501))
        for name, unit, values, limit in (
            ("angle", "rad", motion.q, self.parameters.joint_limit),
            ("velocity", "rad/s", motion.dq, self.parameters.velocity_limit),
            ("acceleration", "rad/s²", motion.ddq, (MAX_ACCELERATION, MAX_ACCELERATION)),
        ):
            peak = np.abs(values).max(axis=0)
            if np.any(peak > limit):
                raise ValueError(
                    f"reference {name} reaches {peak.tolist()} {unit}; this plant allows {limit} {unit}: "
                    "raise its duration or move its path"
                )

    def _steps_per_frame(self) -> int:
        fps: int = self.metadata["render_fps"]
        return max(1, round(1.0 / (fps * self.control_period)))

    def _render_frame(self) -> np.ndarray | None:
        if self._episode is None or not self._trace:
            raise ResetNeeded("nothing to draw before the first env.reset()")
        if self._renderer is None:
            # Imported here: a training run never loads pygame.
            from fuzzyarm.envs.rendering import Renderer

            self._renderer = Renderer(self.render_mode == "human", self.metadata["render_fps"])
        time = self._index * self.control_period
        picture: np.ndarray | None = self._renderer.draw(self._episode, np.array(self._trace), time, self.parameters)
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


def _chosen(case: str, disturbance: Disturbance | None) -> Disturbance:
    """Return the disturbance itself, or that of the named case."""
    if disturbance is None:
        return find_case(case).disturbance
    if not isinstance(disturbance, Disturbance):
        raise ValueError(f"disturbance = {disturbance!r} must be a fuzzyarm.envs.disturbances.Disturbance")
    if case != "nominal":
        raise ValueError(f"give either case = {case!r} or a disturbance, not both")
    return disturbance
