"""Damage to files: values and structure of documents, bytes, and what stands in place of a file."""

from __future__ import annotations

import copy
import json
import os
import shutil
import socket
from collections.abc import Callable, MutableMapping, MutableSequence
from pathlib import Path
from typing import Any

import numpy as np

from .samples import scratch
from .values import hostile_text, json_value

__all__ = ["SPECIAL", "copied", "damaged_bytes", "damaged_document", "to_json"]


def damaged_document(rng: np.random.Generator, document: Any) -> tuple[Any, str]:
    """Return a document with one to three changes of values or structure, and a description."""
    changed, texts = copy.deepcopy(document), []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        holder, key, text = _place(rng, changed)
        texts.append(f"{text}: {_change(rng, holder, key)}")
    return changed, "; ".join(texts)


def _place(rng: np.random.Generator, document: Any) -> tuple[Any, Any, str]:
    """A random entry of a random mapping or list, deeper the longer one is lucky."""
    holder, text = document, ""
    while True:
        keys = list(holder) if isinstance(holder, MutableMapping) else list(range(len(holder)))
        key = keys[rng.integers(len(keys))]
        text += f"[{key!r:.20}]"
        below = holder[key]
        if not isinstance(below, MutableMapping | MutableSequence) or not below or rng.random() < 0.2:
            return holder, key, text
        holder = below


def _change(rng: np.random.Generator, holder: Any, key: Any) -> str:
    change = rng.integers(8)
    if change == 0:
        del holder[key]
        return "left out"
    if change == 1 and isinstance(holder, MutableMapping):
        holder[hostile_text(rng)] = holder.pop(key)
        return "renamed"
    if change == 2 and isinstance(holder, MutableMapping):
        holder[hostile_text(rng)] = json_value(rng)
        return "another key"
    if change == 3 and isinstance(holder, MutableSequence):
        holder.insert(int(rng.integers(len(holder) + 1)), json_value(rng, holder[key]))
        return "another entry"
    if change == 4:
        holder[key] = [holder[key]]
        return "in a list"
    holder[key] = json_value(rng, holder[key])
    return f"{holder[key]!r:.40}"


def to_json(content: Any) -> bytes:
    """Return JSON as it comes, lone surrogates and numbers that are not finite too."""
    return json.dumps(content, indent=1).encode("utf-8", "surrogatepass")


def damaged_bytes(rng: np.random.Generator, content: bytes) -> tuple[bytes, str]:
    """Return bytes with some flipped, cut, repeated, inserted or exchanged, and a description."""
    data, change = bytearray(content), int(rng.integers(9))
    place = int(rng.integers(len(data)))
    end = min(len(data), place + int(rng.integers(1, 64)))
    match change:
        case 0:
            data[place] ^= 1 << int(rng.integers(8))
        case 1:
            del data[place:]
        case 2:
            del data[place:end]
        case 3:
            data[place:place] = rng.bytes(int(rng.integers(1, 64)))
        case 4:
            data[place:end] = bytes(end - place)
        case 5:
            data += data[place:]
        case 6:
            data[place:end] = rng.bytes(end - place)
        case 7:
            data[:0] = [b"\xef\xbb\xbf", b"\xff\xfe", b"\x00", b"\n" * 1000, b"\x80\x04", b"[" * 5000][rng.integers(6)]
        case 8:
            data = bytearray(rng.bytes(int(rng.integers(0, 200))))
    return bytes(data), f"bytes changed ({change}) at {place}"


def copied(source: Path, target: str, content: bytes) -> Path:
    """Return a copy of a folder in which one file has another content."""
    folder = scratch()
    shutil.copytree(source, folder, dirs_exist_ok=True, symlinks=True)
    (folder / target).write_bytes(content)
    return folder


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _folder(path: Path) -> None:
    path.mkdir()


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(200 * 2**30)


def _link(target: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(target)


def _text(content: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content) and None


SPECIAL: dict[str, Callable[[Path], None]] = {
    "a FIFO": _fifo,
    "a folder": _folder,
    "a socket": _socket,
    "200 GiB of nothing": _sparse,
    "a link to /dev/zero": _link("/dev/zero"),
    "a link to /dev/random": _link("/dev/random"),
    "a link to /dev/null": _link("/dev/null"),
    "a link to /dev/full": _link("/dev/full"),
    "a link to /proc/self/mem": _link("/proc/self/mem"),
    "a link to itself": _link("itself"),
    "a link to nowhere": _link("/nowhere/at/all"),
    "nothing": lambda path: None,
    "an empty file": _text(b""),
    "10 MB of brackets": _text(b"[" * 10_000_000),
    "10 MB of mappings": _text(b'{"a":' * 2_000_000),
    "90 MB of empty lists": _text(b"[" + b"[]," * 30_000_000 + b"[]]"),
    "a number of a million digits": _text(b'{"schema": ' + b"9" * 1_000_000 + b"}"),
    "a line of nested lists": _text(b"a = " + b"[" * 100_000),
    "nested tables": _text(b"a" + b".a" * 100_000 + b" = 1"),
    "a key twice": _text(b'{"schema": 1, "schema": 1}'),
    "NUL": _text(bytes(100_000)),
    "UTF-16": _text('{"schema": 1}'.encode("utf-16")),
    "a zip archive of nothing": _text(b"PK\x05\x06" + bytes(18)),
    "a pickle": _text(b"\x80\x04cos\nsystem\n(S'touch canary'\ntR."),
}
"""What may stand in place of a file, by name."""
