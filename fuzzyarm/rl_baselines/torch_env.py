"""A batch of arms in torch tensors on CPU or GPU, compiled into one kernel, for learners in torch.

The step is that of `torch_step`.
"""

import contextlib
import math
import os
import re
import types
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from fuzzyarm.common import checks
from fuzzyarm.common.waiting import announced
from fuzzyarm.envs.arguments import (
    action_space,
    chosen_disturbance,
    chosen_reference,
    observation_space,
    real_numbers,
)
from fuzzyarm.envs.batch.layout import Noise
from fuzzyarm.envs.batch.randomness import key_of
from fuzzyarm.envs.batch.tables import tabulated
from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import checked_periods
from fuzzyarm.envs.physics.equations import chosen_arm, equations_of
from fuzzyarm.envs.physics.parameters import LARGEST, ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import Scenario
from fuzzyarm.envs.scenario.disturbances import Disturbance
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation, find_randomisation
from fuzzyarm.envs.scenario.reference import Reference
from fuzzyarm.rl_baselines import _torch_step as torch_step
from fuzzyarm.rl_baselines._torch_numbers import TorchTable
from fuzzyarm.rl_baselines._torch_step import Equations, Outcome, Shared, by_step

__all__ = ["TorchFuzzyArm"]

_MOST_LANES = 2**26  # a lane takes about 100 bytes


