"""A crafted checkpoint, with the right digest, is refused in one line before anything of it is used."""

import hashlib
import io
import os
import struct
import zipfile

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig  # noqa: E402
from fuzzyarm.rl_baselines.checkpoint import CheckpointError, read_checkpoint, write_checkpoint  # noqa: E402
from fuzzyarm.rl_baselines.training import Training  # noqa: E402

CONFIG = PPOConfig(total_timesteps=128, lanes=2, n_steps=64, batch_size=64, n_epochs=1, hidden=(8,))


@pytest.fixture(scope="module")
def content(tmp_path_factory, brief_evaluations):
    """What the checkpoint of a short run holds."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    Training(CONFIG, folder).run()
    return lambda: read_checkpoint(folder / "checkpoint.pt")


def put(content, path, value):
    *above, last = path
    for key in above:
        inner = content[key]
        if isinstance(inner, tuple):
            content[key] = inner = list(inner)
        content = inner
    content[last] = value


def at(content, path):
    for key in path:
        content = content[key]
    return content


def resumed(folder, content):
    write_checkpoint(folder / "checkpoint.pt", content)
    return Training.resume(CONFIG, folder)


def refused(folder, content):
    with pytest.raises(CheckpointError) as caught:
        resumed(folder, content)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_the_checkpoint_itself_is_taken(content, tmp_path):
    assert resumed(tmp_path, content()).algorithm.steps == 128


CRAFTED = {
    ("envs", "clock"): lambda old: old + 10**12,
    ("envs", "drawn"): lambda old: torch.zeros(1, 1),
    ("envs", "values"): lambda old: old[:, :1],
    ("envs", "seen"): lambda old: old[:, :3],
    ("envs", "memory"): lambda old: old * np.nan,
    ("envs", "returns"): lambda old: old[:0],
    ("generators", "numpy", "position"): lambda old: 10**9,
    ("generators", "numpy", "keys"): lambda old: old[:3],
    ("generators", "torch"): lambda old: old[:10],
    ("learner", "last_features"): lambda old: old[:, :2],
    ("learner", "counters", "steps"): lambda old: -5,
    ("learner", "optimizer", "state", 0, "exp_avg"): lambda old: torch.zeros(10**6),
    ("learner", "optimizer", "param_groups"): lambda old: [],
    ("learner", "policy", "action_net.weight"): lambda old: old[:1],
    ("rows",): lambda old: 5,
    ("seconds",): lambda old: (1.0,),
    ("best",): lambda old: "best",
}


@pytest.mark.parametrize("path", CRAFTED, ids=lambda path: ".".join(map(str, path)))
def test_what_does_not_fit_is_refused(content, tmp_path, path):
    crafted = content()
    put(crafted, path, CRAFTED[path](at(crafted, path)))
    refused(tmp_path, crafted)


def sealed(path, data):
    path.write_bytes(b"fuzzyarm-checkpoint/3 " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)


def repacked(change, compression=zipfile.ZIP_STORED):
    """Return an archive of torch whose pickle is changed."""
    buffer, out = io.BytesIO(), io.BytesIO()
    torch.save({"a": torch.zeros(4, dtype=torch.float64)}, buffer)
    with zipfile.ZipFile(buffer) as old, zipfile.ZipFile(out, "w", compression) as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, change(data) if name.endswith("data.pkl") else data)
    return out.getvalue()


def huge(data):
    size = b"J" + struct.pack("<i", 2_000_000_000)
    return data.replace(b"K\x04t", size + b"t").replace(b"K\x04\x85", size + b"\x85")


def nested(data):
    lists = b"\x80\x02]q\x00" + b"".join(
        b"(" + b"h" + bytes([level]) + (b"h" + bytes([level])) * 9 + b"lq" + bytes([level + 1]) for level in range(9)
    )
    return lists + b"."


ARCHIVES = {
    "a storage beyond the file": lambda: repacked(huge),
    "lists of lists of lists": lambda: repacked(nested),
    "compressed": lambda: repacked(lambda data: data, zipfile.ZIP_DEFLATED),
    "another protocol": lambda: repacked(lambda data: b"\x80\x04" + data[2:]),
    "no archive": lambda: b"PK",
    "empty": lambda: b"",
    "half": lambda: repacked(lambda data: data)[:-100],
}


@pytest.mark.parametrize("name", ARCHIVES)
def test_a_crafted_archive_is_refused(tmp_path, name):
    sealed(tmp_path / "checkpoint.pt", ARCHIVES[name]())
    with pytest.raises(CheckpointError, match="start the training again") as caught:
        Training.resume(CONFIG, tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.timeout(60)
def test_a_pipe_is_no_checkpoint(tmp_path):
    os.mkfifo(tmp_path / "checkpoint.pt")
    with pytest.raises(CheckpointError, match="not a regular file"):
        Training.resume(CONFIG, tmp_path)
