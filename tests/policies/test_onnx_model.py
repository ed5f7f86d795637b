"""``onnx:model.onnx``: the policy that the same layers are in a bundle, and what is refused."""

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

from fuzzyarm.cli import main  # noqa: E402
from fuzzyarm.envs.physics.parameters import ArmParameters  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.learned.definition import learning_features  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.learned.features import FeatureLanes, Features, guided, learning_action  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.learned.network import Network  # noqa: E402
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy  # noqa: E402
from fuzzyarm.policies._onnx_model import OnnxPolicy  # noqa: E402
from fuzzyarm.policies._sb3 import sb3_policy  # noqa: E402

ARM = ArmParameters()


def written(path, size, outputs=2, kind=TensorProto.FLOAT, extra=(), lanes="n"):
    """Write tanh layers as an ONNX file, and return their weights."""
    rng = np.random.default_rng(size)
    layers = [0.3 * rng.normal(size=shape).astype(np.float32) for shape in ((8, size), (outputs, 8))]
    chain = [("MatMul", ["x", "w0"], ["a"]), ("Tanh", ["a"], ["b"]), ("MatMul", ["b", "w1"], ["y"])]
    nodes = [helper.make_node(*node) for node in chain]
    inputs = [helper.make_tensor_value_info(name, kind, [lanes, size]) for name in ("x", *extra)]
    output = [helper.make_tensor_value_info("y", kind, [lanes, outputs])]
    stored = [numpy_helper.from_array(np.ascontiguousarray(w.T), f"w{k}") for k, w in enumerate(layers)]
    graph = helper.make_graph(nodes, "g", inputs, output, stored)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return layers


@pytest.mark.parametrize(("history", "lanes"), [(0, "n"), (2, "n"), (0, 1)])
def test_it_is_the_bundle_of_the_same_layers(history, lanes, tmp_path):
    features = learning_features(2, history)
    layers = written(tmp_path / "m.onnx", features.size, lanes=lanes)
    network = Network(np.zeros(features.size), np.ones(features.size), 1e6, tuple(layers), (np.zeros(8), np.zeros(2)))
    ours = OnnxPolicy(tmp_path / "m.onnx", ARM, 1e-3)
    theirs = LearnedPolicy(PolicyBundle(features, learning_action(ARM), network), 1e-3)
    rng, state, other = np.random.default_rng(0), None, None
    for step in range(9):
        observation, start = rng.normal(size=(5, 10)) * rng.choice([1e-3, 1.0], (5, 1)), rng.random(5) < 0.3
        torque, state = ours.predict(observation, state, start)
        expected, other = theirs.predict(observation, other, start)
        np.testing.assert_allclose(torque, expected, atol=2e-3, err_msg=str(step))
    assert np.ptp(torque) > 1.0
    with pytest.raises(TypeError, match="load the file in each process"):
        pickle.dumps(ours)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"size": 11}, "its input has 11 numbers; an observation of FuzzyArmLearn-v0 has 10"),
        ({"size": 10, "outputs": 3}, r"its output for one observation has shape \(1, 3\); needed: \(1, 2\)"),
        ({"size": 10, "extra": ("h",)}, r"its inputs are x tensor\(float\) \['n', 10\], h"),
        ({"size": 10, "lanes": 4}, r"inputs are x .* \[4, 10\]; .* \(n, size\), for n observations, or \(1, size\)"),
        ({"size": 10, "kind": TensorProto.DOUBLE}, "is not an ONNX model that onnxruntime can run"),
    ],
)
def test_another_model_is_refused_by_what_it_has(given, message, tmp_path):
    written(tmp_path / "m.onnx", **given)
    with pytest.raises(ValueError, match=message):
        OnnxPolicy(tmp_path / "m.onnx", ARM, 1e-3)


def test_a_model_that_only_unpickling_could_read_is_exported_by_the_code_of_the_page(tmp_path, monkeypatch):
    """Layers of the user's own: refused as a zip, with the way out, which then acts as the model does."""
    torch, sb3 = pytest.importorskip("torch"), pytest.importorskip("stable_baselines3")
    from fuzzyarm.rl_baselines.sb3_vec_env import learning_envs

    monkeypatch.chdir(tmp_path)
    own = {"activation_fn": torch.nn.ELU}
    model = sb3.PPO("MlpPolicy", learning_envs(1, case="nominal"), policy_kwargs=own, seed=0, device="cpu")
    model.save("my-model")
    with pytest.raises(ValueError, match="activation_fn, which cannot be read without unpickling; export the model to"):
        sb3_policy(Path("my-model.zip"), ARM, 1e-3)
    page = (Path(__file__).parents[2] / "docs" / "tutorials" / "train.md").read_text(encoding="utf-8")
    code = page[page.index("class Actor(") :].partition("```")[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch's older exporter, which needs no other library
        exec(compile(code, "train.md", "exec"), {"torch": torch, "model": model})
    policy = OnnxPolicy(Path("my-model.onnx"), ARM, 2e-3)
    observation = np.random.default_rng(0).normal(size=(4, 10))
    torque, _ = policy.predict(observation)
    seen = Features(learning_features(2), 2e-3)
    features = FeatureLanes(seen, guided(None)).see(observation, np.zeros((4, seen.memory_size)))
    action, _ = model.predict(features.astype(np.float32), deterministic=True)
    np.testing.assert_allclose(torque, action * [500.0, 250.0], rtol=1e-4, atol=1e-4)


def test_it_is_ranked_from_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "m.onnx", 10)
    words = ["--policy", "onnx:m.onnx", "--case", "nominal", "--out", "results"]
    assert main(["evaluate", *words]) in (0, 1)
    assert "onnx:m.onnx" in (tmp_path / "results" / "results.json").read_text()
    (tmp_path / "m.onnx").write_bytes(b"no model")
    assert main(["evaluate", *words]) == 2
    assert "m.onnx is not an ONNX model" in capsys.readouterr().err
