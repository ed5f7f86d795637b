"""The training run: the student drives, the teacher labels, and the student learns from the latest chunks.

A gradient step lowers the mean over a window of

    √(1 + ((ρ - ρ*)/s)²) - 1,    or 0 where the teacher's torque is at its limit,

with s = 0.02, ρ the student's residual torque and ρ* the teacher's torque minus the base torque u_b, over R (`Units`).
A training run takes minutes and cannot be resumed; the same seed gives the same network on the same machine.
"""

import dataclasses
import math
import time
from collections import deque
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
import torch

from fuzzyarm.envs.physics.equations import AnyArm, equations_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.fuzzy_policy.laws.learned.estimate.policy import LearnedObserverPolicy
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle, EstimateNetwork, shapes_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import GAP_SHARE, QUIET, context_parts, unexplained_parts
from fuzzyarm.rl_baselines.config import SEGMENT, EstimateConfig
from fuzzyarm.rl_baselines.estimate._courses import draw_courses
from fuzzyarm.rl_baselines.estimate._driving import Chunk, DrivenLanes

__all__ = [
    "EstimateTraining",
]


_PERIOD = 1e-3
"""Control period during training [s]."""

_SCALE = 0.02  # s in the loss
_LAST_RATE, _LARGEST_GRADIENT = 1e-5, 1.0
_NEWEST = 3  # one gradient step in this many uses the newest chunk


class _Student(torch.nn.Module):
    """The network of `fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn` as a torch module.

    h has `hidden` entries and tanh(P c) has `modulation`. V, G and D are initially zero, and so is the residual torque.
    """

    def __init__(self, hidden: int, modulation: int, generator: torch.Generator, physics: Physics) -> None:
        super().__init__()
        unexplained = unexplained_parts(physics.joints, physics.axes)
        self._load, self._gap = unexplained.load, unexplained.gap
        self._motion = context_parts(physics.joints, physics.axes).motion
        for name, shape in shapes_of(hidden, modulation, physics.joints, physics.axes).items():
            if len(shape) == 1 or name in "VGD":
                tensor = torch.zeros(shape)
            else:
                tensor = torch.randn(shape, generator=generator) / math.sqrt(shape[1])
            setattr(self, name, torch.nn.Parameter(tensor))
        with torch.no_grad():
            self.get_parameter("gate_bias")[:hidden] = -2.0  # bias of s: a memory of about eight samples

    def network(self) -> EstimateNetwork:
        """Return the network as it is shipped, in single precision."""
        return EstimateNetwork(**{name: value.detach().numpy().copy() for name, value in self.named_parameters()})

    def forward(
        self, z: torch.Tensor, c: torch.Tensor, h: torch.Tensor, begins: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return residual torques ρ, unclipped, and memories h⁺ (steps, lanes, hidden); arguments as in `Chunk`."""
        # Tensors are split before the loop: the gradient of an index in the loop would be as large as the whole tensor.
        n: Any = self  # its arrays by name
        gates = (z @ n.gate_z.T + c @ n.gate_c.T + n.gate_bias).unbind()
        candidate = (z @ n.A.T + (c @ n.C.T) * (z @ n.B.T)).unbind()
        gate_h, kept, states = n.gate_h.T, n.U.T, []
        for at_gate, at_candidate, begin in zip(gates, candidate, begins.unbind(), strict=True):
            h = h * begin
            s, r = torch.sigmoid(torch.addmm(at_gate, h, gate_h)).chunk(2, dim=1)
            h = torch.lerp(h, torch.tanh(torch.addcmul(at_candidate, r, h @ kept)), s)
            states.append(h)
        after = torch.stack(states)
        weights = 1.0 + torch.tanh(c @ n.P.T + n.p_0) @ n.W.T
        remembered, gap = after * weights, GAP_SHARE * torch.sinh(z[..., self._gap])
        answer = remembered @ n.V.T + (remembered @ n.G.T) * gap + z @ n.D.T
        square = z[..., self._load].square().sum(-1, keepdim=True)
        heard = square / (square + QUIET * QUIET)
        return (c[..., self._motion] * heard) * answer, after


class EstimateTraining:
    """A training run from its settings, for the arm of Table 1 or another one.

    Attributes:
        report: called after every chunk with its row of the learning curve.
        student: the network.
        rows: the curve: chunk, tip_error_mm (root mean square over all lanes), loss, lost (episodes that ended early).
    """

    def __init__(
        self,
        config: EstimateConfig,
        report: Callable[[dict[str, Any]], None] = lambda row: None,
        arm: AnyArm | None = None,
    ) -> None:
        torch.set_num_threads(1)
        self.config, self.report, self._arm = config, report, ArmParameters() if arm is None else arm
        self._generator = np.random.default_rng(config.seed)
        first, physics = torch.Generator().manual_seed(config.seed), equations_of(self._arm)
        self.student = _Student(config.hidden, config.modulation, first, physics)
        self._policy = LearnedObserverPolicy(self.student.network(), self._arm, _PERIOD)
        self._optimiser = torch.optim.Adam(self.student.parameters(), lr=config.learning_rate)
        steps = config.chunks * config.updates
        self._rate = torch.optim.lr_scheduler.CosineAnnealingLR(self._optimiser, steps, _LAST_RATE)
        self.rows: list[dict[str, Any]] = []

    def run(self) -> EstimateBundle:
        """Train to the end and return the bundle.

        Raises:
            ValueError: the loss is no longer finite.
        """
        config, began = self.config, time.process_time()
        replay: deque[Chunk] = deque(maxlen=config.replay)
        for number in range(config.chunks):
            if number % config.redraw == 0:
                courses = draw_courses(self._arm, config.lanes, _PERIOD, self._generator)
                drive = DrivenLanes(courses, self._policy, self._generator)
            replay.append(drive.chunk(self._policy, config.steps))
            learned = [self._update(replay, update) for update in range(config.updates)]
            self._policy = self._policy.with_network(self.student.network())
            loss = float(np.mean(learned))
            row = {"chunk": number, "tip_error_mm": 1e3 * drive.error, "loss": loss, "lost": drive.lost}
            if not np.isfinite(loss):
                raise ValueError(
                    f"the training has diverged: its loss is {loss} in chunk {number}; choose a learning_rate "
                    f"below {config.learning_rate:g}, or another seed"
                )
            self.rows.append(row)
            self.report({**row, "cpu_time_s": time.process_time() - began})
        versions = {name: version(name) for name in ("fuzzyarm", "numpy", "torch", "llvmlite")}
        training = {**dataclasses.asdict(config), "cpu_time_s": round(time.process_time() - began, 1)}
        arm = self._arm if isinstance(self._arm, ArmParameters) else ArmDefinition(self._arm.name, self._arm.digest)
        record: dict[str, Any] = {"training": training, "curve": self.rows, "versions": versions}
        return EstimateBundle(self.student.network(), arm, _PERIOD, seed=config.seed, **record)

    def _update(self, replay: deque[Chunk], number: int) -> float:
        config, draw = self.config, self._generator
        chunk = replay[-1] if number % _NEWEST == 0 else replay[int(draw.integers(len(replay)))]
        segments = (config.steps - config.window) // SEGMENT + 1
        window = chunk.window(int(draw.integers(segments)), config.window)
        rho, _ = self.student(window.z, window.c, window.memory[0], window.begins)
        error = (rho - window.label) / _SCALE
        loss = ((torch.sqrt(1.0 + error * error) - 1.0) * window.free).mean()
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.student.parameters(), _LARGEST_GRADIENT)
        if torch.isfinite(norm):
            self._optimiser.step()
        self._rate.step()
        return float(loss.detach())
