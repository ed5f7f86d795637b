"""The network of a learned policy, from normalised features through layers to actions in [-1, 1], one per joint.

    h_0 = clip((f - mean)/std, ±c),    h_(i+1) = s(W_i h_i + b_i),    a = o(W_n h_n + b_n),

where s is tanh or max(x, 0), and o is tanh or clips to ±1. PPO trains a Gaussian policy, with its mean from the last
layer; SAC and TQC train the tanh of a Gaussian.

tanh, the logistic function and asinh are computed from +, -, *, / and the square root, which IEEE 754 rounds correctly,
not by the C library, whose last digits differ between machines.

A recurrent network has a long short-term memory (`cell`) in front of these layers, as in torch and
stable-baselines3-contrib. The output h of the cell is then h_0. With the normalised features
x = clip((f - mean)/std, ±c) and the cell's content m (h and m are zero when an episode begins),

    (i, r, g, o) = W_x x + W_h h + b,    m⁺ = σ(r)∘m + σ(i)∘tanh g,    h⁺ = σ(o)∘tanh m⁺.
"""

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from fuzzyarm.common.checks import choice, finite_array, instance, real, shown
from fuzzyarm.envs.physics.elementwise import root, select
from fuzzyarm.numbers.functions import RECORDERS, Cells, apart, array, each, maximum, minimum

__all__ = ["Cell", "Network", "add_product", "area_sine", "hyperbolic_tangent", "logistic", "real_array"]

