"""What docs/contributing/add.md adds from outside the package works with the public commands, as it is printed."""

import contextlib
import csv
import dataclasses
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from unittest import mock

import gymnasium as gym
import numpy as np
import pytest
from support.trainings import resumed_to_the_bit

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.episodes.metrics import METRICS
from fuzzyarm.eval.evaluation import figures
from fuzzyarm.eval.evaluation.figures import _time_figures as time_figures
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.policies.registry import POLICIES
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS, add_algorithm, algorithm_of, find_algorithm
from fuzzyarm.rl_baselines.algorithms.ppo import SPEC, PPOConfig

PAGE = (Path(__file__).parents[2] / "docs" / "contributing" / "add.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page's snippets as a module; what they register is forgotten at the end."""
    folder = tmp_path_factory.mktemp("outside")
    (folder / "contributed.py").write_text("\n".join(BLOCKS), encoding="utf-8")
    with contextlib.ExitStack() as registries, pytest.MonkeyPatch.context() as patch:
        for registry in (CASES, METRICS, POLICIES, ALGORITHMS):
            registries.enter_context(mock.patch.dict(registry))
        patch.syspath_prepend(folder)
        # Figures are drawn, one of each kind, but not turned into files, which takes longer than all else.
        patch.setattr("fuzzyarm.eval.evaluation.figures.write_all", lambda *args: [])
        patch.setattr(figures, "_time_figures", lambda joints: dict([*time_figures(joints).items()][:1]))
        yield importlib.import_module("contributed")
        sys.modules.pop("contributed").env.close()


@pytest.fixture(scope="module")
def evaluated(page, tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluation")
    assert main(["evaluate", "--policy", "spring", "--case", "pushed-tool", "--out", str(folder)]) == 0
    return folder


def test_a_tip_force_acts_in_its_case(page):
    env = gym.make("FuzzyArm-v0", case="pushed-tool")
    env.reset(seed=0)
    forces = [env.step(np.zeros(2))[4]["external_force"] for _ in range(300)]
    peak = np.argmax(np.abs(forces).max(axis=1))
    np.testing.assert_allclose(forces[peak], (0.0, page.SidePush.force), rtol=1e-3, atol=1e-9)
    assert 145 <= peak <= 155  # ms


def test_a_reference_is_followed(page):
    env, law, state = page.env, load_policy("fuzzy-4"), None
    observation, _ = env.reset(seed=0)
    errors, done = [], False
    while not done:
        action, state = law.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        errors.append(info["tip_error"])
        done = terminated or truncated
    assert truncated and len(errors) == 2000 and max(errors) < 0.01


def test_a_batch_takes_them_too(page):
    reference = page.JointReference(page.Ellipse(), duration=2.0)
    arguments = {"case": "pushed-tool", "reference": reference}
    batch = gym.make_vec("FuzzyArm-v0", num_envs=3, vectorization_mode="vector_entry_point", **arguments)
    single = gym.make("FuzzyArm-v0", **arguments)
    torque, observations = np.array([20.0, -5.0]), batch.reset(seed=0)[0]
    np.testing.assert_array_equal(observations[1], single.reset(seed=1)[0])
    for _ in range(50):
        observations, rewards, *_ = batch.step(np.tile(torque, (3, 1)))
        observation, reward, *_ = single.step(torque)
        np.testing.assert_array_equal(observations[1], observation)
        assert rewards[1] == reward


def test_a_metric_is_in_the_results(evaluated):
    (row,) = json.loads((evaluated / "results.json").read_text())["results"]
    assert 0.0 < row["tip_error_end_mm"] <= row["tip_error_max_mm"]
    heading, values = (line.split(",") for line in (evaluated / "results.csv").read_text().splitlines())
    assert dict(zip(heading, values, strict=True))["tip_error_end_mm"]


def test_the_evaluation_can_be_checked_and_shown(evaluated, capsys):
    assert main(["evaluate", "--check", str(evaluated)]) == 0
    assert main(["report", str(evaluated)]) == 0
    assert main(["leaderboard", str(evaluated)]) == 0
    assert "spring" in capsys.readouterr().out


def test_a_controller_has_margins_and_a_sweep(page, tmp_path, capsys, few_postures):
    assert main(["margins", "--policy", "spring"]) == 0
    words = "sweep --policy spring --case pushed-tool --plants 2 --jobs 1 --out"
    assert main([*words.split(), str(tmp_path / "sweep")]) == 0
    assert "spring" in capsys.readouterr().out
    action, state = load_policy("spring").predict(np.zeros((5, 10)))
    assert action.shape == (5, 2) and state.shape == (5, 0)


@pytest.mark.usefixtures("page", "undrawn")
def test_an_algorithm_trains_and_its_policy_is_evaluated(tmp_path):
    out, settings = tmp_path / "run", {"lanes": 4, "total-timesteps": 1000, "n-steps": 25, "seed": 3}
    words = [word for name, value in settings.items() for word in (f"--{name}", str(value))]
    assert main(["train", "search", *words, "--out", str(out)]) == 0
    rows = csv.DictReader((out / "curve.csv").read_text().splitlines())
    best = [float(row["best_reward"]) for row in rows]
    assert len(best) == 10 and best == sorted(best) and best[0] < best[-1]
    assert main(["train", "search", *words, "--out", str(out)]) == 0
    words = ["--policy", str(out / "policy"), "--case", "pushed-tool", "--out", str(tmp_path)]
    assert main(["evaluate", *words]) in (0, 1)


@pytest.mark.usefixtures("page")
def test_an_algorithm_from_outside_is_shipped_and_resumed(tmp_path):
    config = ALGORITHMS["search"].config(lanes=4, total_timesteps=800, checkpoint_interval=240)
    resumed_to_the_bit(config, tmp_path, 400)
    lines = (tmp_path / "whole" / "curve.csv").read_text().splitlines()
    assert lines[0].startswith("steps,episode_reward,episode_length,tip_error_mm,best_reward,nominal_max_mm,")
    assert len(lines) == 5
    bundle = PolicyBundle.load(tmp_path / "whole" / "policy")
    assert bundle.training["algorithm"] == "random search" and bundle.training["n_steps"] == 50
    assert set(bundle.versions) == {"fuzzyarm", "numpy", "gymnasium", "llvmlite"}
    action, _ = load_policy(tmp_path / "whole" / "policy").predict(np.ones(10))
    assert np.abs(action).max() > 1.0


@pytest.mark.usefixtures("page")
def test_names_and_classes_of_settings_are_unique(monkeypatch):
    search = ALGORITHMS["search"]
    assert find_algorithm("search") is algorithm_of(search.config()) is search
    assert algorithm_of(PPOConfig()) is find_algorithm("ppo") is SPEC
    with pytest.raises(ValueError, match="algorithm 'ppo' already exists"):
        add_algorithm(dataclasses.replace(search, name="ppo"))
    with pytest.raises(ValueError, match="SearchConfig belongs to 'search'; give a subclass of it as config"):
        add_algorithm(dataclasses.replace(search, name="another"))
    monkeypatch.delitem(ALGORITHMS, "search")
    with pytest.raises(ValueError, match="unknown algorithm 'search'; choose from: ppo"):
        find_algorithm("search")
    message = "SearchConfig is not the configuration of a known algorithm; call add_algorithm"
    with pytest.raises(ValueError, match=message):
        algorithm_of(search.config())


DEFAULTS = """
import dataclasses, json
from fuzzyarm.envs.scenario.cases import Case, add_case
from fuzzyarm.envs.scenario.disturbances import Disturbance
if {added}:
    add_case(Case("added", "Case 4: added", Disturbance()))
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.eval.paper.evidence import PAPER_CASES
from fuzzyarm.eval.sweep.config import SweepConfig
from fuzzyarm.rl_baselines import _case_evaluation as case_evaluation
from fuzzyarm.rl_baselines.algorithms.ppo import PRESETS
print(json.dumps([
    EvaluationConfig().cases, SweepConfig().cases, case_evaluation.COLUMNS, PAPER_CASES,
    {{name: preset.to_dict() for name, preset in PRESETS.items()}},
]))
"""


@pytest.mark.slow
def test_a_new_case_changes_no_default_no_training_column_and_no_evidence():
    """Whether it is added before or after the modules that hold them are imported."""
    found = []
    for added in (False, True):
        command = [sys.executable, "-c", DEFAULTS.format(added=added)]
        found.append(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
    assert found[0] == found[1]
    assert found[0][0] == ["nominal", "machining", "payload"]


def test_names_are_taken_once(page):
    for block in BLOCKS:
        if "\nadd_" in block:
            with pytest.raises(ValueError, match="already"):
                exec(compile(block, "add.md", "exec"), vars(page).copy())
