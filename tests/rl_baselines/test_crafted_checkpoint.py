"""Checkpoints are read back as they were written; crafted and damaged ones are refused in one line, none is run."""

import functools
import hashlib
import io
import operator
import os
import random
import struct
import zipfile

import numpy as np
import pytest
import torch

from fuzzyarm.rl_baselines import _checkpoint as checkpoint
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.training import Training

CONFIG = PPOConfig(total_timesteps=128, lanes=2, n_steps=64, batch_size=64, n_epochs=1, hidden=(8,))


@pytest.fixture(scope="module")
def whole(tmp_path_factory, brief_evaluations):
    folder = tmp_path_factory.mktemp("whole") / "run"
    Training(CONFIG, folder).run()
    return folder / "checkpoint.pt"


def refused(path, message="."):
    """A training is not resumed from the checkpoint, for a reason in one short line."""
    with pytest.raises(checkpoint.CheckpointError, match=message) as caught:
        Training.resume(CONFIG, path.parent)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


def test_a_checkpoint_comes_back_with_what_was_in_it(tmp_path):
    path = tmp_path / "c.pt"
    content = {"a": np.arange(3), "b": [{"x": 1.5, 2: None}], "c": np.float64(0.1), "t": (1, "two")}
    checkpoint.write_checkpoint(path, content)
    found = checkpoint.read_checkpoint(path)
    assert found["a"].tolist() == [0, 1, 2] and found["b"] == content["b"] and found["t"] == (1, "two")
    assert found["c"] == 0.1


def test_random_generators_go_on_where_their_state_was_taken(tmp_path):
    def drawn():
        return torch.rand(3).tolist(), np.random.random(3).tolist(), random.random()  # noqa: NPY002

    checkpoint.write_checkpoint(tmp_path / "c.pt", {"generators": checkpoint.random_state()})
    expected = drawn()
    assert drawn() != expected
    checkpoint.set_random_state(checkpoint.read_checkpoint(tmp_path / "c.pt")["generators"])
    assert drawn() == expected


CRAFTED = {
    "envs.clock": lambda old: old + 10**12,
    "envs.drawn": lambda old: torch.zeros(1, 1),
    "envs.values": lambda old: old[:, :1],
    "envs.seen": lambda old: old[:, :3],
    "envs.memory": lambda old: old * np.nan,
    "envs.returns": lambda old: old[:0],
    "generators.numpy.position": lambda old: 10**9,
    "generators.numpy.keys": lambda old: old[:3],
    "generators.torch": lambda old: old[:10],
    "learner.last_features": lambda old: old[:, :2],
    "learner.counters.steps": lambda old: -5,
    "learner.optimizer.state": lambda old: {0: old[0] | {"exp_avg": torch.zeros(10**6)}},
    "learner.optimizer.param_groups": lambda old: [],
    "learner.policy": lambda old: old | {"action_net.weight": old["action_net.weight"][:1]},
    "rows": lambda old: 5,
    "seconds": lambda old: (1.0,),
    "best": lambda old: "best",
}


@pytest.mark.parametrize("path", CRAFTED)
def test_what_does_not_fit_is_refused(whole, tmp_path, path):
    content, (*above, last) = checkpoint.read_checkpoint(whole), path.split(".")
    inner = functools.reduce(operator.getitem, above, content)
    inner[last] = CRAFTED[path](inner[last])
    checkpoint.write_checkpoint(tmp_path / "checkpoint.pt", content)
    refused(tmp_path / "checkpoint.pt")


class _Foreign:
    """What unpickling would run."""

    def __reduce__(self):
        return os.system, ("touch run-by-pickle",)


def repacked(change=lambda data: data, content=None, compression=zipfile.ZIP_STORED):
    """Return an archive of torch whose pickle is changed."""
    buffer, out = io.BytesIO(), io.BytesIO()
    torch.save(content or {"a": torch.zeros(4, dtype=torch.float64)}, buffer)
    with zipfile.ZipFile(buffer) as old, zipfile.ZipFile(out, "w", compression) as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, change(data) if name.endswith("data.pkl") else data)
    return out.getvalue()


def signed(make):
    """Write an archive whose digest is right."""

    def write(path):
        data = make()
        path.write_bytes(b"fuzzyarm-checkpoint/3 " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)

    return write


def huge(data):
    size = b"J" + struct.pack("<i", 2_000_000_000)
    return data.replace(b"K\x04t", size + b"t").replace(b"K\x04\x85", size + b"\x85")


def nested(data):
    """Lists of ten references to one list each, nine times within each other."""
    levels = (b"(" + (b"h" + bytes([k])) * 10 + b"lq" + bytes([k + 1]) for k in range(9))
    return b"\x80\x02]q\x00" + b"".join(levels) + b"."


ARCHIVES = {
    "code": signed(lambda: repacked(content={"config": _Foreign()})),
    "a storage beyond the file": signed(lambda: repacked(huge)),
    "lists of lists of lists": signed(lambda: repacked(nested)),
    "compressed": signed(lambda: repacked(compression=zipfile.ZIP_DEFLATED)),
    "another protocol": signed(lambda: repacked(lambda data: b"\x80\x04" + data[2:])),
    "no archive": signed(lambda: b"PK"),
    "empty": signed(lambda: b""),
    "half": signed(lambda: repacked()[:-100]),
}


DAMAGED = {
    "gone": (lambda path: path.unlink(), "No such file or directory; there is nothing to resume here"),
    "truncated": (lambda path: os.truncate(path, 1000), "is damaged"),
    "a byte": (lambda path: path.write_bytes(path.read_bytes()[:-1] + b"?"), "is damaged"),
    "foreign": (lambda path: path.write_bytes(b"PK"), "is not a checkpoint of this version"),
    "older": (lambda path: path.write_bytes(b"fuzzyarm-checkpoint/1 0\n"), "is not a checkpoint of this version"),
    "empty": (lambda path: checkpoint.write_checkpoint(path, {"config": {}}), "does not fit this version"),
    "a list": (lambda path: checkpoint.write_checkpoint(path, {"config": [1]}), "does not fit this version"),
    "a pipe": (lambda path: (path.unlink(), os.mkfifo(path)), "not a regular file"),
}
DAMAGED |= {name: (write, "is not a valid checkpoint: .*; start a new run") for name, write in ARCHIVES.items()}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", DAMAGED)
def test_a_file_that_is_no_checkpoint_is_refused(name, whole, tmp_path, monkeypatch):
    damage, message = DAMAGED[name]
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(whole.read_bytes())
    assert name != "gone" or Training.resume(CONFIG, tmp_path).algorithm.steps == 128  # as it is, it is taken
    damage(path)
    refused(path, message)
    assert not (tmp_path / "run-by-pickle").exists()
