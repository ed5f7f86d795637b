"""The controller file: exact, and refused in one clear line when it is not what it should be."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import Controller, ControllerFileError, _digest


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


@pytest.fixture
def document(controller):
    return json.loads(controller.to_json())


def write(tmp_path, content):
    """Write a text, or a document with a digest that fits it: tampering by somebody who knows the format."""
    path = tmp_path / "controller.json"
    if isinstance(content, dict) and "digest" in content:
        content = {key: value for key, value in content.items() if key != "digest"}
        content["digest"] = _digest(content)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_round_trip_is_exact(controller, tmp_path):
    controller.save(tmp_path / "copy.json")
    copy = Controller.load(tmp_path / "copy.json")
    for field in ("gains", "P", "Q", "X", "tau"):
        np.testing.assert_array_equal(getattr(copy, field), getattr(controller, field))
    assert (copy.alpha, copy.gamma, copy.model.kept) == (controller.alpha, controller.gamma, controller.model.kept)
    assert copy.model.parameters == controller.model.parameters
    assert copy.to_json() == controller.to_json()


@pytest.mark.parametrize("content", ["", "{", "[1, 2", "not json", '"text"', "null", "{}", "[" * 100_000, "\x00\x01"])
def test_foreign_files_raise_one_clear_line(tmp_path, content):
    path = write(tmp_path, content)
    with pytest.raises(ControllerFileError, match=re.escape(str(path))) as caught:
        Controller.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "key",
    [
        "robot",
        "kept",
        "bounds",
        "form",
        "integral",
        "common_multiplier",
        "alpha",
        "gains",
        "P",
        "Q",
        "X",
        "tau",
        "origin",
    ],
)
def test_a_missing_field_is_named(document, tmp_path, key):
    del document[key]
    with pytest.raises(ControllerFileError, match=key):
        Controller.load(write(tmp_path, document))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("schema", "fuzzyarm-controller/99", "fuzzyarm-controller/1"),
        ("alpha", "-0x1p+0", "alpha"),
        ("alpha", "inf", "alpha"),
        ("gamma", "nan", "gamma"),
        ("alpha", 20.0, "hexadecimal"),
        ("alpha", ["0x1p+0"], "alpha|must be|not"),
        ("kept", ["z1", "z9"], "z9"),
        ("integral", 1, "integral"),
        ("P", [["0x1p+0"]], "P must hold"),
        ("gains", "0x1p+0", "gains"),
        ("tau", [], "tau"),
        ("form", "printed", "consistent, paper"),
        ("form", "paper", "weight does not go with"),
        ("common_multiplier", "no", "common_multiplier"),
        ("feedforward", [["0x1p+0"]], "feedforward does not go with"),
        ("origin", "text", "origin|items"),
    ],
)
def test_a_wrong_field_is_refused(document, tmp_path, key, value, message):
    document[key] = value
    with pytest.raises(ControllerFileError, match=message):
        Controller.load(write(tmp_path, document))


def test_changed_robot_does_not_fit_the_stored_bounds(document, tmp_path):
    document["robot"]["mass"][1] = (9.5).hex()
    with pytest.raises(ControllerFileError, match="bounds"):
        Controller.load(write(tmp_path, document))


def leaves(value, path=()):
    """Yield the path of every number of a document."""
    if isinstance(value, list):
        for index, entry in enumerate(value):
            yield from leaves(entry, (*path, index))
    elif isinstance(value, dict):
        for key, entry in value.items():
            yield from leaves(entry, (*path, key))
    elif isinstance(value, str) and value.lstrip("-").startswith("0x"):
        yield path


def test_any_changed_digit_is_noticed(document, tmp_path):
    """The last bit of every number in the file: gains, robot, bounds, alpha, gamma, P, slacks, multipliers."""
    paths = list(leaves(document))
    assert len(paths) > 300
    for path in paths[:: len(paths) // 60]:
        holder = changed = json.loads(json.dumps(document))
        for key in path[:-1]:
            holder = holder[key]
        holder[path[-1]] = math.nextafter(float.fromhex(holder[path[-1]]), math.inf).hex()
        file = tmp_path / "changed.json"
        file.write_text(json.dumps(changed))
        with pytest.raises(ControllerFileError, match="digest"):
            Controller.load(file)


def test_an_unproven_controller_is_taken_only_when_told_so(document, tmp_path):
    document["alpha"] = (200.0).hex()
    path = write(tmp_path, document)
    with pytest.raises(ControllerFileError, match="allow_unproven=True"):
        load_policy(path)
    assert load_policy(path, allow_unproven=True).controller.alpha == 200.0


def test_a_changed_gain_is_refused_by_load_policy(document, tmp_path):
    document["gains"][0][0][0][0] = (1e4).hex()
    with pytest.raises(ControllerFileError, match="is not proven"):
        load_policy(write(tmp_path, document))


def test_a_huge_file_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr("fuzzyarm.fuzzy_policy.controller.MAX_BYTES", 10)
    with pytest.raises(ControllerFileError, match="larger"):
        Controller.load(write(tmp_path, "0" * 11))


def test_another_robot_is_refused_with_the_fields_that_differ():
    with pytest.raises(ControllerFileError, match=r"another robot \(mass differ\)"):
        load_policy("fuzzy-4", robot=ArmParameters(mass=(15.0, 9.5)))


def test_arrays_are_read_only(controller):
    with pytest.raises(ValueError, match="read-only"):
        controller.gains[0, 0, 0, 0] = 0.0


def test_an_interrupted_save_leaves_the_old_file(controller, tmp_path, monkeypatch):
    path = tmp_path / "controller.json"
    path.write_text("old")

    def broken(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", broken)
    with pytest.raises(OSError, match="No space"):
        controller.save(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_controller_without_integral_has_four_states(controller):
    cut = {
        "gains": controller.gains[..., :4],
        "P": controller.P[:4, :4],
        "Q": controller.Q[:, :4, :4],
        "X": controller.X[:, :4, :4],
    }
    assert dataclasses.replace(controller, integral=False, **cut).gains.shape == (2, 2, 2, 4)
    with pytest.raises(ControllerFileError, match=r"gains must hold finite numbers of shape \(2, 2, 2, 4\)"):
        dataclasses.replace(controller, integral=False)
