"""The settings of a training with PPO: presets, what is refused, and the names of stable-baselines3."""

import dataclasses
import inspect
import math
import re
import subprocess
import sys

import pytest
import stable_baselines3 as sb3
from support.command_line import without_progress

from fuzzyarm.cli import main
from fuzzyarm.cli._commands import train
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.laws.learned.definition import learning_features
from fuzzyarm.fuzzy_policy.laws.learned.features import learning_action
from fuzzyarm.rl_baselines.algorithms.ppo import PRESETS, PPOConfig
from fuzzyarm.rl_baselines.config import TrainingConfig

OWN = {field.name for field in dataclasses.fields(PPOConfig)} - {f.name for f in dataclasses.fields(TrainingConfig)}


def test_the_defaults_are_the_registered_task():
    arm, config = ArmParameters(), PPOConfig()
    assert config.features == learning_features(2) and config.action == learning_action(arm)
    past = dataclasses.replace(config, past_errors=3, past_actions=3, integral_time=0.1)
    assert past.features == learning_features(2, history=3)


def test_settings_have_the_names_of_stable_baselines3():
    theirs = {*inspect.signature(sb3.PPO.__init__).parameters, "log_std_init"}  # the last is of its policies
    assert OWN - theirs == {"final_learning_rate", "asymmetric_critic", "smoothness"}
    assert {"n_steps", "n_epochs", "ent_coef", "vf_coef", "max_grad_norm"} <= OWN


def test_settings_and_presets_can_be_read_without_torch():
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"
        "from fuzzyarm.rl_baselines.algorithms import ALGORITHMS\n"
        "print(list(ALGORITHMS['ppo'].presets), 'llvmlite' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['robust', 'nominal', 'residual'] False"


@pytest.mark.parametrize("config", PRESETS.values(), ids=PRESETS)
def test_a_configuration_survives_json(config):
    assert PPOConfig.from_dict(config.to_dict()) == config
    with pytest.raises(ValueError, match="the configuration lacks: lanes"):
        PPOConfig.from_dict({name: value for name, value in config.to_dict().items() if name != "lanes"})
    with pytest.raises(ValueError, match="unknown field rollout"):
        PPOConfig.from_dict(config.to_dict() | {"rollout": 64})


REFUSED = [
    ({"total_timesteps": 4.5}, "total_timesteps = 4.5 must be a whole number"),
    ({"lanes": -1}, "lanes = -1 is out of range; allowed: 1 to 65536"),
    ({"gamma": math.nan}, r"gamma = nan is out of range; allowed: \[0, 1\]"),
    ({"learning_rate": 0.0}, r"learning_rate = 0.0 is out of range; allowed: \(0, inf\)"),
    (
        {"final_learning_rate": 1.0},
        r"final_learning_rate = 1.0 is out of range; allowed: \[0, 0.0003\]",
    ),
    ({"batch_size": 100}, "batch_size = 100 must divide lanes times n_steps = 2048"),
    ({"scale": (1.0, 0.0)}, r"scale\[1\] = 0.0 N m is out of range; allowed: \(0, inf\)"),
    ({"scale": ()}, "number of scales = 0 is out of range"),
    ({"hidden": (64, 0)}, "hidden = 0 is out of range"),
    ({"distribution": "other"}, "distribution = 'other' is unknown; choose from: nominal, robust"),
    ({"action_period": 1.0}, r"action_period = 1.0 s is out of range; allowed: \(0, 0.1\] s"),
    ({"base": "fuzzy-4"}, r"scale\[0\] = 500.0 rad is out of range; allowed: \(0, 0.5\] rad"),
    ({"base": ""}, "base = ''"),
    ({"smoothness": 1.0, "ent_coef": 0.1}, "smoothness = 1.0 and ent_coef = 0.1: at least one must be 0"),
    ({"integral_time": math.inf}, "integral_time = inf s is out of range"),
]


@pytest.mark.parametrize(("values", "message"), REFUSED, ids=[str(values) for values, _ in REFUSED])
def test_what_is_wrong_is_named_with_what_is_allowed(values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        PPOConfig(**values)


@pytest.fixture
def chosen(monkeypatch, tmp_path):
    """What a command line asks for; nothing is trained."""
    found = []
    monkeypatch.setattr(train, "train_with_progress", lambda config, *_: found.append(config))

    def call(*words):
        assert main(["train", "ppo", *map(str, words), "--out", str(tmp_path)]) == 0
        return found[-1]

    return call


def test_without_options_a_training_has_the_first_preset(chosen):
    assert chosen() == PRESETS["robust"] == PPOConfig()
    assert {name: chosen("--preset", name) for name in PRESETS} == PRESETS


def test_an_option_changes_that_of_the_preset_alone(chosen):
    words = "--seed", 5, "--total-timesteps", "4e6", "--evaluation-interval", "4_000"
    changed = {"seed": 5, "total_timesteps": 4_000_000, "evaluation_interval": 4000}
    assert chosen("--preset", "nominal", *words) == dataclasses.replace(PRESETS["nominal"], **changed)


BAD = {
    "--total-timesteps 4.5": "--total-timesteps 4.5 must be a whole number",
    "--scale x 0": "--scale x must be a number",
    "--distribution other": '"nominal", "robust"',
    "--preset other": "--preset other is unknown; choose from: robust, nominal, residual",
    "--batch-size 100": "batch_size = 100 must divide lanes times n_steps = 2048",
    "--robot ur55": "unknown robot 'ur55'",
    "--robot ur5 --scale 1 2": "must be 6 numbers",
    "--robot ur5 --base fuzzy-4": "fuzzy-4",
    "--base mine.json --scale 0.01 0.02": "is not the name of",
    "--robot missing.toml": "missing.toml",
    "--action-period 0.0015": "which is not a whole multiple of control_period",
}


@pytest.mark.parametrize(("flags", "message"), BAD.items(), ids=BAD)
def test_on_the_command_line_that_is_one_line_and_exit_code_2(flags, message, tmp_path, capsys):
    assert main(["train", "ppo", *flags.split(), "--out", str(tmp_path / "run")]) == 2
    shown = capsys.readouterr()
    lines = [line for line in without_progress(shown.err).splitlines() if line]
    assert not shown.out and len(lines) == 1
    assert re.search(message, lines[0])
