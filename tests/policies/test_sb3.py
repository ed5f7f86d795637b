"""Models that stable-baselines3 has saved: their own `predict`, the normaliser beside, and what is refused."""

import io
import json
import zipfile

import gymnasium as gym
import numpy as np
import pytest

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.policies import resolve

torch, sb3 = pytest.importorskip("torch"), pytest.importorskip("stable_baselines3")
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from fuzzyarm.rl_baselines.learning_task import FuzzyArmLearnEnv  # noqa: E402


def saved(folder, kind="PPO", history=0):
    """A model with random weights and moments of its observations, and the environment that it is for."""
    venv = VecNormalize(DummyVecEnv([lambda: FuzzyArmLearnEnv(case="payload", history=history)]))
    few = {"n_steps": 16, "batch_size": 16} if kind == "PPO" else {"learning_starts": 16, "buffer_size": 64}
    model = getattr(sb3, kind)("MlpPolicy", venv, seed=0, device="cpu", **few).learn(16)
    model.save(folder / "model.zip")
    np.savez(folder / "model.npz", mean=venv.obs_rms.mean, var=venv.obs_rms.var, clip=venv.clip_obs)
    return model, venv


@pytest.mark.parametrize(("kind", "history"), [("PPO", 0), ("PPO", 3), ("SAC", 0), ("TD3", 1)])
def test_a_saved_model_acts_as_it_does_in_its_own_library(kind, history, tmp_path):
    model, venv = saved(tmp_path, kind, history)
    spec = resolve(f"sb3:{tmp_path / 'model.zip'}", run_code=True)
    assert spec.label == "model" and set(spec.files()) == {"model.zip"}
    policy, state = spec.load(control_period=2e-3), None
    env = FuzzyArmLearnEnv(case="payload", history=history)
    seen, _ = env.reset(seed=0)
    for _ in range(30):
        action, _ = model.predict(venv.normalize_obs(seen), deterministic=True)
        torque, state = policy.predict(env._lane._seen[0], state)
        np.testing.assert_allclose(torque / [500.0, 250.0], np.clip(action, -1, 1), atol=2e-5)
        seen, *_ = env.step(action)


def test_a_name_from_a_file_loads_no_zip(tmp_path, capsys):
    saved(tmp_path)
    name = f"sb3:{tmp_path / 'model.zip'}"
    with pytest.raises(ValueError, match="does not run"):
        load_policy(name)
    out = str(tmp_path / "results")
    assert main(["evaluate", "--policy", name, "--case", "nominal", "--out", out]) in (0, 1)
    assert json.loads((tmp_path / "results" / "results.json").read_text())["config"]["policies"] == ["sb3:model.zip"]
    assert main(["evaluate", "--check", out]) == 2
    assert "--policy sb3:model.zip" in capsys.readouterr().err
    assert main(["evaluate", "--check", out, "--policy", name]) == 0


def test_what_is_no_model_of_the_task_is_refused(tmp_path, capsys):
    def model(name, environment=None, **settings):
        environment = environment or FuzzyArmLearnEnv(case="nominal")
        sb3.PPO("MlpPolicy", environment, n_steps=16, batch_size=16, **settings).save(tmp_path / name)

    (tmp_path / "text.zip").write_text("no zip")
    model("other.zip", gym.make("Pendulum-v1"))
    model("relu.zip", policy_kwargs={"activation_fn": torch.nn.ReLU})
    model("good.zip")
    second = "mlp_extractor.policy_net.2.weight"
    for name, change in (
        ("bare.zip", lambda w: w.pop("action_net.bias")),
        ("wide.zip", lambda w: w.update({second: w[second][:, :-1].clone()})),  # the first layer gives more
    ):
        with zipfile.ZipFile(tmp_path / "good.zip") as source, zipfile.ZipFile(tmp_path / name, "w") as archive:
            weights = torch.load(io.BytesIO(source.read("policy.pth")), weights_only=True)
            change(weights)
            torch.save(weights, buffer := io.BytesIO())
            archive.writestr("data", source.read("data"))
            archive.writestr("policy.pth", buffer.getvalue())
    with zipfile.ZipFile(tmp_path / "empty.zip", "w") as archive:
        archive.writestr("data", "{}")
    for name, words in (
        *((f"{name}.zip", "cannot be read as a model saved by stable-baselines3") for name in ("text", "empty")),
        ("other.zip", "range from -1 to 1"),
        ("relu.zip", "activation_fn"),
        ("bare.zip", "are not those of an MlpPolicy"),
        ("wide.zip", "wide.zip: "),
        ("none.zip", "No such file"),
    ):
        assert main(["score", "--policy", f"sb3:{tmp_path / name}"]) == 2
        error = capsys.readouterr().err
        assert words in error and name in error and error.count("\n") == 1
