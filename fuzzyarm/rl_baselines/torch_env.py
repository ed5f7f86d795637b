"""A batch of arms that lives in torch tensors, for learners that do so too: on CPU or GPU, compiled into one kernel.

The physics and the task are the functions of `fuzzyarm.envs`, line for line; here they meet tensors. Nothing on the
way of a step waits for the device or depends on data: lanes that end begin anew by selection.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
import sys
import threading
import types
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.error import ResetNeeded
from torch import Tensor

from fuzzyarm.envs.arguments import (
    action_space,
    chosen_disturbance,
    chosen_reference,
    observation_space,
    whole_substeps,
)
from fuzzyarm.envs.batch import kernels as lane_kernels
from fuzzyarm.envs.batch import schedule
from fuzzyarm.envs.batch.tables import check_reference
from fuzzyarm.envs.batch.randomness import key_of
from fuzzyarm.envs.batch.schedule import Schedule
from fuzzyarm.envs.physics import integrator
from fuzzyarm.envs.physics.dynamics import Arm, Plant, State, gravity_torque, loaded, lump, plant_of
from fuzzyarm.envs.physics.elementwise import sine_cosine
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, Draw, find_randomisation, varied
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.envs.task import Assessment, Limits, Target, assess, clipped, finite
from fuzzyarm.envs.termination import reason_of
from fuzzyarm.rl_baselines.torch_numbers import Angle, Table, normal_pair, uniform, word

# Words of an episode's random stream as plain integers, which torch.compile takes for constants.
_NEXT, _DRAWN, _NOISY = (int(number) for number in (lane_kernels.NEXT, lane_kernels.DRAWN, lane_kernels.NOISY))

# One kernel for the whole step: by default the compiler cuts it after 64 operations, and the arm's state goes through
# memory at each cut.
COMPILER_OPTIONS: dict[str, str | int | bool | Callable[..., Any]] = {
    "max_fusion_size": 1_000_000,
    "guard_filter_fn": torch.compiler.skip_all_guards_unsafe,
}


class TorchFuzzyArm:
    """A batch of arms in torch tensors: ``FuzzyArm-v0`` without leaving the device.

    Equations, reward, episode ends, observations and the meaning of the arguments are those of
    `fuzzyarm.envs.fuzzy_arm.FuzzyArmEnv`. Lane i of a batch that was reset with ``seed=s`` draws the same plants,
    references and noise as the NumPy environment with seed s + i, on every device; in float64 it is the same
    trajectory up to rounding.

        envs = TorchFuzzyArm(4096, device="cuda", randomisation="robust")
        observation = envs.reset(seed=0)
        observation, reward, terminated, truncated, info = envs.step(policy(observation))

    A lane that ends begins its next episode within the same step: its observation is then the new episode's first,
    while reward, flags and `info` are about the one that ended. All in `info` is a tensor with a row per lane:

    | key | what | unit |
    | --- | --- | --- |
    | final_obs | (n, 10) observation before a new episode began; in the other lanes the observation itself | SI |
    | tip | (n, 2) of the links | m |
    | tip_error | (n,) distance of the tip from its reference | m |
    | reward_tracking, reward_effort | (n,) parts of the reward | |
    | torque_clipped | (n,) bool, whether the action was beyond the torque limits | |
    | reason | (n,) `fuzzyarm.envs.termination.Termination`, 0 if the lane was not terminated | |

    An action that is not finite does not raise, which would mean to wait for the device: the lane's state stays, its
    reward is 0 and it is terminated with `Termination.NOT_FINITE`, as if its state had become infinite.

    Gradients do not flow through a step. Tensors that a step returned keep their values. `state` and
    `randomisation_info` are for privileged critics and for looking in.

    Args:
        num_envs: number of lanes n.
        device: of all tensors.
        dtype: torch.float32 or torch.float64, of the state, the physics and all results. Over the paper's episodes the
            tip of the float32 arm stays within 0.1 µm of the float64 one (the sub-step itself costs 0.2 to 0.9 µm).
        compiled: compile the step with torch.compile, at the first step (half a minute or more; a later process
            finds most of the work in torch's cache on disk). On the CPU this needs a C++ compiler.
        case: "nominal", "machining" or "payload".
        disturbance: one of your own in place of the case.
        reference: default: the paper's circle.
        parameters: the plant's, default: Table 1.
        control_period: [s].
        substep: [s], a whole fraction of the control period; default: the largest one up to 0.2 ms.
        randomisation: what each episode draws: "nominal", "plants", "robust" or a `DomainRandomisation`.

    Raises:
        ValueError: a value is unknown or out of range; the message names it and the choices.
        gymnasium.error.ResetNeeded: `step` before `reset`.
        RuntimeError: the first step finds no compiler.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        device: str | torch.device = "cpu",
        dtype: torch.dtype = torch.float32,
        compiled: bool = True,
        case: str = "nominal",
        disturbance: Disturbance | None = None,
        reference: JointReference | None = None,
        parameters: ArmParameters | None = None,
        control_period: float = 1e-3,
        substep: float | None = None,
        randomisation: str | DomainRandomisation = "nominal",
    ) -> None:
        """Build the tables; arguments as in the class docstring."""
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise ValueError(f"num_envs = {num_envs!r} is out of range; allowed: 1, 2, 3, ...")
        if dtype not in (torch.float32, torch.float64):
            raise ValueError(f"dtype = {dtype!r} is unknown; choose torch.float32 or torch.float64")
        self.num_envs, self.device, self.dtype, self.compiled = int(num_envs), torch.device(device), dtype, compiled
        self.parameters = parameters or ArmParameters()
        self.control_period, self.substeps = control_period, whole_substeps(control_period, substep)
        self.substep = control_period / self.substeps
        self.randomisation = find_randomisation(randomisation, self.parameters)
        self.single_action_space = action_space([self.parameters])
        self.single_observation_space = observation_space([self.parameters])
        with torch.inference_mode(False):  # tensors of either mode can be written in it, its own in no other
            self._task = self._build_task(chosen_disturbance(case, disturbance), reference)
            zeros = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
            numbers = (zeros.to(dtype, copy=True) for _ in range(12 if dtype == torch.float32 else 8))
            self._lanes = _Lanes(tuple(numbers), zeros, zeros.clone())
        self._advance = _compiled(_advance) if compiled else _advance
        self._begun = self._stepped = False

    @property
    def state(self) -> Tensor:
        """The true states (n, 8), noise-free, in the order of `State`: motor and link angles [rad], velocities."""
        return torch.stack(self._lanes.numbers[:8], dim=-1)

    def randomisation_info(self) -> dict[str, Tensor]:
        """Return what the episodes under way drew, by quantity: (n, 2) for one value per joint, else (n,)."""
        drawn = _drawn(self._task, self._lanes.key)._asdict()
        rows = {name: value.expand(self.num_envs).clone() for name, value in drawn.items()}
        info: dict[str, Tensor] = {}
        for name, value in rows.items():
            if name.endswith("1"):
                info[name[:-1]] = torch.stack([value, rows[f"{name[:-1]}2"]], dim=-1)
            elif not name.endswith("2"):
                info[name] = value
        return info

    def reset(self, seed: int | None = None) -> Tensor:
        """Begin an episode in every lane and return the observations (n, 10).

        Args:
            seed: lane i gets the random stream of seed + i. None: the streams go on; the first time, from 0.
        """
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0):
            raise ValueError(f"seed = {seed!r} is out of range; allowed: 0, 1, 2, ... or None")
        with torch.no_grad():
            if seed is not None or not self._begun:
                first = int(seed or 0)
                keys = np.array([key_of(first + lane) for lane in range(self.num_envs)], dtype=np.uint64)
                self._lanes.key.copy_(torch.from_numpy(keys.view(np.int64)))
            new, reference = _begin(self._task, self._lanes.key)
            _write(self._lanes, new)
            self._begun = True
            rows = _observed(self._task, self._lanes, reference)
            return _stacked(rows).t()

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """Hold the torques `action` (n, 2) [N m] for one control period.

        Returns:
            Observations (n, 10), rewards (n,), terminated (n,) and truncated (n,) as bool, and `info`.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun: call envs.reset() before envs.step()")
        action = torch.as_tensor(action, dtype=self.dtype, device=self.device)
        if action.shape != (self.num_envs, 2):
            raise ValueError(
                f"action has shape {tuple(action.shape)}; needed: {(self.num_envs, 2)}, motor torques [N m]"
            )
        with torch.no_grad():
            torque = action.detach().t().contiguous()
            if self._stepped or not self.compiled:
                outcome = self._advance(self._task, self._lanes, torque)
            else:
                with _announced_compilation():
                    outcome = self._advance(self._task, self._lanes, torque)
                self._stepped = True
        info = {
            "final_obs": outcome.final_observation.t(),
            "tip": outcome.tip.t(),
            "tip_error": outcome.tip_error,
            "reward_tracking": outcome.reward_tracking,
            "reward_effort": outcome.reward_effort,
            "torque_clipped": outcome.torque_clipped,
            "reason": outcome.reason,
        }
        return outcome.observation.t(), outcome.reward, outcome.terminated, outcome.truncated, info

    def _build_task(self, disturbance: Disturbance, reference: JointReference | None) -> _Task:
        """Tabulate every episode there may be."""
        plant, payload, noise = plant_of(self.parameters), disturbance.payload, disturbance.encoder_noise
        own = chosen_reference(reference, self.randomisation, self.parameters)
        members = self.randomisation.references if own is None else (own,)
        for member in members:
            check_reference(member, self.parameters)
        built = [Schedule.build(member, disturbance, self.control_period) for member in members]
        steps = np.array([one.steps for one in built])
        like = torch.empty(0, dtype=self.dtype, device=self.device)
        return _Task(
            plant=plant,
            payload=payload.mass,
            payload_radius=plant.length[1] if payload.at == "tip" else plant.mass_center[1],
            noise=(0.0, 0.0) if noise is None else (noise.position, noise.velocity),
            ranges=tuple((float(low), float(high)) for low, high in self.randomisation.ranges),
            period=self.control_period,
            substeps=self.substeps,
            spans=Table(np.stack([np.cumsum(steps) - steps, steps], axis=-1), like.to(torch.int64)),
            starts=Table(np.array([one.references[0] for one in built]), like),
            # What acts in a step, beside what the arm is compared with after it.
            rows=Table(np.concatenate([_by_step(one.table) for one in built]), like),
        )


class _Lanes(NamedTuple):
    """What a lane carries from step to step, (n,) each; all else follows from it.

    The numbers of its state, in float32 followed by the rests of its four angles; the key of the episode's random
    stream, and its steps so far, both int64.
    """

    numbers: tuple[Tensor, ...]
    key: Tensor
    step: Tensor


class _Outcome(NamedTuple):
    """What a step returns; observations (10, n), tips (2, n), the others (n,)."""

    observation: Tensor
    final_observation: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    tip: Tensor
    tip_error: Tensor
    reward_tracking: Tensor
    reward_effort: Tensor
    torque_clipped: Tensor
    reason: Tensor


@dataclasses.dataclass(frozen=True)
class _Task:
    """What all lanes share: numbers, which are constants to the compiler, and tables.

    Attributes:
        plant: the nominal arm.
        payload: mass [kg] that the disturbance adds.
        payload_radius: its distance from joint 2 [m].
        noise: standard deviations of measured angles [rad] and velocities [rad/s].
        ranges: low and high of every entry of `Draw`.
        period: control period [s].
        substeps: in it.
        spans: (episodes, 2), first row in `rows` and number of steps.
        starts: (episodes, 6), the reference at the start.
        rows: (steps, 19), the episodes' tables below each other, see `_by_step`.
    """

    plant: Plant
    payload: float
    payload_radius: float
    noise: tuple[float, float]
    ranges: tuple[tuple[float, float], ...]
    period: float
    substeps: int
    spans: Table
    starts: Table
    rows: Table

    def nominal(self) -> Plant:
        """Return the plant in tensors of shape ()."""
        number = self.rows.number
        return Plant(*(tuple(map(number, v)) if isinstance(v, tuple) else number(v) for v in self.plant))


def _advance(task: _Task, lanes: _Lanes, action: Tensor) -> _Outcome:
    """Hold torques (2, n) for one control step; `lanes` are changed in place."""
    nominal, drawn = task.nominal(), _drawn(task, lanes.key)
    arm, limits = _arm(task, nominal, drawn), _limits(nominal)
    beginning, steps = task.spans.at(drawn.reference.long())
    row = task.rows.at(beginning + lanes.step)
    reference, target = row[: schedule.TARGET], Target(*row[schedule.TARGET : schedule.FORCE])
    force, bias = [drawn.force * part for part in row[schedule.FORCE : schedule.BIAS]], row[schedule.BIAS :]

    sound = torch.isfinite(action[0]) & torch.isfinite(action[1])
    asked = [torch.where(sound, part, 0.0) for part in action.unbind(0)]
    torque1, torque2 = clipped(asked[0], limits.torque1), clipped(asked[1], limits.torque2)
    held = (torque1 + bias[0], torque2 + bias[1])
    after = integrator.held(_state(lanes.numbers), held, force, arm, task.period / task.substeps, task.substeps)
    numbers = _numbers(after, task.rows.dtype)
    sound = sound & (finite(State(*numbers[:8])) > 0.0)
    now = _Lanes(_where(sound, numbers, lanes.numbers), lanes.key, lanes.step + 1)
    found = assess(_state(now.numbers), torque1, torque2, bias[0], bias[1], arm, limits, target)

    reason = _reason(found, sound)
    terminated = reason > 0
    truncated = ~terminated & (now.step == steps)
    ended = terminated | truncated
    new, new_reference = _begin(task, now.key)
    final, first = _observed(task, now, reference), _observed(task, new, new_reference)
    _write(lanes, _Lanes(_where(ended, new.numbers, now.numbers), *_where(ended, new[1:], now[1:])))
    return _Outcome(
        _stacked(_where(ended, first, final)),
        _stacked(final),
        torch.where(sound, found.reward, 0.0),
        terminated,
        truncated,
        torch.stack([found.tip_x, found.tip_y]),
        found.tip_error,
        found.reward_tracking,
        found.reward_effort,
        (torque1 != asked[0]) | (torque2 != asked[1]),
        reason,
    )


def _begin(task: _Task, key: Tensor) -> tuple[_Lanes, list[Tensor]]:
    """Return the episodes after those with the keys (n,), and their first reference; shapes (n,) or ().

    At rest; the motors hold the gravity torque of the arm as it is known.
    """
    key, nominal = word(key, _NEXT), task.nominal()
    drawn = _drawn(task, key)
    reference = task.starts.at(drawn.reference.long())
    q1, q2 = reference[0] + drawn.angle1, reference[1] + drawn.angle2
    gravity1, gravity2 = gravity_torque(sine_cosine(q1)[0], sine_cosine(q1 + q2)[0], lump(nominal))
    start1, start2, rest = _angle(q1), _angle(q2), torch.zeros_like(q1)
    motor1, motor2 = start1 + gravity1 / nominal.stiffness[0], start2 + gravity2 / nominal.stiffness[1]
    numbers = _numbers(State(motor1, motor2, start1, start2, rest, rest, rest, rest), task.rows.dtype)
    return _Lanes(numbers, key, torch.zeros_like(key)), reference


def _write(lanes: _Lanes, new: _Lanes) -> None:
    """Change lanes in place."""
    for old, row in zip((*lanes.numbers, *lanes[1:]), (*new.numbers, *new[1:]), strict=True):
        old.copy_(row)


def _angle(value: Tensor, rest: Tensor | None = None) -> Any:
    """Return an angle as the physics shall see it: compensated in float32, as it is in float64."""
    if value.dtype == torch.float64:
        return value
    return Angle(value, torch.zeros_like(value) if rest is None else rest)


def _state(numbers: tuple[Tensor, ...]) -> State:
    """Return the state as the physics shall see it."""
    rests = numbers[8:] or (None,) * 4
    return State(*map(_angle, numbers[:4], rests), *numbers[4:8])


def _numbers(state: State, dtype: torch.dtype) -> tuple[Tensor, ...]:
    """Return what `_state` was made of; the dtype is lost on the way if torch's default dtype is a longer one."""
    values = (part.value if isinstance(part, Angle) else part for part in state)
    rests = (part.rest for part in state if isinstance(part, Angle))
    return tuple(part.to(dtype) for part in (*values, *rests))


