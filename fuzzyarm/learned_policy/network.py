"""The network of a learned policy: normalised features through layers to an action in [-1, 1]².

    h_0 = clip((f - mean)/std, ±c),    h_(i+1) = s(W_i h_i + b_i),    a = o(W_n h_n + b_n),

where s is tanh, or max(x, 0), and o clips to ±1, or is tanh. PPO trains a Gaussian policy, and the last layer gives its
mean; SAC and TQC train tanh of one. The shipped policy takes the mean as its action and is therefore deterministic.

A recurrent network has a long short-term memory in front of these layers (`cell`), which then take its output for h_0.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from fuzzyarm.common.checks import choice, instance, real, shown
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.learned_policy.cell import Cell, remember
from fuzzyarm.learned_policy.functions import add_product, hyperbolic_tangent

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
        """Check shapes and numbers, and store the layers one after the other for the kernel."""
        object.__setattr__(self, "clip", real("clip", self.clip, above=0.0))
        choice("activation", self.activation, ACTIVATIONS)
        choice("output", self.output, OUTPUTS)
        for name in ("weights", "biases"):
            for array in instance(name, getattr(self, name), tuple):
                _numbers(name, array)
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
        layers = [part for pair in zip(self.weights, self.biases, strict=True) for part in (pair[0].T, pair[1])]
        flat = np.concatenate([np.ravel(part) for part in layers]).astype(np.float64)
        normaliser = np.array(self.mean, dtype=np.float64), np.array(self.std, dtype=np.float64), float(self.clip)
        layers_of = np.array(self.sizes if self.cell is None else self.sizes[1:]), flat, *self._kinds
        object.__setattr__(self, "_normaliser", normaliser)
        object.__setattr__(self, "_layers", layers_of)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Widths of the layers, from the inputs to the outputs; the cell's output counts as one."""
        return (len(self.mean), *(() if self.cell is None else (self.cell.hidden,)), *map(len, self.biases))

    @property
    def memory_size(self) -> int:
        """Numbers that a lane remembers from one action to the next, all zero when an episode begins."""
        return 0 if self.cell is None else self.cell.memory_size

    @property
    def _kinds(self) -> tuple[bool, bool]:
        """Whether s is max(x, 0), and whether o is tanh."""
        return self.activation == "relu", self.output == "tanh"

    def act(self, features: np.ndarray, action: np.ndarray, memory: np.ndarray | None = None) -> None:
        """Fill `action` (lanes, outputs) from `features` (lanes, inputs).

        A recurrent network advances its `memory` (lanes, memory_size) in place.
        """
        normaliser, layers = self._normaliser, self._layers  # type: ignore[attr-defined]
        if self.cell is None:
            _forward(features, *normaliser, *layers, action)
        else:
            seen, hidden = np.empty((len(features), self.cell.hidden)), self.cell.hidden
            remember(features, *normaliser, *self.cell.arguments, memory, seen)
            # What the cell gives lies within ±1, so that nothing is changed here.
            _forward(seen, np.zeros(hidden), np.ones(hidden), 1.0, *layers, action)


@kernel
def _forward(
    features: np.ndarray,
    mean: np.ndarray,
    std: np.ndarray,
    clip: float,
    sizes: np.ndarray,
    flat: np.ndarray,
    rectified: bool,
    squashed: bool,
    action: np.ndarray,
) -> None:
    """See the module; `flat` holds W_i^T, row by row, and b_i of each layer, one after the other.

    Lane by lane, so that an action does not depend on how many lanes there are.
    """
    before, after, layers = np.empty(sizes.max()), np.empty(sizes.max()), len(sizes) - 1
    for lane in range(len(features)):
        for k in range(sizes[0]):
            before[k] = min(max((features[lane, k] - mean[k]) / std[k], -clip), clip)
        place = 0
        for layer in range(layers):
            inputs, outputs = sizes[layer], sizes[layer + 1]
            bias = place + inputs * outputs
            sums = after[:outputs]
            for j in range(outputs):  # assigned at once they compile the text of an error, for seconds
                sums[j] = flat[bias + j]
            add_product(before[:inputs], flat[place:bias].reshape((inputs, outputs)), sums)
            place = bias + outputs
            if layer == layers - 1:
                for j in range(outputs):
                    action[lane, j] = hyperbolic_tangent(sums[j]) if squashed else min(max(sums[j], -1.0), 1.0)
            elif rectified:
                for j in range(outputs):
                    before[j] = max(sums[j], 0.0)
            else:
                for j in range(outputs):
                    before[j] = hyperbolic_tangent(sums[j])


def _numbers(name: str, array: Any) -> None:
    """Check that something is an array of real numbers; TypeError otherwise."""
    if instance(name, array, np.ndarray).dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers; it holds {shown(array.dtype)}")
