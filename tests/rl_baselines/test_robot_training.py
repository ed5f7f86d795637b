"""Training for any robot: its scales, what it starts from, and that what it ships acts on the robot."""

import json

import numpy as np
import pytest

from fuzzyarm import ArmParameters, load_policy, robot_named
from fuzzyarm.cli import main
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ArmDefinition
from fuzzyarm.rl_baselines._checkpoint import CheckpointError
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
from fuzzyarm.rl_baselines.training import Training, default_scale

SIZES = {"total-timesteps": 256, "lanes": 4, "n-steps": 32, "batch-size": 64, "n-epochs": 1, "hidden": 8}
SHORT = [word for name, value in SIZES.items() for word in (f"--{name}", str(value))]


def test_default_scales_follow_from_the_arm():
    ur5 = robot_named("ur5")
    np.testing.assert_allclose(default_scale(ur5, base=False), ur5.drive("torque_limit"))
    assert default_scale(ur5, base=True) == (0.01,) * 6
    assert len(default_scale(ArmParameters(), base=True)) == 2


def test_a_configuration_names_its_arm_only_if_it_is_another():
    assert "robot" not in PPOConfig().to_dict()
    config = PPOConfig(robot="ur5", scale=(1.0,) * 6)
    assert PPOConfig.from_dict(config.to_dict()) == config and config.features.joints == 6
    with pytest.raises(TypeError, match="robot"):
        PPOConfig(robot=6)


@pytest.mark.usefixtures("brief_evaluations")
def test_a_run_of_a_changed_robot_is_not_resumed(tmp_path, monkeypatch):
    """The file is read again: another arm is refused, the same one in other words is not."""
    monkeypatch.setattr("fuzzyarm.rl_baselines.learning_task._REFERENCES", 8)
    toml = tmp_path / "arm.toml"
    toml.write_text("stiffness = [4e4, 3e4]\n")
    folder = tmp_path / "run"
    config = PPOConfig(robot=str(toml), total_timesteps=128, lanes=2, n_steps=64, batch_size=64, hidden=(8,))
    Training(config, folder).run()
    toml.write_text("stiffness = [4e4, 3.1e4]\n")
    with pytest.raises(CheckpointError, match=r"a different arm.*arm\.toml"):
        Training.resume(config, folder)
    toml.write_text("# as before\nstiffness = [40000, 30000]\n")
    assert Training.resume(config, folder).algorithm.steps == 128


@pytest.mark.slow
def test_a_training_ships_a_policy_of_the_robot_and_goes_on(tmp_path):
    words = ["train", "ppo", "--robot", "planar-3r", "--base", "computed-torque-tip", "--elastic-target"]
    assert main([*words, *SHORT, "--out", str(tmp_path / "whole")]) == 0
    half = ["128" if word == "256" else word for word in SHORT]
    assert main([*words, *half, "--out", str(tmp_path / "parts")]) == 0
    assert main([*words, *SHORT, "--out", str(tmp_path / "parts")]) == 0
    whole, parts = (PolicyBundle.load(tmp_path / name / "policy") for name in ("whole", "parts"))
    assert whole.arm == ArmDefinition("planar-3r", robot_named("planar-3r").digest)
    assert json.loads((tmp_path / "whole" / "policy" / "policy.json").read_text())["training"]["robot"] == "planar-3r"
    assert [row["steps"] for row in parts.curve][-1] == 256
    policy = load_policy(tmp_path / "whole" / "policy", robot="planar-3r")
    torque, _ = policy.predict(np.zeros((5, 15)))
    assert torque.shape == (5, 3) and np.isfinite(torque).all()
    command = ["evaluate", "--robot", "planar-3r", "--policy", str(tmp_path / "whole" / "policy")]
    assert main([*command, "--case", "nominal", "--out", str(tmp_path / "evaluation")]) in (0, 1)
