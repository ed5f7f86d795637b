"""Every format of a file: its fields, its structure and its bytes, signed again where a digest guards them."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import math
import os
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import fuzzyarm
from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.certified.frozen import freeze, gain_at, pole_rate
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.eval.certified.verification import verify_file
from fuzzyarm.eval.evaluation.ranking import rank_policies
from fuzzyarm.eval.evaluation.recheck import recheck_results
from fuzzyarm.eval.evaluation.results_file import read_results
from fuzzyarm.eval.paper.drift import EXPECTED, load_expected
from fuzzyarm.eval.report.stored import read_evaluation
from fuzzyarm.eval.sweep.identity import digest_of_identity
from fuzzyarm.eval.sweep.run import Sweep
from fuzzyarm.fuzzy_policy.controller import Controller, _digest
from fuzzyarm.rl_baselines.training import Training

from .arguments import driven
from .damage import SPECIAL, damaged_bytes, damaged_document, to_json
from .samples import CANARY, evaluation, scratch, sweep, training
from .surface import Broken, Surface, Try

__all__ = ["READERS", "SURFACES"]

CONTROLLERS = Path(fuzzyarm.__file__).parent / "fuzzy_policy" / "controllers"
BUNDLES = Path(fuzzyarm.__file__).parent / "learned_policy" / "policies"
CLAIMED = ("fuzzy-1", "fuzzy-2", "paper-1", "paper-4")  # files that are quickly proven


def prepared() -> None:
    """Make the samples, and use everything once."""
    evaluation(), sweep(), training(), read_evaluation(evaluation()), Training.resume(training()).algorithm.update()
    verify_file(CONTROLLERS / "fuzzy-1.json"), _acted(_bundle()), driven(FuzzyArmEnv())


def no_code_ran() -> None:
    """Check that nothing that a file named or held was executed."""
    if CANARY.exists() or "abuse_canary" in sys.modules:
        CANARY.unlink(missing_ok=True)
        raise Broken("code from a file was run")


def _document(content: bytes) -> Any:
    return json.loads(content)


def file_of(
    name: str,
    source: Callable[[], Path],
    target: str,
    read: Callable[[Path], Any],
    sign: Callable[[Any], Any] | None,
    *,
    count: int,
    same: Callable[[Any, Any, bool], None] = lambda original, changed, signed: None,
) -> Surface:
    """A surface of a JSON document: half of the tries change values, the others bytes.

    Args:
        name: of the surface.
        source: a folder with good files; it is copied for each try.
        target: the file in it that is changed.
        read: reads the copy of the folder; returns if it was accepted.
        sign: puts the digest right; None if there is none.
        count: tries of a whole run.
        same: called with the document before and after, and whether it is signed, if it was accepted.
    """

    def attempt(rng: np.random.Generator) -> Try:
        good = (source() / target).read_bytes()
        signed = sign is not None and rng.random() < 0.7
        if rng.random() < 0.7:
            document, text = damaged_document(rng, _document(good))
            if signed and sign is not None and isinstance(document, dict):
                try:
                    document, text = sign(document), f"{text}, signed"
                except (KeyError, TypeError, ValueError, AttributeError):
                    signed = False
            content = to_json(document)
        else:
            content, text = damaged_bytes(rng, good)
            signed = False

        def run() -> None:
            folder = _copied(source(), target, content)
            try:
                read(folder)
            finally:
                no_code_ran()
            same(_document(good), _document(content), signed)

        return Try(f"{target}: {text}", run)

    return Surface(name, "files", count, attempt, prepare=prepared)


def _copied(source: Path, target: str, content: bytes) -> Path:
    folder = scratch()
    shutil.copytree(source, folder, dirs_exist_ok=True, symlinks=True)
    (folder / target).write_bytes(content)
    return folder


@functools.cache
def _controller(name: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="abuse-"))
    shutil.copy(CONTROLLERS / f"{name}.json", folder / "controller.json")
    return folder


def _signed_controller(document: dict[str, Any]) -> dict[str, Any]:
    document.pop("digest", None)
    return document | {"digest": _digest(document)}


def _verified(folder: Path) -> None:
    """Verify a controller file; what is called PROVEN has to hold on frozen loops, in floating point."""
    report = verify_file(folder / "controller.json")
    text = report.to_text() + json.dumps(report.to_dict(), allow_nan=True)
    if report.certificate.proven and "NOT PROVEN" not in text:
        _check_claim(report.controller)


def _check_claim(controller: Controller) -> None:
    """Check rates and gains of the consistent form at random states of the box: no proof, but an oracle of its own."""
    if controller.form != "consistent":
        return
    rng, limits = np.random.default_rng(0), controller.model.parameters
    q = rng.uniform(-1.0, 1.0, (400, 2)) * limits.joint_limit
    dq = rng.uniform(-1.0, 1.0, (400, 2)) * limits.velocity_limit
    F, G = freeze(RigidLoop(controller), q, dq)
    slow, gains = pole_rate(F).min(), [gain_at(F, G, np.full(400, 1j * w)).max() for w in (0.0, 1.0, 10.0, 100.0)]
    if slow < controller.alpha * (1.0 - 1e-6) or max(gains) > controller.gamma * (1.0 + 1e-6):
        raise Broken(
            f"PROVEN, but the rate is {slow:g} (alpha {controller.alpha:g}), the gain {max(gains):g} "
            f"(gamma {controller.gamma:g})"
        )
    fastest = -np.linalg.eigvals(F).real.min()
    if controller.fastest_pole is not None and fastest > controller.fastest_pole * (1.0 + 1e-6):
        raise Broken(f"PROVEN, but a pole is at {-fastest:g}, claimed above {-controller.fastest_pole:g}")


def _same_controller(original: Any, changed: Any, signed: bool) -> None:
    if not signed and original != changed:
        raise Broken("a changed file with the old digest was taken")


def _robot(rng: np.random.Generator) -> Try:
    if rng.random() < 0.6:
        values, text = damaged_document(rng, ArmParameters().to_dict())
        lines = (f"{key if key.isidentifier() else json.dumps(key)} = {_toml(value)}" for key, value in values.items())
        content = "\n".join(lines).encode("utf-8", "surrogatepass")
    else:
        content, text = damaged_bytes(rng, ArmParameters().to_toml().encode())

    def run() -> None:
        path = scratch() / "robot.toml"
        path.write_bytes(content)
        driven(FuzzyArmEnv(parameters=ArmParameters.from_toml(path)))

    return Try(f"robot.toml: {text}", run)


def _toml(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else f"{'-' * (value < 0)}inf"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return "''" if value is None else json.dumps(value)


def _bundle() -> Path:
    return BUNDLES / "ppo-nominal"


def _acted(folder: Path) -> None:
    policy = load_policy(folder)
    observation = np.array([0.3, 0.5, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0])
    torque, _ = policy.predict(observation)
    if not (np.abs(torque) <= ArmParameters().torque_limit).all():
        raise Broken(f"torque {torque}")


def _weights(rng: np.random.Generator) -> Try:
    """Bytes of the weights, most of them with the digest put right; the header is text, which is changed more often."""
    good, signed = (_bundle() / "weights.safetensors").read_bytes(), rng.random() < 0.8
    length = int.from_bytes(good[:8], "little")
    if rng.random() < 0.5:
        header, text = damaged_document(rng, json.loads(good[8 : 8 + length]))
        head = to_json(header)
        size = len(head) if rng.random() < 0.8 else int(rng.integers(2**63, dtype=np.int64))
        content = size.to_bytes(8, "little") + head + good[8 + length :]
    else:
        content, text = damaged_bytes(rng, good)

    def run() -> None:
        folder = _copied(_bundle(), "weights.safetensors", content)
        if signed:
            document = json.loads((folder / "policy.json").read_text())
            document["weights_sha256"] = hashlib.sha256(content).hexdigest()
            (folder / "policy.json").write_text(json.dumps(document))
        _acted(folder)
        if not signed and content != good:
            raise Broken("changed weights with the old digest were taken")

    return Try(f"weights.safetensors: {text}{', signed' if signed else ''}", run)


def _read_results(folder: Path) -> None:
    results = read_results(folder)
    rank_policies([folder])
    if (
        results.config.seeds * len(results.config.policies) * len(results.config.cases) > 1
        or results.config.control_period < 5e-4
    ):
        return
    recheck_results(results, ())


def _archive(name: str, source: Callable[[], Path], target: str, read: Callable[[Path], Any], count: int) -> Surface:
    """A surface of an archive of arrays: its bytes, its members, and their headers."""

    def attempt(rng: np.random.Generator) -> Try:
        good = (source() / target).read_bytes()
        content, text = _changed_archive(rng, good) if rng.random() < 0.7 else damaged_bytes(rng, good)

        def run() -> None:
            folder = _copied(source(), target, content)
            try:
                read(folder)
            finally:
                no_code_ran()

        return Try(f"{target}: {text}", run)

    return Surface(name, "files", count, attempt, prepare=prepared)


def _changed_archive(rng: np.random.Generator, good: bytes) -> tuple[bytes, str]:
    """Exchange a member of an archive: another array, another header, objects, damaged bytes."""
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        members = {one: archive.read(one) for one in archive.namelist()}
    name = list(members)[rng.integers(len(members))]
    change, content = int(rng.integers(8)), members[name]
    if change == 0:
        del members[name]
    elif change == 1:
        members[f"{name}x" if rng.random() < 0.5 else "../evil.npy"] = content
    elif change in (2, 3):
        other = _arrays(rng, np.load(io.BytesIO(content), allow_pickle=False))
        buffer = io.BytesIO()
        np.save(buffer, other, allow_pickle=True)
        members[name] = buffer.getvalue()
    elif change == 4:
        members[name] = content.replace(
            b"(", [b"(10000000000000,", b"(-1,", b"((", b"(1e3,", b"(__import__('os'),"][rng.integers(5)], 1
        )
    else:
        members[name], _ = damaged_bytes(rng, content)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED if rng.random() < 0.5 else zipfile.ZIP_STORED) as archive:
        for one, data in members.items():
            archive.writestr(one, data)
    data = bytearray(buffer.getvalue())
    if change == 7:  # the encrypted flag, or another compression, in the list of members
        place = data.find(b"PK\x01\x02")
        data[place + 8 + 2 * int(rng.integers(2))] = int(rng.integers(256))
    return bytes(data), f"member {name} changed ({change})"


class _Payload:
    """What a pickle runs: the canary."""

    def __reduce__(self) -> Any:
        return os.mkdir, (str(CANARY),)


def _arrays(rng: np.random.Generator, good: np.ndarray) -> np.ndarray:
    others: list[Any] = [
        np.array([_Payload(), None], dtype=object),
        np.array("x"),
        np.zeros(0),
        np.array(1j),
        good[np.newaxis],
        good.astype(str),
        np.full(good.shape, np.nan),
        np.full(good.shape, 1e300),
        np.array(True),
        np.zeros(3, dtype="f4,i8"),
        np.array(-1),
    ]
    return np.asarray(others[rng.integers(len(others))])


def _signed_run(document: dict[str, Any]) -> dict[str, Any]:
    """Sign a run.json as whoever forges it would: the numbers follow the configuration."""
    numbers = document["numbers"]
    document["numbers"] = {name: document["config"].get(name, value) for name, value in numbers.items()}
    then = {name: document[name] for name in ("numbers", "policies", "made_with")}
    return document | {"digest": digest_of_identity(then)}


def _resumed_sweep(folder: Path) -> None:
    opened = Sweep.resume(folder)
    if opened.store.config.total <= 4 and opened.store.config.plants <= 4:
        opened.store.missing()
        opened.store.load_all()


def _read_evaluation(folder: Path) -> None:
    """Read an evaluation whose rollouts are signed again."""
    from fuzzyarm.eval.episodes.rollout_file import digest, read_rollouts

    rollouts = read_rollouts(folder / "rollouts.npz")
    document = json.loads((folder / "results.json").read_text())
    document["rollouts_sha256"] = digest(rollouts)
    (folder / "results.json").write_text(json.dumps(document))
    read_evaluation(folder)


def _checkpoint(rng: np.random.Generator) -> Try:
    """Bytes, or entries of the mapping, with the digest put right."""
    import torch

    good = (training() / "checkpoint.pt").read_bytes()
    line, _, data = good.partition(b"\n")
    signed = rng.random() < 0.85
    if rng.random() < 0.75:
        found = torch.load(io.BytesIO(data), weights_only=True)
        text = _change_tensors(rng, found, torch)
        buffer = io.BytesIO()
        torch.save(found, buffer)
        data = buffer.getvalue()
    else:
        data, text = damaged_bytes(rng, data)
    if signed:
        line = line.split(b" ")[0] + b" " + hashlib.sha256(data).hexdigest().encode()

    def run() -> None:
        folder = scratch()
        (folder / "checkpoint.pt").write_bytes(line + b"\n" + data)
        try:
            resumed = Training.resume(folder)
        finally:
            no_code_ran()
        if resumed.config.lanes <= 64 and resumed.config.n_steps <= 128 and resumed.config.n_epochs <= 8:  # type: ignore[attr-defined]
            resumed.algorithm.update()

    return Try(f"checkpoint.pt: {text}{', signed' if signed else ''}", run)


def _change_tensors(rng: np.random.Generator, content: Any, torch: Any) -> str:
    """Change an entry of nested mappings and lists of tensors."""
    holder, text = content, ""
    while True:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        key = keys[rng.integers(len(keys))]
        text += f"[{key!r:.20}]"
        if not isinstance(holder[key], dict | list) or not holder[key] or rng.random() < 0.1:
            break
        holder = holder[key]
    value = holder[key]
    if isinstance(value, torch.Tensor) and value.numel() and rng.random() < 0.8:
        flat = value.clone().flatten()
        place, change = int(rng.integers(flat.numel())), rng.integers(5)
        if change == 0:
            holder[key] = value[..., :0] if value.ndim else value[None]
        elif change == 1:
            holder[key] = value.to(torch.complex64)
        elif flat.dtype.is_floating_point:
            flat[place] = [math.nan, math.inf, 1e30, -1e30][rng.integers(4)]
            holder[key] = flat.reshape(value.shape)
        elif flat.dtype != torch.bool:
            flat[place] = [int(torch.iinfo(flat.dtype).max), int(torch.iinfo(flat.dtype).min), 0][rng.integers(3)]
            holder[key] = flat.reshape(value.shape)
        return f"{text}: a number"
    holder[key] = [None, -1, 10**6, "x", [], {}, math.nan, torch.zeros(3), True, "abuse_canary:make"][rng.integers(10)]
    return f"{text}: {str(holder[key])[:30]}"


READERS: dict[str, Callable[[Path], Any]] = {
    "controller": lambda path: Controller.load(path),
    "robot": lambda path: ArmParameters.from_toml(path),
    "expected": lambda path: load_expected(path),
    "results": lambda path: read_results(path),
    "bundle": lambda path: load_policy(_beside(path, "policy.json", _bundle())),
    "weights": lambda path: load_policy(_beside(path, "weights.safetensors", _bundle())),
    "rollouts": lambda path: read_evaluation(_beside(path, "rollouts.npz", evaluation())),
    "run.json": lambda path: Sweep.resume(_beside(path, "run.json", sweep())),
    "chunk": lambda path: Sweep.resume(_beside(path, "chunks/000000.npz", sweep())).remaining,
    "checkpoint": lambda path: Training.resume(_beside(path, "checkpoint.pt", training())),
}
"""Readers of one file of each format."""


def _beside(path: Path, name: str, good: Path) -> Path:
    folder = scratch()
    shutil.copytree(good, folder, dirs_exist_ok=True)
    (folder / name).unlink()
    (folder / name).symlink_to(path)
    return folder


def _in_place_of_a_file(rng: np.random.Generator) -> Try:
    kind, reader = list(SPECIAL)[rng.integers(len(SPECIAL))], list(READERS)[rng.integers(len(READERS))]

    def run() -> None:
        path = scratch() / "itself"
        SPECIAL[kind](path)
        try:
            READERS[reader](path)
        finally:
            no_code_ran()
            path.is_file() and path.unlink()

    return Try(f"{reader} is {kind}", run)


def _expected_folder() -> Path:
    return EXPECTED.parent


SURFACES = (
    *(
        file_of(
            f"controller {name}",
            functools.partial(_controller, name),
            "controller.json",
            _verified,
            _signed_controller,
            count=500 if name.startswith("fuzzy") else 400,
            same=_same_controller,
        )
        for name in CLAIMED
    ),
    Surface("robot TOML", "files", 1500, _robot, prepare=prepared),
    file_of("policy.json", _bundle, "policy.json", _acted, None, count=800),
    Surface("weights.safetensors", "files", 600, _weights, prepare=prepared),
    file_of("results.json", evaluation, "results.json", _read_results, None, count=800),
    _archive("rollouts.npz", evaluation, "rollouts.npz", _read_evaluation, 500),
    file_of("run.json", sweep, "run.json", _resumed_sweep, _signed_run, count=600),
    _archive("chunk", sweep, "chunks/000000.npz", _resumed_sweep, 500),
    Surface("checkpoint", "files", 300, _checkpoint, prepare=prepared),
    file_of(
        "expected.json",
        _expected_folder,
        "expected.json",
        lambda folder: load_expected(folder / "expected.json"),
        None,
        count=400,
    ),
    Surface("in place of a file", "files", 240, _in_place_of_a_file, prepare=prepared),
)
