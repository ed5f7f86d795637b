"""Data sets: what is recorded is what the arm does under it, and Minari reads what was written."""

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from support.command_line import printed, refused

from fuzzyarm import load_policy
from fuzzyarm.eval.dataset import store
from fuzzyarm.eval.dataset.config import CONDITIONS, LEVELS, DatasetConfig
from fuzzyarm.eval.dataset.store import open_dataset, provenance_of, record, score_of

EXAMPLES = Path(__file__).parents[3] / "examples"
LIMIT = np.array([500.0, 250.0])


def assert_given_again(env, seed, episode):
    """Take the actions of an episode again; return the tip errors and whether each step was terminated or truncated."""
    observation, _ = env.reset(seed=seed)
    steps = [env.step(action) for action in episode.actions]
    observations, rewards, terminated, truncated, infos = zip(*steps, strict=True)
    assert_array_equal([observation, *observations], episode.observations)
    assert_array_equal(rewards, episode.rewards)
    return [info["tip_error"] for info in infos], terminated, truncated


def test_the_recorded_torques_give_the_recorded_episode_again():
    second = list(record(load_policy("computed-torque"), "loads", 2, 5, noise=0.02))[1]
    assert second.seed == 6
    env = gym.make("FuzzyArm-v0", **CONDITIONS["loads"])
    errors, terminated, truncated = assert_given_again(env, 6, second)
    assert_array_equal(errors, second.tip_errors)
    assert np.flatnonzero(np.logical_or(terminated, truncated)).tolist() == [len(errors) - 1]
    assert truncated[-1] == second.completed
    noise = (second.actions - second.intended) / LIMIT
    assert noise.std() == pytest.approx(0.02, rel=0.05) and abs(noise.mean()) < 0.002


@pytest.mark.parametrize(("policy", "score"), [("computed-torque", 0.0), ("learned-observer", 100.0)])
def test_the_anchors_score_0_and_100_in_the_episodes_of_the_data_and_noise_costs(policy, score):
    plain, noisy = (list(record(load_policy(policy), "loads", 2, 5, noise)) for noise in (0.0, 0.02))
    assert score_of(plain, "loads")[0] == pytest.approx(score)
    assert score_of(noisy, "loads")[0] < score
    half = dataclasses.replace(plain[0], rewards=plain[0].rewards[:100], tip_errors=plain[0].tip_errors[:100])
    assert score_of([half], "loads")[0] < -100.0  # what is missing at the end counts as lost


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"level": "good"}, "level = 'good' is unknown"),
        ({"level": "mixed", "episodes": 2}, "episodes = 2 is out of range"),
        ({"noise": 1.5}, "noise = 1.5 is out of range"),
    ],
)
def test_wrong_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        DatasetConfig(**settings)


def test_policies_share_the_episodes():
    assert DatasetConfig(level="mixed", episodes=8).shares == dict(zip(LEVELS["mixed"], (3, 3, 2), strict=True))
    assert DatasetConfig(level="medium", condition="loads").name == "fuzzyarm/medium-loads-v0"


def test_without_minari_the_extra_is_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "minari", None)
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert '".[datasets]"' in refused(capsys, "dataset", "--out", tmp_path / "sets")
    assert not (tmp_path / "sets").exists()


@pytest.fixture
def minari():
    pytest.importorskip("h5py")
    return pytest.importorskip("minari")


@pytest.mark.slow
def test_minari_loads_what_the_command_wrote(minari, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path.parent)
    words = ["dataset", "--out", tmp_path.name, "--level", "mixed", "--episodes", "3", "--seed", "4"]
    assert "3 episodes" in printed(capsys, *words)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    name, policies = DatasetConfig(level="mixed").name, LEVELS["mixed"]
    assert list(minari.list_local_datasets()) == [name]
    dataset = minari.load_dataset(name)
    for seed, (policy, found) in enumerate(zip(policies, dataset, strict=True), 4):
        (expected,) = record(load_policy(policy), "nominal", 1, seed, 0.02)
        for signal in ("observations", "actions", "rewards"):
            assert_array_equal(getattr(found, signal), getattr(expected, signal))
        assert_array_equal(found.infos["intended_action"], expected.intended)
        assert (found.truncations[-1], found.terminations[-1]) == (expected.completed, not expected.completed)
    (best,) = record(load_policy("learned-observer"), "nominal", 1, 0)  # all nominal episodes without noise are alike
    assert minari.get_normalized_score(dataset, np.array([best.rewards.sum()])) == pytest.approx(1.0)
    assert dataset.recover_environment().observation_space == dataset.observation_space
    own = provenance_of(open_dataset(tmp_path / name))
    assert own["settings"]["seed"] == 4 and list(own["policies"]) == list(policies)
    assert "already exists" in refused(capsys, *words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fuzzyarm"]


@pytest.mark.slow
def test_stored_episodes_are_in_the_declared_spaces_and_give_themselves_again_bit_for_bit(minari, tmp_path):
    settings = DatasetConfig(level="medium", condition="loads", episodes=2, seed=7)
    dataset = open_dataset(store.write_dataset(settings, tmp_path))
    env = dataset.recover_environment()
    assert dataset.action_space == env.action_space and env.action_space.dtype == np.float32
    for stored, metadata in zip(dataset, dataset.storage.get_episode_metadata([0, 1]), strict=True):
        assert all(map(dataset.action_space.contains, stored.actions))
        assert all(map(dataset.observation_space.contains, stored.observations))
        _, terminated, truncated = assert_given_again(env, metadata["seed"], stored)
        assert (terminated[-1], truncated[-1]) == (stored.terminations[-1], stored.truncations[-1])
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("script", ["clone_policy.py", "offline_td3_bc.py"])
def test_the_examples_learn_from_a_data_set(script, minari, tmp_path):
    folder = store.write_dataset(DatasetConfig(level="medium", episodes=1), tmp_path)
    command = [sys.executable, "-W", "error", str(EXAMPLES / script), str(folder), "--seconds", "0.5"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"N \S+, mean tip error \S+ mm, [01] of 1 episodes to the end", done.stdout)
