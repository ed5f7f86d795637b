"""A bundle is read back as it was written, or refused in one line; a recurrent network."""

import dataclasses
import json
import os

import numpy as np
import pytest
from safetensors.numpy import save
from scipy.special import expit
from support.bundles import answering, bundle, edited, estimate_network, resealed, robot_bundle
from support.policies import answers
from support.results import identical

from fuzzyarm import ArmParameters, load_policy, robot_named
from fuzzyarm.fuzzy_policy.laws.learned.bundle import _LARGEST_DESCRIPTION as LARGEST
from fuzzyarm.fuzzy_policy.laws.learned.bundle import BundleError, PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.estimate.rnn import EstimateBundle
from fuzzyarm.fuzzy_policy.laws.learned.network import Cell
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy

HIDDEN, ROBOT = 3, robot_named("planar-3r")
ROBOTS_ENTRY = {"name": ROBOT.name, "digest": ROBOT.digest}


def test_a_bundle_comes_back_bit_for_bit(tmp_path):
    first, folder = bundle(), tmp_path / "mine"
    first.save(folder)
    second = PolicyBundle.load(folder)
    for name in ("features", "action", "training", "seed", "curve", "versions"):
        assert getattr(first, name) == getattr(second, name)
    for name in ("clip", "mean", "std", "weights", "biases"):
        assert identical(getattr(first.network, name), getattr(second.network, name))
    assert sorted(path.name for path in folder.iterdir()) == ["policy.json", "weights.safetensors"]
    assert json.loads((folder / "policy.json").read_text())["network"]["activation"] == "tanh"


def written(name, content):
    return lambda folder: (folder / name).write_bytes(content)


DAMAGES = (
    (lambda f: (f / "weights.safetensors").unlink(), "weights.safetensors: No such file"),
    (lambda f: os.truncate(f / "weights.safetensors", 300), "sha256 differs"),
    (written("policy.json", b"\xff\xfe\x00"), "policy.json: the content cannot be read as JSON"),
    (written("policy.json", b"[" * 10**5), "policy.json: .*nested too deeply"),
    (written("policy.json", b" " * (LARGEST + 1)), "policy.json(:| is) larger than"),
    (edited(schema="x/2"), "the schema is 'x/2'; this version of fuzzyarm"),
    (edited(seed="gone"), "missing required field `seed`"),
    (edited(run="rm"), "unknown field run"),
    (edited("network", mean=["1"] * 20), r"Expected `float`, got .* at `network\.mean"),
    (edited("network", std=[float("nan")] * 20), "NaN is not a JSON number"),
    (edited("network", std=[0.0] * 20), "std, .*, must contain only positive numbers"),
    (edited("network", mean=[0.0] * 19), r"std has shape \(20,\); allowed: \(19,\)"),
    (edited("network", sizes=[20, 2]), r"policy.json says \[20, 2\]"),
    (edited("network", activation="elu"), "activation = 'elu' is unknown"),
    (edited("network", output="sine"), "output = 'sine' is unknown"),
    (edited("features", past_errors=9), "has 20 inputs"),
    (edited("action", scale=[-1, 2]), "scale"),
    (edited("action", gate=1.0), "unknown field gate"),
    (edited("features", innovation_times=[0.1]), "unknown field innovation_times"),
    (edited(curve="up"), "Expected `array`, got `str` at `curve"),
    (resealed(**{"layer0.bias": np.full(16, np.inf, np.float32)}), "layer 0: bias contains numbers that are not fin"),
    (resealed(**{"layer0.bias": np.zeros(16)}), "layer0.bias has type float64"),
    (resealed(**{"layer1.weight": np.zeros((8, 15), np.float32)}), r"layer 1: weight has shape \(8, 15\)"),
    (resealed(save({"w": np.zeros(3, np.float32)})), r"has the arrays \(w\); needed"),
    (resealed(b"\x80\x04."), "weights.safetensors is damaged"),
)
DAMAGES_OF_A_ROBOTS = (  # a bundle for planar-3r
    (edited(arm="gone"), "arm is missing; only a policy for the default arm"),
    (edited("features", joints=2), "features.joints = 2, but action.scale is for 3 joint"),
    (edited("features", joints=13), "joints = 13 is out of range"),
    (edited("arm", digest=7), r"at `arm.digest`"),
    (edited("arm", more=7), "unknown field more"),
    (edited("action", scale=[1.0] * 13), "number of scales = 13"),
)


DAMAGES_OF_AN_OBSERVERS = (
    (edited(schema="fuzzyarm-learned-observer/3"), "fuzzyarm reads 'fuzzyarm-learned-observer/4'; train"),
    (resealed(X=np.zeros(3, np.float32)), "needed: A, B, C"),
    (resealed(A=np.zeros((7, 3), np.float32)), r"the arrays A \(.*\) and V \(.*\) fit no arm"),
    (resealed(D=np.full((2, 26), np.nan, np.float32)), "D"),
    (edited(parameters={"mass": [-1.0, 2.0]}), "mass"),
    (edited(control_period=5.0), "control_period"),
    (edited(arm=ROBOTS_ENTRY), "exactly one of the entries 'parameters' and 'arm' must be given"),
)
OBSERVER = EstimateBundle(estimate_network(), ArmParameters(), 1e-3)
BUNDLES = ((bundle(), DAMAGES), (robot_bundle(ROBOT), DAMAGES_OF_A_ROBOTS), (OBSERVER, DAMAGES_OF_AN_OBSERVERS))


