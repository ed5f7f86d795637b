"""The memory of a recurrent network: a long short-term memory, as torch and stable-baselines3-contrib have it.

With the normalised features x = clip((f - mean)/std, ±c), the output h and the content m (both zero when an episode
begins),

    (i, r, g, o) = W_x x + W_h h + b,    m⁺ = σ(r)∘m + σ(i)∘tanh g,    h⁺ = σ(o)∘tanh m⁺.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from fuzzyarm.common.checks import finite_array, instance, shown
from fuzzyarm.envs.physics.compiled import kernel
from fuzzyarm.learned_policy.functions import add_product, hyperbolic_tangent

__all__ = ["GATES", "LARGEST_MEMORY", "Cell", "remember"]

GATES = 4
"""i, r, g and o."""
_CONTENT = 2  # the number of g

LARGEST_MEMORY = 1024
"""Numbers in h; a larger cell is refused before memory is allocated."""


@dataclasses.dataclass(frozen=True, eq=False)
class Cell:
    """The arrays of the module's equations, the rows of i, r, g and o below each other.

    Attributes:
        weight_x: W_x, (4 hidden, inputs).
        weight_h: W_h, (4 hidden, hidden).
        bias: b, (4 hidden,).

    Raises:
        TypeError: an entry is no array of real numbers.
        ValueError: shapes do not fit together, or a number is not finite.
    """

    weight_x: np.ndarray
    weight_h: np.ndarray
    bias: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes and numbers."""
        for field in dataclasses.fields(self):
            if instance(field.name, getattr(self, field.name), np.ndarray).dtype.kind not in "fiu":
                raise TypeError(f"{field.name} must hold real numbers; it holds {shown(getattr(self, field.name))}")
        if self.weight_x.ndim != 2 or self.weight_h.ndim != 2:
            raise ValueError(
                f"weight_x and weight_h have {self.weight_x.ndim} and {self.weight_h.ndim} axes; needed: 2"
            )
        if not 1 <= self.hidden <= LARGEST_MEMORY:
            raise ValueError(f"weight_h has {self.hidden} columns; allowed: 1 to {LARGEST_MEMORY}")
        rows = GATES * self.hidden
        for name, shape in (
            ("weight_x", (rows, self.weight_x.shape[1])),
            ("weight_h", (rows, self.hidden)),
            ("bias", (rows,)),
        ):
            finite_array(name, getattr(self, name), shape)

    @property
    def hidden(self) -> int:
        """Numbers in h, and in m."""
        return int(self.weight_h.shape[1])

    @property
    def memory_size(self) -> int:
        """Numbers that a lane remembers: h, then m."""
        return 2 * self.hidden

    @functools.cached_property
    def arguments(self) -> tuple[np.ndarray, ...]:
        """What `remember` takes behind the normaliser, in double precision: the matrices transposed, and b."""
        arrays = self.weight_x.T, self.weight_h.T, self.bias
        return tuple(np.array(array, dtype=np.float64, order="C") for array in arrays)


@kernel
def remember(
    features: np.ndarray,
    mean: np.ndarray,
    std: np.ndarray,
    clip: float,
    of_x: np.ndarray,
    of_h: np.ndarray,
    bias: np.ndarray,
    memory: np.ndarray,
    output: np.ndarray,
) -> None:
    """Advance the memory (lanes, 2 hidden) by features (lanes, inputs), and fill `output` (lanes, hidden) with h⁺.

    h and m are pure numbers. Lane by lane, so that nothing depends on how many lanes there are.
    """
    inputs, hidden = len(mean), len(of_h)
    x, h, sums = np.empty(inputs), np.empty(hidden), np.empty(len(bias))
    for lane in range(len(features)):
        for k in range(inputs):
            x[k] = min(max((features[lane, k] - mean[k]) / std[k], -clip), clip)
        for k in range(hidden):
            h[k] = memory[lane, k]
        for k in range(len(bias)):  # assigned at once they compile the text of an error, for seconds
            sums[k] = bias[k]
        add_product(x, of_x, sums)
        add_product(h, of_h, sums)
        for gate in range(GATES):
            # σ(a) = (1 + tanh(a/2))/2
            scale, shift = (1.0, 0.0) if gate == _CONTENT else (0.5, 0.5)
            for k in range(gate * hidden, (gate + 1) * hidden):
                sums[k] = shift + scale * hyperbolic_tangent(scale * sums[k])
        for k in range(hidden):
            content = sums[hidden + k] * memory[lane, hidden + k] + sums[k] * sums[2 * hidden + k]
            memory[lane, hidden + k] = content
            output[lane, k] = sums[3 * hidden + k] * hyperbolic_tangent(content)
            memory[lane, k] = output[lane, k]
