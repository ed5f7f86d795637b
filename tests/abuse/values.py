"""Spoiled values, as strategies of hypothesis: of the wrong kind, out of range, too large, hostile."""

from __future__ import annotations

import copy
import datetime
import decimal
import fractions
import json
import math
import pathlib
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import Any

import numpy as np
from hypothesis import strategies as st

__all__ = ["damaged", "document", "hostile", "plausible", "spoiled", "to_json", "wrong"]

EXTREME = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e-15, 1e15, 1e300, 1.7e308, -1e308, 0, 1, -1,
    2, 3, 7, 100, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, 2**64, -(2**63), 10**400, -(10**400),
)  # fmt: skip
TEXTS = (
    "", " ", "0", "1", "nan", "inf", "1e999", "0x1p4", "None", "True", "nominal", "max", "\x00", "a\x00b", "\n",
    "a\nb", "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "\u202eevil", "\ufeff", "é", "🙂", "\udcff", "𝟙", "٣",
    "../../etc/passwd", "/dev/zero", "-", "--", "--help", "-h", "=", "=1+1", "@x", "%s%n", "{0}", "${HOME}", "`id`",
    "$(id)", "a:b", "os:system", "abuse_canary:make", "abuse_canary:make.x", "A" * 300, "A" * 100_000, "[" * 50,
    "fuzzy-4", "fuzzy-4-tip", "none", ".", "..", "~", "*",
)  # fmt: skip


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
    lambda: None, lambda: True, lambda: False, lambda: 1j, lambda: complex(1.0, 0.0), lambda: b"1",
    lambda: bytearray(2), lambda: decimal.Decimal("1.5"), lambda: decimal.Decimal("NaN"),
    lambda: fractions.Fraction(1, 3), lambda: fractions.Fraction(10**400), lambda: np.float32(0.5),
    lambda: np.float64("nan"), lambda: np.float16(6e4), lambda: np.longdouble(2), lambda: np.int8(-3),
    lambda: np.uint64(2**64 - 1), lambda: np.bool_(True), lambda: np.complex128(1),
    lambda: np.datetime64("2024-01-01"), lambda: np.timedelta64(1, "s"), lambda: np.str_("1"), lambda: np.void(b"ab"),
    lambda: np.array(1.0), lambda: np.array([1.0, 2.0]), lambda: np.array([[1.0, 2.0]]),
    lambda: np.array([1 + 2j, 0]), lambda: np.array(["1", "2"]),
    lambda: np.array(["2024-01-01"] * 2, dtype="datetime64[D]"), lambda: np.array([None, 1.0], dtype=object),
    lambda: np.array([True, False]), lambda: np.zeros(0), lambda: np.zeros((3, 3)), lambda: np.zeros((0, 2)),
    lambda: np.zeros(2, dtype="f4,i8"), lambda: np.ma.masked_array([1.0, 2.0], [True, False]),
    lambda: np.array([math.nan, 1.0]), lambda: np.array([math.inf, 1.0]),
    lambda: np.broadcast_to(np.float64(1), (10**9,)), lambda: [], lambda: (), lambda: {}, lambda: set(),
    lambda: {1: 2}, lambda: {"a": 1}, lambda: [1.0], lambda: [1.0, 2.0, 3.0], lambda: ["1", "2"],
    lambda: [None, None], lambda: [True, False], lambda: [[1.0, 2.0]], lambda: [1.0, [2.0]], lambda: range(2),
    lambda: range(10**12), lambda: iter([1.0, 2.0]), lambda: (number for number in (1.0, 2.0)),
    lambda: memoryview(b"ab"), lambda: object(), lambda: object, lambda: len, lambda: lambda *_: None,
    lambda: Ellipsis, lambda: NotImplemented, lambda: slice(1), lambda: datetime.date(2024, 1, 1),
    lambda: datetime.timedelta(1), lambda: pathlib.Path("x"), lambda: ValueError("x"), _Raising,
    lambda: _Endless([1.0, 2.0]), lambda: _Text("nominal"), lambda: _Whole(3), _circular, nested,
    lambda: [0.0] * 10_000, lambda: (1e308, 1e308), lambda: (0.0, math.nan),
)  # fmt: skip

numbers = st.one_of(
    st.sampled_from(EXTREME),
    st.floats(width=64),
    st.integers(-(2**200), 2**200),
    st.tuples(st.sampled_from([-1.0, 1.0]), st.floats(-320.0, 308.0)).map(lambda two: two[0] * 10.0 ** two[1]),
)
hostile = st.one_of(
    st.sampled_from(TEXTS), st.sampled_from(TEXTS), st.text(st.characters(exclude_categories=()), max_size=12)
)
wrong = st.one_of(
    st.sampled_from(WRONG).map(lambda make: make()), st.sampled_from(WRONG).map(lambda make: make()), numbers, hostile
)
"""A value of any kind."""


@st.composite
def near(draw: Any, valid: float) -> Any:
    """A number near a valid one, or not far from it."""
    if isinstance(valid, int) and draw(st.booleans()):
        return valid + draw(st.integers(-3, 3))
    changes = (
        -valid,
        10.0 * valid,
        0.1 * valid,
        1e3 * valid,
        1e-6 * valid,
        math.nextafter(valid, math.inf),
        valid + 0.5,
    )
    return draw(st.sampled_from(changes))


