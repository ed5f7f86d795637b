"""What a policy's name refers to: kind, label, files and digests, and policies added from outside the package."""

import hashlib
import json
import pickle
import shutil
import sys
from pathlib import Path

import cloudpickle
import numpy as np
import pytest

import fuzzyarm
from fuzzyarm.cli import main
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.fuzzy_policy.laws.computed_torque import ComputedTorquePolicy
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies import NAMES, Kind, add_policy, load_policy, registry, resolve, resolve_all

PACKAGE = Path(fuzzyarm.__file__).parent
SHIPPED, TRAINED = PACKAGE / "fuzzy_policy" / "controllers", PACKAGE / "fuzzy_policy" / "laws" / "learned" / "policies"


@pytest.mark.parametrize(
    ("name", "kind", "tip", "named"),
    [
        ("computed-torque", Kind.LAW, False, True),
        ("computed-torque-tip", Kind.LAW, True, True),
        ("elastic-observer", Kind.LAW, False, True),
        ("fuzzy-4-tip", Kind.CONTROLLER, True, True),
        ("runs/mine.json", Kind.CONTROLLER, False, False),
        ("runs/mine.json-tip", Kind.CONTROLLER, True, False),
        ("ppo-robust", Kind.LEARNED, False, True),
        ("runs/ppo-1", Kind.LEARNED, False, False),
        ("package.module:factory", Kind.CODE, False, False),
        ("a.b:c.d", Kind.CODE, False, False),
        # Neither a wrapper nor code: read as folders, which do not exist.
        *((name, Kind.LEARNED, False, False) for name in ("elastic-observer-tip", ":b", "a:b:c", "a-b:c", ".a:b")),
    ],
)
def test_every_kind_of_name(name, kind, tip, named):
    spec, label = resolve(name), name.removeprefix("runs/").replace(".json", "")
    assert (spec.name, spec.kind, spec.tip, spec.named, spec.label) == (name, kind, tip, named, label)


@pytest.mark.parametrize("name", ["nobody", "elastic-observer-tip", "runs/nothing"])
def test_an_unknown_name_fails_when_it_is_loaded_and_names_the_choices(name):
    with pytest.raises(ValueError, match=r"unknown policy .*choose from: fuzzy-32, .*controller file.*folder"):
        resolve(name).load()


