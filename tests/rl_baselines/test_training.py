"""A training is reproducible, also if it is stopped and resumed."""

import csv
import json
import os
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from support.bundles import answering
from support.trainings import stopped

from fuzzyarm import load_policy
from fuzzyarm.cli import main
from fuzzyarm.cli._commands.train import train_with_progress
from fuzzyarm.fuzzy_policy.laws.learned.bundle import PolicyBundle
from fuzzyarm.fuzzy_policy.laws.learned.policy import LearnedPolicy
from fuzzyarm.rl_baselines import training as trainer
from fuzzyarm.rl_baselines._case_evaluation import COLUMNS, evaluate_cases
from fuzzyarm.rl_baselines._checkpoint import read_checkpoint
from fuzzyarm.rl_baselines.algorithms.ppo import PRESETS, PPOConfig
from fuzzyarm.rl_baselines.training import Training

pytestmark = pytest.mark.usefixtures("brief_evaluations")

# A dozen updates; everything is on: drawn plants and references, a base, evaluations and checkpoints between them.
COMMON = {"lanes": 8, "n_epochs": 2}
FLAGS = {
    **{**COMMON, "preset": "residual", "total_timesteps": 6144, "n_steps": 64, "batch_size": 256, "hidden": 16},
    **{"evaluation_interval": 3000, "checkpoint_interval": 1024, "seed": 11},
}
SHORT = {**COMMON, "total_timesteps": 512, "n_steps": 32, "batch_size": 128, "evaluation_interval": 10**6}
SMALL = PPOConfig(**SHORT)


def words(flags):
    return [word for name, value in flags.items() for word in (f"--{name.replace('_', '-')}", str(value))]


def results(folder):
    """Those results of a run that must be reproducible: weights, descriptions and the curve."""
    names = ("policy/policy.json", "policy/weights.safetensors", "best/policy.json", "best/weights.safetensors")
    return {name: (folder / name).read_bytes() for name in ("curve.csv", *names) if (folder / name).exists()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory, brief_evaluations):
    folder = tmp_path_factory.mktemp("whole") / "run"
    assert main(["train", "ppo", *words(FLAGS), "--out", str(folder)]) == 0
    return folder


def config_of(folder):
    return PPOConfig.from_dict(read_checkpoint(folder / "checkpoint.pt")["config"])


@pytest.mark.slow
def test_a_stopped_run_goes_on_as_if_nothing_had_been(whole, tmp_path):
    """Stopped here within the process; `tests/abuse` kills trainings."""
    folder = stopped(config_of(whole), tmp_path / "run", 2560)
    assert read_checkpoint(folder / "checkpoint.pt")["steps"] == 2048  # no more than an interval is lost
    assert results(folder) != results(whole)
    assert main(["train", "ppo", *words(FLAGS), "--out", str(folder)]) == 0
    assert results(folder) == results(whole) and len(results(whole)) >= 3
    for one in (folder, whole):
        times = json.loads((one / "run.json").read_text())
        assert set(times) == {"wall_time_s", "cpu_time_s"} and min(times.values()) > 0.0
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in whole.iterdir())


@pytest.mark.slow
def test_a_finished_run_goes_on_to_a_larger_total(whole, tmp_path):
    """What was done keeps its bits; then the learning rate falls as if the new total had been that of the beginning."""
    folder = shutil.copytree(whole, tmp_path / "run")
    assert main(["train", "ppo", *words(FLAGS | {"total_timesteps": 9216}), "--out", str(folder)]) == 0
    before, after = ((one / "curve.csv").read_text().splitlines() for one in (whole, folder))
    assert after[: len(before)] == before and len(after) == len(before) + 6
    rows = list(csv.DictReader(after))
    assert [int(row["steps"]) for row in rows[-6:]] == [6144 + 512 * k for k in range(1, 7)]
    preset, last = PRESETS["residual"], rows[-6]
    first, final = preset.learning_rate, preset.final_learning_rate
    assert float(last["learning_rate"]) == pytest.approx(final + (first - final) * (1.0 - 6656 / 9216))
    assert PolicyBundle.load(folder / "policy").training["steps_done"] == 9216


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"total_timesteps": 512}, "total_timesteps = 512 is below the 6144 steps already done"),
        ({"seed": 1}, "contains a training run with seed = 11, not 1: give the options with which it began"),
        ({"preset": "robust"}, "contains a training run with base = 'fuzzy-4-tip', not 'none'"),
        ({}, ""),
    ],
)
def test_a_finished_run_is_left_as_it_is(other, message, whole, capsys):
    before = results(whole)
    assert main(["train", "ppo", *words(FLAGS | other), "--out", str(whole)]) == (2 if other else 0)
    assert message in capsys.readouterr().err
    assert results(whole) == before


