"""The folder of a sweep: its configuration, the finished chunks, and the code and versions that produced them.

``run.json`` is written first, then ``chunks/NNNNNN.npz`` one by one, each whole or not at all. Every file carries the
digest of the sweep's identity (`identity.sweep_identity`). Chunks of another identity are never mixed in.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm.common.array_files import read_arrays
from fuzzyarm.common.checks import instance, listed
from fuzzyarm.common.documents import DocumentError, check_schema, read_json
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.sweep.config import SHOWN, SweepConfig
from fuzzyarm.eval.sweep.identity import difference, digest_of_identity, sweep_identity
from fuzzyarm.eval.sweep.results import METRICS, SweepResults
from fuzzyarm.policies import Kind, PolicySpec, found_again, resolve, resolve_all

__all__ = ["RUN", "SCHEMA", "Store"]

SCHEMA = "fuzzyarm-sweep/3"  # of the file of a sweep that tells what is run
RUN = "run.json"  # its name
_CHUNKS = "chunks"


@dataclasses.dataclass(frozen=True)
class Store:
    """The folder of a sweep.

    Attributes:
        folder: where it is.
        config: of the sweep.
        specs: its policies by label; those that are the user's code may run it.
        digest: of its identity.
    """

    folder: Path
    config: SweepConfig
    specs: dict[str, PolicySpec]
    digest: str

    @classmethod
    def create(cls, folder: Path, config: SweepConfig) -> Store:
        """Begin a sweep in a folder that holds none; the folder is made if needed.

        Policies of the form ``package.module:factory`` are imported: the caller vouches for the configuration.

        Raises:
            ValueError: there is a sweep already, or a policy is damaged, or two have the same label.
            OSError: the folder cannot be written to, or a policy's file cannot be read.
        """
        if (folder / RUN).exists():
            raise ValueError(f"{folder} holds a sweep already: go on with it with --resume, or choose another --out")
        if any(folder.glob(f"{_CHUNKS}/[!.]*")):
            raise ValueError(
                f"{folder / _CHUNKS} holds results of a sweep whose {RUN} is missing: remove {_CHUNKS}, or choose "
                "another --out"
            )
        specs = resolve_all(config.policies, run_code=True)
        found = sweep_identity(config, specs)
        store = cls(folder, config, specs, digest_of_identity(found))
        document = {"schema": SCHEMA, "command": config.command(), "config": config.to_dict(), **found}
        chunks = folder / _CHUNKS
        chunks.mkdir(parents=True, exist_ok=True)  # one that is empty is what a run leaves that is killed here
        try:
            write_atomically(folder / RUN, json.dumps(document | {"digest": store.digest}, indent=1) + "\n")
        except BaseException:
            store.take_back()
            raise
        return store

    @classmethod
    def open(cls, folder: Path, given: Mapping[str, Any] | None = None) -> Store:
        """Return the sweep of a folder, to go on with.

        Args:
            folder: of the sweep.
            given: fields of the configuration that the user has repeated. Those of `config.SHOWN` replace what the
                folder says; the others must be the same. The user's own code that the folder names is run only if
                ``policies`` names it too, alone or with all the other policies; a policy whose file is no longer where
                it was may be named with its path.

        Raises:
            ValueError: there is no sweep; its file is damaged or of another format; it was begun with another
                configuration, code, version or policy file; or it names code that the user has not named.
            OSError: a file cannot be read.
        """
        path = folder / RUN
        if not path.is_file():
            raise ValueError(f"{folder} holds no sweep to go on with: {RUN} is missing; begin one without --resume")
        config, then, digest = _read_run(path)
        given = dict(given or {})
        named = given.pop("policies", ())
        _check_policies(path, config, named)
        shown = {name: given.pop(name) for name in SHOWN if name in given}
        for name, value in given.items():
            _check_same(folder, name, getattr(config, name), value)
        config = dataclasses.replace(config, **shown)
        found = found_again(config.policies, then["policies"], named, folder)
        specs = {label: resolve(spec.name, run_code=spec.name in named) for label, spec in resolve_all(found).items()}
        now = sweep_identity(config, specs)
        for name, what in (("made_with", "versions"), ("policies", "policy files"), ("cases", "added cases")):
            if changed := difference(then.get(name, {}), now.get(name, {})):
                raise ValueError(
                    f"{folder} was begun with other {what} than there are now ({changed}), and results are not mixed: "
                    "begin anew in another folder"
                )
        return cls(folder, config, specs, digest)

    def take_back(self) -> None:
        """Undo `create` if there are no chunks yet."""
        chunks = self.folder / _CHUNKS
        if not any(chunks.iterdir()):
            chunks.rmdir()
            (self.folder / RUN).unlink(missing_ok=True)

    def missing(self) -> list[int]:
        """Return the chunks that are still to be run; ValueError if one that exists is damaged or of another sweep."""
        return [number for number in range(self.config.chunks) if self.load(number) is None]

    def save(self, number: int, results: SweepResults) -> None:
        """Write a chunk, whole or not at all."""
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, digest=np.array(self.digest), **results.arrays())
        write_atomically(self._path(number), content.getvalue())

    def load(self, number: int) -> SweepResults | None:
        """Return a chunk; None if it has not been run, ValueError if its file is damaged."""
        path = self._path(number)
        if not path.exists():
            return None
        try:
            arrays = read_arrays(path)
        except ValueError as error:  # it names the file
            raise ValueError(f"{error}: delete it, and --resume runs it again") from None
        digest = str(arrays.pop("digest", ""))
        if set(arrays) != {"plants", *METRICS}:
            raise ValueError(f"{path} is damaged (an array is missing): delete it, and --resume runs it again")
        results = SweepResults(**arrays)
        if digest != self.digest:
            raise ValueError(
                f"{path} is of another sweep than {self.folder / RUN}: delete it, and --resume runs it again"
            )
        if not results.fits(
            len(self.config.policies), len(self.config.cases), len(self.config.members(number)), self.config.joints
        ):
            raise ValueError(f"{path} is damaged (its size is wrong): delete it, and --resume runs it again")
        return results

    def load_all(self) -> SweepResults:
        """Return the results of the whole sweep; ValueError if a chunk is missing."""
        chunks = [self.load(number) for number in range(self.config.chunks)]
        done = [chunk for chunk in chunks if chunk is not None]
        if len(done) < len(chunks):
            raise ValueError(f"{self.folder} lacks {len(chunks) - len(done)} chunks: --resume runs them")
        return SweepResults.joined(done)

    def _path(self, number: int) -> Path:
        return self.folder / _CHUNKS / f"{number:06d}.npz"


def _read_run(path: Path) -> tuple[SweepConfig, dict[str, Any], str]:
    """Return the configuration, the identity and its digest from ``run.json``."""
    try:
        content = read_json(path)
    except DocumentError as error:  # it names the file
        raise ValueError(f"{error}; begin anew in another folder") from None
    try:
        document = check_schema(content, SCHEMA)
        parts = ("numbers", "policies", "made_with", *({"cases"} & document.keys()))
        then = {name: instance(name, document[name], dict) for name in parts}
        unknown = [name for name in then.get("cases", ()) if name not in CASES]
        config, digest = None if unknown else SweepConfig.from_dict(document["config"]), document["digest"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} cannot be used ({_line(error)}): begin anew in another folder") from None
    if config is None:
        raise ValueError(f"{path} runs cases that this process lacks: add them with add_case: {listed(unknown)}")
    if digest != digest_of_identity(then) or then["numbers"] != json.loads(json.dumps(config.numbers())):
        raise ValueError(f"{path} was changed after the sweep began: begin anew in another folder")
    return config, then, digest


def _check_same(folder: Path, name: str, kept: Any, value: Any) -> None:
    """Check that the user has repeated a field of the configuration as the folder has it."""
    if value == kept:
        return
    if isinstance(kept, ArmParameters):
        raise ValueError(
            f"{folder} holds a sweep of another robot ({difference(kept.to_dict(), value.to_dict())}): choose another "
            "--out"
        )
    if isinstance(value, Robot):
        then = "the two-joint arm" if kept is None else f"{kept.name}, with other numbers"
        raise ValueError(f"{folder} holds a sweep of {then}, not of {value.name}: choose another --out")
    raise ValueError(f"{folder} holds a sweep with {name} = {kept}, not {value}: choose another --out")


def _check_policies(path: Path, config: SweepConfig, named: Sequence[str]) -> None:
    """Check that the user has named all code that would be run, and no policy that is not in the sweep."""
    code = [name for name in config.policies if resolve(name).kind is Kind.CODE]
    unnamed = [name for name in code if name not in named]
    if unnamed:
        flags = " ".join(f"--policy {name}" for name in unnamed)
        raise ValueError(
            f"{path} names code that is not part of fuzzyarm, which a file alone does not get run; if you trust it, "
            f"add {flags}"
        )
    labels = [resolve(name).label for name in config.policies]
    all_named = [resolve(name).label for name in named] == labels
    moved = [name for name in named if (spec := resolve(name)).path and not spec.named and spec.label in labels]
    if not all_named and set(named) - set(moved) - set(code):
        raise ValueError(
            f"{path.parent} holds a sweep with policies = {', '.join(config.policies)}, not {', '.join(named)}: "
            "choose another --out"
        )


def _line(error: Exception) -> str:
    """Return the message of an error in one line."""
    return " ".join(str(error).split()) or type(error).__name__
