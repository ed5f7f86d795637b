"""The arm in torch's memory without torch's arithmetic: recorded kernels step tensors where they lie.

A reset, a step with the resets that are due, and any number of steps under a law are one launch each. The memory is
laid out as that of `FuzzyArmVectorEnv`, and a lane has the same bits, but for the last bit of encoder noise, see
`numbers.gpu`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from fuzzyarm.envs.batch.kernels import Kernels
from fuzzyarm.envs.batch.lanes import Lanes
from fuzzyarm.envs.batch.layout import CLOCK, SCALARS, Clock, Flags, Totals
from fuzzyarm.envs.physics.records import size
from fuzzyarm.envs.scenario.randomisation import draw_record
from fuzzyarm.fuzzy_policy.law import Law, constants_array, within_limits
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.numbers.functions import zeros
from fuzzyarm.numbers.gpu import gpu
from fuzzyarm.numbers.machine import WIDE, Kernel
from fuzzyarm.rl_baselines.torch_step import Outcome

__all__ = ["KernelLanes", "launcher"]

_Launch = Callable[..., None]
"""``launch(kernel, arrays, constants, tables, steps)`` on tensors; it need not wait for the end."""


def launcher(device: torch.device) -> _Launch | None:
    """Return what launches kernels on tensors of an NVIDIA GPU, on torch's current stream; None for other devices."""
    if device.type != "cuda" or torch.version.hip is not None:
        return None
    own = gpu(torch.cuda.current_device() if device.index is None else device.index)

    def launch(kernel: Kernel, arrays: Any, constants: Tensor, tables: Any, steps: int) -> None:
        own.launch(kernel, arrays, constants, tables, steps, torch.cuda.current_stream(device).cuda_stream)

    return launch


class KernelLanes:
    """A batch of n = `count` arms in tensors of float64, like `lanes`, by lane or one for all; no memory is shared."""

    def __init__(self, lanes: Lanes, count: int, device: torch.device, launch: _Launch) -> None:
        self._kernels, self._launch, self._count = lanes.kernels, launch, count
        self._layout, self._physics = lanes.layout, lanes.physics
        self._empty = functools.partial(torch.empty, dtype=torch.float64, device=device)
        given, constants, tables = lanes.inputs()
        self._given, self._constants = self._like(given).expand(count, -1), self._like(constants)
        self._tables = [self._like(table) for table in tables]
        self._at_rest = self._empty(1, size(self._physics.State)).fill_(torch.nan).expand(count, -1)
        self._values = self._empty(-(-count // WIDE), size(self._layout.Lane), WIDE)
        self._clock = torch.zeros((size(Clock), count), dtype=torch.int64, device=device)

    @property
    def state(self) -> Tensor:
        """The true states (n, 4 joints), a copy, see `TorchFuzzyArm.state`."""
        numbers = self._values[:, : size(self._physics.State)]
        return numbers.transpose(1, 2).reshape(-1, numbers.shape[1])[: self._count].clone()

    @property
    def key(self) -> Tensor:
        """The keys (n,) of the episodes' random streams, int64."""
        return self._clock[CLOCK.key]

    def reset(self) -> Tensor:
        """Begin the episodes after those with the keys, and return the observations (n, 5 joints)."""
        seen, results = self._empty(self._count, self._layout.observed), self._empty(self._layout.reported, self._count)
        drawn = self._empty(size(draw_record(self._physics.joints)), self._count)
        arrays = *self._lane(), drawn, self._given, self._at_rest, seen, results
        self._launch(self._kernels.begin, arrays, self._constants[3:], self._tables, 1)
        return seen

    def step(self, action: Tensor) -> Outcome:
        """Hold torques (n, joints) [N m] for one control step, and begin the next episode in each lane that ends."""
        final, seen = self._empty(2, self._count, self._layout.observed)
        results, flags = self._empty(self._layout.reported, self._count), self._empty(len(Flags._fields), self._count)
        arrays = *self._lane(), action.contiguous(), self._given, final, seen, results, flags
        self._launch(self._kernels.advance, arrays, self._constants, self._tables, 1)
        scalars = dict(zip(SCALARS, results[-len(SCALARS) :], strict=True))
        ended = Flags(*flags.view(torch.int64))
        # The first byte of 0 or 1 is that of False or True.
        terminated, truncated, clipped = (one.view(torch.bool)[:: one.element_size()] for one in ended[:3])
        errors = scalars["tip_error"], scalars["reward_tracking"], scalars["reward_effort"]
        parts = seen.t(), final.t(), scalars["reward"], terminated, truncated, results[self._layout.parts.tip]
        return Outcome(*parts, *errors, clipped, ended.reason)

    def run(self, policy: Policy, law: Law, steps: int, memory: Tensor | None) -> tuple[Tensor, Tensor, Totals]:
        """Take steps under a law, see `TorchFuzzyArm.run`; return observations (n, 5 joints), memory and `Totals`."""
        shapes = zeros(law.memory), zeros(law.constants), tuple(table.shape for table in law.tables)
        kernel = _closed_loop(self._kernels, law.act, policy.integral_at, *shapes)
        seen = self._empty(self._count, self._layout.observed)
        totals = self._empty(len(Totals._fields), self._count).zero_()
        remembered = self._empty(policy.memory_size, self._count).zero_()
        if memory is not None:
            remembered.copy_(memory.t())
        limit = tuple(policy.torque_limit.tolist())
        constants = torch.cat([self._constants, self._like(constants_array(law, limit))])
        tables = [*self._tables, *map(self._like, law.tables)]
        arrays = *self._lane(), remembered, self._given, seen, totals
        self._launch(kernel, arrays, constants, tables, steps)
        return seen, remembered.t(), Totals(*totals)

    def _lane(self) -> tuple[Tensor, Tensor]:
        return self._values, self._clock.view(torch.float64)

    def _like(self, array: Any) -> Tensor:
        return self._empty(array.shape).copy_(torch.from_numpy(array))


@functools.lru_cache(maxsize=64)
def _closed_loop(
    kernels: Kernels,
    act: Any,
    integral_at: int | None,
    memory: Any,
    constants: Any,
    tables: tuple[tuple[int, int], ...],
) -> Kernel:
    """Return the kernel of a law within its limits."""
    joints = kernels.layout.physics.joints
    command = within_limits(Law(act, memory, constants), joints, integral_at)
    return kernels.run(command, memory, (constants, (0.0,) * joints), tables)
