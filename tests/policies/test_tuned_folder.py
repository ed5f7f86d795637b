"""A folder of `fuzzyarm tune`: its policies by name, its arm as a robot, and what it refuses."""

import dataclasses
import json
import shutil

import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli.evaluate import Options as EvaluateOptions
from fuzzyarm.cli.evaluate import _config
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import chosen_arm, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.stability.margins import MarginsConfig
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.fuzzy import FuzzyPolicy
from fuzzyarm.fuzzy_policy.laws.observer_gains import ObserverWeights
from fuzzyarm.fuzzy_policy.laws.tip import TipPolicy
from fuzzyarm.policies import policies_of, resolve
from fuzzyarm.policies.registry import POLICIES
from fuzzyarm.policies.tuned import NAME, SCHEMA, TunedLaws, read_laws

ARM = ArmParameters()
NAMES = ("fuzzy-4", "computed-torque", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer", "adaptive-observer")
OBSERVER = dataclasses.replace(ObserverWeights(), link_angle=0.03)
LAWS = TunedLaws(
    schema=SCHEMA,
    arm_sha256=robot_of(ARM).digest,
    control_period=1e-3,
    policies=NAMES,
    bandwidth=55.0,
    observer=dataclasses.asdict(OBSERVER),
    adaptive=dataclasses.asdict(AdaptiveWeights()),
)


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "my-arm"
    made.mkdir()
    ARM.write_toml(made / "robot.toml")
    shutil.copy(POLICIES["fuzzy-4"].path, made)
    (made / NAME).write_text(LAWS.to_json(), encoding="utf-8")
    return made


def test_its_policies_have_its_numbers(folder):
    assert load_policy(folder / "computed-torque").bandwidth == 55.0
    assert load_policy(f"{folder}/computed-torque-tip").law.bandwidth == 55.0
    assert load_policy(f"{folder}/elastic-observer").weights == OBSERVER
    assert isinstance(load_policy(f"{folder}/fuzzy-4"), FuzzyPolicy)
    adaptive = load_policy(f"{folder}/adaptive-observer")
    assert isinstance(adaptive.fallback, TipPolicy) and isinstance(adaptive.fallback.law, FuzzyPolicy)


def test_the_folder_names_its_arm_and_its_policies(folder, monkeypatch):
    assert chosen_arm(folder, None) == ARM
    assert FuzzyArmEnv(robot=folder).unwrapped.reset(seed=0)[0].shape == (10,)
    monkeypatch.chdir(folder.parent)
    expected = tuple(f"my-arm/{name}" for name in NAMES)
    assert policies_of("my-arm") == MarginsConfig(robot="my-arm").names() == expected
    assert _config(EvaluateOptions(robot="my-arm")).policies == expected
    assert [resolve(name).label for name in expected] == list(NAMES)
    assert policies_of("ur5") is policies_of(None) is policies_of("nowhere") is None


def test_the_folder_of_another_arm_is_refused(folder):
    softer = dataclasses.replace(ARM, stiffness=(6e4, 1e4))
    with pytest.raises(ValueError, match="tuned for another arm"):
        load_policy(f"{folder}/computed-torque", robot=softer)
    softer.write_toml(folder / "robot.toml")
    with pytest.raises(ValueError, match=r"robot\.toml was changed"):
        policies_of(str(folder))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bandwidth": None}, "numbers of computed-torque are not"),
        ({"bandwidth": -1.0}, "bandwidth"),
        ({"observer": {"a\nb": 1.0}}, "missing or unknown"),
        ({"adaptive": {**LAWS.adaptive, "gate": 0.0}}, "gate"),
        ({"policies": ["../fuzzy-4"]}, "no name of a policy"),
        ({"schema": "fuzzyarm-tuned/0"}, "this version reads"),
    ],
)
def test_damaged_laws_are_refused_in_one_line(folder, change, message):
    document = json.loads((folder / NAME).read_text(encoding="utf-8")) | change
    (folder / NAME).write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ValueError, match=message) as refused:
        read_laws(folder, ARM)
    assert "\n" not in str(refused.value) and str(folder) in str(refused.value)
