"""A bundle is read back as it was written, or refused in one line."""

import dataclasses
import hashlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from safetensors.numpy import save
from support.bundles import bundle, network

from fuzzyarm.fuzzy_policy.laws.learned import bundle as folders
from fuzzyarm.fuzzy_policy.laws.learned.bundle import BundleError, PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.definition import ActionDefinition
from fuzzyarm.fuzzy_policy.laws.learned.network import Network


@pytest.fixture
def folder(tmp_path):
    """A folder with a whole bundle."""
    bundle().save(tmp_path / "mine")
    return tmp_path / "mine"


def test_a_bundle_comes_back_bit_for_bit(folder):
    first, second = bundle(), PolicyBundle.load(folder)
    for name in ("features", "action", "training", "seed", "curve", "versions"):
        assert getattr(first, name) == getattr(second, name)
    assert first.network.clip == second.network.clip
    for name in ("mean", "std"):
        assert getattr(first.network, name).tobytes() == getattr(second.network, name).tobytes()
    for name in ("weights", "biases"):
        for one, other in zip(getattr(first.network, name), getattr(second.network, name), strict=True):
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    assert sorted(path.name for path in folder.iterdir()) == ["policy.json", "weights.safetensors"]
    assert json.loads((folder / "policy.json").read_text())["network"]["activation"] == "tanh"


def test_the_network_is_the_one_of_the_equations():
    made, rng = network(), np.random.default_rng(1)
    features = rng.normal(size=(50, 20)) * rng.choice([1.0, 100.0], (50, 1))
    action, hidden = np.empty((50, 2)), np.clip((features - made.mean) / made.std, -10.0, 10.0)
    made.act(features, action)
    for weight, bias in list(zip(made.weights, made.biases, strict=True))[:-1]:
        hidden = np.tanh(hidden @ weight.T.astype(float) + bias)
    linear = hidden @ made.weights[-1].T.astype(float) + made.biases[-1]
    assert np.abs(linear).max() > 1.0 > np.abs(linear).min()
    np.testing.assert_allclose(action, np.clip(linear, -1.0, 1.0), rtol=0.0, atol=1e-12)


def edited(folder, change):
    """Change the description."""
    description = json.loads((folder / "policy.json").read_text())
    change(description)
    (folder / "policy.json").write_text(json.dumps(description))


def resealed(folder, tensors):
    """Other weights, with the hash that goes with them."""
    resealed_bytes(folder, save(tensors))


def resealed_bytes(folder, content):
    (folder / "weights.safetensors").write_bytes(content)
    edited(folder, lambda d: d.update(weights_sha256=hashlib.sha256(content).hexdigest()))


def with_another_type(content, kind):
    """Weights in whose header the type of one tensor is another text."""
    end = 8 + int.from_bytes(content[:8], "little")
    header = content[8:end].replace(b'"F32"', kind, 1)
    return len(header).to_bytes(8, "little") + header + content[end:]


def tensors(**changes):
    """The tensors of the bundle, some changed."""
    made, found = bundle().network, {}
    for number, (weight, bias) in enumerate(zip(made.weights, made.biases, strict=True)):
        found |= {f"layer{number}.weight": weight, f"layer{number}.bias": bias}
    return found | changes


def flip(path, place):
    """Turn one bit of a file."""
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


