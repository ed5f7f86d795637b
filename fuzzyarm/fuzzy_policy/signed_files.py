"""Controller files of every form: JSON with exact numbers, floats in C99 hexadecimal, and a digest.

Loading a file executes nothing from it.
"""

import abc
import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from fuzzyarm.common.checks import finite_array, shown
from fuzzyarm.common.documents import DocumentError, check_schema, read_json, record
from fuzzyarm.common.files import write_atomically

__all__ = [
    "ControllerFileError", "SignedController", "checked_fields", "controller_in", "decoded", "encoded",
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
    """Return `value`, a hexadecimal string or nested lists or mappings of these, as floats; ValueError for others."""
    if isinstance(value, str):
        try:
            return float.fromhex(value)
        except OverflowError:
            raise ValueError(f"{shown(value)} exceeds the largest float") from None
    if isinstance(value, list):
        return [decoded(entry) for entry in value]
    if isinstance(value, dict):
        return {key: decoded(entry) for key, entry in value.items()}
    raise ValueError(f"{shown(value)} must be a hexadecimal float in quotes, such as '0x1.8p+1'")


def _digest_of(document: dict[str, Any]) -> str:
    """Return the SHA-256 of a document's canonical JSON, which detects accidental changes but not forgeries."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8")).hexdigest()


_MAX_BYTES = 8 * 1024 * 1024  # size of the largest file that is read; far above that of the largest model
_LARGEST = 1e60  # largest magnitude of an array's entry
_Built = TypeVar("_Built")


class ControllerFileError(ValueError):
    """Error for a file that is damaged, not a controller file, or for another robot; the message says which."""


def controller_in(path: str | Path, build: Callable[[Any], _Built]) -> _Built:
    """Return the result of `build` for the JSON content of a file; ControllerFileError if the file is not valid."""
    try:
        return build(read_json(Path(path), largest=_MAX_BYTES))
    except DocumentError as error:  # names the file itself
        raise ControllerFileError(str(error)) from None
    except (TypeError, ValueError) as error:
        raise ControllerFileError(f"{path}: {error}") from None


def checked_fields(
    content: Any, schema: str, fields: Mapping[str, Any], optional: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the fields of a document by name; ValueError if its schema, its fields or its digest are wrong.

    `fields` gives the type of each field except `schema` and `digest`; `optional` fields may be missing, and are then
    not in the result.
    """
    check_schema(content, schema)
    required = {"schema": str, **fields, "digest": str}
    free = [(name, Any, dataclasses.field(default=None)) for name in optional]
    document: Any = record(content, dataclasses.make_dataclass("Document", [*required.items(), *free]))
    if content["digest"] != _digest_of({key: value for key, value in content.items() if key != "digest"}):
        raise ControllerFileError(
            "the digest does not match: the file was changed; restore it, or design a new controller"
        )
    return {name: getattr(document, name) for name in content}


class SignedController(abc.ABC):
    """Base class of the controllers in files; ControllerFileError on construction if fields do not fit together."""

    def __post_init__(self) -> None:
        try:
            self._check()
        except (TypeError, ValueError) as error:
            raise ControllerFileError(str(error)) from None

    @abc.abstractmethod
    def _check(self) -> None:
        """Check the fields and store them in their final form; TypeError or ValueError if one does not fit."""

    @property
    @abc.abstractmethod
    def _encoded(self) -> dict[str, Any]:
        """The content of the controller file without its digest."""

    @classmethod
    @abc.abstractmethod
    def from_document(cls, content: Any) -> Self:
        """Return the controller in a file's parsed JSON; ValueError if it is of another form or damaged."""

    def _take(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _array(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Return a read-only copy of the field `name`, an array that must have this shape."""
        array = finite_array(name, getattr(self, name), shape, largest=_LARGEST)
        array.flags.writeable = False
        return array

    @property
    def digest(self) -> str:
        """The digest in the controller file: SHA-256 of its content, in hexadecimal digits."""
        return _digest_of(self._encoded)

    def to_json(self) -> str:
        """Return the text of the controller file; its last line contains the digest."""
        entries = {**self._encoded, "digest": self.digest}
        lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
        return "{\n" + ",\n".join(lines) + "\n}\n"

    def save(self, path: str | Path) -> None:
        """Write the controller file, atomically."""
        write_atomically(Path(path), self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a controller file; ControllerFileError if it is damaged or of another form, OSError if unreadable."""
        return controller_in(path, cls.from_document)
