"""The network of `learned-observer` in torch, over sequences, for its regression."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from fuzzyarm.envs.physics.records import Physics
from fuzzyarm.fuzzy_policy.laws.learned.estimate.network import EstimateNetwork, shapes_of
from fuzzyarm.fuzzy_policy.laws.learned.estimate.signals import GAP_SHARE, QUIET, context_parts, unexplained_parts

__all__ = ["Student"]

_GATE = -2.0  # of s at the beginning: a memory of about eight samples


class Student(torch.nn.Module):
    """The equations of `fuzzyarm.fuzzy_policy.laws.learned.estimate.network`.

    Args:
        hidden: numbers in h.
        modulation: numbers in tanh(P c).
        generator: of the first weights; V, G and D begin at zero, so the residual does.
        physics: the equations of the arm.
    """

    def __init__(self, hidden: int, modulation: int, generator: torch.Generator, physics: Physics) -> None:
        """Draw the weights."""
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
            self.get_parameter("gate_bias")[:hidden] = _GATE

    def network(self) -> EstimateNetwork:
        """Return the network as it is shipped, in single precision."""
        return EstimateNetwork(**{name: value.detach().numpy().copy() for name, value in self.named_parameters()})

    def forward(
        self, z: torch.Tensor, c: torch.Tensor, h: torch.Tensor, begins: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return ρ before it is clipped (steps, lanes, n) and h⁺ (steps, lanes, hidden).

        Args:
            z: (steps, lanes, numbers of z).
            c: (steps, lanes, numbers of c).
            h: (lanes, hidden) before the first step.
            begins: (steps, lanes, 1), 0 where an episode begins, else 1.
        """
        # Tensors are taken apart before the loop: an index within it would have a derivative as large as the whole.
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


def as_tensor(array: np.ndarray) -> torch.Tensor:
    """Return an array in single precision as a tensor."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
