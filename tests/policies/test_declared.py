"""What policies declare, by name, by file and by code; and a folder of `fuzzyarm tune`, its arm and its policies."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli._commands.evaluate import Options as EvaluateOptions
from fuzzyarm.cli._commands.evaluate import _config
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import chosen_arm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.eval.declarations import read_declarations, written_declarations
from fuzzyarm.eval.stability.margins import MarginsConfig
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies import NAMES, policies_of, resolve
from fuzzyarm.policies.declared import _ELASTIC as ELASTIC
from fuzzyarm.policies.declared import HEADINGS, Declared, declared, declared_by_name, stated
from fuzzyarm.policies.registry import POLICIES
from fuzzyarm.policies.tuned import NAME, SCHEMA, TunedLaws

OWN = {"objective": "o", "tuned_on": "t", "knows": "k", "sees": "s", "remembers": "r"}
CONTROLLER = POLICIES["fuzzy-4"].path
ARM = ArmParameters()
TUNED = ("fuzzy-4", "computed-torque", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer", "adaptive-observer")
OBSERVER = dataclasses.replace(ObserverWeights(), link_angle=0.03)
WEIGHTS = {"observer": dataclasses.asdict(OBSERVER), "adaptive": dataclasses.asdict(AdaptiveWeights())}
LAWS = TunedLaws(SCHEMA, robot_of(ARM).digest, control_period=1e-3, policies=TUNED, bandwidth=55.0, **WEIGHTS)


@pytest.fixture
def folder(tmp_path):
    """A folder as `fuzzyarm tune` writes it."""
    made = tmp_path / "my-arm"
    made.mkdir()
    ARM.write_toml(made / "robot.toml")
    shutil.copy(CONTROLLER, made)
    (made / NAME).write_text(LAWS.to_json(), encoding="utf-8")
    return made


@pytest.mark.parametrize("name", NAMES)
def test_policies_of_the_package_declare_all(name):
    own = declared(name)
    assert len(own) == len(HEADINGS) and all(own) and "preview" in own.sees


@pytest.mark.parametrize("name", ["computed-torque-tip", "adaptive-observer"])
def test_on_another_arm_a_named_law_says_on_which_arm_its_numbers_were_chosen(name):
    of_table, lighter = declared(name), ArmParameters(mass=(12.0, 8.0))
    assert declared(name, arm=ArmParameters()) == of_table
    assert declared(name, arm=lighter) == of_table._replace(tuned_on=f"{of_table.tuned_on}; all of the arm of Table 1")
    own = declared(name, arm=robot_named("ur5"))
    assert "ur5" in own.tuned_on and own[2:] == of_table[2:]
    assert own.objective.split(", ")[0] in ("bandwidth of Table 1", "weights of Table 1")


def test_a_controller_file_declares_what_is_in_it_and_not_what_the_policy_of_its_name_does(tmp_path):
    path = tmp_path / "fuzzy-4.json"
    path.write_bytes(CONTROLLER.read_bytes())
    own, shipped = declared(str(path)), declared("fuzzy-4")
    assert own[2:] == shipped[2:]
    assert own.objective.startswith(Controller.load(path).origin["objective"])
    assert own.tuned_on != shipped.tuned_on
    assert declared(f"{path}-tip").knows == ELASTIC
    assert declared_by_name(str(path)) is None  # reads no file


@pytest.mark.parametrize("name", ["computed-torque", "computed-torque-tip", "elastic-observer", "fuzzy-4"])
def test_a_tuned_folder_declares_as_its_law_but_for_the_arm(folder, name):
    own, law = declared(str(folder / name)), declared(name)
    assert own._replace(tuned_on="") == law._replace(tuned_on="")
    shutil.copy(CONTROLLER, folder / "other.json")
    assert declared(str(folder / "other.json")) == declared(str(CONTROLLER))
    assert own.tuned_on.startswith(law.tuned_on.split(" on ")[0]) and own.tuned_on.endswith("of the arm of my-arm")
    if "tip" not in name:  # of a serial robot, whose policies are tuned on margins alone
        (folder / "robot.toml").write_text(robot_named("planar-3r").to_toml())
        own = declared(str(folder / name))
        assert own[2:] == law[2:] and own.objective != law.objective
        assert own.tuned_on == "margins at random postures and along the default path of the arm of my-arm"


@pytest.mark.parametrize("name", ["ppo-nominal", "ppo-robust", "ppo-residual", "learned-observer"])
def test_a_learned_folder_declares_what_its_bundle_records(name):
    """The shipped bundles, which say by hand what they were trained on, as anybody's."""
    own, shipped = declared(str(POLICIES[name].path)), declared(name)
    assert own.knows == shipped.knows and own.sees == shipped.sees
    assert own.objective.startswith(shipped.objective)
    assert own.tuned_on.split(" of ")[0].split(";")[0] == shipped.tuned_on.split(";")[0]
    for kept in ("fuzzy-4-tip", "leaky integral of the error", "the state of a network"):
        assert (kept in own.remembers) == (kept in shipped.remembers)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({**OWN, "preview": "p"}, "declared has the unknown field(s) preview; needed: objective, tuned_on, knows"),
        ({**OWN, "sees": "two\nlines"}, "sees = 'two\\nlines' is not allowed"),
        ("all", "declared lacks objective"),
    ],
)
def test_a_wrong_declaration_is_refused_by_its_field(given, message):
    with pytest.raises(ValueError) as refused:
        stated(given)
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_files_hold_declarations_and_older_ones_have_those_of_known_names():
    found = {"fuzzy-4": declared("fuzzy-4"), "mine": stated(OWN), "silent": None}
    names = ("fuzzy-4", "mine.json", "silent")
    written = json.loads(json.dumps(written_declarations(found)))
    assert read_declarations(written, names) == found
    assert read_declarations(None, names) == {"fuzzy-4": declared("fuzzy-4"), "mine": None, "silent": None}
    with pytest.raises(ValueError, match="the policies that were run are"):
        read_declarations({"fuzzy-4": None}, names)


