"""Spoiled values: of the wrong kind, out of range, too large, hostile; each from a random generator."""

from __future__ import annotations

import fractions
import math
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

import numpy as np

from .pools import EXTREME, TEXTS, WRONG, nested

__all__ = ["hostile_text", "json_value", "plausible", "spoiled", "wrong"]


def hostile_text(rng: np.random.Generator) -> str:
    """A text from the list, or of random characters, control characters and lone surrogates among them."""
    if rng.random() < 0.7:
        return str(TEXTS[rng.integers(len(TEXTS))])
    last = int(rng.choice([0x20, 0x7F, 0x3000, 0xE000, 0x11000]))
    return "".join(chr(int(one)) for one in rng.integers(0, last, rng.integers(1, 12)))


def _number(rng: np.random.Generator) -> Any:
    kind = rng.integers(4)
    if kind == 0:
        return EXTREME[rng.integers(len(EXTREME))]
    if kind == 1:  # any pattern of bits
        return float(np.frombuffer(rng.bytes(8), dtype=np.float64)[0])
    if kind == 2:
        whole = int.from_bytes(rng.bytes(int(rng.integers(1, 40))), "little")
        return whole if rng.random() < 0.5 else -whole
    return float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-320.0, 308.0))


def wrong(rng: np.random.Generator) -> Any:
    """A value of any kind."""
    kind = rng.random()
    if kind < 0.55:
        return WRONG[rng.integers(len(WRONG))]()
    return _number(rng) if kind < 0.8 else hostile_text(rng)


def spoiled(rng: np.random.Generator, valid: Any) -> Any:
    """A value in place of a valid one: another kind, another number, or a part of it spoiled."""
    if rng.random() < 0.35:
        return wrong(rng)
    match valid:
        case bool():
            return rng.choice([0, 1, 2]).item() if rng.random() < 0.5 else wrong(rng)
        case int() | float():
            return _near(rng, valid) if rng.random() < 0.6 else _number(rng)
        case str():
            return hostile_text(rng)
        case list() | tuple() if valid:
            return _spoiled_sequence(rng, valid)
        case np.ndarray() if valid.size:
            return _spoiled_array(rng, valid)
        case dict() if valid:
            return _spoiled_mapping(rng, valid)
    return wrong(rng)


def _near(rng: np.random.Generator, valid: float) -> Any:
    if isinstance(valid, int) and rng.random() < 0.5:
        return valid + int(rng.integers(-3, 4))
    changed = (
        -valid,
        10.0 * valid,
        0.1 * valid,
        1e3 * valid,
        1e-6 * valid,
        np.nextafter(float(valid), math.inf),
        valid + 0.5,
    )
    return changed[rng.integers(len(changed))]


def _spoiled_sequence(rng: np.random.Generator, valid: Any) -> Any:
    entries = list(valid)
    place, change = int(rng.integers(len(entries))), rng.integers(6)
    if change == 0:
        entries.append(spoiled(rng, entries[place]))
    elif change == 1:
        del entries[place]
    elif change == 2:
        entries.reverse()
    elif change == 3:
        array = np.empty(len(entries), dtype=object)
        array[:] = [str(type(entry)) for entry in entries] if rng.random() < 0.5 else entries
        return array
    else:
        entries[place] = spoiled(rng, entries[place])
    return entries if rng.random() < 0.2 else tuple(entries)


def _spoiled_array(rng: np.random.Generator, valid: np.ndarray) -> Any:
    change = rng.integers(7)
    if change == 0:
        return valid.astype(str(rng.choice(["complex128", "object", "S8", "U8", "bool", "float16", "int8", "uint64"])))
    if change == 1:
        return valid[..., :-1]
    if change == 2:
        return valid[np.newaxis]
    if change == 3:
        return valid.tolist()
    if change == 4:
        return np.asfortranarray(valid[::-1])
    changed = np.array(valid)
    place = tuple(int(rng.integers(size)) for size in changed.shape)
    with np.errstate(all="ignore"):
        numbers = [np.nan, np.inf, -np.inf, 1e300, -1e300, 10.0**12, 2.0**62, -1.0, 0.0, 0.5]
        bounds = np.iinfo(changed.dtype) if changed.dtype.kind in "iu" else None
        value = float(rng.choice(numbers))
        if bounds is not None:
            value = [bounds.min, bounds.max, 10**12, -1, 0][rng.integers(5)] if bounds.bits == 64 else bounds.max
        changed[place] = value
    return changed


def _spoiled_mapping(rng: np.random.Generator, valid: dict) -> dict:
    changed = dict(valid)
    key = list(valid)[rng.integers(len(valid))]
    change = rng.integers(4)
    if change == 0:
        del changed[key]
    elif change == 1:
        changed[hostile_text(rng) if rng.random() < 0.8 else 3] = valid[key]
    else:
        changed[key] = spoiled(rng, valid[key])
    return changed


def json_value(rng: np.random.Generator, valid: Any = None) -> Any:
    """A value that JSON can hold, spoiled."""
    kind = rng.random()
    if kind < 0.25:
        return hostile_text(rng)
    if kind < 0.4:
        choices: list[Any] = [
            None,
            True,
            False,
            [],
            {},
            [[]],
            {"": 0},
            [None],
            nested(60),
            [0.0] * 5000,
            "0x1p9999",
            "nan",
        ]
        return choices[rng.integers(len(choices))]
    if isinstance(valid, str) and valid.lstrip("-").startswith("0x") and kind < 0.9:  # an exact number
        try:
            return float(_near(rng, float.fromhex(valid)) if rng.random() < 0.7 else _number(rng)).hex()
        except OverflowError:
            return "0x1p1023"
    if isinstance(valid, int | float) and not isinstance(valid, bool) and kind < 0.7:
        return float(_near(rng, valid)) if isinstance(valid, float) else _near(rng, valid)
    return _number(rng)


def plausible(value: Any, valid: Any) -> bool:
    """Whether a value that was accepted in place of a valid one is at least of its kind."""
    match valid:
        case None:
            return True
        case bool():
            return isinstance(value, bool | np.bool_)
        case int():
            return isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)
        case float():
            real = isinstance(value, int | float | np.integer | np.floating | fractions.Fraction)
            return real and not isinstance(value, bool | np.bool_) and (math.isfinite(value) or math.isinf(valid))
        case str():
            return isinstance(value, str)
        case list() | tuple():
            if not isinstance(value, Sequence | np.ndarray):  # an iterator, which is used up
                return isinstance(value, Iterable) and not isinstance(value, Set | Mapping)
            alike = valid if len(value) == len(valid) else (valid or [None])[:1] * min(len(value), 10**5)
            return not isinstance(value, str | bytes) and all(map(plausible, value, alike))
        case np.ndarray():
            return np.asarray(value).dtype.kind in "fiu"
    return (
        value is None
        or isinstance(value, type(valid))
        or any(hasattr(value, name) for name in ("points", "at", "mass"))
    )
