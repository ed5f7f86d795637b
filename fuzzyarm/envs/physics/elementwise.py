"""The functions that the physics needs beyond arithmetic, for every number type it supports.

The plant is written once, for scalars: `numbers` records it and makes machine code for one arm and for many at once;
NumPy runs it on arrays, torch on tensors. Sine, cosine and exponential are polynomials here, because vector libraries
round differently from scalar ones, and lane i of a batch would then differ from the single arm in the last bits.
Tensors use torch's own functions.
"""

import math
from typing import Any

import numpy as np

from fuzzyarm.numbers import functions
from fuzzyarm.numbers.functions import apart

__all__ = ["gaussian", "logarithm", "positive_part", "root", "select", "sign", "sinc", "sine_cosine", "smaller"]

# π/2 = sum of the three; the first two have 33 bits, so k times them is exact for |k| < 2^20 (Cody and Waite).
_HALF_PI = (float.fromhex("0x1.921fb544p+0"), float.fromhex("0x1.0b4611a6p-34"), float.fromhex("0x1.3198a2e037073p-69"))
_TWO_BY_PI = 2.0 / math.pi
_NEGLIGIBLE = 40.0  # exp(-40) = 4e-18 is lost when it is added to 1


def select(condition: Any, first: Any, second: Any) -> Any:
    """Return `first` where the condition holds, else `second`."""
    if isinstance(condition, np.ndarray):
        return np.where(condition, first, second)
    return functions.select(condition, first, second)


@apart
def _sine_cosine(angle: Any) -> tuple[Any, Any]:
    """Return (sin, cos) for |angle| < 1e6 rad, by Taylor polynomials of degree 15 and 16, used within ±π/4."""
    turns = np.rint(angle * _TWO_BY_PI)
    x = ((angle - turns * _HALF_PI[0]) - turns * _HALF_PI[1]) - turns * _HALF_PI[2]
    # Estrin's scheme: its chain of dependent operations is half as long as that of Horner's scheme.
    z = x * x
    z2 = z * z
    high = (1 / 362880 - z * (1 / 39916800)) + z2 * (1 / 6227020800 - z * (1 / 1307674368000))
    sine = x + x * z * (((-1 / 6) + z * (1 / 120)) + z2 * (-1 / 5040 + z * high))
    high = (-1 / 3628800 + z * (1 / 479001600)) + z2 * (-1 / 87178291200 + z * (1 / 20922789888000))
    cosine = 1.0 - 0.5 * z + z2 * (((1 / 24) - z * (1 / 720)) + z2 * (1 / 40320) + z2 * z * high)
    quadrant = turns - 4.0 * np.floor(0.25 * turns)
    swapped = (quadrant == 1.0) | (quadrant == 3.0)
    first, second = select(swapped, cosine, sine), select(swapped, sine, cosine)
    return select(quadrant >= 2.0, -first, first), select((quadrant == 1.0) | (quadrant == 2.0), -second, second)


@apart
def _gaussian(x: Any) -> Any:
    """Return exp(-x²): the Taylor polynomial of exp(-x²/128) of degree 10, raised to the 128th power."""
    square = x * x
    y = select(square < _NEGLIGIBLE, square, _NEGLIGIBLE) * (-1 / 128)
    y2 = y * y
    low = (1.0 + y) + y2 * (1 / 2 + y * (1 / 6))
    middle = (1 / 24 + y * (1 / 120)) + y2 * (1 / 720 + y * (1 / 5040))
    high = (1 / 40320 + y * (1 / 362880)) + y2 * (1 / 3628800)
    y4 = y2 * y2
    root = low + y4 * (middle + y4 * high)
    for _ in range(7):
        root = root * root
    return root


def sine_cosine(angle: Any) -> tuple[Any, Any]:
    """Return (sin, cos) of an angle [rad]; absolute error below 3e-16 for |angle| <= 2π."""
    return (angle.sin(), angle.cos()) if hasattr(angle, "sin") else _sine_cosine(angle)


def sinc(angle: Any) -> Any:
    """Return sin(x)/x of an angle [rad], 1 at x = 0."""
    return angle.sinc() if hasattr(angle, "sinc") else select(angle == 0.0, 1.0, sine_cosine(angle)[0] / angle)


def gaussian(x: Any) -> Any:
    """Return exp(-x²) with absolute error below 3e-14; the value is 4e-18 for all x² > 40."""
    return (-(x * x)).exp() if hasattr(x, "exp") else _gaussian(x)


def logarithm(x: Any) -> Any:
    """Return the natural logarithm of x."""
    return x.log() if hasattr(x, "log") else np.log(x)


def root(x: Any) -> Any:
    """Return the square root of x; for tensors, its gradient at 0 is 0."""
    if getattr(x, "requires_grad", False):
        positive = 1.0 * (x > 0.0)
        return positive * (x + (1.0 - positive)).sqrt()
    return x.sqrt() if hasattr(x, "sqrt") else np.sqrt(x)


def sign(x: Any) -> Any:
    """Return the sign of x: -1, 0 or 1; 0 for nan."""
    return 1.0 * (x > 0.0) - 1.0 * (x < 0.0)


def positive_part(x: Any) -> Any:
    """Return max(x, 0)."""
    return 0.5 * (x + abs(x))


def smaller(a: Any, b: Any) -> Any:
    """Return min(a, b)."""
    return (a <= b) * a + (a > b) * b