def test_code_declares_by_an_attribute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "stating_law.py").write_text(
        f"class Law:\n    declared = {OWN!r}\n\n    def predict(self, observation, **named):\n"
        "        return observation[..., :2] * 0.0, None\n\n\nclass Wrong(Law):\n    declared = {'objective': 'o'}\n"
    )
    spec = resolve("stating_law:Law", run_code=True)
    policy = spec.load()
    assert declared(spec, policy) == Declared(*OWN.values()) == declared(spec, policy, passes=3)
    assert np.all(policy.predict(np.zeros(10))[0] == 0.0)
    with pytest.raises(ValueError, match="stating_law:Wrong: declared lacks tuned_on"):
        resolve("stating_law:Wrong", run_code=True).load()


def test_its_policies_have_its_numbers(folder):
    assert load_policy(folder / "computed-torque").bandwidth == 55.0
    assert load_policy(f"{folder}/computed-torque-tip").law.bandwidth == 55.0
    assert load_policy(f"{folder}/elastic-observer").weights == OBSERVER
    assert isinstance(load_policy(f"{folder}/fuzzy-4"), FuzzyPolicy)
    fallback = load_policy(f"{folder}/adaptive-observer").fallback
    assert isinstance(fallback, TipPolicy) and isinstance(fallback.law, FuzzyPolicy)


def test_the_folder_names_its_arm_and_its_policies(folder, monkeypatch):
    assert chosen_arm(folder, None) == ARM
    assert FuzzyArmEnv(robot=folder).unwrapped.reset(seed=0)[0].shape == (10,)
    monkeypatch.chdir(folder.parent)
    expected = tuple(f"my-arm/{name}" for name in TUNED)
    assert policies_of("my-arm") == MarginsConfig(robot="my-arm").names() == expected
    assert _config(EvaluateOptions(robot="my-arm")).policies == expected
    assert [resolve(name).label for name in expected] == list(TUNED)
    assert policies_of("ur5") is policies_of(None) is policies_of("nowhere") is None


def test_the_folder_of_another_arm_is_refused(folder):
    softer = dataclasses.replace(ARM, stiffness=(6e4, 1e4))
    with pytest.raises(ValueError, match="tuned for a different arm"):
        load_policy(f"{folder}/computed-torque", robot=softer)
    softer.write_toml(folder / "robot.toml")
    with pytest.raises(ValueError, match=r"robot\.toml was changed"):
        policies_of(str(folder))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bandwidth": None}, "parameters of computed-torque are missing"),
        ({"bandwidth": -1.0}, "bandwidth"),
        ({"observer": {"a\nb": 1.0}}, "missing weights: encoder.*; unknown: .a.*nb."),
        ({"adaptive": {**LAWS.adaptive, "gate": 0.0}}, "gate"),
        ({"policies": ["../fuzzy-4"]}, "must be the name of a policy"),
        ({"schema": "fuzzyarm-tuned/0"}, "this version of fuzzyarm reads"),
    ],
)
def test_damaged_laws_are_refused_in_one_line(folder, change, message):
    document = json.loads((folder / NAME).read_text(encoding="utf-8")) | change
    (folder / NAME).write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ValueError, match=message) as refused:
        TunedLaws.read(folder, ARM)
    assert "\n" not in str(refused.value) and str(folder) in str(refused.value)
