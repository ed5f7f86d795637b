"""The checkpoint of a training run: one file, replaced atomically, so that a complete one always exists.

The file is a line, ``fuzzyarm-checkpoint/3 SHA256``, followed by the output of `torch.save` for tensors, numbers and
text. It is read with ``weights_only=True``, so that no code in it is run. `check_like` compares its content with that
of a new training run with the same configuration; no part of a state is used before all parts are known to fit.
"""

import hashlib
import io
import math
import random
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fuzzyarm.common.checks import instance, is_real, real, reals, shown, whole
from fuzzyarm.common.console import escaped
from fuzzyarm.common.documents import DocumentError, read_bytes
from fuzzyarm.common.files import write_atomically

__all__ = [
    "CheckpointError", "check_finite", "check_learner", "check_like", "progress_in", "random_state",
    "read_checkpoint", "set_random_state", "write_checkpoint",
]  # fmt: skip


_SCHEMA = b"fuzzyarm-checkpoint/3"
_LARGEST = 2**30  # bytes
_LARGEST_INDEX = 2**26  # bytes of all but the tensors
_LARGEST_NUMBER = 1e100  # its square is finite
_MOST_VALUES = 1_000_000
_NUMPY = ("kind", "keys", "position", "has_gauss", "gauss")  # parts of the state of NumPy's generator
_MOST_STEPS = 1e9  # below 0, and far above this, Adam's corrections overflow
_SHOWN = 200  # characters of a library's message


class CheckpointError(ValueError):
    """A missing or damaged checkpoint, or one from another run; the message is one line that says what to do."""


def write_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write nested mappings and lists of tensors, NumPy arrays, numbers and text.

    Raises:
        OSError: the file cannot be written; the previous checkpoint is untouched.
    """
    buffer = io.BytesIO()
    torch.save(_as_tensors(content), buffer)
    data = buffer.getvalue()
    try:
        write_atomically(path, _SCHEMA + b" " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)
    except OSError as error:
        intact = "the previous checkpoint is intact: restore write access or free space, then resume"
        left = intact if path.exists() else "there is no checkpoint yet"
        raise OSError(error.errno, f"{error.strerror or error}; {left}", str(path)) from None


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Return the content that `write_checkpoint` stored at `path`, with NumPy arrays as tensors.

    Raises:
        CheckpointError: the file is missing, damaged or not a checkpoint.
    """
    try:
        content = read_bytes(path, largest=_LARGEST)
    except DocumentError as error:
        raise CheckpointError(f"{error}; start a new run in another folder") from None
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror or error}; there is nothing to resume here") from None
    line, _, data = content.partition(b"\n")
    schema, _, digest = line.partition(b" ")
    if schema != _SCHEMA:
        raise CheckpointError(
            f"{path} is not a checkpoint of this version ({_SCHEMA.decode()}); start a new run in another folder"
        )
    if hashlib.sha256(data).hexdigest().encode() != digest:
        raise CheckpointError(f"{path} is damaged (its sha256 differs); start a new run in another folder")
    try:
        _check_archive(data)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="Detected pickle protocol")  # `torch.save` writes no other
            loaded = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        _check_values(loaded, len(data))
    except Exception as error:  # a crafted archive or pickle may raise anything
        reason = escaped(str(error).split("\n", maxsplit=1)[0][:_SHOWN])
        raise CheckpointError(
            f"{path} is not a valid checkpoint: {reason}; start a new run in another folder"
        ) from None
    if not isinstance(loaded, dict):
        raise CheckpointError(
            f"{path} does not contain a mapping of names to values; start a new run in another folder"
        )
    return loaded


