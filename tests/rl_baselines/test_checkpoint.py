"""Checkpoints are read back as they were written, or refused in one line; no code in them is run."""

import hashlib
import io
import os
import random

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig  # noqa: E402
from fuzzyarm.rl_baselines.checkpoint import (  # noqa: E402
    CheckpointError,
    random_state,
    read_checkpoint,
    set_random_state,
    write_checkpoint,
)
from fuzzyarm.rl_baselines.training import Training  # noqa: E402

CONFIG = PPOConfig(total_timesteps=128, lanes=2, n_steps=64, batch_size=64, n_epochs=1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, brief_evaluations):
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    Training(CONFIG, folder).run()
    return folder


def test_a_checkpoint_comes_back_with_what_was_in_it(tmp_path):
    path = tmp_path / "c.pt"
    content = {"a": np.arange(3, dtype=np.uint32), "b": [{"x": 1.5, 2: None}], "c": np.float64(0.1), "t": (1, "two")}
    write_checkpoint(path, content)
    found = read_checkpoint(path)
    assert found["a"].tolist() == [0, 1, 2] and found["b"] == content["b"] and found["t"] == (1, "two")
    assert found["c"] == 0.1


class _Foreign:
    """What unpickling would run."""

    def __reduce__(self):
        return os.system, ("touch run-by-pickle",)


def foreign(path):
    """A sealed file with code in it."""
    buffer = io.BytesIO()
    torch.save({"config": _Foreign()}, buffer)
    data = buffer.getvalue()
    path.write_bytes(b"fuzzyarm-checkpoint/3 " + hashlib.sha256(data).hexdigest().encode() + b"\n" + data)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "No such file or directory; there is nothing to resume here"),
        (lambda path: os.truncate(path, 1000), "is damaged"),
        (lambda path: path.write_bytes(path.read_bytes()[:-1] + b"?"), "is damaged"),
        (lambda path: path.write_bytes(b"PK"), "is no checkpoint of this version"),
        (lambda path: path.write_bytes(b"fuzzyarm-checkpoint/1 0\n"), "is no checkpoint of this version"),
        (lambda path: write_checkpoint(path, {"config": {}}), "is of another version"),
        (lambda path: write_checkpoint(path, {"config": [1]}), "is of another version"),
        (foreign, "holds something else than tensors, numbers and text"),
    ],
    ids=["gone", "truncated", "a byte", "foreign", "older", "empty", "a list", "code"],
)
def test_a_checkpoint_that_cannot_be_used_is_one_line(whole, tmp_path, damage, message, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "checkpoint.pt"
    path.write_bytes((whole / "checkpoint.pt").read_bytes())
    damage(path)
    with pytest.raises(CheckpointError, match=message) as caught:
        Training.resume(CONFIG, tmp_path)
    assert "\n" not in str(caught.value) and not (tmp_path / "run-by-pickle").exists()


def test_random_generators_go_on_where_their_state_was_taken(tmp_path):
    def drawn():
        return torch.rand(3).tolist(), np.random.random(3).tolist(), random.random()  # noqa: NPY002

    write_checkpoint(tmp_path / "c.pt", {"generators": random_state()})
    expected = drawn()
    assert drawn() != expected
    set_random_state(read_checkpoint(tmp_path / "c.pt")["generators"])
    assert drawn() == expected
