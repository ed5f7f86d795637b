"""Values that nobody should give: of every kind, size and shape, for the tests that refuse them."""

import datetime
import fractions
import math
import pathlib

import numpy as np

__all__ = ["strange_values"]


class _Hostile:
    """An object whose every conversion fails."""

    def __float__(self):
        raise TypeError("no float")

    def __repr__(self):
        return "hostile"


def strange_values():
    """Return one value of each strange kind."""
    numbers = [0, 1, -1, 2, 10**400, -(10**400), 2**63, 2**64, 0.0, -0.0, 1e-300, 5e-324, 1e-15, 1e308, -1e308, 1e300]
    special = [math.nan, math.inf, -math.inf, True, False, None, 1j, complex(1.0, 0.0), fractions.Fraction(1, 3)]
    scalars = [np.float32(0.1), np.float64("nan"), np.int8(-5), np.uint64(2**64 - 1), np.bool_(True), np.str_("1.0")]
    texts = ["", "1.0", "nan", "nominal", "a\nb", "\ud800", "x" * 10**5, b"1", "\0", "../../etc/passwd"]
    dates = [datetime.datetime(2020, 1, 1), datetime.timedelta(1), np.datetime64("2020-01-01"), np.timedelta64(1, "s")]
    arrays = [
        np.zeros(0),
        np.zeros(1),
        np.zeros(2),
        np.zeros((2, 2)),
        np.zeros((8, 1)),
        np.full(2, np.nan),
        np.array([1 + 2j, 0]),
        np.array(["1", "2"]),
        np.array(["2020", "2021"], dtype="M8[ns]"),
        np.array([True, False]),
        np.array([10**400, 1], dtype=object),
        np.array([None, 1.0], dtype=object),
        np.zeros(2, dtype=[("a", float)]),
        np.zeros((1,) * 20),
        np.float64(3.0) * np.ones(3),
    ]
    containers = [
        [],
        [1],
        [1, 2],
        (1.0, 2.0),
        (0, 1e308),
        (1, 0),
        ["1", "2"],
        [[1, 2], [3]],
        {},
        {"a": 1},
        {1: 2},
        {1, 2},
    ]
    others = [range(2), iter([1.0, 2.0]), _Hostile(), _Hostile, len, object(), pathlib.Path("nowhere"), slice(2), ...]
    return [*numbers, *special, *scalars, *texts, *dates, *arrays, *containers, *others]