@pytest.mark.parametrize(
    ("name", "inside", "route"),
    [
        ("model.zip", None, "sb3:model.zip"),
        ("model.onnx", None, "onnx:model.onnx"),
        *((f"model{ending}", None, "module:factory") for ending in (".pt", ".pth", ".safetensors")),
        ("empty", (), "module:factory"),
        ("models", ("b.txt", "c.zip"), "sb3:models/c.zip"),
        ("run", ("curve.csv", "policy/policy.json"), "run/policy"),
    ],
)
def test_what_is_no_policy_is_refused_with_what_to_write_instead(name, inside, route, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for path in [Path(name)] if inside is None else [Path(name, entry) for entry in (*inside, "notes")]:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    for command in ("evaluate", "score"):
        assert main([command, "--policy", name]) == 2
        error = capsys.readouterr().err
        assert f"{name} " in error and error.endswith(f" --policy {route}\n") and error.count("\n") == 1


def test_files_are_known_by_their_content(tmp_path, monkeypatch):
    def files(name):
        return resolve(name).files()

    monkeypatch.chdir(tmp_path)
    four, robust, residual = (
        hashlib.sha256(path.read_bytes()).hexdigest()
        for path in (
            SHIPPED / "fuzzy-4.json",
            *(TRAINED / f"ppo-{name}/policy.json" for name in ("robust", "residual")),
        )
    )
    assert files("fuzzy-4") == files("fuzzy-4-tip") == {"fuzzy-4.json": four}
    assert files("computed-torque") == files("computed-torque-tip") == files("nobody") == {}
    assert files("ppo-robust") == {"policy.json": robust}
    with_base = {"policy.json": residual, "fuzzy-4.json": four}
    assert files("ppo-residual") == files(TRAINED / "ppo-residual") == with_base
    other_system = (SHIPPED / "fuzzy-4.json").read_bytes().replace(b"\n", b"\r\n")
    Path("mine.json").write_bytes(other_system)
    assert files("mine.json-tip") == {"mine.json": four}
    with pytest.raises(OSError, match=r"gone\.json"):
        files("gone.json")


def test_code_that_a_file_names_is_not_imported_for_its_digest(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    Path("my_trap.py").write_text("open('ran', 'w').close()\n", encoding="utf-8")
    shutil.copytree(TRAINED / "ppo-residual", "mine")
    description = json.loads(Path("mine/policy.json").read_text())
    description["action"]["base"] = "my_trap:factory"
    Path("mine/policy.json").write_text(json.dumps(description))
    assert list(resolve("mine").files()) == ["policy.json"]
    with pytest.raises(ValueError, match="base 'my_trap:factory', which is unknown"):
        resolve("mine", run_code=True).load()
    with pytest.raises(ValueError, match="names code"):
        resolve("my_trap:factory").files()
    assert not Path("ran").exists()
    assert list(resolve("my_trap:factory", run_code=True).files()) == ["my_trap.py"]
    assert Path("ran").exists()
    del sys.modules["my_trap"]


def test_two_policies_of_one_label_are_refused():
    assert list(resolve_all(["fuzzy-4", "a/b.json", "ppo-robust"])) == ["fuzzy-4", "b", "ppo-robust"]
    trained = ["runs/one/policy", "runs/two/policy", "runs/two/best", "policy"]
    assert list(resolve_all(trained)) == ["one", "two", "two-best", "policy"]
    with pytest.raises(ValueError, match=r"a/b.json, c/b: two of them have the same name; leave out or rename one"):
        resolve_all(["a/b.json", "c/b"])


def test_an_added_policy_is_known_by_its_name_which_is_free_and_means_nothing_else(monkeypatch):
    monkeypatch.setattr(registry, "POLICIES", registry.POLICIES.copy())
    monkeypatch.setattr("fuzzyarm.policies.spec.POLICIES", registry.POLICIES)
    add_policy("soft", lambda robot, control_period: ComputedTorquePolicy(robot, control_period, 5.0), has_tip=True)
    spec = resolve("soft-tip")
    assert (spec.kind, spec.label, spec.files(), spec.named) == (Kind.LAW, "soft-tip", {}, True)
    policy = load_policy("soft-tip", control_period=2e-3)
    assert isinstance(policy, TipPolicy) and policy.control_period == 2e-3
    with pytest.raises(ValueError, match=r"choose from: .*learned-observer, .*soft, .*soft-tip. Also accepted: a cont"):
        load_policy("nobody")
    assert "soft" not in {*EvaluationConfig().policies, *NAMES}  # defaults stay as they are
    for name in ("", "a-tip", "a.json", "a/b", "a:b", "a\\b", "fuzzy-4"):
        with pytest.raises(ValueError, match=r"cannot name a policy|policy 'fuzzy-4' already exists"):
            add_policy(name, ComputedTorquePolicy)


@pytest.mark.parametrize("name", ["computed-torque-tip", "elastic-observer", "fuzzy-4-tip"])
def test_a_policy_is_pickled_without_its_machine_code_and_acts_the_same(name):
    """Also by cloudpickle, which would take a compiled function apart; workers of a sweep get policies that way."""
    policy, observation = load_policy(name), np.linspace(0.1, 1.0, 10)
    first, state = policy.predict(observation)
    for there in (pickle.loads(pickle.dumps(policy)), cloudpickle.loads(cloudpickle.dumps(policy))):
        np.testing.assert_array_equal(there.predict(observation)[0], first)
        np.testing.assert_array_equal(there.predict(observation, state)[0], policy.predict(observation, state)[0])