@pytest.mark.parametrize(("made", "damage", "message"), [(made, *one) for made, damages in BUNDLES for one in damages])
def test_a_damaged_or_foreign_bundle_is_refused_in_one_line(tmp_path, made, damage, message):
    made.save(tmp_path / "mine")
    damage(tmp_path / "mine")
    with pytest.raises(BundleError, match=message) as caught:
        load_policy(tmp_path / "mine", robot=ROBOT)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 700


@pytest.mark.parametrize(("activation", "hidden"), [("tanh", np.tanh), ("relu", lambda x: np.maximum(x, 0.0))])
@pytest.mark.parametrize(("output", "last"), [("tanh", np.tanh), ("clip", lambda x: np.clip(x, -1.0, 1.0))])
def test_the_layers_are_those_of_the_equation(activation, hidden, output, last, tmp_path):
    whole = bundle()
    network = dataclasses.replace(whole.network, activation=activation, output=output)
    dataclasses.replace(whole, network=network).save(tmp_path / "other")
    read = PolicyBundle.load(tmp_path / "other").network
    features = 3.0 * np.random.default_rng(0).normal(size=(7, read.sizes[0]))
    h = np.clip((features - read.mean) / read.std, -read.clip, read.clip)
    *inner, outer = zip(read.weights, read.biases, strict=True)
    for weight, bias in inner:
        h = hidden(h @ weight.T.astype(float) + bias)
    np.testing.assert_allclose(answering(read)(features), last(h @ outer[0].T.astype(float) + outer[1]), atol=1e-12)
    named = json.loads((tmp_path / "other" / "policy.json").read_text())["network"]
    assert ("output" in named) == (output == "tanh")  # bundles of PPO have the bytes that they always had


def test_saving_replaces_a_bundle_and_nothing_else(tmp_path):
    for made in (bundle(), bundle(seed=1)):
        made.save(tmp_path / "mine")
        assert PolicyBundle.load(tmp_path / "mine").network.weights[0][0, 0] == made.network.weights[0][0, 0]
    (tmp_path / "papers").mkdir()
    with pytest.raises(ValueError, match="exists and is not a policy bundle"):
        bundle().save(tmp_path / "papers")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "papers"]


def recurrent():
    """A bundle with a random cell in front of two layers."""
    rng, made = np.random.default_rng(0), bundle()
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
    m = expit(r) * m + expit(i) * np.tanh(g)
    h = expit(o) * np.tanh(m)
    y = np.tanh(network.weights[0] @ h + network.biases[0])
    return np.clip(network.weights[1] @ y + network.biases[1], -1.0, 1.0), h, m


def test_a_recurrent_network_is_the_textbooks_memory_before_the_layers_and_has_no_file(tmp_path):
    made = recurrent()
    with pytest.raises(ValueError, match="a recurrent network cannot be saved"):
        made.save(tmp_path / "policy")
    network, memory = made.network, np.zeros((2, 2 * HIDDEN))
    assert network.sizes == (made.features.size, HIDDEN, 5, 2)
    rng, expected, answer = np.random.default_rng(1), memory.copy(), answering(network)
    for _ in range(4):
        features = rng.normal(size=(2, network.sizes[0]))
        action = answer(features, memory)
        for lane in range(2):
            wanted, *past = oracle(network, features[lane], *np.split(expected[lane], 2))
            expected[lane] = np.concatenate(past)
            np.testing.assert_allclose(action[lane], wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(memory, expected, rtol=1e-12, atol=1e-13)
    assert np.ptp(action) > 0.05


def test_every_lane_has_a_memory_of_its_own_which_begins_with_its_episode():
    policy, shown = LearnedPolicy(recurrent(), 2e-3), 0.3 * np.random.default_rng(2).normal(size=(6, 3, 10))
    starts = np.zeros((6, 3), dtype=bool)
    starts[3, 1] = True
    (torque, state), (single, alone) = answers(policy, shown, starts), answers(policy, shown[3:, 1])
    assert np.array_equal(single, torque[3:, 1]) and np.array_equal(alone, state[1])
    assert not np.array_equal(state[0], state[1])


def test_a_cell_of_other_shapes_is_refused():
    for shapes, message in (
        (((12, 4), (12, 4), (12,)), "weight_x has shape"),
        (((12, 4), (12,), (12,)), "weight_h has 1 dimension"),
        (((0, 4), (0, 0), (0,)), "0 columns; allowed: 1 to 1024"),
    ):
        with pytest.raises(ValueError, match=message):
            Cell(*map(np.zeros, shapes))
