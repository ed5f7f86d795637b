"""Controller files of every form: JSON with exact numbers, floats as texts in C99 hexadecimal, and a digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fuzzyarm.common.checks import shown
from fuzzyarm.common.documents import DocumentError, check_schema, read_json, record

__all__ = [
    "MAX_BYTES",
    "ControllerFileError",
    "checked_record",
    "controller_in",
    "decoded",
    "digest_of",
    "encoded",
    "signed",
]  # fmt: skip


def encoded(value: Any) -> Any:
    """Return `value` with every float in exact hexadecimal and arrays as nested lists."""
    if isinstance(value, np.ndarray):
        return encoded(value.tolist())
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, dict):
        return {key: encoded(entry) for key, entry in value.items()}
    return [encoded(entry) for entry in value] if isinstance(value, list) else value


def decoded(value: Any) -> Any:
    """Return nested lists or mappings with every hexadecimal string as a float; anything else raises ValueError."""
    if isinstance(value, str):
        try:
            return float.fromhex(value)
        except OverflowError:
            raise ValueError(f"{shown(value)} is beyond the largest float") from None
    if isinstance(value, list):
        return [decoded(entry) for entry in value]
    if isinstance(value, dict):
        return {key: decoded(entry) for key, entry in value.items()}
    raise ValueError(f"{shown(value)} is not an exact hexadecimal float")


def digest_of(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a document's canonical JSON: it detects accidental changes and is no signature."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8")).hexdigest()


def signed(document: dict[str, Any]) -> str:
    """Return the text of a file with a document and, in its last line, the digest of it."""
    entries = {**document, "digest": digest_of(document)}
    lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


MAX_BYTES = 8 * 1024 * 1024
"""Size of the largest file that is read; far above that of the largest model."""

Document = TypeVar("Document")
Built = TypeVar("Built")


class ControllerFileError(ValueError):
    """A controller file is damaged, no controller file, or made for another robot; the message says which."""


def controller_in(path: str | Path, build: Callable[[Any], Built]) -> Built:
    """Return what `build` makes of the content of a file.

    Raises:
        ControllerFileError: the content is no JSON, is too large, or `build` raised TypeError or ValueError.
        OSError: the file cannot be read.
    """
    try:
        return build(read_json(Path(path), largest=MAX_BYTES))
    except DocumentError as error:  # names the file itself
        raise ControllerFileError(str(error)) from None
    except (TypeError, ValueError) as error:
        raise ControllerFileError(f"{path}: {error}") from None


def checked_record(content: Any, schema: str, kind: type[Document]) -> Document:
    """Return the record of a document; ValueError if its schema, its fields or its digest are not right."""
    check_schema(content, schema)
    document = record(content, kind)
    if content["digest"] != digest_of({key: value for key, value in content.items() if key != "digest"}):
        raise ControllerFileError("the digest does not match: the file was changed after it was written")
    return document
