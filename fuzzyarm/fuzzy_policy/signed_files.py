"""Controller files: JSON with exact numbers and a digest. This is what the files of every form have in common."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from fuzzyarm.common.documents import DocumentError, check_schema, read_json, record
from fuzzyarm.fuzzy_policy.hexadecimal import digest_of

__all__ = ["MAX_BYTES", "ControllerFileError", "checked_record", "controller_in"]

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
