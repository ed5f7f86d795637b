"""Policies declare what they optimise, know and see: by their names, out of their files, and by code of one's own."""

import json

import numpy as np
import pytest

from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.eval.declarations import read_declarations, written_declarations
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.policies import NAMES, resolve
from fuzzyarm.policies.declared import ELASTIC, HEADINGS, Declared, declared, declared_by_name, stated
from fuzzyarm.policies.registry import POLICIES
from fuzzyarm.policies.tuned import SCHEMA, TunedLaws

OWN = {"objective": "o", "tuned_on": "t", "knows": "k", "sees": "s", "remembers": "r"}
CONTROLLER = POLICIES["fuzzy-4"].path


@pytest.mark.parametrize("name", NAMES)
def test_policies_of_the_package_declare_all(name):
    own = declared(name)
    assert len(own) == len(HEADINGS) and all(own)
    assert "preview" in own.sees


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


@pytest.fixture
def tuned(tmp_path):
    """A folder as `fuzzyarm tune` writes it, with another controller file in it."""
    folder, arm = tmp_path / "mine", ArmParameters(mass=(12.0, 8.0))
    folder.mkdir()
    (folder / "robot.toml").write_text(arm.to_toml())
    for name in ("fuzzy-4.json", "other.json"):
        (folder / name).write_bytes(CONTROLLER.read_bytes())
    laws = TunedLaws(SCHEMA, robot_of(arm).digest, 1e-3, ("computed-torque", "fuzzy-4"), bandwidth=50.0)
    (folder / "laws.json").write_text(laws.to_json())
    return folder


@pytest.mark.parametrize("name", ["computed-torque", "computed-torque-tip", "elastic-observer", "fuzzy-4"])
def test_a_tuned_folder_declares_as_its_law_but_for_the_arm(tuned, name):
    own, law = declared(str(tuned / name)), declared(name)
    assert own._replace(tuned_on="") == law._replace(tuned_on="")
    assert declared(str(tuned / "other.json")) == declared(str(CONTROLLER))
    assert own.tuned_on.startswith(law.tuned_on.split(" on ")[0]) and own.tuned_on.endswith("of the arm of mine")
    if "tip" not in name:  # of a serial robot, whose policies are tuned on margins alone
        (tuned / "robot.toml").write_text(robot_named("planar-3r").to_toml())
        own = declared(str(tuned / name))
        assert own[2:] == law[2:] and own.objective != law.objective
        assert own.tuned_on == "margins at random postures and along the default path of the arm of mine"


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
        ({**OWN, "preview": "p"}, "declared has the unknown field preview; needed: objective, tuned_on, knows, sees"),
        ({**OWN, "sees": "two\nlines"}, "sees = 'two\\nlines' is none"),
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
    with pytest.raises(ValueError, match="not of the policies"):
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
