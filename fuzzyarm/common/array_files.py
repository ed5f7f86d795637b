"""Reading of NumPy's arrays, ``.npy``, and archives of them, ``.npz``, from untrusted files.

Before memory is allocated, the sizes stated by the archive are checked against a limit, and the size of each array
against its header. Arrays contain booleans, integers, real numbers, strings, or records of these; nothing is unpickled.
"""

import errno
import math
import struct
import tokenize
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from fuzzyarm.common.console import escaped
from fuzzyarm.common.documents import DocumentError, open_regular

__all__ = ["read_arrays"]

_LARGEST_ARRAYS = 4 * 2**30  # bytes of all arrays of a file together, unless stated otherwise
_MOST_COMPRESSED = 100  # largest ratio of the arrays' size to the file's; files with an all-zero signal reach 20

_ENDING, _MAGIC = ".npy", b"\x93NUMPY"
_KINDS = "biufU"  # booleans, numbers, strings
_LARGEST_DIRECTORY = 8 * 2**20  # bytes of the list of members; each member takes about 50
_END, _END64 = struct.Struct("<4s4H2LH"), struct.Struct("<4sQ2H2L4Q")  # the last records of a zip archive
_LOCATOR = 20  # bytes of the record between the two
_ENCRYPTED = 0x1
_SLACK = 2**20  # bytes added to the size that a file may unpack to
_OF_DAMAGE = (  # raised by zipfile, zlib, struct and NumPy's reading of a header for a damaged file
    ArithmeticError, EOFError, LookupError, MemoryError, OSError, RuntimeError, SyntaxError, TypeError, ValueError,
    Warning, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


class _NotRead(ValueError):
    """Error for a file that may be intact but is not read because it is encrypted or too large, for example."""


def read_arrays(path: Path, *, largest: int = _LARGEST_ARRAYS) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name; the name of a single array is "".

    Raises:
        DocumentError: the file is not regular, is not an archive of arrays, is damaged, or unpacks to more than
            `largest` bytes; the message is one line that names the file.
        OSError: the file cannot be read.
    """
    with open_regular(path) as file:
        try:
            size = file.seek(0, 2)
            file.seek(0)
            if file.read(len(_MAGIC)) == _MAGIC:
                file.seek(0)
                return {"": _array(file, path.name, min(size, largest))}
            _check_directory(file, size)
            with zipfile.ZipFile(file) as archive:
                members = archive.infolist()
                _check_members(members, min(largest, _MOST_COMPRESSED * size) + _SLACK)
                found = {}
                for member in members:
                    with archive.open(member) as stream:
                        array = _array(stream, member.filename, member.file_size)
                    found[member.filename.removesuffix(_ENDING)] = array
                return found
        except _OF_DAMAGE as error:
            if isinstance(error, OSError) and error.errno != errno.EINVAL:  # EINVAL: a position before the beginning
                raise
            reason = escaped(" ".join(str(error).split())[:160]) or type(error).__name__
            said = f"{path}: {reason}" if isinstance(error, _NotRead) else f"{path} is damaged ({reason})"
            raise DocumentError(said) from None


def _check_directory(file: BinaryIO, size: int) -> None:
    """Raise ValueError if a zip archive's list of members, which `zipfile` reads as a whole, is too large."""
    file.seek(max(size - _END.size, 0))
    content = file.read(_END.size)
    if len(content) < _END.size:
        raise ValueError("it is too short for a zip archive")
    signature, *_, length, _, comment = _END.unpack(content)
    if signature != b"PK\x05\x06" or comment:
        raise ValueError("it must end with the end record of a zip archive, without a comment")
    before = size - _END.size - _LOCATOR - _END64.size
    if before >= 0:
        file.seek(before)
        wide = _END64.unpack(file.read(_END64.size))
        if wide[0] == b"PK\x06\x06":
            length = max(length, wide[8])
    if length > _LARGEST_DIRECTORY:
        raise ValueError(f"its zip directory has {length} bytes; allowed: at most {_LARGEST_DIRECTORY}")


def _check_members(members: list[zipfile.ZipInfo], most: int) -> None:
    names = {member.filename for member in members}
    if len(names) < len(members):
        raise ValueError("two of its entries have the same name")
    for member in members:
        if not member.filename.endswith(_ENDING):
            raise _NotRead(f"{member.filename[:40]!r} is not an array: its name must end in {_ENDING}")
        if member.flag_bits & _ENCRYPTED:
            raise _NotRead(f"{member.filename[:40]!r} is encrypted; save it without a password")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise _NotRead(f"{member.filename[:40]!r} has compression method {member.compress_type}; allowed: 0 or 8")
    total = sum(member.file_size for member in members)
    if total > most:
        raise _NotRead(f"its arrays unpack to {total} bytes; allowed for this file: at most {most}")


def _array(stream: IO[bytes], name: str, size: int) -> np.ndarray:
    """Return the array in a stream of `size` bytes; ValueError if its header does not state exactly this size."""
    if np.lib.format.read_magic(stream) != (1, 0):
        raise _NotRead(f"{name[:40]!r} must be in version 1.0 of the .npy format")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # about headers of Python 2
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    fields = [dtype] if dtype.names is None else [dtype[name].base for name in dtype.names]
    if any(field.kind not in _KINDS or field.names is not None for field in fields):
        raise _NotRead(f"{name[:40]!r} has the type {str(dtype)[:40]}; save arrays of numbers or text")
    needed, left = math.prod(shape) * dtype.itemsize, size - stream.tell()
    if min(shape, default=0) < 0 or needed != left:
        raise ValueError(f"{name[:40]!r} has {left} bytes; needed: {needed}, for shape {shape} and type {dtype}"[:160])
    array = np.empty(shape, dtype, order="F" if by_columns else "C")
    content = stream.read(needed + 1)  # with the limit: `read()` would unpack more than the stated size
    if len(content) != needed:
        raise ValueError(f"{name[:40]!r} does not unpack to the {needed} bytes that its header states")
    if needed:
        array.reshape(-1, order="A").view(np.uint8)[:] = np.frombuffer(content, dtype=np.uint8)
    _check_values(name, array)
    return array


def _check_values(name: str, array: np.ndarray) -> None:
    """Raise ValueError if an array contains strings or booleans with invalid bytes."""
    if array.dtype.kind == "U":
        points = np.frombuffer(array.astype(array.dtype.newbyteorder("<")).tobytes(), dtype="<u4")
        if np.any((points > 0x10FFFF) | ((points >= 0xD800) & (points <= 0xDFFF))):
            raise ValueError(f"{name[:40]!r} contains text that is not valid Unicode")
    if array.dtype.kind == "b" and np.any(np.frombuffer(array.tobytes(), dtype=np.uint8) > 1):
        raise ValueError(f"{name[:40]!r} contains an invalid boolean: a byte other than 0 or 1")