def _observed(task: _Task, lanes: _Lanes, reference: list[Tensor]) -> list[Tensor]:
    """Return the ten rows of the observation: motors, with noise if there is any, then the reference."""
    state, limits = State(*lanes.numbers[:8]), _limits(task.nominal())
    angles, velocities = [state.motor1, state.motor2], [state.motor_velocity1, state.motor_velocity2]
    if max(task.noise) > 0.0:
        counter = lanes.step * 4 + _NOISY
        for rows, spread, offset in ((angles, task.noise[0], 0), (velocities, task.noise[1], 2)):
            noise = normal_pair(lanes.key, counter + offset, task.rows.dtype)
            rows[0], rows[1] = rows[0] + spread * noise[0], rows[1] + spread * noise[1]
    return [
        clipped(angles[0], 2.0 * limits.angle1),
        clipped(angles[1], 2.0 * limits.angle2),
        clipped(velocities[0], 10.0 * limits.velocity1),
        clipped(velocities[1], 10.0 * limits.velocity2),
        *reference,
    ]


def _drawn(task: _Task, key: Tensor) -> Draw:
    """Return what the episodes with these keys (n,) drew; entries are of shape (n,), or () where nothing is drawn."""
    entries = [
        low + (high - low) * uniform(key, _DRAWN + place, task.rows.dtype) if low < high else task.rows.number(low)
        for place, (low, high) in enumerate(task.ranges)
    ]
    entries[-1] = torch.floor(entries[-1])
    return Draw(*entries)


