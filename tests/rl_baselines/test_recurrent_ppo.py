"""Recurrent PPO through the one trainer: exact resume, a bundle that acts as the model does, refusals."""

import dataclasses
import inspect

import numpy as np
import pytest

torch = pytest.importorskip("torch")
sb3_contrib = pytest.importorskip("sb3_contrib")
from support.trainings import resumed_to_the_bit  # noqa: E402

from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle  # noqa: E402
from fuzzyarm.rl_baselines.algorithm import OnPolicyConfig  # noqa: E402
from fuzzyarm.rl_baselines.algorithms.recurrent_ppo import PRESETS, RecurrentPPOConfig  # noqa: E402
from fuzzyarm.rl_baselines.checkpoint import CheckpointError, read_checkpoint, write_checkpoint  # noqa: E402
from fuzzyarm.rl_baselines.training import CHECKPOINT, Training  # noqa: E402

SMALL = RecurrentPPOConfig(
    total_timesteps=96,
    lanes=3,
    n_steps=8,
    batch_size=12,
    n_epochs=2,
    lstm_hidden_size=5,
    hidden=(8,),
    learning_rate=0.03,
    distribution="robust",
    references=3,
    circles=1,
    past_errors=0,
    past_actions=0,
    evaluation_interval=96,
    checkpoint_interval=24,
    tensorboard=False,
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A training run through, which one that was stopped and resumed equals to the bit."""
    return resumed_to_the_bit(SMALL, tmp_path_factory.mktemp("recurrent"), 48)


@pytest.mark.slow
def test_the_bundle_acts_as_the_model_does_step_by_step_and_from_zero_when_an_episode_begins(trained):
    network, algorithm = PolicyBundle.load(trained.folder / "policy").network, trained.algorithm
    rng, state, memory = np.random.default_rng(0), None, np.zeros((4, network.memory_size))
    actions = []
    for k in range(12):
        features = 3.0 * rng.normal(size=(4, network.sizes[0]))
        begins = np.full(4, k == 7)
        memory[begins] = 0.0
        action = np.empty((4, 2))
        network.act(features, action, memory)
        seen = algorithm.normaliser.normalize_obs(features).astype(np.float32)
        expected, state = algorithm.model.predict(seen, state, begins, deterministic=True)
        np.testing.assert_allclose(action, expected, atol=2e-6)
        actions.append(action)
    assert np.ptp(actions) > 0.1


@pytest.mark.slow
def test_a_crafted_memory_is_refused(trained, tmp_path):
    content = read_checkpoint(trained.folder / CHECKPOINT)
    for value, message in ((torch.zeros(1, 3, 6), "policy_h is"), (torch.full((1, 3, 5), torch.nan), "not finite")):
        content["learner"]["memories"]["policy_h"] = value
        write_checkpoint(tmp_path / CHECKPOINT, content)
        with pytest.raises(CheckpointError, match=message):
            Training.resume(tmp_path)


def test_settings_have_the_names_of_the_library_and_presets_stand():
    own = {field.name for field in dataclasses.fields(RecurrentPPOConfig)}
    theirs = inspect.signature(sb3_contrib.common.recurrent.policies.RecurrentActorCriticPolicy.__init__).parameters
    assert own - {field.name for field in dataclasses.fields(OnPolicyConfig)} == {"lstm_hidden_size"} <= set(theirs)
    assert list(PRESETS) == ["nominal", "robust"]
    with pytest.raises(ValueError, match="lstm_hidden_size = 0 is out of range; allowed: 1 to 512"):
        dataclasses.replace(SMALL, lstm_hidden_size=0)
