"""Reading of JSON and TOML files into typed, checked records.

A record is a dataclass; its fields and their types are the schema. A file contains only data: its content is parsed and
checked against these types, and nothing in it is run or imported.

Only regular files are read, no larger than a limit, with at most `_MOST_VALUES` values, without duplicate keys, and no
deeper than `_DEEPEST`.
"""

import dataclasses
import errno
import json
import math
import os
import stat
import tomllib
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from fuzzyarm.common.checks import listed

__all__ = [
    "DocumentError", "check_schema", "open_regular", "parse_json", "read_bytes", "read_checked", "read_json",
    "read_toml", "record",
]  # fmt: skip

_Built = TypeVar("_Built")
_Record = TypeVar("_Record")

_LARGEST = 16 * 2**20  # bytes of a document, unless stated otherwise
_LARGEST_TOML = 2**18  # bytes; the parser of TOML is slow
_MOST_VALUES = 500_000  # in a JSON document: an empty list takes fifty times the memory of its two brackets
_DEEPEST = 40  # levels of lists and mappings


class DocumentError(ValueError):
    """A document is missing, too large, damaged or of another schema; one line names the file and the problem."""


def read_json(path: Path, *, largest: int = _LARGEST) -> Any:
    """Return the content of a JSON file: mappings, lists, strings, finite numbers, booleans and None.

    Raises:
        DocumentError: the file is not regular, larger than `largest` bytes or not JSON; or it contains more than
            `_MOST_VALUES` values, a duplicate key, a number that is not finite or a string that is not Unicode, or is
            nested deeper than `_DEEPEST`.
        OSError: the file cannot be read.
    """
    content = read_bytes(path, largest=largest)
    try:
        return parse_json(content)
    except ValueError as error:
        raise DocumentError(f"{path}: {error}") from None


def read_toml(path: Path, *, largest: int = _LARGEST_TOML) -> dict[str, Any]:
    """Return the content of a TOML file; errors as for `read_json`."""
    text = read_bytes(path, largest=largest)
    try:
        decoded = text.decode("utf-8")
        _check_dotted_keys(decoded)
        content = tomllib.loads(decoded)
        _check_values(content, finite=False)  # the record checks the numbers
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"{path} cannot be read as TOML: {_brief(error)}") from None
    return content