def _arm(task: _Task, nominal: Plant, drawn: Draw) -> Arm:
    """Return the lanes' constants with what they drew and carry."""
    number = task.rows.number
    arm: Arm = loaded(lump(varied(nominal, drawn)), number(task.payload), number(task.payload_radius), nominal.gravity)
    return Arm(*loaded(arm, drawn.payload, nominal.length[1], nominal.gravity))


def _limits(plant: Plant) -> Limits:
    return Limits(*plant.joint_limit, *plant.velocity_limit, *plant.torque_limit)


def _reason(found: Assessment, sound: Tensor) -> Tensor:
    """Return numbers of `Termination` as int64."""
    reason: Tensor = reason_of(1.0 * sound, found.angles_inside, found.velocities_inside)
    return reason.to(torch.int64)


def _where(condition: Tensor, first: Sequence[Tensor], second: Sequence[Tensor]) -> tuple[Tensor, ...]:
    return tuple(torch.where(condition, a, b) for a, b in zip(first, second, strict=True))


def _stacked(rows: Sequence[Tensor]) -> Tensor:
    """Return (rows, n) from rows of shape (n,) or (); the first is (n,)."""
    return torch.stack([row.expand_as(rows[0]) for row in rows])


def _by_step(table: np.ndarray) -> np.ndarray:
    """Return a row per control step: reference and target at its end, force and bias during it."""
    return np.concatenate([table[1:, : schedule.FORCE], table[:-1, schedule.FORCE :]], axis=-1)


