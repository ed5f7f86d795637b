"""The controller file: exact, and refused in one clear line if it is damaged or inconsistent."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest
from support.shipped import CONTROLLERS

from fuzzyarm import Controller, load_policy
from fuzzyarm.fuzzy_policy.controller import POLE_ARRAYS
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError
from fuzzyarm.fuzzy_policy.signed_files import _digest_of as digest_of


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


@pytest.fixture
def document(controller):
    return json.loads(controller.to_json())


def without_fastest_pole(controller):
    return dataclasses.replace(controller, fastest_pole=None, **dict.fromkeys(POLE_ARRAYS))


def write(tmp_path, content):
    """Write a document with a digest that fits it: tampering by somebody who knows the format."""
    path = tmp_path / "controller.json"
    content = {key: value for key, value in content.items() if key != "digest"}
    path.write_text(json.dumps(content | {"digest": digest_of(content)}))
    return path


def test_round_trip_is_exact(controller, tmp_path):
    controller.save(tmp_path / "copy.json")
    copy = Controller.load(tmp_path / "copy.json")
    for field in ("gains", "P", "Q", "X", "tau", *POLE_ARRAYS, "alpha", "gamma", "fastest_pole", "model"):
        np.testing.assert_array_equal(getattr(copy, field), getattr(controller, field))
    for field in ("gains", "P", "Q", "X", "tau", *POLE_ARRAYS):
        with pytest.raises(ValueError, match="read-only"):
            getattr(copy, field).flat[0] = 0.0
    assert copy.to_json() == controller.to_json()


def test_any_changed_digit_is_noticed(controller, tmp_path):
    """The last bit of every number in the file: gains, robot, bounds, alpha, gamma, P, slacks, multipliers."""
    text, file = controller.to_json(), tmp_path / "changed.json"
    numbers = list(re.finditer(r"-?0x[^\"]*", text))
    assert len(numbers) > 300
    for number in numbers[:: len(numbers) // 60]:
        other = math.nextafter(float.fromhex(number[0]), math.inf).hex()
        file.write_text(text[: number.start()] + other + text[number.end() :])
        with pytest.raises(ControllerFileError, match="digest"):
            Controller.load(file)


def test_a_controller_without_integral_has_four_states(controller):
    controller = without_fastest_pole(controller)
    cut = {name: getattr(controller, name)[..., :4, :4] for name in ("P", "Q", "X")}
    cut["gains"] = controller.gains[..., :4]
    assert dataclasses.replace(controller, integral=False, **cut).gains.shape == (2, 2, 2, 4)
    with pytest.raises(ControllerFileError, match=r"gains has shape \(2, 2, 2, 6\); allowed: \(2, 2, 2, 4\)"):
        dataclasses.replace(controller, integral=False)
    with pytest.raises(ControllerFileError, match="fastest_pole must not be given with the paper form"):
        dataclasses.replace(Controller.load(CONTROLLERS["paper-1"]), fastest_pole=200.0)


def test_files_of_older_versions_without_a_fastest_pole_are_written_as_before(controller):
    text = without_fastest_pole(controller).to_json()
    assert "pole" not in text
    assert Controller.from_document(json.loads(text)).to_json() == text


def test_a_missing_field_is_named(document, tmp_path):
    of_pole = {"fastest_pole", *POLE_ARRAYS}
    for key in document.keys() - {"schema", "digest", "feedforward", "weight"}:
        rest = {name: value for name, value in document.items() if name != key}
        said = r"pole_.* must (not )?be given with fastest_pole = " if key in of_pole else key
        with pytest.raises(ControllerFileError, match=said):
            Controller.load(write(tmp_path, rest))


def test_a_wrong_field_is_refused(document, tmp_path):
    for key, value, message in (
        ("schema", "fuzzyarm-controller/99", "fuzzyarm-controller/1"),
        ("alpha", "-0x1p+0", "alpha"),
        ("gamma", "nan", "gamma"),
        ("alpha", 20.0, "hexadecimal"),
        ("kept", ["z1", "z9"], "z9"),
        ("integral", 1, "integral"),
        ("P", [["0x1p+0"]], "P has shape"),
        ("form", "printed", "consistent, paper"),
        ("form", "paper", "weight must be given with the paper form"),
        ("feedforward", [["0x1p+0"]], "feedforward must not be given with the consistent form"),
        ("origin", "text", "origin|items"),
        ("fastest_pole", None, "hexadecimal"),
        ("fastest_pole", "inf", "fastest_pole = inf 1/s is out of range"),
        ("fastest_pole", (20.0).hex(), r"fastest_pole = 20.0 1/s is out of range; allowed: \(20, 1e\+06\] 1/s"),
        ("pole_Q", None, "pole_Q must be given with fastest_pole = 200.0"),
        ("pole_tau", [], "pole_tau has shape"),
        ("robot", {"mass": [(19.5).hex(), (9.5).hex()]}, "bounds"),
    ):
        changed = document | {key: document[key] | value if key == "robot" else value}
        with pytest.raises(ControllerFileError, match=message):
            Controller.load(write(tmp_path, changed))


def test_an_unproven_controller_is_taken_only_when_told_so(document, tmp_path):
    for key, value, message in (
        ("alpha", 100.0, "allow_unproven=True"),
        ("fastest_pole", 60.0, "is not proven.* first: Phi_1,1,1 < 0"),
    ):
        path = write(tmp_path, document | {key: value.hex()})
        with pytest.raises(ControllerFileError, match=message):
            load_policy(path)
        assert getattr(load_policy(path, allow_unproven=True).controller, key) == value
