"""The controller file: exact, and refused in one clear line if it is damaged or inconsistent."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest
from support.shipped import CONTROLLERS

from fuzzyarm import load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import POLE_ARRAYS, Controller
from fuzzyarm.fuzzy_policy.signed_files import ControllerFileError, digest_of
from fuzzyarm.synthesis import Specification, design


@pytest.fixture(scope="module")
def controller():
    return load_policy("fuzzy-4").controller


@pytest.fixture(scope="module")
def limited():
    """Return a controller that claims a bound of its fastest pole, too."""
    return design(Specification(fastest_pole=200.0)).controller


@pytest.fixture
def document(controller):
    return json.loads(controller.to_json())


def without_fastest_pole(controller):
    return dataclasses.replace(controller, fastest_pole=None, **dict.fromkeys(POLE_ARRAYS))


def write(tmp_path, content):
    """Write a text, or a document with a digest that fits it: tampering by somebody who knows the format."""
    path = tmp_path / "controller.json"
    if isinstance(content, dict) and "digest" in content:
        content = {key: value for key, value in content.items() if key != "digest"}
        content["digest"] = digest_of(content)
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
        ("P", [["0x1p+0"]], "P has shape"),
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
    document["alpha"] = (100.0).hex()
    path = write(tmp_path, document)
    with pytest.raises(ControllerFileError, match="allow_unproven=True"):
        load_policy(path)
    assert load_policy(path, allow_unproven=True).controller.alpha == 100.0


def test_a_changed_gain_is_refused_by_load_policy(document, tmp_path):
    document["gains"][0][0][0][0] = (1e4).hex()
    with pytest.raises(ControllerFileError, match="is not proven"):
        load_policy(write(tmp_path, document))


def test_a_huge_file_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr("fuzzyarm.fuzzy_policy.signed_files.MAX_BYTES", 10)
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
    controller = without_fastest_pole(controller)
    cut = {
        "gains": controller.gains[..., :4],
        "P": controller.P[:4, :4],
        "Q": controller.Q[:, :4, :4],
        "X": controller.X[:, :4, :4],
    }
    assert dataclasses.replace(controller, integral=False, **cut).gains.shape == (2, 2, 2, 4)
    with pytest.raises(ControllerFileError, match=r"gains has shape \(2, 2, 2, 6\); allowed: \(2, 2, 2, 4\)"):
        dataclasses.replace(controller, integral=False)


def test_a_fastest_pole_and_its_slack_survive_the_round_trip(limited, tmp_path):
    limited.save(tmp_path / "copy.json")
    copy = load_policy(tmp_path / "copy.json").controller
    assert copy.fastest_pole == 200.0
    for field in POLE_ARRAYS:
        np.testing.assert_array_equal(getattr(copy, field), getattr(limited, field))
        with pytest.raises(ValueError, match="read-only"):
            getattr(copy, field).flat[0] = 0.0
    assert copy.to_json() == limited.to_json()


def test_a_model_without_dropped_premises_has_no_multipliers_of_its_fastest_pole(limited):
    model = dataclasses.replace(limited.model, kept=("z1", "z2", "z3", "z4", "z5"))
    shapes = {
        "gains": (16, 2, 2, 6),
        **dict.fromkeys(("Q", "X", "pole_Q", "pole_X"), (136, 6, 6)),
        **dict.fromkeys(("tau", "pole_tau"), (136, 2, 0)),
    }
    whole = dataclasses.replace(limited, model=model, **{name: np.zeros(shape) for name, shape in shapes.items()})
    copy = Controller.from_document(json.loads(whole.to_json()))
    assert {name: getattr(copy, name).shape for name in shapes} == shapes


def test_files_without_a_fastest_pole_say_nothing_of_it(controller):
    """What older versions wrote is read and written as before."""
    text = without_fastest_pole(controller).to_json()
    assert "pole" not in text
    assert Controller.from_document(json.loads(text)).to_json() == text


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("fastest_pole", None, "hexadecimal"),
        ("fastest_pole", 200.0, "hexadecimal"),
        ("fastest_pole", "inf", "fastest_pole = inf 1/s is out of range"),
        ("fastest_pole", "nan", "fastest_pole = nan 1/s is out of range"),
        ("fastest_pole", (20.0).hex(), r"fastest_pole = 20.0 1/s is out of range; allowed: \(20, 1e\+06\] 1/s"),
        ("fastest_pole", ["0x1p+8"], "must be|not supported"),
        ("pole_Q", None, "pole_Q does not go with fastest_pole = 200.0"),
        ("pole_X", [["0x1p+0"]], "pole_X has shape"),
        ("pole_tau", [], "pole_tau has shape"),
    ],
)
def test_a_wrong_fastest_pole_is_refused(limited, tmp_path, key, value, message):
    document = json.loads(limited.to_json())
    document[key] = value
    with pytest.raises(ControllerFileError, match=message):
        Controller.load(write(tmp_path, document))


@pytest.mark.parametrize("key", ["fastest_pole", *POLE_ARRAYS])
def test_a_fastest_pole_without_its_slack_or_the_other_way_round_is_refused(limited, tmp_path, key):
    document = json.loads(limited.to_json())
    del document[key]
    with pytest.raises(ControllerFileError, match=r"pole_.* does not go with fastest_pole = "):
        Controller.load(write(tmp_path, document))


def test_the_form_of_the_paper_has_no_fastest_pole():
    paper = Controller.load(CONTROLLERS["paper-1"])
    with pytest.raises(ControllerFileError, match="fastest_pole does not go with the paper form"):
        dataclasses.replace(paper, fastest_pole=200.0)


def test_a_smaller_fastest_pole_than_proven_is_refused_by_load_policy(limited, tmp_path):
    document = json.loads(limited.to_json())
    document["fastest_pole"] = (60.0).hex()
    with pytest.raises(ControllerFileError, match="first: Phi_1,1,1 < 0"):
        load_policy(write(tmp_path, document))
