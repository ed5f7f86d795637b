"""Documents and bytes that are spoiled, as strategies of hypothesis."""

from __future__ import annotations

import contextlib
import copy
import json
import math
from typing import Any

from hypothesis import strategies as st

__all__ = ["damaged", "document", "to_json"]

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

numbers = st.one_of(
    st.sampled_from(EXTREME),
    st.floats(width=64),
    st.integers(-(2**200), 2**200),
    st.tuples(st.sampled_from([-1.0, 1.0]), st.floats(-320.0, 308.0)).map(lambda two: two[0] * 10.0 ** two[1]),
)
hostile = st.one_of(
    st.sampled_from(TEXTS), st.sampled_from(TEXTS), st.text(st.characters(exclude_categories=()), max_size=12)
)


@st.composite
def near(draw: Any, valid: float) -> Any:
    if isinstance(valid, int) and draw(st.booleans()):
        return valid + draw(st.integers(-3, 3))
    scaled = [factor * valid for factor in (-1.0, 10.0, 0.1, 1e3, 1e-6)]
    return draw(st.sampled_from([*scaled, math.nextafter(valid, math.inf), valid + 0.5]))


DEEP = json.loads("[" * 61 + "]" * 61)
ANYTHING = [None, True, False, [], {}, [[]], {"": 0}, [None], DEEP, [0.0] * 5000, "0x1p9999", "nan"]


@st.composite
def _entry(draw: Any, valid: Any) -> Any:
    """A value of JSON in place of another."""
    options = [hostile, st.sampled_from(ANYTHING), numbers]
    if isinstance(valid, str) and valid.lstrip("-").startswith("0x"):
        with contextlib.suppress(ValueError, OverflowError):  # an exact number, unless it was changed before
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
                holder[draw(hostile)] = copy.deepcopy(draw(_entry(None)))
            case 3 if isinstance(holder, list):
                holder.insert(key, copy.deepcopy(draw(_entry(holder[key]))))
            case 4:
                holder[key] = [holder[key]]
            case _:
                holder[key] = copy.deepcopy(draw(_entry(holder[key])))
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
