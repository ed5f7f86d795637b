"""Forged and extreme controller files: one clear line, or an honest report; never another error and no false proof."""

import dataclasses
import functools
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slow_twins import slow_but
from support.shipped import CONTROLLERS

from fuzzyarm.cli import main
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, Controller
from fuzzyarm.fuzzy_policy.signed_files import LARGEST, ControllerFileError, digest_of
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.proof import rigid_loop as frozen
from fuzzyarm.proof.certificate import certify
from fuzzyarm.proof.rigid_loop import RigidLoop, find_worst_point, gain_at, pole_rate
from fuzzyarm.proof.verification import verify_file

BASES = ("fuzzy-1", "fuzzy-4", "paper-1")
SLACK = ("Q", "X", "tau")


@functools.cache
def shipped(name):
    return Controller.load(CONTROLLERS[name])


@functools.cache
def limits(name):
    """Return the slowest pole [1/s] of the loop frozen anywhere in the box, and its largest gain: no proof beats it.

    After a short search, which finds them nearly.
    """
    loop = RigidLoop(shipped(name))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frozen, "GENERATIONS", 40)
        slowest = -find_worst_point(loop, lambda F, G, omega: -pole_rate(F)).value
        return slowest, find_worst_point(loop, lambda F, G, omega: gain_at(F, G, 1j * omega)).value


def signed(document, folder):
    """Write a document with a digest that fits it, as somebody would who knows the format."""
    content = {key: value for key, value in document.items() if key != "digest"}
    path = Path(folder) / "forged.json"
    path.write_text(json.dumps({**content, "digest": digest_of(content)}))
    return path


def report_on(path):
    """Return the report on a file, or None if it is refused in one line; every other error is a failure."""
    refused = None
    try:
        verification = verify_file(path)
    except ControllerFileError as error:
        refused = str(error)
    if refused is not None:
        assert "\n" not in refused and str(path) in refused and len(refused) < 600
        return None
    json.dumps(verification.to_dict(), allow_nan=True)
    assert verification.to_text().startswith(f"{path}: ")
    return verification.certificate


# What stands in a field -----------------------------------------------------------------------------------------------

EXTREMES = [0.0, -0.0, 5e-324, 1e-308, 1e-160, 1e-30, 1.0, -1.0, 1e30, 1e60, 1e61, 1e160, 1.7e308, -1.7e308]
TEXTS = ["inf", "-inf", "nan", "0x1p+99999", "-0x1p+99999", "0x1p-99999", "", "0x", "20", "\ud800", "\x1b[31m", "z1"]
OTHERS = [None, True, False, 10**400, -(10**400), 1e308, 20.0, 0, [], {}, [[]], {"a": []}, [None], [["0x1p+0"]]]
VALUES = st.one_of(
    st.sampled_from([*(value.hex() for value in EXTREMES), *TEXTS, *OTHERS]),
    st.floats(allow_nan=False).map(float.hex),
    st.recursive(st.text(max_size=5) | st.integers(), lambda part: st.lists(part, max_size=3), max_leaves=5),
)


def changed(data, value):
    """Return a document with one change somewhere in it: a value, a length, a key, or its type."""
    inside = isinstance(value, dict | list) and len(value) > 0
    if not inside or data.draw(st.integers(0, 9)) == 0:
        return data.draw(VALUES)
    key = data.draw(st.sampled_from(list(value) if isinstance(value, dict) else range(len(value))))
    copy = dict(value) if isinstance(value, dict) else list(value)
    action = data.draw(st.sampled_from(["change"] * 8 + ["remove", "repeat"]))
    if action == "remove":
        del copy[key]
    elif action == "repeat" and isinstance(copy, list):
        copy.append(copy[key])
    elif action == "repeat":
        copy[f"{key} "] = copy[key]
    else:
        copy[key] = changed(data, copy[key])
    return copy


@functools.cache
def text_of(name):
    return shipped(name).to_json()


def attack(data, name):
    """Change one or two fields, sign, and verify: refused in a line, or reported on, and what is proven holds."""
    document = json.loads(text_of(name))
    for _ in range(data.draw(st.integers(1, 2))):
        field = data.draw(st.sampled_from(list(document)))
        document[field] = changed(data, document[field])
    with tempfile.TemporaryDirectory() as folder:
        path = signed(document, folder)
        certificate = report_on(path)
        if certificate is not None and certificate.proven and name.startswith("fuzzy"):
            assert_true_on_frozen_loops(Controller.load(path))


@settings(max_examples=30, deadline=None)
@given(data=st.data(), name=st.sampled_from(BASES))
def test_any_changed_field_is_refused_in_a_line_or_reported_on(data, name):
    attack(data, name)


@pytest.mark.slow
@settings(max_examples=1000, deadline=None)
@given(data=st.data(), name=st.sampled_from(BASES))
def test_many_changed_fields_are_refused_in_a_line_or_reported_on(data, name):
    attack(data, name)


def assert_true_on_frozen_loops(controller):
    """An oracle without any inequality: poles and gains of the loop frozen at random states of the box."""
    model, rng = controller.model, np.random.default_rng(0)
    n = controller.gains.shape[-1]
    for z in rng.uniform(*model.bounds.T, size=(50, 5)):
        h, v = model.weights(z)
        A, E, B = np.zeros((n, n)), np.eye(n), np.zeros((n, 2))
        E[:4, :4], A[:4, :4], A[4:, :2], B[2:4] = model.E(z), model.A(z), np.eye(2)[: n - 4], np.eye(2)
        F, G = np.linalg.solve(E, A + B @ np.einsum("i,k,ikab->ab", h, v, controller.gains)), np.linalg.solve(E, B)
        poles = np.linalg.eigvals(F).real
        assert poles.max() < -controller.alpha * (1.0 - 1e-9)
        assert controller.fastest_pole is None or poles.min() > -controller.fastest_pole * (1.0 + 1e-9)
        for omega in (0.0, 10.0, 100.0):
            response = np.linalg.solve(1j * omega * np.eye(n) - F, G)[:2]
            assert np.linalg.norm(response, 2) < controller.gamma * (1.0 + 1e-9)


