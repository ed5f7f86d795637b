"""Reading of JSON and TOML files into typed, checked records.

A record is a dataclass; its fields and their types are the schema. A file holds data only: it is parsed and checked
against the types, and nothing in it is run or imported.

Only regular files are read, no larger than a limit, without duplicate keys, and no deeper than `DEEPEST`.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import stat
import tomllib
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec

from fuzzyarm.common.checks import listed

__all__ = ["DEEPEST", "LARGEST", "DocumentError", "check_schema", "parse_json", "read_json", "read_toml", "record"]

Record = TypeVar("Record")

LARGEST = 64 * 2**20  # bytes of a document, if not said otherwise
DEEPEST = 40  # levels of lists and mappings


class DocumentError(ValueError):
    """A document is missing, too large, damaged or of another schema; one line that names the file and the problem."""


def read_json(path: Path, *, largest: int = LARGEST) -> Any:
    """Return the content of a JSON file: mappings, lists, texts, finite numbers, truth values and None.

    Raises:
        DocumentError: no regular file, larger than `largest` bytes, or no JSON; or it holds a key twice, a number
            that is not finite, or is deeper than `DEEPEST`.
        OSError: the file cannot be read.
    """
    try:
        return parse_json(_read(path, largest))
    except ValueError as error:
        raise DocumentError(f"{path}: {error}") from None


def read_toml(path: Path, *, largest: int = LARGEST) -> dict[str, Any]:
    """Return the content of a TOML file; errors as for `read_json`."""
    try:
        content = tomllib.loads(_read(path, largest).decode("utf-8"))
        _check_depth(content)
    except (ValueError, RecursionError) as error:
        raise DocumentError(f"{path} is not a TOML file: {_brief(error)}") from None
    return content


def parse_json(text: bytes | str) -> Any:
    """Return the content of a JSON text; ValueError as for `read_json`, without the file."""
    try:
        content = json.loads(text, object_pairs_hook=_without_duplicates, parse_constant=_no_constant)
        _check_depth(content)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not a JSON document: {_brief(error)}") from None
    return content


def record(content: Any, kind: type[Record]) -> Record:
    """Return plain content as a record, a dataclass: every field of its type, none missing, none unknown.

    Raises:
        ValueError: the content does not fit, or the record's own checks refuse a value; the message names the place.
    """
    _refuse_unknown(content, kind)
    try:
        return msgspec.convert(content, kind, strict=True)
    except msgspec.ValidationError as error:
        raise ValueError(str(error).replace(" - at `$.", " at `").replace(" - at `$", " at `")) from None


def _refuse_unknown(content: Any, kind: Any) -> None:
    """Raise ValueError for a mapping with a key that the dataclass has no field for, also in dataclasses within it."""
    if not (isinstance(content, dict) and dataclasses.is_dataclass(kind) and isinstance(kind, type)):
        return
    known = get_type_hints(kind)
    unknown = sorted(map(str, set(content) - {field.name for field in dataclasses.fields(kind)}))
    if unknown:
        names = sorted(field.name for field in dataclasses.fields(kind))
        raise ValueError(f"unknown field {listed(unknown)}; known: {', '.join(names)}")
    for name, value in content.items():
        _refuse_unknown(value, known[name])


def check_schema(content: Any, schema: str) -> dict[str, Any]:
    """Return a mapping whose ``schema`` is the one this version reads; ValueError with both otherwise."""
    found = content.get("schema") if isinstance(content, dict) else None
    if not isinstance(content, dict) or found != schema:
        raise ValueError(f"the schema is {str(found)[:80]!r}, this version reads {schema!r}")
    return content


def _read(path: Path, largest: int) -> bytes:
    """Return the bytes of a regular file; the open file is checked, so that it cannot be exchanged in between."""
    # Without O_NONBLOCK, opening a FIFO waits for a writer.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise ValueError("not a regular file")
        content = file.read(largest + 1)
    if len(content) > largest:
        raise ValueError(f"larger than {largest} bytes, the most that is read of such a file")
    return content


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {double[:40]!r} stands twice")
    for name, value in pairs:
        if isinstance(value, float) and not math.isfinite(value):  # 1e999 parses as inf
            raise ValueError(f"{name[:40]!r} is not finite")
    return content


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _check_depth(content: Any) -> None:
    """Raise ValueError for content deeper than `DEEPEST`; level by level, without recursion."""
    level = [content]
    for _ in range(DEEPEST + 1):
        containers = [part for part in level if isinstance(part, dict | list)]
        if not containers:
            return
        level = [entry for part in containers for entry in (part.values() if isinstance(part, dict) else part)]
    raise ValueError(f"lists and mappings are nested more than {DEEPEST} deep")


def _brief(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else str(error)[:120]
