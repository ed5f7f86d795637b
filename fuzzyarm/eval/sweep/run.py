"""A sweep in its folder: how it is started, run chunk by chunk, resumed, summarised and replayed.

``run.json`` is written first, then ``chunks/NNNNNN.npz`` one by one, each whole or not at all. Resuming a sweep runs
the chunks that are missing. ``run.json`` contains the identity of the sweep: the configuration and everything else on
which the results depend, that is versions and code, added cases, and the files of the policies. Every file carries the
digest of the identity, and results of different identities are never mixed in one folder.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import platform
import re
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import fuzzyarm
from fuzzyarm.common.array_files import read_arrays
from fuzzyarm.common.checks import instance, listed, path_of
from fuzzyarm.common.documents import read_bytes, read_checked
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES, INSTANTS, Case
from fuzzyarm.eval.declarations import declarations_of, unrelated
from fuzzyarm.eval.engine import Engine, source_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.episodes.rollout_file import npz_bytes
from fuzzyarm.eval.provenance import json_text
from fuzzyarm.eval.sweep._episodes import SweepResults, replay, run_plants
from fuzzyarm.eval.sweep._plants import CONTROL_PERIOD
from fuzzyarm.eval.sweep.config import SHOWN, SweepConfig
from fuzzyarm.eval.sweep.summary import SCHEMA, SUMMARY, summarise
from fuzzyarm.fuzzy_policy.policy import Predictor
from fuzzyarm.policies import PolicySpec, found_again, resolve, resolve_all

__all__ = [
    "Sweep",
]

_RUN = "run.json"


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A sweep in its folder, with its policies loaded.

    `specs` maps labels to the policies' specs (user code named there may run), `policies` to the policies for the robot
    of `config`. `digest` is the digest of everything on which the results depend.
    """

    folder: Path
    config: SweepConfig
    specs: dict[str, PolicySpec]
    policies: dict[str, Predictor]
    digest: str

    @classmethod
    def begin(cls, folder: Path, config: SweepConfig) -> Sweep:
        """Begin a sweep in a folder without one; the folder is made if needed.

        Policies of the form ``package.module:factory`` are imported: the caller trusts the configuration.

        Raises:
            ValueError: the folder has a sweep, or a policy is unknown, damaged or made for another robot, or two
                policies have the same label; nothing is written then.
            OSError: a file cannot be read or written.
        """
        folder, config = path_of("folder", folder), instance("config", config, SweepConfig)
        if (folder / _RUN).exists():
            raise ValueError(f"{folder} already contains a sweep: continue it with --resume, or choose another --out")
        if any(folder.glob("chunks/[!.]*")):
            raise ValueError(
                f"{folder / 'chunks'} contains results of a sweep whose {_RUN} is missing: remove this folder, or "
                "choose another --out"
            )
        specs = resolve_all(config.policies, run_code=True)
        identity = _identity_of(config, specs)
        sweep = cls._loaded(folder, config, specs, _digest_of(identity))
        document = {"schema": SCHEMA, "command": config.command(), **identity, "config": config.to_dict()}
        # A run that ends after this line leaves an empty folder of chunks, which does not prevent the next.
        (folder / "chunks").mkdir(parents=True, exist_ok=True)
        write_atomically(folder / _RUN, json_text({**document, "digest": sweep.digest}))
        return sweep

    @classmethod
    def resume(cls, folder: Path, given: Mapping[str, Any] | None = None) -> Sweep:
        """Return the sweep of a folder, to be continued, summarised or replayed.

        Args:
            folder: the folder of the sweep.
            given: fields of the configuration that the user repeats. Those of `config.SHOWN` replace the values in the
                folder; the others must equal them. The user's own code that the folder names runs only if
                ``policies`` names it too, alone or with other policies; a policy whose file has moved may be named
                with its new path.

        Raises:
            ValueError: the folder has no sweep; its file is damaged or of another format; it was begun with another
                configuration, code, version or policy file; or it names code that the user has not named.
            OSError: a file cannot be read.
        """
        path, given = path_of("folder", folder) / _RUN, dict(given or {})
        if not path.is_file():
            raise ValueError(f"{folder} contains no sweep: {_RUN} is missing; begin one without --resume and --replay")
        config, then, digest = read_checked(path, SCHEMA, "start again in another folder", _begun)
        if digest != _digest_of(then):
            raise ValueError(f"{path} was changed after the sweep began: start again in another folder")
        named = given.pop("policies", ())
        others = unrelated(f"{path} names code", config.policies, named)
        if others and [resolve(name).label for name in named] != config.labels:
            raise ValueError(
                f"{folder} contains a sweep with policies = {', '.join(config.policies)}, not {', '.join(named)}: "
                "resume it with its own policies, or choose another --out"
            )
        config = dataclasses.replace(config, **{name: given.pop(name) for name in SHOWN if name in given})
        if changed := _difference(config.to_dict(), dataclasses.replace(config, **given).to_dict()):
            raise ValueError(f"{folder} contains a sweep with other settings ({changed}): choose another --out")
        names = found_again(config.policies, then["policies"], named, Path(folder))
        specs = {label: resolve(spec.name, run_code=spec.name in named) for label, spec in resolve_all(names).items()}
        if changed := _difference(then, _identity_of(config, specs)):
            raise ValueError(
                f"{folder} was started with different versions, code, cases or policy files ({changed}), "
                "and results must not be mixed: start again in another folder"
            )
        return cls._loaded(Path(folder), config, specs, digest)

    @classmethod
    def _loaded(cls, folder: Path, config: SweepConfig, specs: dict[str, PolicySpec], digest: str) -> Sweep:
        policies: dict[str, Predictor] = {label: spec.load(CONTROL_PERIOD, config.arm) for label, spec in specs.items()}
        return cls(folder, config, specs, policies, digest)

    def take_back(self) -> None:
        """Undo `begin` if there are no chunks yet."""
        if not any((self.folder / "chunks").iterdir()):
            (self.folder / "chunks").rmdir()
            (self.folder / _RUN).unlink(missing_ok=True)

    def missing(self) -> list[int]:
        """Return the chunks that have not been run; ValueError if one that exists is damaged or of another sweep."""
        return [number for number in range(self.config.chunks) if self._load(number) is None]

    def run(self, engine: Engine, report: Callable[[str], None] = lambda text: None) -> Iterator[int]:
        """Run the missing chunks, write each as soon as it is done, and yield the number of its plants.

        The errors are those of `Engine.run`, and ValueError if a chunk is damaged, a policy fails or versions differ.
        """
        work = functools.partial(_run_chunk, self.config, self.policies, _made_with())
        with contextlib.closing(engine.run(work, self.missing(), report)) as chunks:
            for number, results in chunks:
                content = npz_bytes({"digest": np.array(self.digest), **results.arrays}, compressed=False)
                write_atomically(self._path(number), content)
                yield len(results.plants)

    def results(self) -> SweepResults:
        """Return the results of the whole sweep; ValueError if a chunk is missing or damaged."""
        done = [chunk for number in range(self.config.chunks) if (chunk := self._load(number)) is not None]
        if missing := self.config.chunks - len(done):
            raise ValueError(f"results are missing from {self.folder} (chunks: {missing}): run these with --resume")
        return SweepResults.joined(done)

    def summarise(self, progress: Callable[[], None] = lambda: None) -> tuple[dict[str, Any], list[Path]]:
        """Write summary, episodes and figures; `progress` is called after each figure.

        Return the content of ``sweep.json``, see `summary.summarise`, and the paths of all files written.
        """
        # Imported here and in `replay_plant`, because Matplotlib takes a second to load.
        from fuzzyarm.eval.sweep._figures import write_sweep_figures

        config, folder, results = self.config, self.folder, self.results()
        document = summarise(config, results, declarations_of(self.specs, self.policies, config.arm))
        contents: dict[str, str | bytes] = {
            SUMMARY: json_text(document),
            "episodes.npz": npz_bytes(results.arrays),
        }
        for name, content in contents.items():
            write_atomically(folder / name, content)
        figures = write_sweep_figures(config, results, document["rows"], folder, progress)
        return document, [*(folder / name for name in contents), *figures]

    def replay_plant(self, policy: str, case: str, plant: int) -> tuple[Rollout, Path]:
        """Run one episode of the sweep again, given the policy's label, the case and the number of the plant.

        Return its signals, and the folder to which they and their figures were written.
        """
        from fuzzyarm.eval.evaluation.figures import write_figures

        rollout = replay(self.config, self.policies, plant, policy, case)
        folder = self.folder / f"replay-{policy.replace(':', '-')}-{case}-{plant}"
        folder.mkdir(exist_ok=True)
        write_atomically(folder / "episode.npz", npz_bytes(dataclasses.asdict(rollout)))
        write_figures([rollout], folder, titles=self.config.titles)
        return rollout, folder

    def _path(self, number: int) -> Path:
        return self.folder / "chunks" / f"{number:06d}.npz"

    def _load(self, number: int) -> SweepResults | None:
        """Return the results of a chunk, None if it has not been run; ValueError for a damaged or foreign file."""
        path, again = self._path(number), "delete this chunk, then --resume runs it again"
        if not path.exists():
            return None
        try:
            arrays = read_arrays(path)
        except ValueError as error:  # it names the file
            raise ValueError(f"{error}: {again}") from None
        if str(arrays.pop("digest", "")) != self.digest:
            raise ValueError(f"{path} belongs to a different sweep from {self.folder / _RUN}: {again}")
        return SweepResults.of(arrays)


