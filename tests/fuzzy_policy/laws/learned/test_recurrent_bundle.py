"""Recurrent bundles: the cell's equations, the folder, the memory of every lane, and what is refused."""

import dataclasses
import json

import numpy as np
import pytest
from support.bundles import bundle

from fuzzyarm.fuzzy_policy.laws.learned.bundle import BundleError, PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.network import Cell
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy

HIDDEN = 3


def recurrent(seed=0):
    """A bundle with a random cell in front of two layers."""
    rng, made = np.random.default_rng(seed), bundle()
    inputs = made.features.size

    def random(*shape):
        return rng.normal(size=shape).astype(np.float32)

    cell = Cell(random(4 * HIDDEN, inputs), random(4 * HIDDEN, HIDDEN), random(4 * HIDDEN))
    layers = {"weights": (random(5, HIDDEN), random(2, 5)), "biases": (random(5), random(2))}
    return dataclasses.replace(made, network=dataclasses.replace(made.network, cell=cell, **layers))


def oracle(network, features, h, m):
    """One lane of the network as the textbook has it; returns action, h and m."""
    x, cell = np.clip((features - network.mean) / network.std, -network.clip, network.clip), network.cell
    i, r, g, o = np.split(cell.weight_x @ x + cell.weight_h @ h + cell.bias, 4)

    def sigma(a):
        return 1.0 / (1.0 + np.exp(-a))

    m = sigma(r) * m + sigma(i) * np.tanh(g)
    h = sigma(o) * np.tanh(m)
    y = np.tanh(network.weights[0] @ h + network.biases[0])
    return np.clip(network.weights[1] @ y + network.biases[1], -1.0, 1.0), h, m


def test_it_is_the_textbooks_memory_before_the_layers_also_after_a_way_through_the_folder(tmp_path):
    made = recurrent()
    made.save(tmp_path / "policy")
    network = PolicyBundle.load(tmp_path / "policy").network
    assert (network.sizes, network.memory_size) == ((made.features.size, HIDDEN, 5, 2), 2 * HIDDEN)
    rng, memory, action = np.random.default_rng(1), np.zeros((2, 2 * HIDDEN)), np.empty((2, 2))
    expected = [(np.zeros(HIDDEN), np.zeros(HIDDEN))] * 2
    for _ in range(4):
        features = rng.normal(size=(2, network.sizes[0]))
        network.act(features, action, memory)
        found = [oracle(made.network, row, *past) for row, past in zip(features, expected, strict=True)]
        np.testing.assert_allclose(action, [a for a, _, _ in found], rtol=1e-12, atol=1e-13)
        expected = [(h, m) for _, h, m in found]
    np.testing.assert_allclose(memory, [np.concatenate(pair) for pair in expected], rtol=1e-12, atol=1e-13)
    assert np.ptp(action) > 0.05


def test_every_lane_has_a_memory_of_its_own_which_begins_with_its_episode():
    policy, rng = LearnedPolicy(recurrent(), 2e-3), np.random.default_rng(2)
    shown = 0.3 * rng.normal(size=(6, 3, 10))
    state, alone = None, None
    for k, observation in enumerate(shown):
        torque, state = policy.predict(observation, state, np.array([False, k == 3, False]))
        if k >= 3:
            single, alone = policy.predict(observation[1], alone)
            assert np.array_equal(single, torque[1]) and np.array_equal(alone, state[1])
    assert not np.array_equal(state[0], state[1])


def test_another_network_is_refused(tmp_path):
    recurrent().save(tmp_path / "policy")
    path = tmp_path / "policy" / "policy.json"
    content = json.loads(path.read_text())
    for change, message in (
        ({"cell": "gru"}, "cell = 'gru' is unknown; choose from: none, lstm"),
        ({"cell": "none"}, "needed: layer0.weight, layer0.bias"),
        ({"sizes": [20, 5, 2]}, "policy.json says"),
    ):
        path.write_text(json.dumps(content | {"network": content["network"] | change}))
        with pytest.raises(BundleError, match=message):
            PolicyBundle.load(tmp_path / "policy")
    for shapes, message in (
        (((12, 4), (12, 4), (12,)), "weight_x has shape"),
        (((12, 4), (12,), (12,)), "weight_h has 1 axes; needed: 2"),
        (((0, 4), (0, 0), (0,)), "0 columns; allowed: 1 to 1024"),
    ):
        with pytest.raises(ValueError, match=message):
            Cell(*(np.zeros(shape) for shape in shapes))
