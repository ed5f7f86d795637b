"""The network of `learned-observer` in torch: over sequences, for its regression, and its slopes at a point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch

from fuzzyarm.learned_policy.estimate.network import EstimateNetwork, shapes_of
from fuzzyarm.learned_policy.estimate.signals import MOTION, QUIET, UNEXPLAINED_PARTS

__all__ = ["Slopes", "Student"]

_GATE = -2.0  # of s at the beginning: a memory of about eight samples


class Slopes(NamedTuple):
    """The derivatives of (h⁺, ρ) by (h, z) at points (points,).

    Attributes:
        h_h: (points, hidden, hidden).
        h_z: (points, hidden, z).
        rho_h: (points, 2, hidden).
        rho_z: (points, 2, z).
    """

    h_h: torch.Tensor
    h_z: torch.Tensor
    rho_h: torch.Tensor
    rho_z: torch.Tensor


class Student(torch.nn.Module):
    """The equations of `fuzzyarm.learned_policy.estimate.network`.

    Args:
        hidden: numbers in h.
        modulation: numbers in tanh(P c).
        generator: of the first weights; V and D begin at zero, so the residual does.
    """

    gate_z: torch.Tensor
    gate_h: torch.Tensor
    gate_c: torch.Tensor
    gate_bias: torch.Tensor
    A: torch.Tensor
    B: torch.Tensor
    C: torch.Tensor
    U: torch.Tensor
    V: torch.Tensor
    D: torch.Tensor
    P: torch.Tensor
    p_0: torch.Tensor
    W: torch.Tensor

    def __init__(self, hidden: int, modulation: int, generator: torch.Generator) -> None:
        """Draw the weights."""
        super().__init__()
        for name, shape in shapes_of(hidden, modulation).items():
            if len(shape) == 1 or name in "VD":
                tensor = torch.zeros(shape)
            else:
                tensor = torch.randn(shape, generator=generator) / math.sqrt(shape[1])
            setattr(self, name, torch.nn.Parameter(tensor))
        with torch.no_grad():
            self.gate_bias[:hidden] = _GATE

    def network(self) -> EstimateNetwork:
        """Return the network as it is shipped, in single precision."""
        return EstimateNetwork(**{name: value.detach().numpy().copy() for name, value in self.named_parameters()})

    def forward(
        self, z: torch.Tensor, c: torch.Tensor, h: torch.Tensor, begins: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return ρ before it is clipped (steps, lanes, 2) and h⁺ (steps, lanes, hidden).

        Args:
            z: (steps, lanes, numbers of z).
            c: (steps, lanes, numbers of c).
            h: (lanes, hidden) before the first step.
            begins: (steps, lanes, 1), 0 where an episode begins, else 1.
        """
        # Tensors are taken apart before the loop: an index within it would have a derivative as large as the whole.
        gates = (z @ self.gate_z.T + c @ self.gate_c.T + self.gate_bias).unbind()
        candidate = (z @ self.A.T + (c @ self.C.T) * (z @ self.B.T)).unbind()
        gate_h, kept, states = self.gate_h.T, self.U.T, []
        for at_gate, at_candidate, begin in zip(gates, candidate, begins.unbind(), strict=True):
            h = h * begin
            s, r = torch.sigmoid(torch.addmm(at_gate, h, gate_h)).chunk(2, dim=1)
            h = torch.lerp(h, torch.tanh(torch.addcmul(at_candidate, r, h @ kept)), s)
            states.append(h)
        after = torch.stack(states)
        return (c[..., MOTION, None] * _heard(z)) * ((after * self._weights(c)) @ self.V.T + z @ self.D.T), after

    def _weights(self, c: torch.Tensor) -> torch.Tensor:
        return 1.0 + torch.tanh(c @ self.P.T + self.p_0) @ self.W.T

    def slopes(self, z: torch.Tensor, c: torch.Tensor, h: torch.Tensor) -> Slopes:
        """Return the derivatives at points z (points, ·), c (points, ·) and h (points, hidden), in double precision."""
        p = {name: value.double() for name, value in self.named_parameters()}
        hidden = len(p["U"])
        open_ = torch.sigmoid(z @ p["gate_z"].T + h @ p["gate_h"].T + c @ p["gate_c"].T + p["gate_bias"])
        s, r = open_[:, :hidden, None], open_[:, hidden:, None]
        turned, kept = (c @ p["C"].T)[:, :, None], (h @ p["U"].T)[:, :, None]
        n = torch.tanh(z @ p["A"].T + turned[..., 0] * (z @ p["B"].T) + r[..., 0] * kept[..., 0])[:, :, None]
        bend = 1.0 - n * n
        gate_s, gate_r = s * (1.0 - s) * (n - h[:, :, None]), kept * r * (1.0 - r)
        n_z = bend * (p["A"] + turned * p["B"] + gate_r * p["gate_z"][hidden:])
        n_h = bend * (r * p["U"] + gate_r * p["gate_h"][hidden:])
        unit = torch.eye(hidden, dtype=torch.float64)
        h_z = s * n_z + gate_s * p["gate_z"][:hidden]
        h_h = (1.0 - s) * unit + s * n_h + gate_s * p["gate_h"][:hidden]
        w = 1.0 + torch.tanh(c @ p["P"].T + p["p_0"]) @ p["W"].T
        moving, heard, load = c[:, MOTION, None, None], _heard(z)[:, :, None], z[:, None, UNEXPLAINED_PARTS.load]
        after = h[:, :, None] + s * (n - h[:, :, None])
        weighed = p["V"] * w[:, None, :]
        answer = weighed @ after + (z @ p["D"].T)[:, :, None]
        out, rho_z = moving * heard * weighed, moving * heard * p["D"].expand(len(z), -1, -1)
        by_load = torch.zeros_like(rho_z)
        by_load[:, :, UNEXPLAINED_PARTS.load] = moving * answer * 2.0 * load * (1.0 - heard) ** 2 / (QUIET * QUIET)
        return Slopes(h_h, h_z, out @ h_h, out @ h_z + rho_z + by_load)


def _heard(z: torch.Tensor) -> torch.Tensor:
    """Return g (..., 1) of z (..., numbers of z), see `network`."""
    square = z[..., UNEXPLAINED_PARTS.load].square().sum(-1, keepdim=True)
    return square / (square + QUIET * QUIET)


def as_tensor(array: np.ndarray) -> torch.Tensor:
    """Return an array in single precision as a tensor."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
