"""The values that tries are made of: extreme numbers, texts, and objects of the wrong kind."""

from __future__ import annotations

import datetime
import decimal
import fractions
import math
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["EXTREME", "TEXTS", "WRONG", "nested"]

EXTREME = (
    math.nan,
    math.inf,
    -math.inf,
    0.0,
    -0.0,
    5e-324,
    -5e-324,
    1e-300,
    1e-15,
    1e15,
    1e300,
    1.7e308,
    -1e308,
    0,
    1,
    -1,
    2,
    3,
    7,
    100,
    2**31 - 1,
    2**31,
    2**32,
    2**53 + 1,
    2**63 - 1,
    2**63,
    2**64,
    -(2**63),
    10**400,
    -(10**400),
)
TEXTS = (
    "",
    " ",
    "0",
    "1",
    "nan",
    "inf",
    "1e999",
    "0x1p4",
    "None",
    "True",
    "nominal",
    "max",
    "\x00",
    "a\x00b",
    "\n",
    "a\nb",
    "\x1b[31mred\x1b[0m",
    "\x1b]0;title\x07",
    "\u202eevil",
    "\ufeff",
    "é",
    "🙂",
    "\udcff",
    "𝟙",
    "٣",
    "../../etc/passwd",
    "/dev/zero",
    "-",
    "--",
    "--help",
    "-h",
    "=",
    "=1+1",
    "@x",
    "%s%n",
    "{0}",
    "${HOME}",
    "`id`",
    "$(id)",
    "a:b",
    "os:system",
    "abuse_canary:make",
    "abuse_canary:make.x",
    "A" * 300,
    "A" * 100_000,
    "[" * 50,
    "fuzzy-4",
    "fuzzy-4-tip",
    "none",
    ".",
    "..",
    "~",
    "*",
)


class _Raising:
    """Everything about it fails."""

    def __repr__(self) -> str:
        raise RuntimeError("no repr")

    def __float__(self) -> float:
        raise RuntimeError("no number")

    def __len__(self) -> int:
        raise RuntimeError("no length")


class _Endless(list):
    """A list that says it is longer than it is."""

    def __len__(self) -> int:
        return 2**62


class _Text(str):
    """A text of another class."""


class _Whole(int):
    """A whole number of another class."""


def _circular() -> list[Any]:
    content: list[Any] = [1.0]
    content.append(content)
    return content


def nested(levels: int = 200) -> list[Any]:
    content: list[Any] = []
    for _ in range(levels):
        content = [content]
    return content


WRONG: tuple[Callable[[], Any], ...] = (
    lambda: None,
    lambda: True,
    lambda: False,
    lambda: 1j,
    lambda: complex(1.0, 0.0),
    lambda: b"1",
    lambda: bytearray(2),
    lambda: decimal.Decimal("1.5"),
    lambda: decimal.Decimal("NaN"),
    lambda: fractions.Fraction(1, 3),
    lambda: fractions.Fraction(10**400),
    lambda: np.float32(0.5),
    lambda: np.float64("nan"),
    lambda: np.float16(6e4),
    lambda: np.longdouble(2),
    lambda: np.int8(-3),
    lambda: np.uint64(2**64 - 1),
    lambda: np.bool_(True),
    lambda: np.complex128(1),
    lambda: np.datetime64("2024-01-01"),
    lambda: np.timedelta64(1, "s"),
    lambda: np.str_("1"),
    lambda: np.void(b"ab"),
    lambda: np.array(1.0),
    lambda: np.array([1.0, 2.0]),
    lambda: np.array([[1.0, 2.0]]),
    lambda: np.array([1 + 2j, 0]),
    lambda: np.array(["1", "2"]),
    lambda: np.array(["2024-01-01"] * 2, dtype="datetime64[D]"),
    lambda: np.array([None, 1.0], dtype=object),
    lambda: np.array([True, False]),
    lambda: np.zeros(0),
    lambda: np.zeros((3, 3)),
    lambda: np.zeros((0, 2)),
    lambda: np.zeros(2, dtype="f4,i8"),
    lambda: np.ma.masked_array([1.0, 2.0], [True, False]),
    lambda: np.array([math.nan, 1.0]),
    lambda: np.array([math.inf, 1.0]),
    lambda: np.broadcast_to(np.float64(1), (10**9,)),
    lambda: [],
    lambda: (),
    lambda: {},
    lambda: set(),
    lambda: {1: 2},
    lambda: {"a": 1},
    lambda: [1.0],
    lambda: [1.0, 2.0, 3.0],
    lambda: ["1", "2"],
    lambda: [None, None],
    lambda: [True, False],
    lambda: [[1.0, 2.0]],
    lambda: [1.0, [2.0]],
    lambda: range(2),
    lambda: range(10**12),
    lambda: iter([1.0, 2.0]),
    lambda: (number for number in (1.0, 2.0)),
    lambda: memoryview(b"ab"),
    lambda: object(),
    lambda: object,
    lambda: len,
    lambda: lambda *_: None,
    lambda: Ellipsis,
    lambda: NotImplemented,
    lambda: slice(1),
    lambda: datetime.date(2024, 1, 1),
    lambda: datetime.timedelta(1),
    lambda: pathlib.Path("x"),
    lambda: ValueError("x"),
    _Raising,
    lambda: _Endless([1.0, 2.0]),
    lambda: _Text("nominal"),
    lambda: _Whole(3),
    _circular,
    nested,
    lambda: [0.0] * 10_000,
    lambda: (1e308, 1e308),
    lambda: (0.0, math.nan),
)
