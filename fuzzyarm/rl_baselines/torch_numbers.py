"""Helpers of the torch arm: compensated angles, tables for look-up, and random streams."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from fuzzyarm.envs.batch import randomness
from fuzzyarm.envs.physics.elementwise import root, sine_cosine

__all__ = ["Angle", "Table", "normal_pair", "uniform", "word"]


class Angle:
    """An angle (lanes,) [rad] in float32, and beside it what float32 could not hold of it (Kahan's compensated sum).

    The physics adds increments to angles, a hundred-thousandth of their size, and takes differences of about that
    size. In plain float32 the tip is off by up to 4 µm in an episode of the paper; with the rest by 0.1 µm.

    It supports the arithmetic that the physics uses: an increment may be added, angles may be added and subtracted,
    which gives tensors, and so do sine, cosine, magnitude, a number times the angle and comparisons with limits.

    Args:
        value: the angle, rounded.
        rest: the exact angle minus `value`.
    """

    def __init__(self, value: Tensor, rest: Tensor) -> None:
        """Take both parts."""
        self.value, self.rest = value, rest

    def __add__(self, other: Any) -> Any:
        return self.value + other.value if isinstance(other, Angle) else self.advanced(other)

    @classmethod
    def __torch_function__(cls, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        """Return tensor + angle, or compare them, which is what torch.compile makes of angle + tensor and so on."""
        if function in (torch.Tensor.le, torch.Tensor.ge):
            limit, angle = arguments
            return function(limit, angle.value)
        if function not in (torch.Tensor.add, torch.Tensor.__radd__):
            return NotImplemented
        increment, angle = arguments
        return angle.advanced(increment)

    def __sub__(self, other: Angle) -> Tensor:
        return (self.value - other.value) + (self.rest - other.rest)

    def __abs__(self) -> Tensor:
        return abs(self.value)

    def __mul__(self, factor: Any) -> Any:
        return self.value * factor if isinstance(factor, float) else NotImplemented

    __rmul__ = __mul__

    def __ge__(self, limit: Any) -> Any:
        return self.value >= limit

    def __le__(self, limit: Any) -> Any:
        return self.value <= limit

    def advanced(self, increment: Tensor) -> Angle:
        """Return the angle plus an increment [rad] that is smaller than it."""
        part = increment + self.rest
        value = self.value + part
        return Angle(value, part - (value - self.value))

    def sin(self) -> Tensor:
        """Return the sine."""
        return self.value.sin()

    def cos(self) -> Tensor:
        """Return the cosine."""
        return self.value.cos()


class Table:
    """Rows of numbers to be looked up lane by lane; a column with one value throughout is a constant to the compiler.

    Args:
        rows: (rows, columns).
        like: a tensor of the dtype and on the device that the numbers shall have.
    """

    def __init__(self, rows: np.ndarray, like: Tensor) -> None:
        """Separate constant columns from the others."""
        same = np.all(rows == rows[0], axis=0)
        self.constants = tuple(rows[0, k].item() if same[k] else None for k in range(rows.shape[1]))
        self.tensor = torch.tensor(rows[:, ~same], dtype=like.dtype, device=like.device)

    @property
    def dtype(self) -> torch.dtype:
        """That of every number looked up."""
        return self.tensor.dtype

    def at(self, place: Tensor) -> list[Tensor]:
        """Return the columns of the rows `place` (n,), each of shape (n,) or ()."""
        columns: list[Tensor] = []
        looked_up = 0
        for constant in self.constants:
            if constant is None:
                columns.append(self.tensor[place, looked_up])
                looked_up += 1
            else:
                columns.append(self.number(constant))
        return columns

    def number(self, value: float) -> Tensor:
        """Return a number as a tensor of shape (); a number of Python times bool would be of torch's default dtype."""
        return self.tensor.new_full((), value)


# The streams of `randomness` on tensors. int64 computes like uint64 except for shifts; torch has no arithmetic for
# uint64.


def word(key: Tensor, counter: int | Tensor) -> Tensor:
    """Return word number `counter` of the streams `key`, both int64 of one shape: the bits of `randomness.draw`."""
    offset = (counter + 1) * _GAMMA
    mixed = key + (_wrapped(offset) if isinstance(offset, int) else offset)
    mixed = (mixed ^ _shifted(mixed, 30)) * _FIRST
    mixed = (mixed ^ _shifted(mixed, 27)) * _SECOND
    return mixed ^ _shifted(mixed, 31)


def uniform(key: Tensor, counter: int | Tensor, dtype: torch.dtype) -> Tensor:
    """Return number `counter` of the streams `key`, of their shape, in [0, 1): `randomness.uniform`.

    In float32 it is cut to its first 24 bits.
    """
    bits = 53 if dtype == torch.float64 else 24
    return _shifted(word(key, counter), 64 - bits).to(dtype) * 2.0**-bits


def normal_pair(key: Tensor, counter: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Return two independent standard normal numbers of the shape of `key`, see `randomness.normal_pair`."""
    radius = root(-2.0 * torch.log(1.0 - uniform(key, counter, dtype)))
    sine, cosine = sine_cosine(randomness.TWO_PI * uniform(key, counter + 1, dtype))
    return radius * cosine, radius * sine


def _shifted(bits: Tensor, places: int) -> Tensor:
    """Shift to the right and fill with zeros."""
    return (bits >> places) & ((1 << (64 - places)) - 1)


def _wrapped(number: int) -> int:
    """Return a number modulo 2^64 as int64 has it."""
    return (number + 2**63) % 2**64 - 2**63


_GAMMA, _FIRST, _SECOND = (_wrapped(int(x)) for x in (randomness.GAMMA, randomness.FIRST, randomness.SECOND))