def check_like(name: str, found: Any, own: Any) -> None:
    """Check that `found`, part of a checkpoint, has the names, types and shapes of `own`, the same part of a new run.

    Lists and empty mappings grow during training; the code that uses them must check their content. ValueError says
    where the two differ; `name` is the name of this part.
    """
    own = _as_tensors(own)
    if isinstance(own, dict) and own:
        if not isinstance(found, dict) or set(found) != set(own):
            given = f"has the entries {sorted(map(str, found))}" if isinstance(found, dict) else f"is {shown(found)}"
            raise ValueError(f"{name} {given}; needed: the entries {sorted(map(str, own))}")
        for key, value in own.items():
            check_like(f"{name}.{key}", found[key], value)
    elif isinstance(own, torch.Tensor):
        if not isinstance(found, torch.Tensor) or (found.dtype, found.shape) != (own.dtype, own.shape):
            given = f"{found.dtype} {tuple(found.shape)}" if isinstance(found, torch.Tensor) else shown(found)
            raise ValueError(f"{name} is {given}; needed: {own.dtype} {tuple(own.shape)}")
    else:
        kinds = float | int if isinstance(own, float) else type(own)
        if not isinstance(found, kinds) or isinstance(found, bool) != isinstance(own, bool):
            raise ValueError(f"{name} = {shown(found)} has a different type from {shown(own)} in this run")


def check_finite(name: str, found: Any) -> None:
    """Raise ValueError if a part of a checkpoint contains a number that is nan or beyond ±`_LARGEST_NUMBER`."""
    if isinstance(found, dict | list | tuple):
        for value in found.values() if isinstance(found, dict) else found:
            check_finite(name, value)
    elif isinstance(found, torch.Tensor):
        if found.is_floating_point() and not bool((found.abs() <= _LARGEST_NUMBER).all()):
            raise ValueError(f"{name} contains numbers that are not finite or lie beyond ±{_LARGEST_NUMBER:g}")
    elif isinstance(found, float) and not abs(found) <= _LARGEST_NUMBER:
        raise ValueError(f"{name} contains the number {found}; allowed: numbers within ±{_LARGEST_NUMBER:g}")


def progress_in(found: dict[str, Any]) -> tuple[list[dict[str, Any]], float, tuple[float, float]]:
    """Return the learning curve's rows, the best score [mm] and the (wall, processor) time [s] in a checkpoint `found`.

    TypeError or ValueError if invalid.
    """
    rows, best = instance("rows", found["rows"], list), found["best"]
    for row in rows:
        if not all(isinstance(name, str) and is_real(value) for name, value in instance("a row", row, dict).items()):
            raise ValueError(f"rows contains {shown(row)}; needed: a mapping of names to numbers")
    if not is_real(best) or math.isnan(best):
        raise ValueError(f"best = {shown(best)} must be a real number")
    wall, cpu = reals("seconds", found["seconds"], 2, "s", low=0.0)
    return rows, float(best), (wall, cpu)


def random_state() -> dict[str, Any]:
    """Return the states of the random generators of torch, NumPy and Python, all of which stable-baselines3 uses."""
    drawn: dict[str, Any] = dict(zip(_NUMPY, np.random.get_state(), strict=True))  # noqa: NPY002
    version, words, following = random.getstate()
    return {
        "torch": torch.get_rng_state(),
        "numpy": drawn | {"keys": drawn["keys"].astype(np.int64)},
        "python": {"version": version, "words": list(words), "following": following},
    }


def set_random_state(state: dict[str, Any]) -> None:
    """Restore the random generators from a result of `random_state`; raise an exception for any other `state`."""
    check_like("generators", state, random_state())
    drawn, python = state["numpy"], state["python"]
    keys = np.array(drawn["keys"].numpy())
    if keys.min() < 0 or keys.max() >= 2**32:
        raise ValueError("generators.numpy.keys must be whole numbers from 0 to 2^32 - 1")
    whole("generators.numpy.position", drawn["position"], high=len(keys))  # NumPy does not check it
    torch.set_rng_state(state["torch"])
    drawn = drawn | {"keys": keys.astype(np.uint32)}
    np.random.set_state(tuple(drawn[name] for name in _NUMPY))  # noqa: NPY002
    random.setstate((python["version"], tuple(python["words"]), python["following"]))


