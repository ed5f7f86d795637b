"""Checks of arguments: each returns the checked value, or raises an error that names the value and what is allowed.

    out of range     ValueError   "duration = -1.0 s is out of range; allowed: (0, inf) s"
    not a number     TypeError    "duration = '1' must be a real number [s]; allowed: (0, inf) s"

Booleans, complex numbers, strings and dates are not accepted as numbers, alone or in arrays.
"""

import math
import numbers
import os
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

__all__ = [
    "all_finite", "array_of", "choice", "distinct", "finite_array", "instance", "interval", "is_real", "is_sequence",
    "keep", "listed", "path_of", "real", "real_entries", "reals", "sequence_of", "shown", "texts", "truth", "whole",
]  # fmt: skip

_Choice = TypeVar("_Choice")

_NO_NUMBERS = (bool, np.bool_, np.timedelta64)  # although some are derived from number classes
_SHOWN = 80  # characters of a value in a message
_MESSAGE = 300  # characters of a message that quotes a type
_FEW = 64  # numbers


def real(
    name: str,
    value: Any,
    unit: str = "",
    *,
    above: float = -math.inf,
    low: float = -math.inf,
    high: float = math.inf,
    below: float = math.inf,
) -> float:
    """Return a real number as float if above < value < below and low <= value <= high; `unit` is for messages."""
    allowed = _allowed(unit, above, low, high, below)
    if not is_real(value):
        raise TypeError(f"{name} = {shown(value)} must be a real number{_bracketed(unit)}; {allowed}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not (math.isfinite(number) and above < number < below and low <= number <= high):
        raise ValueError(f"{name} = {shown(value)}{_spaced(unit)} is out of range; {allowed}")
    return number


def whole(name: str, value: Any, *, low: int = 0, high: int | None = None) -> int:
    """Return `value` as an int; TypeError or ValueError unless it is a whole number from `low` to `high`, if given."""
    allowed = f"allowed: {low}, {low + 1}, {low + 2}, ..." if high is None else f"allowed: {low} to {high}"
    if isinstance(value, _NO_NUMBERS) or not isinstance(value, numbers.Integral):
        raise TypeError(f"{name} = {shown(value)} must be a whole number; {allowed}")
    number = int(value)
    if number < low or (high is not None and number > high):
        raise ValueError(f"{name} = {shown(value)} is out of range; {allowed}")
    return number


def reals(name: str, values: Any, count: int | range, unit: str = "", **bounds: float) -> tuple[float, ...]:
    """Return finite real `values` as floats; `count` is their number, or a range of it; `bounds` as for `real`."""
    counts = count if isinstance(count, range) else (count,)
    if not any(is_sequence(values, size) for size in counts):
        kind = ValueError if _is_sequence(values) else TypeError
        size = f"{count}" if isinstance(count, int) else f"{count[0]} to {count[-1]}"
        needed = f"must be {size} real numbers{_bracketed(unit)}; {_allowed(unit, **bounds)}"
        raise kind(f"{name} = {shown(values)} {needed}")
    return tuple(real(f"{name}[{k}]", value, unit, **bounds) for k, value in enumerate(values))


def is_sequence(values: Any, count: int) -> bool:
    """Return whether values are a sequence or a one-dimensional array of `count` entries; strings are not."""
    flat = not isinstance(values, np.ndarray | memoryview) or values.ndim == 1
    return _is_sequence(values) and flat and len(values) == count


def _is_sequence(values: Any) -> bool:
    return isinstance(values, Sequence | np.ndarray) and not isinstance(values, str | bytes)


def interval(name: str, values: Any, unit: str = "", *, low: float, high: float) -> tuple[float, float]:
    """Return a range (first, last) with low <= first <= last <= high as floats."""
    first, last = reals(name, values, 2, unit, low=low, high=high)
    if first > last:
        raise ValueError(f"{name} = {shown(values)}{_spaced(unit)} must be a range (low, high) with low <= high")
    return first, last


def truth(name: str, value: Any) -> bool:
    """Return `value` as bool if it is a boolean; TypeError otherwise."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{name} = {shown(value)} must be True or False")
    return bool(value)


def choice(name: str, value: Any, choices: Collection[_Choice]) -> _Choice:
    """Return the value if it is one of the choices; ValueError with all of them otherwise."""
    for one in choices:
        if type(one) is type(value) and one == value:
            return one
    raise ValueError(f"{name} = {shown(value)} is unknown; choose from: {', '.join(map(str, choices))}")


def distinct(name: str, values: Sequence[str]) -> Sequence[str]:
    """Return one or more distinct names; ValueError otherwise, TypeError for anything but a sequence of strings."""
    texts(name, values)
    if not values or len(set(values)) != len(values):
        raise ValueError(f"{name} = {shown(list(values))} must be one or more distinct names")
    return values


def texts(name: str, values: Any) -> Sequence[str]:
    """Return a sequence of strings; TypeError for anything else, including a single string."""
    if not isinstance(values, list | tuple) or not all(isinstance(value, str) for value in values):
        raise TypeError(f"{name} = {shown(values)} must be a list or tuple of strings")
    return values


def instance(name: str, value: Any, kind: type[_Choice]) -> _Choice:
    """Return the value if it is an instance of a class; otherwise raise a TypeError that names the class."""
    if not isinstance(value, kind):
        class_name = f"{kind.__module__}.{kind.__qualname__}".removeprefix("builtins.")
        raise TypeError(f"{name} = {shown(value)} must be a {class_name}")
    return value


def keep(record: object, name: str, value: Any) -> None:
    """Set a field of a frozen record to a value checked before."""
    object.__setattr__(record, name, value)


def path_of(name: str, value: Any) -> Path:
    """Return the name of a file or folder as a path; TypeError for other types, ValueError for an impossible name."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"{name} = {shown(value)} must be a path, as a string or pathlib.Path")
    if not str(value) or "\0" in str(value):
        raise ValueError(f"{name} = {shown(str(value))} cannot be a file name: it is empty or contains a NUL character")
    return Path(value)


def sequence_of(name: str, values: Any) -> Sequence[Any]:
    """Return a list or tuple; TypeError for anything else, ValueError for an empty one."""
    if not isinstance(values, list | tuple):
        raise TypeError(f"{name} = {shown(values)} must be a list or a tuple")
    if not values:
        raise ValueError(f"{name} is empty; give at least one entry")
    return values


def finite_array(
    name: str, values: Any, shape: tuple[int, ...], unit: str = "", *, largest: float = math.inf
) -> np.ndarray:
    """Return `values` as a new float64 array of this shape within ±`largest`; errors state `name` and `unit`."""
    array = array_of(name, values)
    real_entries(name, array, unit)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; allowed: {shape}")
    result = array.astype(np.float64)
    if not np.isfinite(result).all():
        raise ValueError(f"{name} contains numbers that are not finite")
    if (np.abs(result) > largest).any():
        allowed = _allowed(unit, low=-largest, high=largest)
        most = np.abs(result).max()
        raise ValueError(f"{name} contains a number of magnitude {most:g}, which is out of range; {allowed}")
    return result


def array_of(name: str, values: Any) -> np.ndarray:
    """Return values as an array of any type and shape; ValueError for rows that differ in length."""
    try:
        return np.asarray(values)
    except (ValueError, MemoryError, OverflowError) as error:
        reason = str(error).partition(".")[0] or "more numbers than fit in memory"
        raise ValueError(f"{name} = {shown(values)} is not an array: {listed([reason])}") from None


def real_entries(name: str, array: np.ndarray, unit: str = "") -> None:
    """Raise TypeError, with this name and unit, unless the array has integers or real floats."""
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must contain real numbers{_bracketed(unit)}, not {array.dtype}"[:_MESSAGE])


def all_finite(array: np.ndarray) -> bool:
    """Return whether all numbers of an array are finite; a small array is tested by its sum, which is faster."""
    few = array.size <= _FEW and math.isfinite(sum(array.ravel().tolist()))
    return few or bool(np.isfinite(array).all())


def is_real(value: Any) -> bool:
    """Return whether a value is a real number; booleans, complex numbers, strings and times are not."""
    return isinstance(value, numbers.Real) and not isinstance(value, _NO_NUMBERS)


def shown(value: Any) -> str:
    """Return the `repr` of a value for a message, shortened if it is long."""
    try:
        text = repr(value)
    except ValueError:  # an integer with more digits than Python prints
        text = f"a whole number of {value.bit_length()} bits" if isinstance(value, int) else object.__repr__(value)
    except Exception:  # a class of the user
        text = object.__repr__(value)
    text = " ".join(text.split()) if "\n" in text else text
    return _cut(text)


def listed(names: Iterable[Any]) -> str:
    """Return names for a message: sorted, shortened if long, with unprintable ones as their `repr`."""
    texts = [name if isinstance(name, str) and name.isprintable() else shown(name) for name in names]
    return _cut(", ".join(sorted(texts)))


def _cut(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


def _allowed(
    unit: str, above: float = -math.inf, low: float = -math.inf, high: float = math.inf, below: float = math.inf
) -> str:
    lower = f"({above:g}" if above >= low else f"[{low:g}"
    upper = f"{below:g})" if below <= high else f"{high:g}]"
    return f"allowed: {lower}, {upper}{_spaced(unit)}"


def _spaced(unit: str) -> str:
    return f" {unit}" if unit else ""


def _bracketed(unit: str) -> str:
    return f" [{unit}]" if unit else ""
