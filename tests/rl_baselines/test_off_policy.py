"""SAC and TQC through the one trainer: settings, exact resume, bundles that act as the model does, refusals."""

import dataclasses
import inspect

import numpy as np
import pytest

torch = pytest.importorskip("torch")
sb3 = pytest.importorskip("stable_baselines3")
from support.trainings import resumed_to_the_bit  # noqa: E402

from fuzzyarm.cli import main  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle  # noqa: E402
from fuzzyarm.rl_baselines.algorithms import ALGORITHMS  # noqa: E402
from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig  # noqa: E402
from fuzzyarm.rl_baselines.algorithms.sac import PRESETS, SACConfig  # noqa: E402
from fuzzyarm.rl_baselines.algorithms.tqc import TQCConfig  # noqa: E402
from fuzzyarm.rl_baselines.checkpoint import CheckpointError, read_checkpoint, write_checkpoint  # noqa: E402
from fuzzyarm.rl_baselines.config import TrainingConfig  # noqa: E402
from fuzzyarm.rl_baselines.training import CHECKPOINT, Training  # noqa: E402

pytestmark = pytest.mark.usefixtures("brief_evaluations")

SMALL = {
    "total_timesteps": 120,
    "lanes": 3,
    "train_freq": 4,
    "gradient_steps": 2,
    "learning_starts": 20,
    "batch_size": 8,
    "buffer_size": 60,  # of which the training fills more: the oldest transitions are replaced
    "hidden": (8,),
    "evaluation_interval": 120,
    "checkpoint_interval": 36,
    "tensorboard": False,
}
KINDS = [SACConfig(**SMALL), SACConfig(**SMALL, activation="tanh", ent_coef=0.01)]


def check(config, folder):
    whole = resumed_to_the_bit(config, folder, 84)
    network = PolicyBundle.load(folder / "whole" / "policy").network
    assert (network.activation, network.output) == (config.activation, "tanh")
    features = 3.0 * np.random.default_rng(0).normal(size=(50, network.sizes[0]))
    action, model = np.empty((50, 2)), whole.algorithm
    network.act(features, action)
    expected, _ = model.model.predict(model.normaliser.normalize_obs(features), deterministic=True)
    np.testing.assert_allclose(action, expected, atol=2e-6)
    assert np.ptp(action) > 0.1
    rows = (folder / "whole" / "curve.csv").read_text().splitlines()
    assert "critic_loss" in rows[0] and rows[-1].startswith("120,")


@pytest.mark.parametrize("config", [KINDS[0], pytest.param(KINDS[1], marks=pytest.mark.slow)], ids=["relu", "tanh"])
def test_sac_resumes_to_the_bit_and_its_bundle_acts_as_it_does(config, tmp_path):
    check(config, tmp_path)


@pytest.mark.slow
def test_tqc_resumes_to_the_bit_and_its_bundle_acts_as_it_does(tmp_path):
    pytest.importorskip("sb3_contrib")
    check(TQCConfig(**SMALL, n_quantiles=5), tmp_path)


def test_settings_have_the_names_of_the_libraries():
    own = {field.name for field in dataclasses.fields(SACConfig)} - {f.name for f in dataclasses.fields(TrainingConfig)}
    assert own - set(inspect.signature(sb3.SAC.__init__).parameters) == {"activation", "final_learning_rate"}
    assert next(iter(PRESETS.values())) == SACConfig()
    assert {"ppo", "sac", "tqc"} <= set(ALGORITHMS)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"activation": "elu"}, "activation = 'elu' is unknown; choose from: tanh, relu"),
        ({"buffer_size": 2}, "buffer_size = 2 is out of range; allowed: lanes = 16 to "),
        ({"buffer_size": 10**9}, "buffer_size = 1000000000 is out of range; allowed: lanes = 16 to .* features"),
        ({"tau": 0.0}, r"tau = 0.0 is out of range; allowed: \(0, 1\]"),
        ({"final_learning_rate": 1.0}, "final_learning_rate = 1.0 is out of range"),
        ({"target_entropy": "auto"}, "target_entropy = 'auto' must be a real number"),
    ],
)
def test_what_is_wrong_is_named_with_what_is_allowed(values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        SACConfig(**values)


def test_quantiles_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match="top_quantiles_to_drop_per_net = 25 is out of range; allowed: 0 to 24"):
        TQCConfig(top_quantiles_to_drop_per_net=25)


@pytest.fixture(scope="module")
def begun(tmp_path_factory, brief_evaluations):
    """The folder of a training with SAC."""
    folder = tmp_path_factory.mktemp("begun") / "run"
    Training(KINDS[0], folder).run()
    return folder


def refused(capsys, *words):
    assert main(["train", *map(str, words)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_a_run_resumes_with_its_own_algorithm_and_settings_only(begun, tmp_path, capsys):
    assert "holds a training with sac, not ppo: fuzzyarm train sac" in refused(
        capsys, "ppo", "--resume", "--out", begun, "--total-timesteps", 240
    )
    assert "leave out --tau" in refused(capsys, "sac", "--resume", "--out", begun, "--tau", 0.1)
    Training(PPOConfig(total_timesteps=128, lanes=2, batch_size=64, tensorboard=False), tmp_path)._write_checkpoint()
    assert "with ppo, not tqc" in refused(capsys, "tqc", "--resume", "--out", tmp_path)


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (("counters", "position"), 20, "position = 20 is out of range"),
        (("counters", "full"), 1, "full = 1 is of another kind"),
        (("buffer", "rewards"), torch.zeros(3, 3), r"rewards is torch.float32 \(3, 3\)"),
        (("buffer", "rewards"), torch.full((20, 3), torch.nan), "not finite"),
        (("entropy", "log_ent_coef"), torch.zeros(2), "log_ent_coef is"),
        (("optimizers", "entropy"), {}, "other names"),
    ],
)
def test_a_crafted_checkpoint_is_refused(begun, tmp_path, where, value, message):
    content = read_checkpoint(begun / CHECKPOINT)
    part, name = where
    content["learner"][part][name] = value
    write_checkpoint(tmp_path / CHECKPOINT, content)
    with pytest.raises(CheckpointError, match=message):
        Training.resume(tmp_path)
