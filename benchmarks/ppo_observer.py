"""PPO beside the elastic observer, and what each of its settings is worth, one at a time.

python benchmarks/ppo_observer.py [--out FOLDER] [--groups observer knobs robust] [--figure FILE]

Trains what the folder does not hold yet, `fuzzyarm train ppo` with the settings of `RUNS`, one thread, and measures
every policy: tip errors on development plants (the distribution of the training with another seed and other
references; what was chosen was chosen by these), rms in the paper's three cases, rate of its torques, and spectral
radii of the local loop. Writes benchmarks/results/ppo_observer.json after every run.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from learned_figures import BOUND
from matplotlib.figure import Figure

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.scenario.reference_family import reference_family
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import linearise_path
from fuzzyarm.eval.stability.local_loop import largest_radius
from fuzzyarm.fuzzy_policy.policy import Policy
from fuzzyarm.rl_baselines.algorithms.ppo import PRESETS, PPOConfig
from fuzzyarm.rl_baselines.training import Training

RESULT = Path(__file__).parent / "results" / "ppo_observer.json"
PERIOD = 1e-3  # s
LANES, STEPS, SEED, REFERENCES = 128, 1500, 7777, 64  # of the development plants
SHOWN = {"machining": "force (Case 2)", "payload": "payload (Case 3)"}
DELAYS = (0.0, 0.5, 1.0)  # samples

_OBSERVER = dataclasses.replace(PRESETS["observer"], tensorboard=False)
_SHORT = dataclasses.replace(_OBSERVER, total_timesteps=750_000, seed=100)
_ROBUST = dataclasses.replace(PRESETS["robust"], tensorboard=False, total_timesteps=2_000_000, seed=100)
_SHIFTED = {"gate": 0.0, "scale": (0.01, 0.02), "innovation_times": (), "smoothing_time": 0.06}

RUNS: dict[str, dict[str, PPOConfig]] = {
    "observer": {f"seed {seed}": dataclasses.replace(_OBSERVER, seed=seed) for seed in range(3)},
    "knobs": {
        "as is": _SHORT,
        "value function sees the features alone": dataclasses.replace(_SHORT, asymmetric_critic=False),
        "no innovation among the features": dataclasses.replace(_SHORT, innovation_times=()),
        "shifts the observer's target": dataclasses.replace(_SHORT, **_SHIFTED),
        "reward's scale 0.3 mm": dataclasses.replace(_SHORT, tip_error_scale=0.3),
        "smoothness 1 in the loss": dataclasses.replace(_SHORT, smoothness=1.0),
    },
    "robust": {
        "as is": _ROBUST,
        "value function sees the plant, smoothness 1 in the loss": dataclasses.replace(
            _ROBUST, asymmetric_critic=True, smoothness=1.0
        ),
    },
}
"""Settings by group and by what is changed."""


def development(policy: Policy) -> dict[str, float]:
    """Return tip errors [mm] over the development plants, and how many episodes were lost."""
    arm = ArmParameters()
    references = (*reference_family(arm, REFERENCES), *[default_reference(arm)] * (REFERENCES // 4))
    drawn = dataclasses.replace(find_randomisation("robust", arm), references=references)
    envs = FuzzyArmVectorEnv(LANES, control_period=PERIOD, case="machining", randomisation=drawn, threads=1)
    (observation, _), state, begins = envs.reset(seed=SEED), None, np.ones(LANES, dtype=bool)
    errors, lost = [], 0
    for _ in range(STEPS):
        torque, state = policy.predict(observation, state, begins)
        observation, _, terminated, truncated, info = envs.step(torque)
        begins, error = terminated | truncated, info["tip_error"].copy()
        if begins.any():
            error[begins] = info["final_info"]["tip_error"][begins]
        errors.append(error)
        lost += int(terminated.sum())
    found = 1e3 * np.array(errors)
    logarithm = float(np.log1p(found / 0.1).mean())
    values = {"mean_mm": found.mean(), "median_mm": np.median(found), "p99_mm": np.quantile(found, 0.99)}
    return {name: round(float(value), 4) for name, value in values.items()} | {
        "log": round(logarithm, 4),
        "lost": lost,
    }


def in_cases(policy: Policy) -> dict[str, dict[str, float]]:
    """Return rms tip error [mm] and rms change of the torque per period [N m] in each case."""
    cases = list(PAPER_CASES)
    envs = FuzzyArmVectorEnv(len(cases), case=cases, control_period=PERIOD, threads=1)
    errors, torques = [], []
    for step in episodes(envs, policy, envs.reset(seed=0)):
        errors.append(np.where(step.running, step.info["tip_error"], np.nan))
        torques.append(step.info["torque"].copy())
    rms = 1e3 * np.sqrt(np.nanmean(np.array(errors) ** 2, axis=0))
    rate = np.sqrt((np.diff(np.array(torques), axis=0)[5:] ** 2).sum(axis=2).mean(axis=0))
    return {
        case: {"rms_mm": round(float(rms[k]), 4), "torque_rate": round(float(rate[k]), 4)}
        for k, case in enumerate(cases)
    }


def measured(policy: Policy) -> dict[str, Any]:
    """Return all that is measured of a policy."""
    row: dict[str, Any] = {"development": development(policy), "cases": in_cases(policy), "radius": {}}
    try:
        loops = linearise_path(policy, ArmParameters(), PERIOD)
    except ValueError:  # it does not hold still, or its torques are clipped there
        loops = []
    for delay in DELAYS:
        row["radius"][f"{delay:g}"] = round(largest_radius(loops, delay=delay), 6) if loops else None
    return row


def trained(config: PPOConfig, folder: Path) -> dict[str, Any]:
    """Train if the folder does not hold the end of this training, and return its times and errors."""
    if not (folder / "run.json").is_file():
        Training(config, folder).run()
    policy = load_policy(folder / "policy", control_period=PERIOD)
    recorded = policy.bundle.training  # type: ignore[attr-defined]
    wanted = json.loads(json.dumps(config.to_dict()))
    if any(recorded.get(name) != value for name, value in wanted.items() if name != "tensorboard"):
        raise ValueError(f"{folder} holds a training with other settings; choose another --out")
    curve = [
        {"steps": row["steps"], **{case: round(row[f"{case}_rms_mm"], 4) for case in PAPER_CASES}}
        for row in policy.bundle.curve  # type: ignore[attr-defined]
    ]
    return {**json.loads((folder / "run.json").read_text()), **measured(policy), "curve": curve}


def draw(document: dict[str, Any], path: Path) -> None:
    """Draw the errors of the seeds over the steps of the training, with those of the base."""
    with matplotlib.style.context("fuzzyarm.eval.fuzzyarm", after_reset=True):
        figure = Figure(figsize=(7.5, 3.0))
        for axes, (case, title) in zip(figure.subplots(1, 2), SHOWN.items(), strict=True):
            base = document["references"]["elastic-observer"]["cases"][case]["rms_mm"]
            axes.axhline(base, label="elastic-observer", **BOUND)
            for name, run in document["runs"]["observer"].items():
                steps = [row["steps"] / 1e6 for row in run["curve"]]
                axes.plot(steps, [row[case] for row in run["curve"]], label=name)
            axes.set(title=title, xlabel="environment steps [million]", ylim=(0.0, None))
        figure.axes[0].set_ylabel("rms tip error [mm]")
        figure.axes[0].legend()
        picture = io.BytesIO()
        figure.savefig(picture, format="png")
    write_atomically(path, picture.getvalue())


def main() -> None:
    """Train and measure what is asked for, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("ppo-observer-runs"), help="folder of the trainings")
    parser.add_argument("--groups", nargs="+", choices=list(RUNS), default=list(RUNS))
    parser.add_argument("--figure", type=Path, help="also draw the errors over the steps of the training")
    arguments = parser.parse_args()
    known = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.is_file() else {"runs": {}}
    if "references" not in known:
        names = ("fuzzy-4", "computed-torque", "elastic-observer", "ppo-robust", "ppo-residual")
        known["references"] = {name: measured(load_policy(name)) for name in names}
    for group in arguments.groups:
        for name, config in RUNS[group].items():
            folder = arguments.out / f"{group}-{name}".replace(" ", "-").replace(",", "").replace("'", "")
            row = {"steps": config.total_timesteps, "seed": config.seed, **trained(config, folder)}
            known["runs"].setdefault(group, {})[name] = row
            print(group, name, {key: value for key, value in row.items() if key != "curve"}, flush=True)
            content = {"command": "python benchmarks/ppo_observer.py", **known, **current_provenance()}
            write_atomically(RESULT, json.dumps(content, indent=1) + "\n")
    if arguments.figure:
        draw(known, arguments.figure)


if __name__ == "__main__":
    main()
