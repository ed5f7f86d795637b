"""The memory of a recurrent network: a long short-term memory, as torch and stable-baselines3-contrib have it.

With the normalised features x = clip((f - mean)/std, ±c), the output h and the content m (both zero when an episode
begins),

    (i, r, g, o) = W_x x + W_h h + b,    m⁺ = σ(r)∘m + σ(i)∘tanh g,    h⁺ = σ(o)∘tanh m⁺.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from fuzzyarm.common.checks import finite_array, instance, shown
from fuzzyarm.learned_policy.functions import add_product, hyperbolic_tangent
from fuzzyarm.numbers.functions import array, each

__all__ = ["GATES", "LARGEST_MEMORY", "Cell"]

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
    def tables(self) -> tuple[np.ndarray, ...]:
        """What `advance` takes, in double precision: the matrices transposed, and b."""
        arrays = self.weight_x.T, self.weight_h.T, self.bias
        return tuple(np.array(array, dtype=np.float64, order="C") for array in arrays)

    def advance(self, x: Any, memory: Any, of_x: Any, of_h: Any, bias: Any) -> Any:
        """Return h⁺ (hidden,), an array, and advance the memory (2 hidden,), h and then m, by x (inputs,)."""
        hidden, sums, output = self.hidden, array(GATES * self.hidden), array(self.hidden)
        for k in each(len(sums)):
            sums[k] = bias[k]
        add_product(x, of_x, sums)
        add_product(memory[:hidden], of_h, sums)
        for gate in range(GATES):
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