def read_bytes(path: Path, *, largest: int = _LARGEST) -> bytes:
    """Return the content of a regular file; DocumentError if it exceeds `largest` bytes."""
    with open_regular(path) as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise DocumentError(f"{path} is larger than the {largest} bytes allowed for such a file")
    return content


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; the caller closes it. DocumentError for a device."""
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):  # opening some devices has side effects
        raise DocumentError(f"{path} is not a regular file")
    # The open file is checked too: it may have been replaced. Without O_NONBLOCK, opening a pipe waits for a writer.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    file = os.fdopen(handle, "rb")
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        file.close()
        raise DocumentError(f"{path} is not a regular file")
    return file


def parse_json(text: bytes | str) -> Any:
    """Return the content of a JSON string; ValueError as for `read_json`, without the file."""
    try:
        text = text.decode("utf-8") if isinstance(text, bytes) else text
        if text.count(",") + text.count("[") + text.count("{") > _MOST_VALUES:
            raise ValueError(f"it has more than the allowed {_MOST_VALUES} values")
        content = json.loads(text, object_pairs_hook=_without_duplicates, parse_constant=_no_constant)
        _check_values(content, finite=True)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"the content cannot be read as JSON: {_brief(error)}") from None
    return content


def record(content: Any, kind: type[_Record]) -> _Record:
    """Return plain content as a record, a dataclass: each field has its type, and no field is missing or unknown.

    Raises:
        ValueError: the content does not fit, or the record's own checks refuse a value; the message names the place.
    """
    _refuse_unknown(content, kind)
    try:
        return msgspec.convert(content, kind, strict=True)
    except msgspec.ValidationError as error:
        raise ValueError(str(error).replace(" - at `$.", " at `").replace(" - at `$", " at `")) from None


def _refuse_unknown(content: Any, kind: Any) -> None:
    """Raise ValueError if a mapping has a key without a field in its dataclass, also in dataclasses within it."""
    if isinstance(kind, types.UnionType):  # a record or None
        kind = next((option for option in get_args(kind) if dataclasses.is_dataclass(option)), kind)
    if isinstance(content, list) and get_origin(kind) in (list, tuple):
        for value in content:
            _refuse_unknown(value, get_args(kind)[0])
    elif isinstance(content, dict) and get_origin(kind) is dict:
        for value in content.values():
            _refuse_unknown(value, get_args(kind)[-1])
    elif isinstance(content, dict) and dataclasses.is_dataclass(kind) and isinstance(kind, type):
        names = sorted(field.name for field in dataclasses.fields(kind))
        if unknown := set(content) - set(names):
            raise ValueError(f"unknown field {listed(unknown)}; known: {', '.join(names)}")
        known = get_type_hints(kind)
        for name, value in content.items():
            _refuse_unknown(value, known[name])


def check_schema(content: Any, schema: str) -> dict[str, Any]:
    """Return a mapping if its ``schema`` is the given one, which this version reads; if not, ValueError names both."""
    found = content.get("schema") if isinstance(content, dict) else None
    if not isinstance(content, dict) or found != schema:
        raise ValueError(f"the schema is {found!r:.80}; this version of fuzzyarm reads {schema!r}")
    return content


def read_checked(path: Path, schema: str, again: str, build: Callable[[dict[str, Any]], _Built]) -> _Built:
    """Return the result of `build` for the content of a JSON file of a schema.

    Every message ends with `again`, an instruction to make the file again. `build` may raise KeyError or IndexError for
    missing entries.

    Raises:
        ValueError: the file does not exist, has another schema or is damaged; the message is one line.
        OSError: the file cannot be read.
    """
    if not path.is_file():
        raise ValueError(f"{path} does not exist; {again}")
    try:
        document = check_schema(read_json(path), schema)
    except DocumentError as error:
        raise ValueError(f"{error}; {again}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}; {again}") from None
    try:
        return build(document)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        problem = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{path} is damaged ({problem}); {again}") from None


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names: set[str] = set()
        double = next(name for name, _ in pairs if name in names or names.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {double[:40]!r} occurs twice")
    for name, value in pairs:
        if isinstance(value, float) and not math.isfinite(value):  # 1e999 parses as inf
            raise ValueError(f"the value of {name[:40]!r} is not finite")
    return content


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a JSON number")


def _check_dotted_keys(text: str) -> None:
    """Raise ValueError for a TOML key of more than `_DEEPEST` parts: parsing time grows with their square."""
    run = 0
    for part in text.split("."):
        run = run + 1 if part.strip() and not any(mark in part for mark in "=,[]{}#\n") else 0
        if run > _DEEPEST:
            raise ValueError(f"a dotted key has more than the allowed {_DEEPEST} parts")


def _check_values(content: Any, *, finite: bool) -> None:
    """Raise ValueError for content nested deeper than `_DEEPEST`, invalid Unicode and, if `finite`, inf and nan."""
    level = [content]
    for depth in range(_DEEPEST + 1):
        below: list[Any] = []
        for part in level:
            if isinstance(part, dict | list) and depth == _DEEPEST:
                raise ValueError(f"lists and mappings are nested more deeply than the allowed {_DEEPEST} levels")
            if isinstance(part, dict):
                below.extend(part)
                below.extend(part.values())
            elif isinstance(part, list):
                below.extend(part)
            elif isinstance(part, str) and not part.isascii():
                part.encode("utf-8")  # UnicodeEncodeError for half a surrogate pair, which cannot be printed
            elif finite and isinstance(part, float) and not math.isfinite(part):
                raise ValueError("a number is not finite")
        level = below


def _brief(error: Exception) -> str:
    return "it is nested too deeply" if isinstance(error, RecursionError) else str(error)[:120]