_SATURATED = 20.0  # from here on tanh is 1 in double precision
_DOUBLINGS = 8  # of exp(y) - 1 with |y| <= 2 _SATURATED/2^8
_LARGEST = 2.0**60  # a larger argument of asinh counts as this one
_SQRT_2 = math.sqrt(2.0)
_HALVINGS = tuple((2.0**k, 2.0**-k, float(k)) for k in (32, 16, 8, 4, 2, 1))
_LN_2 = (float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33"))  # 1024 times the first is exact


@apart
def hyperbolic_tangent(x: Any) -> Any:
    """Return tanh x = -E/(E + 2) with E = exp(-2|x|) - 1 and the sign of x; relative error below 2e-15.

    E(y) = exp(y) - 1 is computed by its Taylor polynomial of degree 11 for y = -2|x|/2^8, and E(2y) = E(y) (E(y) + 2).
    """
    size = abs(x)
    y = select(size > _SATURATED, _SATURATED, size) * (-2.0 / 2.0**_DOUBLINGS)
    y2 = y * y
    y4 = y2 * y2
    low = (1 / 2 + y * (1 / 6)) + y2 * (1 / 24 + y * (1 / 120))
    middle = (1 / 720 + y * (1 / 5040)) + y2 * (1 / 40320 + y * (1 / 362880))
    total = y + y2 * (low + y4 * (middle + y4 * (1 / 3628800 + y * (1 / 39916800))))
    for _ in range(_DOUBLINGS):
        total = total * (total + 2.0)
    result = total / (total + 2.0)
    return select(x > 0.0, -result, result)


@apart
def logistic(x: Any) -> Any:
    """Return 1/(1 + exp(-x)) = (1 + tanh(x/2))/2; absolute error below 1e-15."""
    return 0.5 + 0.5 * hyperbolic_tangent(0.5 * x)


@apart
def area_sine(x: Any) -> Any:
    """Return asinh x = ln(1 + f), f = |x| + x²/(1 + √(1 + x²)), with the sign of x; relative error below 1e-15.

    With 1 + f = 2^k (1 + g) and 1/√2 < 1 + g <= √2, ln(1 + f) = k ln 2 + 2 artanh(g/(g + 2)), where artanh is a Taylor
    polynomial of degree 21. An |x| beyond 2^60 counts as 2^60.
    """
    size = select(abs(x) > _LARGEST, _LARGEST, abs(x))
    square = size * size
    f = size + square / (1.0 + root(1.0 + square))
    m, count = 1.0 + f, 0.0
    for power, inverse, k in _HALVINGS:
        large = m >= power
        m, count = select(large, m * inverse, m), select(large, count + k, count)
    upper = m > _SQRT_2
    m, count = select(upper, 0.5 * m, m), select(upper, count + 1.0, count)
    g = select(count == 0.0, f, m - 1.0)
    s = g / (g + 2.0)
    z = s * s
    z2 = z * z
    z4 = z2 * z2
    low = (2 / 3 + z * (2 / 5)) + z2 * (2 / 7 + z * (2 / 9))
    middle = (2 / 11 + z * (2 / 13)) + z2 * (2 / 15 + z * (2 / 17))
    total = z * (low + z4 * (middle + z4 * (2 / 19 + z * (2 / 21))))
    result = count * _LN_2[0] + ((2.0 * s + s * total) + count * _LN_2[1])
    return select(x < 0.0, -result, result)


def add_product(x: Any, transposed: Any, y: Any) -> None:
    """Add G x to y (rows,), with Gᵀ given as `transposed` (columns, rows); each pass adds four terms to y_j."""
    columns, rows = len(x), len(y)
    if RECORDERS and hasattr(RECORDERS[-1], "rolled"):
        RECORDERS[-1].rolled("add_product", (x, transposed, y), (False, False, True))
        return
    for block in each(columns // 4):
        k = 4 * block
        for j in each(rows):
            two = (y[j] + transposed[k, j] * x[k]) + transposed[k + 1, j] * x[k + 1]
            y[j] = (two + transposed[k + 2, j] * x[k + 2]) + transposed[k + 3, j] * x[k + 3]
    for k in range(columns - columns % 4, columns):
        for j in each(rows):
            y[j] = y[j] + transposed[k, j] * x[k]


_GATES = 4  # i, r, g and o
_CONTENT = 2  # the index of g

_LARGEST_MEMORY = 1024  # entries of h; a larger cell is refused before memory is allocated


def real_array(name: str, array: Any, axes: int) -> None:
    """Check that a value is an array of real numbers with `axes` axes; TypeError or ValueError otherwise."""
    if instance(name, array, np.ndarray).dtype.kind not in "fiu":
        raise TypeError(f"{name} must contain real numbers, not {shown(array.dtype)}")
    if array.ndim != axes:
        raise ValueError(f"{name} has {array.ndim} dimension(s); needed: {axes}")


@dataclasses.dataclass(frozen=True, eq=False)
class Cell:
    """The arrays of the recurrent equations in the module's docstring; the rows are for i, then for r, g and o."""

    weight_x: np.ndarray  # W_x, (4 hidden, inputs)
    weight_h: np.ndarray  # W_h, (4 hidden, hidden)
    bias: np.ndarray  # b, (4 hidden,)

    def __post_init__(self) -> None:
        for name, axes in (("weight_x", 2), ("weight_h", 2), ("bias", 1)):
            real_array(name, getattr(self, name), axes)
        if not 1 <= self.hidden <= _LARGEST_MEMORY:
            raise ValueError(f"weight_h has {self.hidden} columns; allowed: 1 to {_LARGEST_MEMORY}")
        for field in dataclasses.fields(self):
            array = getattr(self, field.name)
            finite_array(field.name, array, (_GATES * self.hidden, *array.shape[1:]))

    @property
    def hidden(self) -> int:
        """Number of entries of h, and of m."""
        return int(self.weight_h.shape[1])

    @functools.cached_property
    def tables(self) -> tuple[np.ndarray, ...]:
        """The last arguments of `advance`, in double precision: the transposed matrices, and b."""
        arrays = self.weight_x.T, self.weight_h.T, self.bias
        return tuple(np.array(array, dtype=np.float64, order="C") for array in arrays)

    def advance(self, x: Any, memory: Any, of_x: Any, of_h: Any, bias: Any) -> Any:
        """Return h⁺ (hidden,) for x (inputs,) and the arrays in `tables`; advance `memory` (2 hidden,), h, then m."""
        hidden, sums, output = self.hidden, array(_GATES * self.hidden), array(self.hidden)
        for k in each(len(sums)):
            sums[k] = bias[k]
        add_product(x, of_x, sums)
        add_product(memory[:hidden], of_h, sums)
        for gate in range(_GATES):
            # σ(a) = (1 + tanh(a/2))/2
            scale, shift = (1.0, 0.0) if gate == _CONTENT else (0.5, 0.5)
            for k in each(hidden):
                at = k + gate * hidden
                sums[at] = shift + scale * hyperbolic_tangent(scale * sums[at])
        for k in each(hidden):
            content = sums[k + hidden] * memory[k + hidden] + sums[k] * sums[k + 2 * hidden]
            memory[k + hidden] = content
            output[k] = sums[k + 3 * hidden] * hyperbolic_tangent(content)
            memory[k] = output[k]
        return output


_ACTIVATIONS = ("tanh", "relu")  # what s may be
_OUTPUTS = ("clip", "tanh")  # what o may be
_LARGEST_LAYER, _MOST_LAYERS = 4096, 9  # far beyond need; a larger network is refused before memory is allocated


@dataclasses.dataclass(frozen=True, eq=False)
class Network:
    """Normaliser, layers and recurrent cell of a network; shapes and values are checked."""

    mean: np.ndarray  # (inputs,) of the features
    std: np.ndarray  # (inputs,) of the features, positive
    clip: float  # c, the bound of the normalised features, positive
    weights: tuple[np.ndarray, ...]  # W_i, (outputs, inputs) of each layer
    biases: tuple[np.ndarray, ...]  # b_i, (outputs,) of each layer
    activation: str = "tanh"  # s, of `_ACTIVATIONS`
    output: str = "clip"  # o, of `_OUTPUTS`
    cell: Cell | None = None  # recurrent cell in front of the layers; None: no memory

    def __post_init__(self) -> None:
        object.__setattr__(self, "clip", real("clip", self.clip, above=0.0))
        choice("activation", self.activation, _ACTIVATIONS)
        choice("output", self.output, _OUTPUTS)
        for bias in instance("biases", self.biases, tuple):
            real_array("biases", bias, 1)
        if not 1 <= len(self.weights) <= _MOST_LAYERS or len(self.biases) != len(self.weights):
            raise ValueError(
                f"the network has {len(self.weights)} weight matrices and {len(self.biases)} bias vectors; needed: one "
                f"of each for every layer, and 1 to {_MOST_LAYERS} layers"
            )
        if not 1 <= min(self.sizes) <= max(self.sizes) <= _LARGEST_LAYER:
            raise ValueError(f"the layers have the widths {self.sizes}; allowed: 1 to {_LARGEST_LAYER} each")
        inputs, *widths = self.sizes
        for name in ("mean", "std"):
            finite_array(name, getattr(self, name), (inputs,))
        if self.cell is not None:
            finite_array("weight_x", self.cell.weight_x, (len(self.cell.weight_x), inputs))
            inputs, *widths = widths
        for number, (weight, bias, outputs) in enumerate(zip(self.weights, self.biases, widths, strict=True)):
            finite_array(f"layer {number}: weight", weight, (outputs, inputs))
            finite_array(f"layer {number}: bias", bias, (outputs,))
            inputs = outputs
        if not np.all(self.std > 0.0):
            raise ValueError("std, the standard deviations of the features, must contain only positive numbers")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of inputs, then the width of each layer; the cell counts as a layer, as wide as its output."""
        return (len(self.mean), *(() if self.cell is None else (self.cell.hidden,)), *map(len, self.biases))

    @functools.cached_property
    def tables(self) -> tuple[np.ndarray, ...]:
        """Arguments of `outputs`, in double precision: mean, std, the cell's arrays, W_i^T and b_i of each layer."""
        layers = [part for pair in zip(self.weights, self.biases, strict=True) for part in (pair[0].T, pair[1])]
        cell = () if self.cell is None else self.cell.tables
        return tuple(np.array(part, dtype=np.float64, order="C") for part in (self.mean, self.std, *cell, *layers))

    @property
    def memory(self) -> Any:
        """The layout of a lane's memory: the recurrent cell's h, then m, zeros at first; () if there is no cell."""
        return Cells((2 * self.cell.hidden,)) if self.cell is not None else ()

    def outputs(self, features: Any, memory: Any, *tables: Any) -> tuple[Any, ...]:
        """Return the action for `features` (inputs,) and the arrays `tables`; a recurrent cell changes `memory`."""
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