DAMAGES = {
    "no folder": (lambda f: [p.unlink() for p in f.iterdir()], "No such file.*a policy bundle is a folder with"),
    "no weights": (lambda f: (f / "weights.safetensors").unlink(), "weights.safetensors: No such file"),
    "a bit of the weights": (lambda f: flip(f / "weights.safetensors", -5), "sha256 differs"),
    "truncated weights": (lambda f: os.truncate(f / "weights.safetensors", 300), "sha256 differs"),
    "truncated description": (lambda f: os.truncate(f / "policy.json", 300), "policy.json: not a JSON document"),
    "no text": (lambda f: (f / "policy.json").write_bytes(b"\xff\xfe\x00"), "policy.json: not a JSON document"),
    "deep": (lambda f: (f / "policy.json").write_text("[" * 10**5), "policy.json: .*nested too deeply"),
    "a list": (lambda f: (f / "policy.json").write_text("[]"), "the schema is 'None', this version reads"),
    "another schema": (
        lambda f: edited(f, lambda d: d.update(schema="x/2")),
        "the schema is 'x/2', this version",
    ),
    "a key too few": (lambda f: edited(f, lambda d: d.pop("seed")), "missing required field `seed`"),
    "a key too many": (lambda f: edited(f, lambda d: d.update(run="rm")), "unknown field run"),
    "no number": (
        lambda f: edited(f, lambda d: d["network"]["mean"].append("1")),
        r"Expected `float`, got .* at `network\.mean",
    ),
    "nan": (
        lambda f: edited(f, lambda d: d["network"]["std"].__setitem__(0, float("nan"))),
        "NaN is no number",
    ),
    "std": (lambda f: edited(f, lambda d: d["network"]["std"].__setitem__(0, 0.0)), "std must be positive"),
    "short mean": (lambda f: edited(f, lambda d: d["network"]["mean"].pop()), "shapes of mean, std"),
    "sizes": (lambda f: edited(f, lambda d: d["network"].update(sizes=[20, 2])), r"policy.json says \[20, 2\]"),
    "no clip": (lambda f: edited(f, lambda d: d["network"].pop("clip")), "missing required field `clip` at `network"),
    "activation": (
        lambda f: edited(f, lambda d: d["network"].update(activation="elu")),
        "activation = 'elu' is unknown",
    ),
    "output": (lambda f: edited(f, lambda d: d["network"].update(output="sine")), "output = 'sine' is unknown"),
    "other features": (lambda f: edited(f, lambda d: d["features"].update(past_errors=9)), "has 20 inputs"),
    "a feature unknown": (lambda f: edited(f, lambda d: d["features"].update(tip=1)), "unknown field tip"),
    "a negative torque": (lambda f: edited(f, lambda d: d["action"].update(scale=[-1, 2])), "scale"),
    "a period of text": (
        lambda f: edited(f, lambda d: d["action"].update(period="2")),
        r"Expected `float`, got .* at `action\.period",
    ),
    "a curve of text": (lambda f: edited(f, lambda d: d.update(curve="up")), "Expected `array`, got `str` at `curve"),
    "infinite weight": (
        lambda f: resealed(f, tensors(**{"layer0.bias": np.full(16, np.inf, np.float32)})),
        "is not finite",
    ),
    "double weights": (lambda f: resealed(f, tensors(**{"layer0.bias": np.zeros(16)})), "layer0.bias is float64"),
    "a wrong shape": (
        lambda f: resealed(f, tensors(**{"layer1.weight": np.zeros((8, 15), np.float32)})),
        "shapes of mean, std, weights and biases",
    ),
    "foreign tensors": (lambda f: resealed(f, {"w": np.zeros(3, np.float32)}), "holds w; needed"),
    "a type with control characters": (
        lambda f: resealed_bytes(f, with_another_type(save(tensors()), b'"a\\u0000b"')),
        "weights.safetensors is damaged",
    ),
    "no safetensors": (
        lambda f: (
            (f / "weights.safetensors").write_bytes(b"\x80\x04."),
            edited(f, lambda d: d.update(weights_sha256=hashlib.sha256(b"\x80\x04.").hexdigest())),
        ),
        "weights.safetensors is damaged",
    ),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_or_foreign_bundle_is_refused_in_one_line(folder, damage, message):
    PolicyBundle.load(folder)
    damage(folder)
    with pytest.raises(BundleError, match=message) as caught:
        PolicyBundle.load(folder)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 700


@pytest.mark.parametrize(("name", "limit"), [("policy.json", "DESCRIPTION"), ("weights.safetensors", "WEIGHTS")])
def test_a_file_too_large_is_not_read(folder, name, limit, monkeypatch):
    monkeypatch.setattr(folders, f"_LARGEST_{limit}", 100)
    with pytest.raises(BundleError, match=rf"{name}(:| is) larger than 100 bytes"):
        PolicyBundle.load(folder)


@pytest.mark.parametrize(("activation", "hidden"), [("tanh", np.tanh), ("relu", lambda x: np.maximum(x, 0.0))])
@pytest.mark.parametrize(("output", "last"), [("tanh", np.tanh), ("clip", lambda x: np.clip(x, -1.0, 1.0))])
def test_the_layers_are_those_of_the_equation(activation, hidden, output, last, tmp_path):
    whole = bundle()
    network = dataclasses.replace(whole.network, activation=activation, output=output)
    dataclasses.replace(whole, network=network).save(tmp_path / "other")
    read = PolicyBundle.load(tmp_path / "other").network
    features = 3.0 * np.random.default_rng(0).normal(size=(7, read.sizes[0]))
    h, action = np.clip((features - read.mean) / read.std, -read.clip, read.clip), np.empty((7, 2))
    *inner, outer = zip(read.weights, read.biases, strict=True)
    for weight, bias in inner:
        h = hidden(h @ weight.T.astype(float) + bias)
    read.act(features, action)
    np.testing.assert_allclose(action, last(h @ outer[0].T.astype(float) + outer[1]), atol=1e-12)
    named = json.loads((tmp_path / "other" / "policy.json").read_text())["network"]
    assert ("output" in named) == (output == "tanh")  # bundles of PPO have the bytes that they always had


def test_the_clip_is_a_float_whatever_number_it_was():
    layer = (np.zeros((2, 2), np.float32),), (np.zeros(2, np.float32),)
    assert Network(np.zeros(2), np.ones(2), 10**60, *layer).clip == 1e60


def test_a_layer_of_any_size_is_not_taken():
    wide = 5000
    with pytest.raises(ValueError, match="allowed: 1 to 4096 in each"):
        Network(np.zeros(2), np.ones(2), 1.0, (np.zeros((wide, 2), np.float32),), (np.zeros(wide, np.float32),))


def test_saving_replaces_a_bundle_and_nothing_else(folder, tmp_path):
    bundle(seed=1).save(folder)
    assert PolicyBundle.load(folder).network.weights[0][0, 0] == bundle(seed=1).network.weights[0][0, 0]
    (tmp_path / "papers").mkdir()
    with pytest.raises(ValueError, match="exists and is no policy bundle"):
        bundle().save(tmp_path / "papers")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "papers"]


