"""What learned policies compute beyond arithmetic: tanh, the logistic function, asinh and products with a matrix.

The functions are made of +, -, *, / and the square root, which IEEE 754 rounds correctly, and not taken from the C
library, whose last digits differ from one machine to the next. A policy is then the same numbers everywhere, also in
exported C.
"""

from __future__ import annotations

import math
from typing import Any

from fuzzyarm.envs.physics.elementwise import root, select
from fuzzyarm.numbers.functions import RECORDERS, apart, each

__all__ = ["add_product", "area_sine", "hyperbolic_tangent", "logistic"]

SATURATED = 20.0  # from here on tanh is 1 in double precision
DOUBLINGS = 8  # of exp(y) - 1 with |y| <= 2 SATURATED/2^8
LARGEST = 2.0**60  # a larger argument of asinh counts as this one
SQRT_2 = math.sqrt(2.0)
HALVINGS = tuple((2.0**k, 2.0**-k, float(k)) for k in (32, 16, 8, 4, 2, 1))
LN_2 = (float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33"))  # the first times 1024 is exact


@apart
def hyperbolic_tangent(x: Any) -> Any:
    """Return tanh x = -E/(E + 2) with E = exp(-2|x|) - 1 and the sign of x; relative error below 2e-15.

    E(y) = exp(y) - 1 is its Taylor polynomial of degree 11 for y = -2|x|/2^8, and E(2y) = E(y) (E(y) + 2).
    """
    size = abs(x)
    y = select(size > SATURATED, SATURATED, size) * (-2.0 / 2.0**DOUBLINGS)
    y2 = y * y
    y4 = y2 * y2
    low = (1 / 2 + y * (1 / 6)) + y2 * (1 / 24 + y * (1 / 120))
    middle = (1 / 720 + y * (1 / 5040)) + y2 * (1 / 40320 + y * (1 / 362880))
    total = y + y2 * (low + y4 * (middle + y4 * (1 / 3628800 + y * (1 / 39916800))))
    for _ in range(DOUBLINGS):
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

    ln m = k ln 2 + 2 artanh(g/(g + 2)) with m = 2^k (1 + g), 1/√2 < 1 + g <= √2, and a Taylor polynomial of degree 21.
    An |x| beyond 2^60 counts as 2^60.
    """
    size = select(abs(x) > LARGEST, LARGEST, abs(x))
    square = size * size
    f = size + square / (1.0 + root(1.0 + square))
    m, count = 1.0 + f, 0.0
    for power, inverse, k in HALVINGS:
        large = m >= power
        m, count = select(large, m * inverse, m), select(large, count + k, count)
    upper = m > SQRT_2
    m, count = select(upper, 0.5 * m, m), select(upper, count + 1.0, count)
    g = select(count == 0.0, f, m - 1.0)
    s = g / (g + 2.0)
    z = s * s
    z2 = z * z
    z4 = z2 * z2
    low = (2 / 3 + z * (2 / 5)) + z2 * (2 / 7 + z * (2 / 9))
    middle = (2 / 11 + z * (2 / 13)) + z2 * (2 / 15 + z * (2 / 17))
    total = z * (low + z4 * (middle + z4 * (2 / 19 + z * (2 / 21))))
    result = count * LN_2[0] + ((2.0 * s + s * total) + count * LN_2[1])
    return select(x < 0.0, -result, result)


def add_product(x: Any, transposed: Any, y: Any) -> None:
    """Add G x to y (rows,), G given as `transposed` (columns, rows): four terms while y_j is at hand."""
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
