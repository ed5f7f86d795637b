"""Every reader of a file: what it holds, its bytes, and what may stand in its place."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import shutil
import socket
import stat
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bundles import resealed
from support.trainings import SMALL_TRAINING

from fuzzyarm import ArmParameters, Robot, Sweep, load_policy, read_log
from fuzzyarm.common import documents
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.eval.dataset.store import open_dataset
from fuzzyarm.eval.episodes.rollout_file import digest, read_rollouts
from fuzzyarm.eval.evaluation.ranking import rank_policies
from fuzzyarm.eval.evaluation.results_file import read_evaluation
from fuzzyarm.eval.paper._report import EXPECTED, load_expected
from fuzzyarm.eval.sweep.config import SHOWN
from fuzzyarm.eval.sweep.ranking import rank_sweeps
from fuzzyarm.eval.sweep.run import _digest_of as digest_of
from fuzzyarm.eval.tuning._finding import read_finding
from fuzzyarm.fuzzy_policy.scheduled_controller import load_controller
from fuzzyarm.policies.registry import LAWS
from fuzzyarm.policies.tip_files import check_bound
from fuzzyarm.policies.tuned import TunedLaws
from fuzzyarm.proof.tip.plant import find_set
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.training import Training

from . import samples
from .judged import Broken, examples, held
from .samples import no_code_ran, scratch, signed
from .values import damaged, document, to_json

pytestmark = pytest.mark.slow


class Reader(NamedTuple):
    """A reader of one file.

    Attributes:
        source: makes a folder of good files, which is copied for each try.
        target: the file in it that is changed.
        read: reads the copy; returns if it was accepted.
        sign: puts the digest right in a document; None if there is none.
        guarded: whether a digest guards the file as well where `sign` is None, so that no change is taken.
    """

    source: Callable[[], Path]
    target: str
    read: Callable[[Path], Any]
    sign: Callable[[Any], Any] | None = None
    guarded: bool = False


def act(folder: Path) -> None:
    torque, _ = load_policy(folder).predict(np.array([0.3, 0.5, 0.0, 0.0, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0]))
    if not (np.abs(torque) <= ArmParameters().torque_limit).all():
        raise Broken(f"torque {torque}")


def drive(path: Path) -> None:
    env = FuzzyArmEnv(parameters=ArmParameters.from_toml(path))
    observation, _ = env.reset(seed=1)
    for torque in ([0.0, 0.0], [5.0, -2.0]):
        if not np.isfinite(observation).all():
            raise Broken(f"observation {observation} is not finite")
        observation, _, terminated, *_ = env.step(np.array(torque))
        if terminated:  # the arm may leave its limits at once
            break


def robot(path: Path) -> None:
    for joint in Robot.from_toml(path).joints:
        numbers = np.array([*joint.axis, *joint.position, *joint.link.center, joint.link.mass])
        if not np.isfinite(numbers).all() or abs(np.linalg.norm(joint.axis) - 1.0) > 1e-6:
            raise Broken(f"joint {joint.name} has numbers or an axis that is none")


def follow(path: Path) -> None:
    found = GivenPath.read(path)
    if not np.isfinite(found.points).all():
        raise Broken("points that are not finite")
    if len(found.points) < 100:
        motion = found.reference(ArmParameters())
        if not all(np.isfinite(part).all() for part in motion.sample(np.linspace(0.0, motion.duration, 7))):
            raise Broken("the motion is not finite")


def log(path: Path) -> None:
    for found in read_log(path):
        if not all(np.isfinite(part).all() for part in (found.angle, found.torque, [found.period])):
            raise Broken("numbers that are not finite")


def tube(folder: Path) -> None:
    """Check a bound whose samples are few; one that is proven is not below that of the true file."""
    found = check_bound(folder / "bound.json")
    if found.proven and found.claim.plants.to_dict() == _true_bound().claim.plants.to_dict():
        same = found.claim == _true_bound().claim
        if same and found.bound < 0.99 * _true_bound().bound:
            raise Broken(f"PROVEN with {found.bound:g} m, found: {_true_bound().bound:g} m")


@functools.cache
def _true_bound() -> Any:
    return check_bound(samples.bounds() / "bound.json")


def evaluation(folder: Path) -> None:
    rank_policies([folder])
    read_evaluation(folder)


def rollouts(folder: Path) -> None:
    """Read an evaluation whose rollouts are signed again."""
    found = json.loads((folder / "results.json").read_text())
    found["rollouts_sha256"] = digest(read_rollouts(folder / "rollouts.npz"))
    (folder / "results.json").write_text(json.dumps(found))
    read_evaluation(folder)


def resume(folder: Path) -> None:
    opened = Sweep.resume(folder)
    if opened.config.total <= 4 and opened.config.plants <= 4:
        opened.missing()
        opened.results()


def sign_run(content: dict[str, Any]) -> dict[str, Any]:
    """Sign a run.json as whoever forges it would."""
    then = {name: content[name] for name in ("config", "policies", "made_with", "cases")}
    then["config"] = {name: value for name, value in then["config"].items() if name not in SHOWN}
    return content | {"digest": digest_of(then)}


def train(folder: Path) -> None:
    longer = PPOConfig(**SMALL_TRAINING | {"total_timesteps": SMALL_TRAINING["total_timesteps"] + 1})
    Training.resume(longer, folder).algorithm.learn(lambda row: None)  # one update more


def laws(folder: Path) -> None:
    for name in TunedLaws.read(folder, ArmParameters()).policies:
        if name in LAWS:
            load_policy(folder / name)


def step(folder: Path) -> None:
    read_finding(folder, "computed-torque", robot_of(ArmParameters()).digest)


def data_set(folder: Path) -> None:
    found = open_dataset(folder / "set")
    with contextlib.suppress(Exception):  # of Minari, whose object it is from here on
        list(found)


def load(folder: Path) -> None:
    load_controller(folder / "controller.json")


READERS = {
    "controller": Reader(samples.controller, "controller.json", load, signed),
    "controller of a robot": Reader(samples.scheduled, "controller.json", load, signed),
    "arm": Reader(samples.tables, "arm.toml", lambda f: drive(f / "arm.toml")),
    "planar robot": Reader(samples.tables, "planar-3r.toml", lambda f: robot(f / "planar-3r.toml")),
    "robot": Reader(samples.tables, "panda.toml", lambda f: robot(f / "panda.toml")),
    "set": Reader(samples.tables, "set.toml", lambda f: find_set(f / "set.toml")),
    "path as TOML": Reader(samples.tables, "path.toml", lambda f: follow(f / "path.toml")),
    "path as CSV": Reader(samples.tables, "path.csv", lambda f: follow(f / "path.csv")),
    "log": Reader(samples.tables, "log.csv", lambda f: log(f / "log.csv")),
    "log as arrays": Reader(samples.tables, "log.npz", lambda f: log(f / "log.npz")),
    "log as an array": Reader(samples.tables, "log.npy", lambda f: log(f / "log.npy")),
    "log of MATLAB": Reader(samples.tables, "log.mat", lambda f: log(f / "log.mat")),
    "bag of MCAP": Reader(samples.tables, "log.mcap", lambda f: log(f / "log.mcap")),
    "bag of SQLite": Reader(samples.tables, "log.db3", lambda f: log(f / "log.db3")),
    "bag in a folder": Reader(samples.tables, "MCAP/metadata.yaml", lambda f: log(f / "MCAP")),
    "bound": Reader(samples.bounds, "bound.json", tube),
    "cells": Reader(samples.bounds, "cells.json", lambda f: check_bound(f / "cells.json")),
    "laws": Reader(samples.tuned, "laws.json", laws),
    "step": Reader(samples.tuned, "steps/computed-torque.json", step),
    "bundle": Reader(samples.bundle, "policy.json", act),
    "weights": Reader(samples.bundle, "weights.safetensors", act, guarded=True),
    "observer": Reader(samples.observer, "policy.json", act),
    "weights of an observer": Reader(samples.observer, "weights.safetensors", act, guarded=True),
    "results": Reader(samples.evaluated, "results.json", evaluation),
    "rollouts": Reader(samples.evaluated, "rollouts.npz", rollouts),
    "expected": Reader(lambda: EXPECTED.parent, "expected.json", lambda f: load_expected(f / "expected.json")),
    "sweep": Reader(samples.swept, "run.json", resume, sign_run, guarded=True),
    "chunk": Reader(samples.swept, "chunks/000000.npz", resume),
    "summary": Reader(samples.swept, "sweep.json", lambda f: rank_sweeps([f])),
    "checkpoint": Reader(samples.trained, "checkpoint.pt", train, guarded=True),
    "data set": Reader(samples.recorded, "set/data/main_data.hdf5", data_set),
    "metadata of a data set": Reader(samples.recorded, "set/data/metadata.json", data_set),
}  # fmt: skip


def changed(reader: Reader, content: bytes | Callable[[Path], None]) -> Path:
    folder = scratch()
    shutil.copytree(reader.source(), folder, ignore=shutil.ignore_patterns("*.py", "__pycache__"), dirs_exist_ok=True)
    (folder / reader.target).unlink()
    if callable(content):
        content(folder / reader.target)
    else:
        (folder / reader.target).write_bytes(content)
    return folder


def try_read(reader: Reader, content: bytes | Callable[[Path], None]) -> bool:
    """Read a changed folder; nothing in it may be run. Return whether it was accepted."""
    folder = changed(reader, content)
    try:
        return held(lambda: reader.read(folder))
    finally:
        no_code_ran()
        shutil.rmtree(folder, ignore_errors=True)


def _toml(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else f"{'-' * (value < 0)}inf"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return "''" if value is None else json.dumps(value)


def _text_of(kind: str, content: Any) -> bytes:
    if kind == ".json":
        return to_json(content)
    lines = (f"{json.dumps(key)} = {_toml(value)}" for key, value in content.items())
    return "\n".join(lines).encode("utf-8", "surrogatepass")


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_the_good_file_is_accepted(reader):
    assert try_read(reader, (reader.source() / reader.target).read_bytes())


@pytest.mark.parametrize(
    "name", [name for name, one in READERS.items() if Path(one.target).suffix in (".json", ".toml")]
)
@examples(25)
@given(data=st.data())
def test_a_document_with_other_content_is_refused_or_right(name, data):
    reader, kind = READERS[name], Path(READERS[name].target).suffix
    good = (reader.source() / reader.target).read_bytes()
    content = json.loads(good) if kind == ".json" else tomllib.loads(good.decode())
    other = data.draw(document(content))
    signed = other
    if reader.sign is not None:
        signed = None
        with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
            signed = reader.sign(other)
    other = signed if signed is not None and data.draw(st.integers(0, 3)) else other
    accepted = try_read(reader, _text_of(kind, other))
    assert not accepted or to_json(signed) == to_json(other), "a changed file with the old digest was taken"


@pytest.mark.parametrize("name", READERS)
@examples(12)
@given(data=st.data())
def test_other_bytes_are_refused_or_right(name, data):
    reader = READERS[name]
    good = (reader.source() / reader.target).read_bytes()
    content = data.draw(damaged(good))
    accepted = try_read(reader, content)
    assert content == good or not (accepted and reader.guarded and reader.sign is None), "the digest guards nothing"


def test_a_sweep_whose_digest_was_exchanged_is_refused_before_its_chunks_are_read():
    content = json.loads((samples.swept() / "run.json").read_text()) | {"digest": "0" * 64}
    folder = changed(READERS["sweep"], to_json(content))
    shutil.rmtree(folder / "chunks")
    with pytest.raises(ValueError, match=r"run\.json was changed after the sweep began"):
        Sweep.resume(folder)


# What stands in place of a file.


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        here = os.getcwd()
        os.chdir(path.parent)  # the name of a socket is short
        try:
            made.bind(path.name)
        finally:
            os.chdir(here)


def _sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 200 * 2**30)


def _link(target: str) -> Callable[[Path], None]:
    return lambda path: path.symlink_to(target)


def _text(content: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content) and None


SPECIAL: dict[str, Callable[[Path], None]] = {
    "a FIFO": os.mkfifo,
    "a folder": os.mkdir,
    "a socket": _socket,
    "200 GiB of nothing": _sparse,
    "a link to /dev/zero": _link("/dev/zero"),
    "a link to /dev/random": _link("/dev/random"),
    "a link to /dev/null": _link("/dev/null"),
    "a link to /dev/full": _link("/dev/full"),
    "a link to /proc/self/mem": _link("/proc/self/mem"),
    "a link to nowhere": _link("/nowhere/at/all"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "nothing": lambda path: None,
    "an empty file": _text(b""),
    "10 MB of brackets": _text(b"[" * 10_000_000),
    "10 MB of mappings": _text(b'{"a":' * 2_000_000),
    "a number of a million digits": _text(b'{"schema": ' + b"9" * 1_000_000 + b"}"),
    "a line of nested lists": _text(b"a = " + b"[" * 100_000),
    "nested tables": _text(b"a" + b".a" * 100_000 + b" = 1"),
    "a key twice": _text(b'{"schema": 1, "schema": 1}'),
    "NUL": _text(bytes(100_000)),
    "UTF-16": _text('{"schema": 1}'.encode("utf-16")),
    "a zip archive of nothing": _text(b"PK\x05\x06" + bytes(18)),
    "a pickle": _text(b"\x80\x04cos\nsystem\n(S'touch canary'\ntR."),
}
"""What may stand in place of a file, by name."""


@pytest.mark.parametrize("name", READERS)
def test_what_stands_in_place_of_a_file_is_refused(name):
    """Every kind is there when the reader comes, which the test sees to; none is accepted."""
    reader = READERS[name]
    for kind, make in SPECIAL.items():
        folder = changed(reader, make)
        path = folder / reader.target
        assert kind == "nothing" or os.path.lexists(path)
        if kind == "a FIFO":
            assert stat.S_ISFIFO(path.stat().st_mode)
        try:
            accepted = held(lambda folder=folder: reader.read(folder))
        except Broken as error:
            raise Broken(f"{name} is {kind}: {error}") from None
        no_code_ran()
        assert kind == "nothing" or os.path.lexists(path), f"{kind} is gone"
        missing = name in ("step", "chunk") and not path.is_file()  # which is made again
        assert not accepted or missing or (kind == "an empty file" and name in ("arm", "set")), kind
        shutil.rmtree(folder, ignore_errors=True)


def test_a_file_that_is_exchanged_before_it_is_opened_is_not_read(tmp_path):
    """A pipe or a device that takes the place of the file that was looked at."""
    (tmp_path / "good").write_text("{}")
    os.mkfifo(tmp_path / "exchanged")
    looked_at = os.stat(tmp_path / "good")
    for path in (tmp_path / "exchanged", Path("/dev/zero")):
        with mock.patch.object(os, "stat", return_value=looked_at), pytest.raises(documents.DocumentError) as caught:
            documents.open_regular(path)
        assert "not a regular file" in str(caught.value)


# Archives of arrays, weights and checkpoints, whose digests are put right.


@examples(40)
@given(data=st.data())
def test_weights_that_are_signed_again_are_refused_or_right(data):
    good = (samples.bundle() / "weights.safetensors").read_bytes()
    length = int.from_bytes(good[:8], "little")
    if data.draw(st.booleans()):
        head = to_json(data.draw(document(json.loads(good[8 : 8 + length]))))
        size = data.draw(st.one_of(st.just(len(head)), st.integers(0, 2**64 - 1)))
        content = size.to_bytes(8, "little") + head + good[8 + length :]
    else:
        content = data.draw(damaged(good))
    folder = changed(READERS["weights"], content)
    resealed(content)(folder)
    held(lambda: act(folder))
    no_code_ran()
