"""What learners reach on `FuzzyArmLearn-v0`, five seeds each, on one core.

    python benchmarks/learning_curves.py [--json FILE] [--learner NAME]

PPO and SAC of stable-baselines3 with their defaults on 64 and 16 lanes, PPO in one file of torch
(`examples/ppo_one_file.py`), PPO of stable-baselines3 tuned (`examples/sb3_tuned.py`, two minutes), `fuzzyarm train
ppo`, and the examples of TorchRL and rsl_rl (extra `clients`, two minutes). Of each training except the last two, the
tip error over its processor time is kept; of what it made, the score N on the held-out set, and the errors in the
paper's three cases. Neither chose any setting.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from measuring import made_now, options_of, printed, write

from fuzzyarm import __version__, load_policy
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.eval.score import scores
from fuzzyarm.policies._onnx_model import OnnxPolicy
from fuzzyarm.policies._sb3 import sb3_policy
from fuzzyarm.rl_baselines._case_evaluation import evaluate_cases

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SEEDS = range(5)
PPO_STEPS, SAC_STEPS = 150_000, 100_000
CLIENTS = {"PPO of TorchRL": ("torchrl", 450_000), "PPO of rsl_rl": ("rsl_rl", 3_400_000)}
Curve = list[tuple[float, float, float]]  # processor time [s], steps, tip error [mm]


def of_sb3(name: str, lanes: int, steps: int) -> Callable[[int, Path, Curve], Any]:
    """Return the training of an algorithm of stable-baselines3 with its default settings."""

    def train(seed: int, folder: Path, curve: Curve) -> Any:
        import stable_baselines3
        from stable_baselines3.common.callbacks import BaseCallback

        from fuzzyarm.rl_baselines.sb3_vec_env import learning_envs

        class Watch(BaseCallback):
            def _on_step(self) -> bool:
                ended = self.model.ep_info_buffer
                if ended and self.num_timesteps % 4096 < lanes:
                    error = 1e3 * float(np.median([one["tip_error"] for one in ended]))
                    curve.append((time.process_time() - began, self.num_timesteps, error))
                return True

        own: dict[str, Any] = {"n_steps": 32} if name == "PPO" else {}  # of each lane
        began = time.process_time()
        model = getattr(stable_baselines3, name)("MlpPolicy", learning_envs(lanes), seed=seed, device="cpu", **own)
        model.learn(steps, callback=Watch())
        model.save(folder / "model.zip")
        return sb3_policy(folder / "model.zip", ArmParameters(), 1e-3)

    return train


def of_example(name: str, seconds: float) -> Callable[[int, Path, Curve], Any]:
    """Return the training of an example."""

    def train(seed: int, folder: Path, curve: Curve) -> Any:
        sys.path.append(str(EXAMPLES))
        example = importlib.import_module(name)
        example.train(seed, seconds, lambda *point: curve.append(point)).save(folder / "policy")
        return load_policy(folder / "policy", control_period=1e-3)

    return train


def of_client(library: str, steps: int) -> Callable[[int, Path, Curve], Any]:
    """Return the training of an example that writes an ONNX file, in a process of its own."""

    def train(seed: int, folder: Path, curve: Curve) -> Any:
        command = [sys.executable, str(EXAMPLES / f"train_{library}.py"), str(steps), "--seed", str(seed)]
        subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, check=True)
        return OnnxPolicy(folder / f"{library}.onnx", ArmParameters(), 1e-3)

    return train


def by_trainer(seed: int, folder: Path, curve: Curve) -> Any:
    """Train by `fuzzyarm train ppo`, without evaluations on the way."""
    from fuzzyarm.rl_baselines.algorithms.ppo import PPOConfig
    from fuzzyarm.rl_baselines.training import Training

    never, began = 10**9, time.process_time()
    config = PPOConfig(seed=seed, evaluation_interval=never, checkpoint_interval=never)

    def report(row: dict[str, Any]) -> None:
        if "tip_error_mm" in row:
            curve.append((time.process_time() - began, row["steps"], row["tip_error_mm"]))

    Training(config, folder / "run", report).run()
    return load_policy(folder / "run" / "policy", control_period=1e-3)


LEARNERS = {
    "PPO of stable-baselines3, defaults": of_sb3("PPO", 64, PPO_STEPS),
    "SAC of stable-baselines3, defaults": of_sb3("SAC", 16, SAC_STEPS),
    "PPO in one file, two minutes": of_example("ppo_one_file", 120.0),
    "PPO in one file, ten minutes": of_example("ppo_one_file", 600.0),
    "PPO of stable-baselines3, tuned": of_example("sb3_tuned", 120.0),
    "fuzzyarm train ppo": by_trainer,
    **{name: of_client(*client) for name, client in CLIENTS.items()},
}


def measured(learner: str, seed: int) -> dict[str, Any]:
    """Train with one seed, and return the curve, the score and the errors."""
    curve: Curve = []
    torch.set_num_threads(1)
    began = sum(os.times()[:4])
    with tempfile.TemporaryDirectory() as folder:
        policy = LEARNERS[learner](seed, Path(folder), curve)
    spent, document = sum(os.times()[:4]) - began, scores({"own": policy})
    found = document["policies"]["own"]
    cases = evaluate_cases(policy)
    return {
        **made_now(),
        **{"learner": learner, "seed": seed, "seconds": spent, "steps": curve[-1][1] if curve else CLIENTS[learner][1]},
        **{"N": found["N"], "q90_mm": found["rms_mm"]["90 %"], "lost_percent": found["lost_percent"]},
        "cases_mm": [cases[f"{case}_rms_mm"] for case in PAPER_CASES],
        "curve": [[round(value, 3) for value in point] for point in curve[:: max(1, len(curve) // 60)]],
    }


def draw(document: dict[str, Any]) -> Figure:
    """Return the figure: the tip error over the time of one core, a panel for each learner, a line for each seed."""
    figure = Figure(figsize=(10.0, 2.8), layout="constrained")
    watched = {learner: runs for learner, runs in document["runs"].items() if runs[0]["curve"]}
    panels = figure.subplots(1, len(watched), sharey=True)
    for panel, (learner, runs) in zip(panels, watched.items(), strict=True):
        for run in runs:
            seconds, _, error = zip(*run["curve"], strict=True)
            panel.semilogy(seconds, error, linewidth=1.0)
        panel.set(xlabel="time of one core [s]")
        panel.set_title(learner.replace(" of ", "\n").replace(", ", "\n"), fontsize="x-small")
    panels[0].set_yticks((1, 3, 10, 30, 100), labels=("1", "3", "10", "30", "100"))
    panels[0].minorticks_off()
    panels[0].set_ylabel("tip error in training [mm]")
    return figure


def main() -> None:
    """Measure all learners, or one."""
    parser = options_of(__doc__)
    parser.add_argument("--learner", choices=LEARNERS, help="measure this one alone, without a file")
    options = parser.parse_args()
    chosen = LEARNERS if options.learner is None else (options.learner,)
    runs = {name: printed(measured(name, seed) for seed in SEEDS) for name in chosen}
    if options.learner is None:
        write(options.json, "learning_curves.py", runs=runs, version=__version__)


if __name__ == "__main__":
    main()
