"""Torch tensors as numbers of the physics: angles with their rounding errors, random 64-bit words, and tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from fuzzyarm.numbers.functions import KINDS

__all__ = ["Angle", "TorchTable", "TorchWord"]


class Angle:
    """An angle (lanes,) [rad] in float32 with its rounding error (Kahan's compensated sum).

    The physics adds increments of a hundred-thousandth of an angle's size. In an episode of the paper the tip is off by
    up to 4 µm in plain float32, and by 0.1 µm if the rounding errors are kept.

    Adding an increment gives an angle; all other operations give tensors.
    `value` is the rounded angle, `rest` the exact angle minus `value`.
    """

    def __init__(self, value: Tensor, rest: Tensor) -> None:
        self.value, self.rest = value, rest

    def __add__(self, other: Any) -> Any:
        return self.value + other.value if isinstance(other, Angle) else self.advanced(other)

    @classmethod
    def __torch_function__(cls, function: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        """Return tensor + angle, tensor <= angle or tensor >= angle: torch.compile may put the `Angle` second."""
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
        """Return the angle plus an increment [rad]; `rest` is exact if |increment| is below |angle|."""
        part = increment + self.rest
        value = self.value + part
        return Angle(value, part - (value - self.value))

    def sin(self) -> Tensor:
        """Return the sine (lanes,) of the rounded angle."""
        return self.value.sin()

    def cos(self) -> Tensor:
        """Return the cosine (lanes,) of the rounded angle."""
        return self.value.cos()


class TorchTable:
    """A table of numbers (rows, columns) that is looked up lane by lane, in the dtype and on the device of `like`.

    A column of equal values is a constant to the compiler.
    """

    def __init__(self, rows: np.ndarray, like: Tensor) -> None:
        same = np.all(rows == rows[0], axis=0)
        self.constants = tuple(rows[0, k].item() if same[k] else None for k in range(rows.shape[1]))
        self.tensor = torch.tensor(rows[:, ~same], dtype=like.dtype, device=like.device)

    @property
    def dtype(self) -> torch.dtype:
        """The dtype of every number looked up."""
        return self.tensor.dtype

    def at(self, place: Tensor) -> list[Tensor]:
        """Return each column at the row indices `place` (n,), of shape (n,), or () for a constant column."""
        columns: list[Tensor] = []
        looked_up = 0
        for constant in self.constants:
            columns.append(self.tensor[place, looked_up] if constant is None else self.number(constant))
            looked_up += constant is None
        return columns

    def number(self, value: float) -> Tensor:
        """Return `value` as a tensor () in the table's dtype: a float times a bool tensor has torch's default dtype."""
        return self.tensor.new_full((), value)


class TorchWord:
    """Unsigned 64-bit words for `fuzzyarm.envs.batch.randomness`, since torch has no arithmetic for its uint64.

    The words are stored as int64, which computes like uint64 except for shifts. `bits` has the shape (lanes,); `dtype`
    is that of numbers converted from the words.
    """

    def __init__(self, bits: Tensor, dtype: torch.dtype) -> None:
        self.bits, self.dtype = bits, dtype

    def __add__(self, other: Any) -> TorchWord:
        return TorchWord(self.bits + _bits(other), self.dtype)

    def __mul__(self, other: Any) -> TorchWord:
        return TorchWord(self.bits * _bits(other), self.dtype)

    def __xor__(self, other: Any) -> TorchWord:
        return TorchWord(self.bits ^ _bits(other), self.dtype)

    def __rshift__(self, places: int) -> TorchWord:
        return TorchWord((self.bits >> places) & ((1 << (64 - places)) - 1), self.dtype)


def _bits(other: Any) -> Any:
    return other.bits if isinstance(other, TorchWord) else (other + 2**63) % 2**64 - 2**63


class _Tensors:
    """The functions of `numbers.functions` for tensors."""

    @staticmethod
    def select(condition: Tensor, first: Any, second: Any) -> Any:
        if isinstance(first, Angle):
            value, rest = (second.value, second.rest) if isinstance(second, Angle) else (second, 0.0)
            return Angle(torch.where(condition, first.value, value), torch.where(condition, first.rest, rest))
        if not isinstance(first, Tensor) and not isinstance(second, Tensor):  # torch would round them to float32
            first = torch.tensor(first, dtype=torch.float64, device=condition.device)
        return torch.where(condition, first, second)

    @staticmethod
    def floor(x: Tensor) -> Tensor:
        return x.floor()

    @staticmethod
    def whole(x: Tensor) -> TorchWord:
        return TorchWord(x.to(torch.int64), torch.float64)


class _Words:
    """The functions of `numbers.functions` for `TorchWord`."""

    @staticmethod
    def number(of: TorchWord) -> Tensor:
        """Return a word below 2^53 as a float; in float32 its lower 29 bits are cleared, lest rounding give 2^53."""
        exact = of.bits if of.dtype == torch.float64 else of.bits & -(1 << 29)
        return exact.to(of.dtype)


KINDS[Tensor], KINDS[TorchWord] = _Tensors, _Words