def _compiled(function: Callable[..., _Outcome]) -> Callable[..., _Outcome]:
    """Return the function compiled as one graph for the arguments it will be called with.

    Raises (the compiled function, at its first call):
        RuntimeError: no compiler was found.
    """
    # torch counts the compiled versions of each code object and gives up after eight: every batch has its own.
    own = types.FunctionType(function.__code__.replace(), function.__globals__)
    compiled = torch.compile(own, fullgraph=True, dynamic=False, options={**COMPILER_OPTIONS})

    def call(*arguments: Any) -> _Outcome:
        try:
            outcome: _Outcome = compiled(*arguments)
        except RuntimeError as error:
            found = re.search(r"[^\n]*\bC(\+\+)? compiler\b[^\n]*", str(error))
            if found is None:
                raise
            message = "compiled=True needs a C++ compiler and found none: install g++ (apt install g++), name yours in "
            message += f"the environment variable CXX, or use TorchFuzzyArm(..., compiled=False) [{found[0]}]"
            raise RuntimeError(message) from None
        return outcome

    return call


@contextlib.contextmanager
def _announced_compilation() -> Iterator[None]:
    """Say on a terminal what is being waited for, if the call within takes more than a second."""
    message = "TorchFuzzyArm: compiling the step (up to a minute; a tenth of it once torch has it on disk) ..."
    timer = threading.Timer(1.0, lambda: print(message, file=sys.stderr, flush=True))
    if sys.stderr.isatty():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
