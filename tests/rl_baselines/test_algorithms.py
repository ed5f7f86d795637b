"""An algorithm from outside the package: the trainer ships and resumes it, and names tell algorithms apart."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
from support.trainings import resumed_to_the_bit

from fuzzyarm import load_policy
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS, add_algorithm, algorithm_of, find_algorithm
from fuzzyarm.rl_baselines.algorithms.ppo import SPEC, PPOConfig

PAGE = Path(__file__).parents[2] / "docs" / "contributing" / "add.md"


@pytest.fixture
def search():
    """The random search of docs/contributing/add.md, registered until the test ends."""
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    (block,) = [block for block in blocks if "class RandomSearch" in block]
    exec(compile(block, "add.md", "exec"), {"__name__": __name__, "dataclasses": dataclasses, "np": np})
    yield ALGORITHMS["search"]
    del ALGORITHMS["search"]


@pytest.mark.usefixtures("brief_evaluations")
def test_an_algorithm_from_outside_is_shipped_and_resumed(search, tmp_path):
    resumed_to_the_bit(search.config(lanes=4, total_timesteps=800, checkpoint_interval=240), tmp_path, 400)
    lines = (tmp_path / "whole" / "curve.csv").read_text().splitlines()
    assert lines[0].startswith("steps,episode_reward,episode_length,tip_error_mm,best_reward,nominal_max_mm,")
    assert len(lines) == 5
    bundle = PolicyBundle.load(tmp_path / "whole" / "policy")
    assert bundle.training["algorithm"] == "random search" and bundle.training["n_steps"] == 50
    assert set(bundle.versions) == {"fuzzyarm", "numpy", "gymnasium", "llvmlite"}
    action, _ = load_policy(tmp_path / "whole" / "policy").predict(np.ones(10))
    assert np.abs(action).max() > 1.0


def test_names_and_classes_of_settings_are_unique(search, monkeypatch):
    assert find_algorithm("search") is algorithm_of(search.config()) is search
    assert algorithm_of(PPOConfig()) is find_algorithm("ppo") is SPEC
    with pytest.raises(ValueError, match="algorithm 'ppo' already exists"):
        add_algorithm(dataclasses.replace(search, name="ppo"))
    with pytest.raises(ValueError, match="SearchConfig belongs to 'search'; give a subclass of it as config"):
        add_algorithm(dataclasses.replace(search, name="another"))
    monkeypatch.delitem(ALGORITHMS, "search")
    with pytest.raises(ValueError, match="unknown algorithm 'search'; choose from: ppo"):
        find_algorithm("search")
    with pytest.raises(
        ValueError, match="SearchConfig is not the configuration of a known algorithm; call add_algorithm"
    ):
        algorithm_of(search.config())
