"""All of a training between two rollouts in one file, written so that a whole one is always there.

The file is a line, ``fuzzyarm-checkpoint/1 SHA256``, and behind it what `torch.save` makes of tensors, numbers and
text. It is read with ``weights_only=True``: nothing in it is run.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import random
import tempfile
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from fuzzyarm.rl_baselines.learning_env import LearningEnvs

SCHEMA = b"fuzzyarm-checkpoint/1"
LARGEST = 2**31  # bytes


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged or of another training; the message is one line that says what to do."""


def write_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint beside `path`, onto the disk, and rename: until then the previous one stays.

    Args:
        path: file to write or replace.
        content: nested mappings and lists of tensors, NumPy arrays, numbers and text.

    Raises:
        OSError: it cannot be written; the previous checkpoint is untouched, and the message says so.
    """
    buffer = io.BytesIO()
    torch.save(_as_tensors(content), buffer)
    data = buffer.getvalue()
    aside = None
    try:
        handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        with os.fdopen(handle, "wb") as file:
            file.write(SCHEMA + b" " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(aside, 0o644)  # mkstemp makes it private
        os.replace(aside, path)
        _sync_folder(path.parent)
    except OSError as error:
        kept = "the checkpoint written before is whole: make room and resume" if path.exists() else "nothing was kept"
        raise OSError(error.errno, f"{error.strerror or error}; {kept}", str(path)) from None
    finally:
        if aside is not None:
            Path(aside).unlink(missing_ok=True)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read what `write_checkpoint` wrote; arrays come back as tensors.

    Raises:
        CheckpointError: the file is missing, damaged or none.
    """
    try:
        with open(path, "rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror or error}; there is nothing to resume here") from None
    line, _, data = content.partition(b"\n")
    schema, _, digest = line.partition(b" ")
    if schema != SCHEMA:
        raise CheckpointError(f"{path} is no checkpoint of this version ({SCHEMA.decode()}); start the training anew")
    if hashlib.sha256(data).hexdigest().encode() != digest:
        raise CheckpointError(f"{path} is damaged (its sha256 differs); start the training anew")
    try:
        loaded = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError, KeyError) as error:
        reason = str(error).split("\n")[0][:200]
        raise CheckpointError(f"{path} holds what no checkpoint holds: {reason}; start the training anew") from None
    if not isinstance(loaded, dict):
        raise CheckpointError(f"{path} holds no mapping; start the training anew")
    return loaded


def learner_state(model: PPO, normaliser: VecNormalize, envs: LearningEnvs) -> dict[str, Any]:
    """Return all that a training consists of between two rollouts.

    Policy, optimiser, normaliser, last observation, counters, random generators and every lane of the environment.
    """
    kind, keys, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002  what stable-baselines3 draws from
    version, words, following = random.getstate()
    return {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "counters": {"steps": model.num_timesteps, "updates": model._n_updates},
        "episodes": [{"r": float(one["r"]), "l": int(one["l"])} for one in model.ep_info_buffer or ()],
        "last_features": np.asarray(model._last_obs),
        "last_starts": np.asarray(model._last_episode_starts),
        "normaliser": {
            "features": _moments(normaliser.obs_rms),
            "returns": _moments(normaliser.ret_rms),
            "discounted": normaliser.returns,
        },
        "envs": envs.get_state(),
        "torch": torch.get_rng_state(),
        "numpy": {"kind": kind, "keys": keys, "position": position, "has_gauss": has_gauss, "gauss": gauss},
        "python": {"version": version, "words": list(words), "following": following},
    }


def set_learner_state(state: dict[str, Any], model: PPO, normaliser: VecNormalize, envs: LearningEnvs) -> None:
    """Put a training back to where `learner_state` was called; it must have been made with the same configuration.

    Raises:
        CheckpointError: the state does not fit the training.
    """
    try:
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        model.num_timesteps, model._n_updates = state["counters"]["steps"], state["counters"]["updates"]
        model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(maxlen=model._stats_window_size)
        model._last_obs, model._last_episode_starts = _array(state["last_features"]), _array(state["last_starts"])
        _set_moments(normaliser.obs_rms, state["normaliser"]["features"])
        _set_moments(normaliser.ret_rms, state["normaliser"]["returns"])
        normaliser.returns = _array(state["normaliser"]["discounted"])
        envs.set_state({name: _array(tensor) for name, tensor in state["envs"].items()})
        torch.set_rng_state(state["torch"])
        drawn = state["numpy"]
        keys = _array(drawn["keys"]).astype(np.uint32)
        np.random.set_state((drawn["kind"], keys, drawn["position"], drawn["has_gauss"], drawn["gauss"]))  # noqa: NPY002
        python = state["python"]
        random.setstate((python["version"], tuple(python["words"]), python["following"]))
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(
            f"the checkpoint does not fit this training ({reason}); start the training anew"
        ) from None


def _sync_folder(folder: Path) -> None:
    """Have the rename itself on the disk; where folders cannot be opened, there is nothing to do."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _as_tensors(content: Any) -> Any:
    """Return the content with tensors for NumPy arrays, which the safe reader does not know."""
    if isinstance(content, dict):
        return {name: _as_tensors(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return type(content)(_as_tensors(value) for value in content)
    if isinstance(content, np.ndarray):
        wide = content.astype(np.int64) if content.dtype == np.uint32 else content
        return torch.from_numpy(np.array(wide))
    return content.item() if isinstance(content, np.generic) else content


def _array(tensor: torch.Tensor) -> np.ndarray:
    return np.array(tensor.numpy())


def _moments(running: Any) -> dict[str, Any]:
    return {"mean": np.asarray(running.mean), "var": np.asarray(running.var), "count": float(running.count)}


def _set_moments(running: Any, moments: dict[str, Any]) -> None:
    running.mean, running.var, running.count = _array(moments["mean"]), _array(moments["var"]), moments["count"]