class TorchFuzzyArm(VectorEnv[Tensor, Tensor, Tensor]):
    """A batch of arms in torch tensors: ``FuzzyArm-v0`` without leaving the device.

    Torch runs the equations, compiled or operation by operation. The class is untested on a GPU. Equations, reward,
    episode ends, observations and the meaning of the arguments are those of `fuzzyarm.envs.fuzzy_arm.FuzzyArmEnv`. Lane
    i of a batch that was reset with ``seed=s`` draws the same plants, references and noise as the NumPy environment
    with seed s + i, on every device; in float64 the trajectories also agree up to rounding.

        envs = TorchFuzzyArm(4096, device="cuda", randomisation="robust")
        observation, info = envs.reset(seed=0)
        observation, reward, terminated, truncated, info = envs.step(policy(observation))

    A lane that ends begins its next episode within the same step: its observation is then the new episode's first one,
    while reward, flags and `info` belong to the ended one. `info` consists of tensors with a row per lane:

    | key | what | unit |
    | --- | --- | --- |
    | final_obs | (n, 5 joints) observation before a new episode began; in the other lanes the observation itself | SI |
    | tip | (n, 2 or 3) position of the tip | m |
    | tip_error | (n,) distance of the tip from its reference | m |
    | reward_tracking, reward_effort | (n,) parts of the reward | |
    | torque_clipped | (n,) bool, whether the action was beyond the torque limits | |
    | reason | (n,) `fuzzyarm.envs.task.Termination`, 0 if the lane was not terminated | |

    An action that is not finite raises no error, which would require waiting for the device: the lane's state stays,
    its reward is 0 and it is terminated with `Termination.NOT_FINITE`.

    Later steps do not change the tensors that a step returned. `state` and `randomisation_info` are for privileged
    critics.

    With ``differentiable=True`` gradients flow through a step. They are the exact derivatives of the discrete step, 0
    while a motor sticks. At a border (a motor at the torque that frees it, a torque at its limit, a tip on its target)
    the gradient is that of one side, the mean of both, or 0. A torque beyond its limit has gradient 0. Gradients do not
    cross episodes. The state carries the graph of all steps since `reset` or `detach`.

    Args:
        num_envs: number of lanes n.
        device: device of all tensors.
        dtype: torch.float32 or torch.float64, for the state, the physics and all results. Over the paper's episodes the
            tip of the float32 arm stays within 0.1 µm of the float64 one (the sub-step itself costs 0.2 to 0.9 µm).
        compiled: compile the step with torch.compile, at the first step (half a minute or more, less with a
            filled cache of torch). On the CPU this needs a C++ compiler.
        differentiable: let gradients flow from what a step returns, and from `state`, to this action and earlier ones.
        case, disturbance, reference, parameters, robot, control_period, substep, randomisation: as for `FuzzyArmEnv`,
            one for all lanes.

    Raises:
        TypeError, ValueError: an argument is refused; the message names it and what is allowed.
        gymnasium.error.ResetNeeded: `step` before `reset`.
        RuntimeError: the first step finds no compiler.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012
    early_end = math.inf  # m, see `torch_step.Shared`

    def __init__(
        self,
        num_envs: int,
        *,
        device: str | torch.device = "cpu",
        dtype: torch.dtype = torch.float32,
        compiled: bool = True,
        differentiable: bool = False,
        case: str = "nominal",
        disturbance: Disturbance | None = None,
        reference: Reference | None = None,
        parameters: ArmParameters | None = None,
        robot: str | os.PathLike[str] | Robot | None = None,
        control_period: float = 1e-3,
        substep: float | None = None,
        randomisation: str | DomainRandomisation = "nominal",
    ) -> None:
        self._arguments = {name: value for name, value in locals().items() if name not in ("self", "__class__")}
        self.num_envs, self.dtype = checks.whole("num_envs", num_envs, low=1, high=_MOST_LANES), dtype
        if not isinstance(dtype, torch.dtype) or dtype not in (torch.float32, torch.float64):
            raise ValueError(f"dtype = {checks.shown(dtype)} is unknown; choose torch.float32 or torch.float64")
        self.device, self.compiled = _device(device), checks.truth("compiled", compiled)
        self.differentiable = checks.truth("differentiable", differentiable)
        self.parameters = chosen_arm(robot, parameters)
        self.randomisation = find_randomisation(randomisation, self.parameters)
        rate = fastest_rate([self.parameters], self.randomisation)
        self.control_period, self.substeps = checked_periods(control_period, substep, rate)
        self.substep = self.control_period / self.substeps
        self.single_action_space = action_space([self.parameters])
        self.single_observation_space = observation_space([self.parameters])
        with torch.inference_mode(False):  # tensors made in inference mode could not be changed outside it
            acting = chosen_disturbance(case, disturbance, self.parameters)
            own = chosen_reference(reference, self.randomisation, self.parameters)
            self._shared = self._build(acting, own)
            zeros = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
            equations = self._shared.equations
            # In float32 the state also contains the rest of each angle.
            count = equations.numbers + (equations.angles if dtype == torch.float32 else 0)
            numbers = (zeros.to(dtype, copy=True) for _ in range(count))
            self._lanes = torch_step.LaneData(tuple(numbers), zeros, zeros.clone())
        self._take: Any = torch_step.following if self.differentiable else torch_step.advance
        if compiled:
            self._take = _compile_step(self._take)
        self._begun = False

    @property  # made on demand: for 2^26 lanes it would fill the memory
    def observation_space(self) -> gym.Space[Any]:  # type: ignore[override]
        """The space of the observations of all lanes."""
        return batch_space(self.single_observation_space, self.num_envs)

    @property
    def action_space(self) -> gym.Space[Any]:  # type: ignore[override]
        """The space of the actions of all lanes."""
        return batch_space(self.single_action_space, self.num_envs)

    def __getstate__(self) -> dict[str, Any]:
        """Return what pickle stores: the arguments, and the lanes without autograd graphs."""
        lanes = torch_step.LaneData(tuple(one.detach() for one in self._lanes.numbers), *self._lanes[1:])
        return {"arguments": self._arguments, "lanes": lanes, "begun": self._begun}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Unpickle: build the batch from the arguments in `state`, then restore its lanes."""
        self.__init__(**state["arguments"])  # type: ignore[misc]
        self._lanes, self._begun = state["lanes"], state["begun"]

    @property
    def state(self) -> Tensor:
        """The true states (n, 4 · joints): motor angles, then link angles [rad], then their velocities [rad/s]."""
        return torch.stack(self._lanes.numbers[: self._shared.equations.numbers], dim=-1)

    def randomisation_info(self) -> dict[str, Tensor]:
        """Return the random quantities of the current episodes by name: (n, joints) if given per joint, else (n,)."""

        def rows(value: Any) -> Tensor:
            if isinstance(value, tuple):
                return torch.stack([rows(number) for number in value], dim=-1)
            row: Tensor = value.expand(self.num_envs).clone()
            return row

        return {name: rows(value) for name, value in torch_step.drawn(self._shared, self._lanes.key)._asdict().items()}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Begin an episode in all n lanes and return the observations (n, 5 joints) and an empty info.

        Args:
            seed: lane i gets the random stream of seed + i. None: the streams continue, initially from 0.
            options: must be empty; there are no options.
        """
        if options:
            raise ValueError(f"options = {checks.shown(options)}: TorchFuzzyArm has no reset options; leave them out")
        first = 0 if seed is None else checks.whole("seed", seed)
        with torch.no_grad():
            if seed is not None or not self._begun:
                keys = np.array([key_of(first + lane) for lane in range(self.num_envs)], dtype=np.uint64)
                self._lanes.key.copy_(torch.from_numpy(keys.view(np.int64)))
            new, reference = torch_step.begin(self._shared, self._lanes.key)
            if self.differentiable:  # the old tensors may be part of a graph
                self.detach()
            torch_step.write(self._lanes, new)
            self._begun = True
            rows = torch_step.observed(self._shared, self._lanes, reference)
            return torch_step.stacked(rows), {}

    def step(self, action: Tensor) -> Outcome:
        """Hold the torques `action` (n, joints) [N m] for one control period.

        Returns:
            Observations (n, 5 joints), rewards (n,), terminated (n,) and truncated (n,) as bool, and `info`.
        """
        if not self._begun:
            raise ResetNeeded("no episode has begun: call envs.reset() before envs.step()")
        given = _real(action)
        needed = self.num_envs, self._shared.equations.physics.joints
        if tuple(given.shape) != needed:
            raise ValueError(f"action has shape {tuple(given.shape)}; needed: motor torques [N m] of shape {needed}")
        return self._advance(torch.as_tensor(given, dtype=self.dtype, device=self.device).t())

    def detach(self) -> None:
        """Cut the graph: later gradients stop here. The state keeps its values."""
        numbers, key, step = self._lanes
        self._lanes = torch_step.LaneData(tuple(one.detach().clone() for one in numbers), key.clone(), step.clone())

    def _advance(self, torque: Tensor) -> Outcome:
        """Hold torques (joints, lanes) [N m] for one control period, and return the results of `step`."""
        if not self.differentiable:
            with torch.no_grad():
                outcome: Outcome = self._take(self._shared, self._lanes, torque.detach().contiguous())
            return outcome
        # Compiled code is valid only for inputs like those of its first call, all of which require gradients.
        with torch.enable_grad():
            numbers = tuple(map(_tracked, self._lanes.numbers))
            self._lanes, outcome = self._take(self._shared, self._lanes._replace(numbers=numbers), _tracked(torque))
        if torch.is_grad_enabled():
            return outcome
        self.detach()
        observation, reward, terminated, truncated, info = outcome
        info = {name: one.detach() for name, one in info.items()}
        return observation.detach(), reward.detach(), terminated, truncated, info

    def _build(self, disturbance: Disturbance, own: Reference | None) -> Shared:
        """Return the data of all episodes that may run; `own` is their reference, None if episodes draw references."""
        physics, payload, noise = equations_of(self.parameters), disturbance.payload, disturbance.encoder_noise
        one, drawn = np.zeros(1, dtype=np.int64), self.randomisation.references
        tables, _, places = tabulated([Scenario(disturbance, own)], [self.parameters], one, drawn, self.control_period)
        built = [episode.schedule for episode in tables.episodes]
        steps = np.array([one.steps for one in built])
        like = torch.empty(0, dtype=self.dtype, device=self.device)
        return Shared(
            equations=Equations(physics),
            plant=physics.plant_of(self.parameters),
            payload=checks.real("payload mass", payload.mass, "kg", low=0.0, high=LARGEST),
            payload_place=float(places[0]),
            noise=Noise(0.0, 0.0) if noise is None else Noise(noise.position, noise.velocity),
            ranges=tuple((float(low), float(high)) for low, high in self.randomisation.ranges(physics.joints)),
            period=self.control_period,
            substeps=self.substeps,
            spans=TorchTable(np.stack([np.cumsum(steps) - steps, steps], axis=-1), like.to(torch.int64)),
            starts=TorchTable(np.array([one.references[0] for one in built]), like),
            # In each row, what acts during a step and what the arm is compared with after it.
            rows=TorchTable(np.concatenate([by_step(one) for one in built]), like),
            early_end=self.early_end,
        )


def _tracked(numbers: Tensor) -> Tensor:
    """Return the tensor if it requires a gradient, otherwise a copy that does."""
    return numbers.contiguous() if numbers.requires_grad else numbers.detach().clone().contiguous().requires_grad_()


def _device(device: str | torch.device) -> torch.device:
    try:
        found = torch.device(device)
        torch.empty(0, device=found)
    except (AssertionError, NotImplementedError, RuntimeError, TypeError, ValueError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        raise ValueError(f"device = {checks.shown(device)} cannot be used: {checks.listed([reason])}") from None
    return found


def _real(action: Any) -> Any:
    """Return an action as an array or a tensor; TypeError unless its entries are real."""
    if not isinstance(action, Tensor):
        return real_numbers("action", action)
    if action.is_complex() or action.dtype == torch.bool:
        raise TypeError(f"action must contain real numbers [N m], not {action.dtype}")
    return action


def _compile_step(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, compiled as one graph at its first call, which raises RuntimeError if no compiler is found."""
    # One kernel for the whole step: by default the compiler cuts it after 64 operations, and the arm's state goes
    # through memory at each cut.
    options: dict[str, Any] = {"max_fusion_size": 1_000_000, "guard_filter_fn": torch.compiler.skip_all_guards_unsafe}
    # torch counts the compiled versions of each code object and gives up after eight, so every batch has its own.
    own = types.FunctionType(function.__code__.replace(), function.__globals__)
    graph = torch.compile(own, fullgraph=True, dynamic=False, options=options)
    first = [_announced_compilation()]

    def call(*arguments: Any) -> Any:
        try:
            with first.pop() if first else contextlib.nullcontext():
                return graph(*arguments)
        except RuntimeError as error:
            found = re.search(r"[^\n]*\bC(\+\+)? compiler\b[^\n]*", str(error))
            if found is None:
                raise
            message = (
                "compiled=True needs a C++ compiler, but none was found: install g++ (apt install g++), name yours in "
            )
            message += f"the environment variable CXX, or use TorchFuzzyArm(..., compiled=False) [{found[0]}]"
            raise RuntimeError(message) from None

    return call


@contextlib.contextmanager
def _announced_compilation() -> Iterator[None]:
    """Print a message on a terminal if the enclosed call takes more than a second."""
    message = (
        "TorchFuzzyArm: compiling the step (up to a minute, or a tenth of that if torch has cached it on disk) ..."
    )
    with announced(message), warnings.catch_warnings():  # the compiler reads .grad of every input
        warnings.filterwarnings("ignore", r"The \.grad attribute of a Tensor that is not a leaf", UserWarning)
        yield