def test_a_disk_that_is_full_leaves_the_bundle_that_was_there(folder, tmp_path, monkeypatch):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        bundle(seed=1).save(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_replacement_that_fails_half_way_brings_the_old_bundle_back(folder, tmp_path, monkeypatch):
    before, replace_path = {path.name: path.read_bytes() for path in folder.iterdir()}, os.replace
    failed = []

    def fails_once(source, target):
        if target == folder and not failed:
            failed.append(source)
            raise OSError(5, "Input/output error")
        replace_path(source, target)

    monkeypatch.setattr(os, "replace", fails_once)
    with pytest.raises(OSError, match="Input/output error"):
        bundle(seed=1).save(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_loading_takes_no_learning_library_and_no_pickle(folder):
    code = (
        "import sys, pickle, numpy as np; pickle.load = pickle.loads = pickle.Unpickler = None\n"
        "from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle\n"
        f"made = PolicyBundle.load({str(folder)!r})\n"
        "print([n for n in ('torch', 'stable_baselines3', 'safetensors.torch') if n in sys.modules], made.seed)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] 3"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"scale": (0.0, 1.0)}, r"scale\[0\] = 0.0 N m is out of range"),
        ({"scale": ()}, "the number of scales = 0 is out of range"),
        ({"scale": [1.0, 1.0]}, "must be a builtins.tuple"),
        ({"base": "fuzzy-4"}, r"scale\[0\] = 400.0 rad is out of range; allowed: \(0, 0.5\] rad"),
        ({"smoothing_time": -1.0}, "smoothing_time = -1.0 s is out of range"),
        ({"period": -1.0}, "period = -1.0 s"),
        ({"base": ""}, "base = ''"),
        ({"base": 4}, "base = 4 must be"),
    ],
)
def test_what_is_out_of_range_is_named(values, message):
    with pytest.raises((TypeError, ValueError), match=message):
        ActionDefinition(**values)