def _run_chunk(
    config: SweepConfig, policies: Mapping[str, Predictor], needed: Mapping[str, str], number: int
) -> SweepResults:
    """Run a chunk in this process; ValueError if the process's package versions or source code differ from `needed`."""
    if found := _difference(_made_with(), needed):
        raise ValueError(
            f"package versions or code of a worker differ from those of the sweep's process ({found}): install "
            "the same versions on all machines, and do not change code during the sweep"
        )
    return run_plants(config, policies, config.members(number))


@functools.cache
def _made_with() -> dict[str, str]:
    """Return the versions of this process's software, and the digest of the package's files."""
    digest, root = hashlib.sha256(), Path(fuzzyarm.__file__).parent
    for file in sorted(root.rglob("*")):
        if file.is_file() and "__pycache__" not in file.parts:
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    versions = {name: version(name) for name in ("fuzzyarm", "numpy", "llvmlite")}
    return {"python": platform.python_version(), **versions, "code": digest.hexdigest()}


def _identity_of(config: SweepConfig, specs: Mapping[str, PolicySpec]) -> dict[str, dict[str, Any]]:
    """Return everything on which the results of a sweep depend, as data for JSON; user code may run."""
    axes = 2 if config.robot is None else 3
    return {
        "config": _numbers(config.to_dict()),
        "policies": {label: spec.files() | _module_files(spec) for label, spec in specs.items()},
        "made_with": _made_with(),
        "cases": {name: _described(case, axes) for name, case in CASES.added().items() if name in config.cases},
    }