def test_a_run_that_was_killed_before_it_wrote_its_times_writes_them(whole, tmp_path):
    folder = shutil.copytree(whole, tmp_path / "run")
    (folder / "run.json").unlink()
    assert main(["train", "ppo", *words(FLAGS), "--out", str(folder)]) == 0
    assert json.loads((folder / "run.json").read_text())["wall_time_s"] > 0.0 and results(folder) == results(whole)


@pytest.mark.parametrize("distribution", ["nominal", pytest.param("robust", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_policy_and_another_seed_another(distribution, tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        Training(replace(SMALL, distribution=distribution, seed=seed), tmp_path / name).run()
    a, b, c = (results(tmp_path / name) for name in "abc")
    assert a == b and a["policy/weights.safetensors"] != c["policy/weights.safetensors"]


@pytest.fixture
def unevaluated(monkeypatch):
    """Let every evaluation find the same at once: it takes longer than these trainings."""
    monkeypatch.setattr(trainer, "evaluate_cases", lambda *_: dict.fromkeys(COLUMNS, 1.0))


@pytest.mark.usefixtures("unevaluated")
def test_a_training_shorter_than_an_update_has_no_negative_rate_and_can_be_extended(tmp_path):
    Training(replace(SMALL, total_timesteps=64), tmp_path / "run").run()  # an update has 256 steps
    optimizer = read_checkpoint(tmp_path / "run" / "checkpoint.pt")["learner"]["optimizer"]
    assert [group["lr"] for group in optimizer["param_groups"]] == [0.0]
    extended = Training.resume(replace(SMALL, total_timesteps=512), tmp_path / "run")
    extended.run()
    assert extended.algorithm.steps == 512


def test_the_shipped_policy_is_the_trained_one(whole):
    policy = Training.resume(config_of(whole), whole).algorithm.model.policy
    bundle, rng = PolicyBundle.load(whole / "policy"), np.random.default_rng(0)
    features = rng.normal(size=(4096, bundle.features.size)) * rng.choice([0.1, 1.0, 2.0], (4096, 1))
    action = answering(bundle.network)(features)
    with torch.no_grad():
        hidden = policy.double().mlp_extractor.policy_net(torch.as_tensor(features))
        expected = np.clip(policy.action_net(hidden).numpy(), -1.0, 1.0)
    assert np.abs(action - expected).max() < 1e-12 and np.ptp(action) > 0.01


def test_the_evaluation_is_that_of_the_bundle_as_it_is_shipped(whole):
    bundle = PolicyBundle.load(whole / "policy")
    found = evaluate_cases(LearnedPolicy(bundle, 1e-3, base=load_policy("fuzzy-4-tip", allow_unproven=True)))
    assert found.items() <= bundle.curve[-1].items()


@pytest.mark.slow
def test_the_best_policy_is_kept_and_its_score_resumed(whole):
    curve = PolicyBundle.load(whole / "policy").curve
    scores = [np.mean([row[f"{case}_rms_mm"] for case in ("nominal", "machining", "payload")]) for row in curve]
    assert Training.resume(config_of(whole), whole).best == pytest.approx(min(scores), rel=1e-12)
    assert PolicyBundle.load(whole / "best").training["steps_done"] == curve[int(np.argmin(scores))]["steps"]


@pytest.mark.usefixtures("unevaluated")
def test_a_disk_that_fills_up_leaves_the_last_checkpoint_whole(tmp_path, monkeypatch, capsys):
    reference = Training(replace(SMALL, checkpoint_interval=256), tmp_path / "whole")
    reference.run()
    written, fsync = [], os.fsync

    def full(handle):
        written.append(handle)
        if len(written) > 4:  # the curve, the first checkpoint and, after each of them, the folder
            raise OSError(28, "No space left on device")
        fsync(handle)

    flags = words(SHORT | {"checkpoint_interval": 256})
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert main(["train", "ppo", *flags, "--out", str(tmp_path / "run")]) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert "checkpoint.pt: No space left on device; the previous checkpoint is intact: restore write access" in message
    assert not [path for path in (tmp_path / "run").iterdir() if path.name.endswith(".part")]
    assert main(["train", "ppo", *flags, "--out", str(tmp_path / "run")]) == 0
    assert results(tmp_path / "run") == results(tmp_path / "whole")


def test_a_file_in_the_place_of_the_folder_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["train", "ppo", "--out", str(tmp_path / "file" / "run")]) == 2
    assert "cannot write to" in capsys.readouterr().err


def test_progress_is_a_line_for_every_evaluation(tmp_path, capsys):
    train_with_progress(replace(SMALL, total_timesteps=512), tmp_path)
    shown = capsys.readouterr().err
    assert re.search(r"512 steps, [\d,]+/s; largest tip error \[mm\]: nominal \d", shown)