@st.composite
def spoiled(draw: Any, valid: Any) -> Any:
    """A value in place of a valid one: another kind, another number, or a part of it spoiled."""
    if draw(st.integers(0, 2)) == 0:
        return draw(wrong)
    match valid:
        case bool():
            return draw(st.one_of(st.integers(0, 2), wrong))
        case int() | float():
            return draw(st.one_of(near(valid), numbers))
        case str():
            return draw(hostile)
        case list() | tuple() if valid:
            return _spoiled_sequence(draw, valid)
        case np.ndarray() if valid.size:
            return _spoiled_array(draw, valid)
        case dict() if valid:
            return _spoiled_mapping(draw, valid)
    return draw(wrong)


def _spoiled_sequence(draw: Any, valid: Any) -> Any:
    entries, place = list(valid), draw(st.integers(0, len(valid) - 1))
    match draw(st.integers(0, 5)):
        case 0:
            entries.append(draw(spoiled(entries[place])))
        case 1:
            del entries[place]
        case 2:
            entries.reverse()
        case 3:
            array = np.empty(len(entries), dtype=object)
            array[:] = entries
            return array
        case _:
            entries[place] = draw(spoiled(entries[place]))
    return entries if draw(st.booleans()) else tuple(entries)


def _spoiled_array(draw: Any, valid: np.ndarray) -> Any:
    kinds = ("complex128", "object", "S8", "U8", "bool", "float16", "int8", "uint64")
    match draw(st.integers(0, 6)):
        case 0:
            return valid.astype(draw(st.sampled_from(kinds)))
        case 1:
            return valid[..., :-1]
        case 2:
            return valid[np.newaxis]
        case 3:
            return valid.tolist()
        case 4:
            return np.asfortranarray(valid[::-1])
    changed, numbers = np.array(valid), [np.nan, np.inf, -np.inf, 1e300, -1e300, 10.0**12, 2.0**62, -1.0, 0.0, 0.5]
    place = tuple(draw(st.integers(0, size - 1)) for size in changed.shape)
    if changed.dtype.kind in "iu":
        bounds = np.iinfo(changed.dtype)
        numbers = [bounds.min, bounds.max, bounds.max // 2, 0]
    with np.errstate(all="ignore"):
        changed[place] = draw(st.sampled_from(numbers))
    return changed


def _spoiled_mapping(draw: Any, valid: dict[Any, Any]) -> dict[Any, Any]:
    changed, key = dict(valid), draw(st.sampled_from(list(valid)))
    match draw(st.integers(0, 3)):
        case 0:
            del changed[key]
        case 1:
            changed[draw(st.one_of(hostile, st.just(3)))] = valid[key]
        case _:
            changed[key] = draw(spoiled(valid[key]))
    return changed


ANYTHING = [None, True, False, [], {}, [[]], {"": 0}, [None], nested(60), [0.0] * 5000, "0x1p9999", "nan"]


@st.composite
def _entry(draw: Any, valid: Any) -> Any:
    """A value of JSON in place of another."""
    options = [hostile, st.sampled_from(ANYTHING), numbers]
    if isinstance(valid, str) and valid.lstrip("-").startswith("0x"):  # an exact number
        exact = near(float.fromhex(valid)) | st.floats(allow_nan=False)
        options += [exact.map(lambda value: float(value).hex())] * 6
    elif isinstance(valid, int | float) and not isinstance(valid, bool):
        options += [near(valid)] * 4
    return draw(st.one_of(options))


@st.composite
def document(draw: Any, content: Any) -> Any:
    """A document of JSON or TOML with one to three changes of values or structure."""
    changed = copy.deepcopy(content)
    for _ in range(draw(st.integers(1, 3))):
        holder, key = changed, None
        while key is None:
            key = draw(st.sampled_from(list(holder) if isinstance(holder, dict) else range(len(holder))))
            if isinstance(holder[key], dict | list) and holder[key] and draw(st.integers(0, 4)):
                holder, key = holder[key], None
        match draw(st.integers(0, 7)):
            case 0 if len(holder) > 1:
                del holder[key]
            case 1 if isinstance(holder, dict):
                holder[draw(hostile)] = holder.pop(key)
            case 2 if isinstance(holder, dict):
                holder[draw(hostile)] = draw(_entry(None))
            case 3 if isinstance(holder, list):
                holder.insert(key, draw(_entry(holder[key])))
            case 4:
                holder[key] = [holder[key]]
            case _:
                holder[key] = draw(_entry(holder[key]))
    return changed


def to_json(content: Any) -> bytes:
    """Return JSON as it comes, lone surrogates and numbers that are not finite too."""
    return json.dumps(content, indent=1).encode("utf-8", "surrogatepass")


FRONTS = [b"\xef\xbb\xbf", b"\xff\xfe", b"\x00", b"\n" * 1000, b"\x80\x04", b"[" * 5000]


@st.composite
def damaged(draw: Any, content: bytes) -> bytes:
    """Bytes of which some are flipped, cut, repeated, inserted or exchanged."""
    data, place = bytearray(content), draw(st.integers(0, len(content) - 1))
    end = min(len(data), place + draw(st.integers(1, 64)))
    match draw(st.integers(0, 8)):
        case 0:
            data[place] ^= 1 << draw(st.integers(0, 7))
        case 1:
            del data[place:]
        case 2:
            del data[place:end]
        case 3:
            data[place:place] = draw(st.binary(min_size=1, max_size=64))
        case 4:
            data[place:end] = bytes(end - place)
        case 5:
            data += data[place:]
        case 6:
            data[place:end] = draw(st.binary(min_size=end - place, max_size=end - place))
        case 7:
            data[:0] = draw(st.sampled_from(FRONTS))
        case 8:
            data = bytearray(draw(st.binary(max_size=200)))
    return bytes(data)


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
        case pathlib.PurePath():
            return isinstance(value, str | pathlib.PurePath)
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