def _digest_of(identity: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def _begun(document: Mapping[str, Any]) -> tuple[SweepConfig, dict[str, dict[str, Any]], str]:
    parts = {name: instance(name, document[name], dict) for name in ("config", "policies", "made_with", "cases")}
    config = SweepConfig.from_dict(parts["config"])
    return config, parts | {"config": _numbers(parts["config"])}, document["digest"]


def _numbers(config: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in config.items() if name not in SHOWN}


def _module_files(spec: PolicySpec) -> dict[str, str]:
    """Return the SHA-256, by path, of the Python files in the user's package or module that defines a policy."""
    source = source_of(spec.code.partition(":")[0].partition(".")[0]) if spec.code else None
    if source is None:
        return {}
    files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
    return {file.relative_to(source.parent).as_posix(): hashlib.sha256(read_bytes(file)).hexdigest() for file in files}


def _described(case: Case, axes: int) -> str:
    """Return the digest of a user's case: of its fields as text, and of its tip force (`axes`,) at some instants."""
    force, t = case.disturbance.tip_force, np.linspace(0.0, 2.0, INSTANTS)
    text = re.sub(r" at 0x[0-9a-f]+", "", repr(case))
    velocity = np.stack([np.cos(t), np.sin(t), t][:axes], axis=-1)
    forces = b"" if force is None else np.asarray(force.at(t, velocity)).tobytes()
    return hashlib.sha256(text.encode() + forces).hexdigest()


def _difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return text on how two mappings differ; it is empty if they are equal."""
    found = []
    for key in dict.fromkeys([*one, *other]):
        then, now = one.get(key), other.get(key)
        if isinstance(then, Mapping) and isinstance(now, Mapping):
            inner = _difference(then, now)
            found += [f"{listed([key])}: {inner}"] if inner else []
        elif then != now:  # the first characters of a digest or a version are enough
            found.append(f"{listed([key])} {listed([then]):.20} and {listed([now]):.20}")
    return ", ".join(found)
