"""What the numbers of a sweep depend on: nothing that a worker computes with is left out."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import fuzzyarm
from fuzzyarm.envs.physics.robot import robot_named
from fuzzyarm.envs.scenario.cases import CASES, Case, add_case
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.eval.sweep.run import SOURCES, Sweep, digest_of, identity_of
from fuzzyarm.policies import resolve_all

ROOT = Path(fuzzyarm.__file__).parent

IMPORTED = """
import itertools, json, sys
from fuzzyarm.eval.sweep import episodes
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.policies import load_policy

names = ("fuzzy-4-tip", "elastic-observer", "ppo-residual")
whole = episodes.episodes
episodes.episodes = lambda *given, **more: itertools.islice(whole(*given, **more), 100)  # of 1500 steps
episodes.run_plants(SweepConfig(cases=("machining",)), {name: load_policy(name) for name in names}, range(1))
print(json.dumps([module.__file__ for name, module in sys.modules.items() if name.startswith("fuzzyarm.")]))
"""


def test_the_digest_covers_every_module_that_runs_an_episode():
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True)
    used = {Path(file).relative_to(ROOT) for file in json.loads(done.stdout)}
    covered = {Path(source) for source in SOURCES}
    missing = {path for path in used if path.name != "__init__.py" and not covered.intersection([path, *path.parents])}
    assert missing == set()


def test_the_identity_holds_the_digest_of_every_file_of_a_policy():
    config = SweepConfig(policies=("fuzzy-4-tip", "ppo-residual", "computed-torque"))
    found = identity_of(config, resolve_all(config.policies))
    assert list(found["policies"]["fuzzy-4-tip"]) == ["fuzzy-4.json"]
    assert "policy.json" in found["policies"]["ppo-residual"]  # which holds the digest of the weights
    assert found["policies"]["computed-torque"] == {}
    assert found["numbers"]["parameters"] == config.parameters.to_dict()
    assert "bound" not in found["numbers"]  # decides only how results are shown
    assert digest_of(found) == digest_of(json.loads(json.dumps(found)))


def test_the_sweep_of_a_robot_is_opened_again_and_another_robot_is_refused(tmp_path):
    robot = robot_named("planar-3r")
    config = SweepConfig(robot=robot, policies=("computed-torque",), plants=2)
    Sweep.begin(tmp_path, config)
    assert Sweep.resume(tmp_path, {"robot": robot}).config == config
    with pytest.raises(ValueError, match="choose another --out"):
        Sweep.resume(tmp_path, {"robot": robot.with_payload(0.1)})


def test_a_sweep_of_an_added_case_goes_on_only_where_the_case_is_known_and_the_same(tmp_path):
    pushes = [
        Case("pushed", "Case 4: pushed", Disturbance(tip_force=ConstantForce((0.0, force)))) for force in (30.0, 31.0)
    ]
    add_case(pushes[0])
    try:
        config = SweepConfig(policies=("computed-torque",), cases=("pushed", "nominal"), plants=2)
        Sweep.begin(tmp_path, config)
        assert Sweep.resume(tmp_path).config == config
        CASES["pushed"] = pushes[1]
        with pytest.raises(ValueError, match=r"begun with other .*\(cases: pushed"):
            Sweep.resume(tmp_path)
        del CASES["pushed"]
        with pytest.raises(ValueError, match=r"unknown case 'pushed'.*add_case adds another"):
            Sweep.resume(tmp_path)
    finally:
        CASES.pop("pushed", None)
