"""The network of a learned policy: normalised features through layers to an action in [-1, 1]².

    h_0 = clip((f - mean)/std, ±c),    h_(i+1) = s(W_i h_i + b_i),    a = o(W_n h_n + b_n),

where s is tanh, or max(x, 0), and o clips to ±1, or is tanh. PPO trains a Gaussian policy, and the last layer gives its
mean; SAC and TQC train tanh of one. The shipped policy takes the mean as its action and is therefore deterministic.

A recurrent network has a long short-term memory in front of these layers (`cell`), which then take its output for h_0.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import choice, instance, real, shown
from fuzzyarm.learned_policy.cell import Cell
from fuzzyarm.learned_policy.functions import add_product, hyperbolic_tangent
from fuzzyarm.numbers.functions import Cells, array, each, maximum, minimum
from fuzzyarm.numbers.machine import Kernel
from fuzzyarm.numbers.program import Program

__all__ = ["ACTIVATIONS", "OUTPUTS", "Network"]

ACTIVATIONS = ("tanh", "relu")
"""What s may be."""

OUTPUTS = ("clip", "tanh")
"""What o may be."""

_LARGEST_LAYER, _MOST_LAYERS = 4096, 9  # far beyond need; a larger network is refused before memory is allocated


@dataclasses.dataclass(frozen=True, eq=False)
class Network:
    """Normaliser and layers.

    Attributes:
        mean: (inputs,) of the features.
        std: (inputs,) of the features, positive.
        clip: c, the bound of the normalised features, positive.
        weights: W_i, (outputs, inputs) of each layer.
        biases: b_i, (outputs,) of each layer.
        activation: s, of `ACTIVATIONS`.
        output: o, of `OUTPUTS`.
        cell: what remembers in front of the layers; None: nothing does.

    Raises:
        ValueError: shapes do not fit together, or a number is not finite or has the wrong sign.
    """

    mean: np.ndarray
    std: np.ndarray
    clip: float
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    activation: str = "tanh"
    output: str = "clip"
    cell: Cell | None = None

    def __post_init__(self) -> None:
        """Check shapes and numbers."""
        object.__setattr__(self, "clip", real("clip", self.clip, above=0.0))
        choice("activation", self.activation, ACTIVATIONS)
        choice("output", self.output, OUTPUTS)
        for name in ("weights", "biases"):
            for one in instance(name, getattr(self, name), tuple):
                _numbers(name, one)
        for name in ("mean", "std"):
            _numbers(name, getattr(self, name))
        if self.mean.ndim != 1 or any(bias.ndim != 1 for bias in self.biases):
            raise ValueError("mean and biases must have one axis")
        if not 1 <= len(self.weights) <= _MOST_LAYERS or len(self.biases) != len(self.weights):
            raise ValueError(
                f"{len(self.weights)} weights and {len(self.biases)} biases; allowed: 1 to {_MOST_LAYERS} layers"
            )
        width, shapes = len(self.mean), [np.shape(self.mean), np.shape(self.std)]
        expected: list[tuple[int, ...]] = [(width,), (width,)]
        if self.cell is not None:
            shapes.append(self.cell.weight_x.shape)
            expected.append((self.cell.weight_x.shape[0], width))
            width = self.cell.hidden
        for weight, bias in zip(self.weights, self.biases, strict=True):
            outputs = len(bias)
            shapes += [weight.shape, bias.shape]
            expected += [(outputs, width), (outputs,)]
            width = outputs
        if shapes != expected:
            raise ValueError(f"shapes of mean, std, weights and biases are {shapes}; they must be {expected}")
        if not 1 <= max(self.sizes) <= _LARGEST_LAYER:
            raise ValueError(f"layers of {self.sizes}; allowed: 1 to {_LARGEST_LAYER} in each")
        numbers = (self.mean, self.std, np.array(self.clip), *self.weights, *self.biases)
        if not all(np.isfinite(array).all() for array in numbers):
            raise ValueError("a mean, std, weight or bias is not finite")
        if not (np.all(self.std > 0.0) and self.clip > 0.0):
            raise ValueError("std and clip must be positive")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Widths of the layers, from the inputs to the outputs; the cell's output counts as one."""
        return (len(self.mean), *(() if self.cell is None else (self.cell.hidden,)), *map(len, self.biases))

    @property
    def memory_size(self) -> int:
        """Numbers that a lane remembers from one action to the next, all zero when an episode begins."""
        return 0 if self.cell is None else self.cell.memory_size

    @functools.cached_property
    def tables(self) -> tuple[np.ndarray, ...]:
        """What `output` takes, in double precision: mean, std, the arrays of the cell, W_i^T and b_i of each layer."""
        layers = [part for pair in zip(self.weights, self.biases, strict=True) for part in (pair[0].T, pair[1])]
        cell = () if self.cell is None else self.cell.tables
        return tuple(np.array(part, dtype=np.float64, order="C") for part in (self.mean, self.std, *cell, *layers))

    @property
    def memory(self) -> Any:
        """The place of what is remembered."""
        return Cells((self.memory_size,)) if self.cell is not None else ()

    def outputs(self, features: Any, memory: Any, *tables: Any) -> tuple[Any, ...]:
        """Return the action from features, an array (inputs,); `memory` of a recurrent network changes in place."""
        mean, std, *layers = tables
        before, sizes = array(len(mean)), self.sizes
        for k in each(len(mean)):
            before[k] = minimum(maximum((features[k] - mean[k]) / std[k], -self.clip), self.clip)
        if self.cell is not None:
            before, layers = self.cell.advance(before, memory, *layers[: len(self.cell.tables)]), layers[3:]
            sizes = sizes[1:]
        last = len(sizes) - 2
        for layer, outputs in enumerate(sizes[1:]):
            sums, (transposed, bias) = array(outputs), layers[2 * layer : 2 * layer + 2]
            for j in each(outputs):
                sums[j] = bias[j]
            add_product(before, transposed, sums)
            if layer < last:
                for j in each(outputs):
                    sums[j] = maximum(sums[j], 0.0) if self.activation == "relu" else hyperbolic_tangent(sums[j])
            before = sums
        if self.output == "tanh":
            return tuple(map(hyperbolic_tangent, before))
        return tuple(minimum(maximum(number, -1.0), 1.0) for number in before)

    def act(self, features: np.ndarray, action: np.ndarray, memory: np.ndarray | None = None) -> None:
        """Fill `action` (lanes, outputs) from `features` (lanes, inputs).

        A recurrent network advances its `memory` (lanes, memory_size) in place.
        """
        held = np.empty((len(features), 0)) if memory is None else memory
        self._kernel((features, held, action), np.empty(0), self.tables)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the machine code."""
        return {name: value for name, value in self.__dict__.items() if name != "_kernel"}

    @functools.cached_property
    def _kernel(self) -> Kernel:
        def act(features: Any, memory: Any, _: Any, __: Any, *tables: Any) -> tuple[Any, ...]:
            return features, memory, self.outputs(features, memory, *tables)

        ports = Cells((len(self.mean),)), self.memory, (0.0,) * self.sizes[-1]
        return Kernel(Program(act, ports, (), [table.shape for table in self.tables]))


def _numbers(name: str, array: Any) -> None:
    """Check that something is an array of real numbers; TypeError otherwise."""
    if instance(name, array, np.ndarray).dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers; it holds {shown(array.dtype)}")
