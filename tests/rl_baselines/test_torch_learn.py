"""``FuzzyArmLearn-v0`` in tensors: the numbers of the NumPy batch, and what learners ask of it."""

import pickle

import numpy as np
import pytest
import torch

from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnVectorEnv
from fuzzyarm.rl_baselines.torch_learn import TorchFuzzyArmLearn

LANES = 4


@pytest.mark.parametrize(("history", "dtype", "close"), [(2, "float64", 1e-6), (0, "float32", 2e-2)])
def test_lanes_are_those_of_the_numpy_batch(history, dtype, close):
    tensors = TorchFuzzyArmLearn(LANES, history=history, dtype=getattr(torch, dtype), compiled=False)
    arrays, rng, ends = FuzzyArmLearnVectorEnv(LANES, history=history), np.random.default_rng(0), 0
    (seen, _), (expected, _) = tensors.reset(seed=5), arrays.reset(seed=5)
    assert tensors.observation_space == arrays.observation_space and tensors.action_space == arrays.action_space
    for _ in range(100):
        assert seen.dtype == torch.float32
        np.testing.assert_allclose(seen, expected, atol=close)
        action = rng.uniform(-0.4, 0.4, (LANES, 2)) + 0.3
        seen, reward, *flags, info = tensors.step(torch.tensor(action))
        expected, earned, *theirs, their_info = arrays.step(action)
        assert [flag.tolist() for flag in flags] == [flag.tolist() for flag in theirs]
        np.testing.assert_allclose(reward, earned, atol=close)
        for lane in np.flatnonzero(theirs[0] | theirs[1]):
            ends += 1
            np.testing.assert_allclose(info["final_obs"][lane], their_info["final_obs"][lane], atol=close)
            assert bool(info["lost"][lane]) == (
                their_info["final_info"]["reason"][lane] == "the tip lost its reference"
            )
    assert ends  # of which the lane begins another


def test_a_pickled_batch_goes_on_where_it_was():
    envs, action = TorchFuzzyArmLearn(2, history=1, compiled=False), torch.full((2, 2), 0.2)
    envs.reset(seed=0)
    envs.step(action)
    twin = pickle.loads(pickle.dumps(envs))
    for _ in range(5):
        for ours, theirs in zip(envs.step(action)[:4], twin.step(action)[:4], strict=True):
            assert torch.equal(ours, theirs)
    envs.close()


def test_wrong_arguments_are_named():
    for arguments, message in (({"history": -1}, "history = -1"), ({"early_end": 0.0}, "early_end = 0")):
        with pytest.raises(ValueError, match=message):
            TorchFuzzyArmLearn(1, compiled=False, **arguments)
    envs = TorchFuzzyArmLearn(2, compiled=False)
    with pytest.raises(ValueError, match="has no reset options"):
        envs.reset(options={"case": "payload"})
    envs.reset()
    with pytest.raises(ValueError, match=r"action has shape \(2, 3\)"):
        envs.step(torch.zeros(2, 3))