# Claims tighter than what was proven ----------------------------------------------------------------------------------


@settings(max_examples=15, deadline=None)
@given(
    name=st.sampled_from(["fuzzy-1", "fuzzy-4"]),
    tighter=st.sampled_from(["alpha", "gamma", "both"]),
    factor=st.floats(1.0, 1e6, exclude_min=True),
    scales=st.tuples(*[st.floats(-3.0, 3.0)] * 4),
)
def test_a_claim_beyond_what_holds_is_never_proven(name, tighter, factor, scales):
    """Whatever P and the slack are scaled by: with this factor some frozen loop breaks the claim."""
    controller, (slowest, largest) = shipped(name), limits(name)
    alpha = min(slowest * factor, RATES[1]) if tighter != "gamma" else controller.alpha
    gamma = max(largest / factor, GAINS[0]) if tighter != "alpha" else controller.gamma
    pole = None if controller.fastest_pole is None else min(max(controller.fastest_pole, 2.0 * alpha), RATES[1])
    if pole is not None and alpha >= pole:
        return
    scaled = {key: getattr(controller, key) * 10.0**scale for key, scale in zip(("P", *SLACK), scales, strict=True)}
    forged = dataclasses.replace(controller, alpha=alpha, gamma=gamma, fastest_pole=pole, **scaled)
    assert not certify(forged).proven


@pytest.mark.parametrize("name", slow_but(["fuzzy-1", "fuzzy-4"], ["fuzzy-1", "fuzzy-2", "fuzzy-4", "fuzzy-8"]))
def test_the_frozen_loop_shows_how_far_a_claim_may_go(name):
    slowest, largest = limits(name)
    assert slowest > shipped(name).alpha and largest < shipped(name).gamma


# Extreme claims -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["alpha", "gamma", "fastest_pole"])
@pytest.mark.parametrize("value", [1e308, 1.7e308, 1e-308, 5e-324, 0.0, -1.0])
def test_an_extreme_claim_is_refused_with_its_range(tmp_path, capsys, field, value):
    document = json.loads(text_of("fuzzy-4"))
    document[field] = value.hex()
    path = signed(document, tmp_path)
    assert main(["verify", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"{field} = " in error and "allowed: " in error


@pytest.mark.parametrize(("field", "factor"), [("X", 1e300), ("P", 1e300), ("gains", 1e300), ("tau", 1e300)])
def test_an_array_of_extreme_numbers_is_refused(tmp_path, capsys, field, factor):
    document = json.loads(text_of("fuzzy-4"))
    document[field] = json.loads(json.dumps(document[field]), parse_float=float)

    def scaled(part):
        return [scaled(entry) for entry in part] if isinstance(part, list) else (float.fromhex(part) * factor).hex()

    document[field] = scaled(document[field])
    assert main(["verify", str(signed(document, tmp_path))]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and field in error


def test_one_extreme_entry_of_P_is_refused(tmp_path, capsys):
    document = json.loads(text_of("fuzzy-1"))
    document["P"][2][4] = document["P"][4][2] = (1.7e308).hex()
    assert main(["verify", str(signed(document, tmp_path))]) == 2
    assert "P holds a number of size 1.7e+308" in capsys.readouterr().err


@pytest.mark.parametrize("field", ["P", "Q", "X", "tau", "gains"])
@pytest.mark.parametrize("value", slow_but([LARGEST, 0.0], [LARGEST, -LARGEST, 1e-300, 0.0]))
def test_numbers_at_the_end_of_the_range_prove_nothing(field, value):
    controller = shipped("fuzzy-4")
    array = np.full_like(getattr(controller, field), value)
    if field == "P":
        array = np.diag(np.diag(array))
    assert not certify(dataclasses.replace(controller, **{field: array})).proven


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), spread=st.sampled_from([1.0, 10.0, 60.0]))
def test_arms_of_any_size_are_refused_or_reported_on(seed, spread):
    """The bounds are those of the arm, so that the file fits together; its gains are those of Table 1."""
    rng, table_1 = np.random.default_rng(seed), ArmParameters()
    values = {
        field.name: tuple(np.atleast_1d(getattr(table_1, field.name)) * 10.0 ** rng.uniform(-spread, spread, 2))
        for field in dataclasses.fields(table_1)
        if field.name != "joint_limit" and isinstance(getattr(table_1, field.name), tuple) and rng.random() < 0.5
    }
    try:
        arm = ArmParameters(**values)
    except ValueError:
        return
    forged = dataclasses.replace(shipped("fuzzy-4"), model=TSModel(arm))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "forged.json"
        forged.save(path)
        report_on(path)


@pytest.mark.parametrize("field", ["alpha", "gamma", "fastest_pole"])
@pytest.mark.parametrize("value", [10**400, np.float64(1e300), "1", True, 1j, [1.0]])
def test_what_is_no_number_of_the_range_is_refused_in_python_too(field, value):
    with pytest.raises(ControllerFileError, match=field):
        dataclasses.replace(shipped("fuzzy-4"), **{field: value})


def test_whole_numbers_are_stored_as_floats(tmp_path):
    whole = dataclasses.replace(shipped("fuzzy-4"), alpha=19, fastest_pole=201)
    whole.save(tmp_path / "whole.json")
    assert Controller.load(tmp_path / "whole.json").alpha == 19.0
