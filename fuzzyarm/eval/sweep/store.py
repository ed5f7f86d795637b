"""The folder of a sweep: what is run, the chunks that are done, and from which code and versions they came.

``run.json`` is written first, then ``chunks/NNNNNN.npz`` one by one, each whole or not at all. Every file carries the
digest of the identity: of the configuration's numbers, the policies' files, the code and the versions. Chunks of
another identity are never mixed in.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import json
import platform
import zipfile
import zlib
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import fuzzyarm
from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.sweep.config import COLUMNS, SweepConfig
from fuzzyarm.eval.sweep.episodes import MEASURES
from fuzzyarm.policies import resolve_all

SCHEMA = "fuzzyarm-sweep/1"
RUN, CHUNKS = "run.json", "chunks"
_HERE = [f"eval/sweep/{name}.py" for name in ("config", "plants", "episodes")]
SOURCES = ("envs", "fuzzy_policy", "learned_policy", "policies.py", *_HERE)
"""Where the code and the data are that decide the numbers, below the package."""


@functools.cache
def made_with() -> dict[str, str]:
    """Return the versions, and a digest of the sources, that this process computes with."""
    root = Path(fuzzyarm.__file__).parent
    versions = {name: version(name) for name in ("fuzzyarm", "numpy", "numba")}
    return {"python": platform.python_version(), **versions, "code": _digest_of(root / name for name in SOURCES)}


def difference(one: dict[str, Any], other: dict[str, Any]) -> str:
    """Return in words in which entries two mappings differ; empty if they do not."""
    keys = [key for key in {**one, **other} if one.get(key) != other.get(key)]
    return ", ".join(f"{key} {_short(one.get(key))} and {_short(other.get(key))}" for key in keys)


@dataclasses.dataclass(frozen=True)
class Store:
    """A sweep's folder, `folder`, of the configuration `config` and the identity with the hash `digest`."""

    folder: Path
    config: SweepConfig
    digest: str

    @classmethod
    def create(cls, folder: Path, config: SweepConfig) -> Store:
        """Begin a sweep in a folder that holds none; it is made if needed.

        Raises:
            ValueError: there is a sweep already.
            OSError: the folder cannot be written to.
        """
        if (folder / RUN).exists() or (folder / CHUNKS).exists():
            raise ValueError(f"{folder} holds a sweep already: go on with it with --resume, or choose another --out")
        identity = _identity(config)
        store = cls(folder, config, _hash(identity))
        document = {"schema": SCHEMA, "command": config.command(), "config": config.to_dict(), **identity}
        (folder / CHUNKS).mkdir(parents=True)
        write_atomically(folder / RUN, json.dumps(document | {"digest": store.digest}, indent=1) + "\n")
        return store

    @classmethod
    def open(cls, folder: Path, **looked_at: Any) -> Store:
        """Return the sweep of a folder, to go on with; `looked_at` changes its bound, worst or map.

        Raises:
            ValueError: there is none, its file is broken, or it was begun with other code, versions or policies.
        """
        path = folder / RUN
        if not path.is_file():
            raise ValueError(f"{folder} holds no sweep to go on with: {RUN} is missing; begin one without --resume")
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            schema, given, digest = document["schema"], document["config"], document["digest"]
            config = SweepConfig.from_dict(given)
            then = {name: document[name] for name in ("numbers", "policies", "made_with")}
        except (KeyError, TypeError, ValueError) as error:  # what JSON and Unicode errors are too
            raise ValueError(f"{path} is broken ({_line(error)}): begin anew in another folder") from None
        if schema != SCHEMA or digest != _hash(then) or then["numbers"] != config.numbers():
            raise ValueError(f"{path} is of another version or was changed: begin anew in another folder")
        now = _identity(config)
        for name, what in (("made_with", "versions"), ("policies", "policy files")):
            if found := difference(then[name], now[name]):
                raise ValueError(
                    f"{folder} was begun with other {what} than there are now ({found}), and results are not mixed: "
                    "begin anew in another folder"
                )
        return cls(folder, dataclasses.replace(config, **looked_at), digest)

    def take_back(self) -> None:
        """Undo `create`, unless there are chunks already."""
        if not any((self.folder / CHUNKS).iterdir()):
            (self.folder / CHUNKS).rmdir()
            (self.folder / RUN).unlink()

    def missing(self) -> list[int]:
        """Return the chunks that are to be run; ValueError if one that is there is broken or of another sweep."""
        return [number for number in range(self.config.chunks) if self.load(number) is None]

    def save(self, number: int, arrays: dict[str, np.ndarray]) -> None:
        """Write a chunk, whole or not at all."""
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, digest=np.array(self.digest), **arrays)
        write_atomically(self._path(number), content.getvalue())

    def load(self, number: int) -> dict[str, np.ndarray] | None:
        """Return a chunk's arrays, see `episodes.measure`; None if it is not there, ValueError if it is broken."""
        path = self._path(number)
        if not path.exists():
            return None
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
                digest, arrays = str(file["digest"]), {name: file[name] for name in ("plants", *MEASURES)}
        except (EOFError, KeyError, ValueError, zipfile.BadZipFile, zlib.error) as error:
            raise ValueError(f"{path} is broken ({_line(error)}): delete it, and --resume runs it again") from None
        if digest != self.digest:
            raise ValueError(
                f"{path} is of another sweep than {self.folder / RUN}: delete it, and --resume runs it again"
            )
        members = len(self.config.members(number))
        shape = len(self.config.policies), len(self.config.cases), members
        if arrays["plants"].shape != (members, len(COLUMNS)) or any(arrays[name].shape != shape for name in MEASURES):
            raise ValueError(f"{path} is broken (its size is wrong): delete it, and --resume runs it again")
        return arrays

    def load_all(self) -> dict[str, np.ndarray]:
        """Return the whole sweep's arrays; all chunks must be there."""
        chunks = [self.load(number) or {} for number in range(self.config.chunks)]
        last = {"plants": 0} | dict.fromkeys(MEASURES, -1)
        return {name: np.concatenate([chunk[name] for chunk in chunks], axis=axis) for name, axis in last.items()}

    def _path(self, number: int) -> Path:
        return self.folder / CHUNKS / f"{number:06d}.npz"


def _identity(config: SweepConfig) -> dict[str, Any]:
    """Return everything that the numbers depend on."""
    specs = resolve_all(config.policies)
    policies = {
        label: "named" if spec.named or spec.path is None else _digest_of([spec.path]) for label, spec in specs.items()
    }
    return {"numbers": config.numbers(), "policies": policies, "made_with": made_with()}


def _digest_of(paths: Iterable[Path]) -> str:
    """Return a hash of files, and of all files below folders, but for what Python and Numba cache."""
    digest = hashlib.sha256()
    for path in paths:
        files = [path] if path.is_file() else sorted(path.rglob("*"))
        for file in files:
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(file.relative_to(path.parent).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _hash(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _short(value: Any) -> str:
    return str(value)[:12]


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
