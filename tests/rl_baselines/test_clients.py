"""``FuzzyArmLearn-v0`` passes the checkers of the libraries that learn it, and their pages run.

The libraries come with the extra ``clients``: ``python -m pytest -m slow tests/rl_baselines/test_clients.py``. For
CleanRL's own script, install tyro and tensorboard, and name the file: ``FUZZYARM_CLEANRL=ppo_continuous_action.py``.
"""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from fuzzyarm import ArmParameters
from fuzzyarm.policies._onnx_model import OnnxPolicy
from fuzzyarm.rl_baselines._case_evaluation import evaluate_cases
from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnEnv, FuzzyArmLearnVectorEnv

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"


def test_the_loop_of_cleanrl_finds_the_ended_episodes_of_the_batch():
    envs = gym.wrappers.vector.RecordEpisodeStatistics(gym.make_vec("fuzzyarm:FuzzyArmLearn-v0", num_envs=4))
    envs.action_space.seed(0)
    envs.reset(seed=0)
    returns, earned, ended = [], np.zeros(4), []
    for _ in range(100):
        _, reward, terminated, truncated, infos = envs.step(envs.action_space.sample())
        earned += reward
        if "final_info" in infos:
            over = np.nonzero(infos["_episode"])[0]
            assert over.tolist() == np.nonzero(terminated | truncated)[0].tolist()
            returns += infos["episode"]["r"][over].tolist()
            ended += earned[over].tolist()
            earned[over] = 0.0
    assert ended and returns == pytest.approx(ended, rel=1e-5)


@pytest.mark.slow
@pytest.mark.skipif("FUZZYARM_CLEANRL" not in os.environ, reason="FUZZYARM_CLEANRL does not name CleanRL's script")
def test_cleanrls_own_script_trains_with_the_lines_of_the_page(tmp_path):
    page = (ROOT / "docs/tutorials/train.md").read_text(encoding="utf-8")
    making, ended = re.search(r"```python\n(    envs = .*?\n)\n(.*?\n)```", page, re.DOTALL).groups()
    script = Path(os.environ["FUZZYARM_CLEANRL"]).read_text(encoding="utf-8")
    script, made = re.subn(r"    envs = gym\.vector\.SyncVectorEnv\(.*?\n    \)\n", making, script, flags=re.DOTALL)
    script, told = re.subn(r"( +episod\w+ = .*final_info.*\n){3}", ended, script)
    assert (made, told) == (1, 1)
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    command = [sys.executable, "script.py", "--num-envs", "64", "--num-steps", "32", "--total-timesteps", "20000"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "episodic_return=" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("mode", [None, "SameStep", "Disabled"])
def test_torchrl_finds_nothing_wrong(mode):
    torchrl = pytest.importorskip("torchrl.envs")
    env = FuzzyArmLearnEnv() if mode is None else FuzzyArmLearnVectorEnv(3, autoreset_mode=mode)
    wrapped = torchrl.GymWrapper(env)
    torchrl.check_env_specs(wrapped)
    rollout = wrapped.rollout(300, break_when_any_done=False)
    assert rollout.shape == (300,) if mode is None else (3, 300)
    assert rollout["next", "done"].any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "library", "words"),
    [
        ("train_torchrl", "torchrl", "250000"),
        ("torchrl_tensors", "torchrl", ""),
        ("train_rsl_rl", "rsl_rl", "1800000"),
        ("train_rsl_rl", "rsl_rl", "12288 --device cpu"),
    ],
)
def test_the_pages_of_other_libraries_run(script, library, words, tmp_path):
    """A minute of training makes a policy that follows the nominal circle; fewer steps only show that the page runs."""
    pytest.importorskip(library)
    command = [sys.executable, str(EXAMPLES / f"{script}.py"), *words.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    for file in tmp_path.glob("*.onnx"):
        policy = OnnxPolicy(file, ArmParameters(), 1e-3)
        assert words.endswith("cpu") or evaluate_cases(policy)["nominal_rms_mm"] < 10.0


@pytest.mark.slow
def test_torchrl_is_shown_the_episodes_of_the_tensors(monkeypatch):
    pytest.importorskip("torchrl")
    monkeypatch.syspath_prepend(EXAMPLES)
    page = importlib.import_module("torchrl_tensors")
    arms, twin = page.Arms(3), page.TorchFuzzyArmLearn(3, compiled=False)
    arms.set_seed(7)
    rollout, (seen, _) = arms.rollout(300, break_when_any_done=False), twin.reset(seed=7)
    for step in rollout.unbind(1):
        assert torch.equal(step["observation"], seen)
        seen, reward, terminated, truncated, info = twin.step(step["action"])
        for name, number in (("terminated", terminated), ("truncated", truncated), ("reward", reward)):
            assert torch.equal(step["next", name][:, 0], number)
        assert torch.equal(step["next", "observation"], info["final_obs"])
    assert rollout["next", "done"].any()