def _check_archive(data: bytes) -> None:
    """Raise ValueError if the zip archive `data` would grow when unpacked; `torch.save` compresses nothing."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise ValueError("its archive is compressed")
    if sum(member.file_size for member in members) > len(data):
        raise ValueError("the entries of its archive are larger than the file")
    if sum(member.file_size for member in members if "/data/" not in member.filename) > _LARGEST_INDEX:
        raise ValueError(f"the entries of its archive other than tensors exceed {_LARGEST_INDEX} bytes")


def _check_values(loaded: Any, size: int) -> None:
    """Check that `loaded` has only numbers, text and plain tensors no larger than the `size` bytes of the file."""
    rest, count = [loaded], 0
    while rest:
        part, count = rest.pop(), count + 1
        if count > _MOST_VALUES:  # a list may contain another list many times, or itself
            raise ValueError(f"the checkpoint contains more values than the allowed {_MOST_VALUES}")
        if isinstance(part, dict):
            rest += [*part, *part.values()]
        elif isinstance(part, list | tuple):
            rest += part
        elif isinstance(part, torch.Tensor):
            if part.layout != torch.strided or part.is_quantized or part.device.type != "cpu" or part.is_complex():
                raise ValueError("allowed: only strided, real, unquantized tensors on the CPU")
            if part.untyped_storage().nbytes() > size or part.numel() * part.element_size() > size:
                raise ValueError("a tensor is larger than the checkpoint's file")
        elif not isinstance(part, str | bool | int | float | None):
            raise ValueError(f"the checkpoint contains an object of the unknown type {type(part).__name__}")


def _as_tensors(content: Any) -> Any:
    """Return nested `content` with tensors in place of NumPy arrays, which the safe reader does not support."""
    if isinstance(content, dict):
        return {name: _as_tensors(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return type(content)(_as_tensors(value) for value in content)
    if isinstance(content, np.ndarray):
        return torch.from_numpy(np.array(content))
    return content.item() if isinstance(content, np.generic) else content


def check_learner(found: dict[str, Any], optimizer: torch.optim.Optimizer, parameters: Sequence[torch.Tensor]) -> None:
    """Check the numbers in a state of PPO, after `check_like` and `check_finite`.

    Of Adam's settings only the learning rate may differ. `parameters` must be in the order of the optimizer. TypeError
    or ValueError says where a number is out of range or does not fit.
    """
    for group, own in zip(found["optimizer"]["param_groups"], optimizer.state_dict()["param_groups"], strict=True):
        check_like("learner.optimizer", group, own)
        real("learner.optimizer.lr", group["lr"], low=0.0)
        changed = [name for name, value in own.items() if name != "lr" and group[name] != value]
        if changed:
            raise ValueError(f"learner.optimizer differs from that of this training run in: {', '.join(changed)}")
    for place, moments in instance("learner.optimizer.state", found["optimizer"]["state"], dict).items():
        parameter = parameters[whole("learner.optimizer.state: parameter", place, high=len(parameters) - 1)].detach()
        name = f"learner.optimizer.state.{place}"
        check_like(name, moments, {"step": torch.zeros(()), "exp_avg": parameter, "exp_avg_sq": parameter})
        real(f"{name}.step", float(moments["step"]), low=0.0, high=_MOST_STEPS)
    for name in ("steps", "updates"):
        whole(f"learner.counters.{name}", found["counters"][name], high=2**62)
    for episode in found["episodes"]:
        if set(instance("an episode", episode, dict)) != {"r", "l", "tip_error"}:
            raise ValueError(f"learner.episodes contains {shown(episode)}; needed: the entries r, l and tip_error")
        real("return of an episode", episode["r"])
        real("tip error of an episode", episode["tip_error"], low=0.0)
        whole("length of an episode", episode["l"])
