"""Archives of arrays, checkpoints and logs of motors: their members, headers, tensors and bytes."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import math
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fuzzyarm.eval.episodes.rollout_file import digest, read_rollouts
from fuzzyarm.eval.report.stored import read_evaluation
from fuzzyarm.identification.log import Log, read_log, write_log
from fuzzyarm.rl_baselines.training import Training

from .damage import damaged_bytes
from .documents import no_code_ran, prepared, read_changed, resumed_sweep
from .samples import CANARY, evaluation, scratch, sweep, training
from .surface import Broken, Surface, Try

__all__ = ["SURFACES"]


def _archive(name: str, source: Callable[[], Path], target: str, read: Callable[[Path], Any], count: int) -> Surface:
    """A surface of an archive of arrays: its bytes, its members, and their headers."""

    def attempt(rng: np.random.Generator) -> Try:
        good = (source() / target).read_bytes()
        content, text = _changed_archive(rng, good) if rng.random() < 0.7 else damaged_bytes(rng, good)

        return Try(f"{target}: {text}", lambda: read_changed(source(), target, content, read))

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
        np.full(good.shape, "x"),
        np.full(good.shape, np.nan),
        np.full(good.shape, 1e300),
        np.array(True),
        np.zeros(3, dtype="f4,i8"),
        np.array(-1),
    ]
    return np.asarray(others[rng.integers(len(others))])


def _read_evaluation(folder: Path) -> None:
    """Read an evaluation whose rollouts are signed again."""
    rollouts = read_rollouts(folder / "rollouts.npz")
    document = json.loads((folder / "results.json").read_text())
    document["rollouts_sha256"] = digest(rollouts)
    (folder / "results.json").write_text(json.dumps(document))
    read_evaluation(folder)


def _checkpoint(rng: np.random.Generator) -> Try:
    """Bytes, or entries of the mapping, with the digest put right."""
    good = (training() / "checkpoint.pt").read_bytes()
    line, _, data = good.partition(b"\n")
    signed = rng.random() < 0.85
    if rng.random() < 0.75:
        found = torch.load(io.BytesIO(data), weights_only=True)
        text = _change_tensors(rng, found)
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


def _change_tensors(rng: np.random.Generator, content: Any) -> str:
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


@functools.cache
def _good_log() -> bytes:
    angle = 0.3 * np.sin(np.arange(1200)[:, np.newaxis] * [4e-3, 7e-3])
    return write_log(Log(1e-3, angle, 40.0 * np.cos(angle), angle)).encode()


def _log(rng: np.random.Generator) -> Try:
    """A log of the motors: what is taken has finite numbers."""
    content, text = damaged_bytes(rng, _good_log()[: int(rng.choice([2000, 60_000, 10**7]))])

    def run() -> None:
        path = scratch() / "log.csv"
        path.write_bytes(content)
        log = read_log(path)
        if not all(np.isfinite(part).all() for part in (log.angle, log.torque, [log.period])):
            raise Broken("a log with numbers that are not finite was taken")

    return Try(f"log.csv: {text}", run)


SURFACES = (
    Surface("log.csv", "files", 400, _log),
    _archive("rollouts.npz", evaluation, "rollouts.npz", _read_evaluation, 500),
    _archive("chunk", sweep, "chunks/000000.npz", resumed_sweep, 500),
    Surface("checkpoint", "files", 300, _checkpoint, prepare=prepared),
)
