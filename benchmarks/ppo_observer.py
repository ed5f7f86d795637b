"""PPO beside the elastic observer, and what each of its settings is worth, one at a time.

python benchmarks/ppo_observer.py [--out FOLDER] [--groups observer told longer knobs ...]

Trains what the folder does not hold yet, `fuzzyarm train ppo` with the settings of `RUNS`, one thread, and measures
every policy: tip errors on development plants (the distribution of the training with another seed and other
references; what was chosen was chosen by these), rms in the paper's three cases and rate of its torques, on time and
half a sample late, and spectral radii of the local loop at rest. The group `observer` is the preset, `told` has the
observer's innovation among its features, and `longer` has two and a half times as many steps; settings of `knobs`
differ in one thing from the first of them. `robust` compares settings of torques without a model that act every 2 ms,
with a third of the steps, and `smooth` has two of them together, every 2 or 1 ms. The last is the preset `robust`,
whose seeds are read from benchmarks/learned instead of trained. Five seeds of each; those of `knobs` and `robust` are
none of the others. Writes benchmarks/results/ppo_observer.json after every run.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from learned_figures import BOUND
from learned_figures import SEED as ONE_SEED
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES
from fuzzyarm.envs.scenario.default_reference import default_reference, reference_family
from fuzzyarm.envs.scenario.randomisation import find_randomisation
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import largest_radius, linearise_path
from fuzzyarm.fuzzy_policy.policy import Policy, Predictor
from fuzzyarm.rl_baselines.algorithms.ppo import PRESETS, PPOConfig
from fuzzyarm.rl_baselines.training import Training

RESULT = Path(__file__).parent / "results" / "ppo_observer.json"
LEARNED = Path(__file__).parent / "learned"
PERIOD = 1e-3  # s
LANES, STEPS, SEED, REFERENCES = 128, 1500, 7777, 64  # of the development plants
TRANSIENT = 5  # samples of an episode whose torques do not count for the rate
SHOWN = {"machining": "force (Case 2)", "payload": "payload (Case 3)"}
DELAYS = (0.0, 0.5, 1.0)  # samples
HELD = "#CC79A7"  # colour of policies that act every 2 ms
REFERENCES_SHOWN = (
    *("fuzzy-4", "computed-torque", "elastic-observer", "learned-observer", "ppo-robust", "ppo-residual"),
)

_OBSERVER = dataclasses.replace(PRESETS["observer"], tensorboard=False)
_TOLD = dataclasses.replace(_OBSERVER, innovation_times=(0.005, 0.03))
_SHORT = dataclasses.replace(_TOLD, total_timesteps=750_000)
_SHIPPED = dataclasses.replace(PRESETS["robust"], tensorboard=False)
_HELD = dataclasses.replace(_SHIPPED, action_period=0.002, gamma=0.98)
_ROBUST = dataclasses.replace(_HELD, asymmetric_critic=False, smoothness=0.0, total_timesteps=2_000_000)
_SHIFTED = {"gate": 0.0, "scale": (0.01, 0.02), "innovation_times": (), "smoothing_time": 0.06}

RUNS: dict[str, dict[str, PPOConfig]] = {
    "observer": {"as is": _OBSERVER},
    "told": {"innovation among the features": _TOLD},
    "longer": {"innovation among the features": dataclasses.replace(_TOLD, total_timesteps=10_000_000)},
    "knobs": {
        "innovation among the features": _SHORT,
        "value function sees the features alone": dataclasses.replace(_SHORT, asymmetric_critic=False),
        "without the innovation": dataclasses.replace(_SHORT, innovation_times=()),
        "shifts the observer's target": dataclasses.replace(_SHORT, **_SHIFTED),
        "reward's scale 0.3 mm": dataclasses.replace(_SHORT, tip_error_scale=0.3),
        "smoothness 1 in the loss": dataclasses.replace(_SHORT, smoothness=1.0),
    },
    "robust": {
        "as is": _ROBUST,
        "value function sees the plant, smoothness 1 in the loss": dataclasses.replace(
            _ROBUST, asymmetric_critic=True, smoothness=1.0
        ),
        "low-pass of 5 ms on the actions": dataclasses.replace(_ROBUST, smoothing_time=0.005),
        "low-pass of 20 ms on the actions": dataclasses.replace(_ROBUST, smoothing_time=0.02),
        "smoothness 100 in the loss": dataclasses.replace(_ROBUST, smoothness=100.0),
    },
    "smooth": {"acts every 2 ms": _HELD, "acts every 1 ms": _SHIPPED},
}
"""Settings by group and by what is changed."""
SEEDS = {group: range(100, 105) if group in ("knobs", "robust") else range(5) for group in RUNS}
"""By group."""


def development(policy: Policy) -> dict[str, float]:
    """Return what is measured over the development plants.

    Tip errors [mm], how many episodes ended early, and of the plants' rms changes of the torque per period [N m],
    without the first samples of an episode, the median.
    """
    arm = ArmParameters()
    references = (*reference_family(arm, REFERENCES), *[default_reference(arm)] * (REFERENCES // 4))
    drawn = dataclasses.replace(find_randomisation("robust", arm), references=references)
    envs = FuzzyArmVectorEnv(LANES, control_period=PERIOD, case="machining", randomisation=drawn, threads=1)
    (observation, _), state, begins = envs.reset(seed=SEED), None, np.ones(LANES, dtype=bool)
    errors, torques, ages, lost = [], [], [np.zeros(LANES)], 0
    for _ in range(STEPS):
        torque, state = policy.predict(observation, state, begins)
        observation, _, terminated, truncated, info = envs.step(torque)
        begins, error = terminated | truncated, info["tip_error"].copy()
        if begins.any():
            error[begins] = info["final_info"]["tip_error"][begins]
        errors.append(error)
        torques.append(torque)
        ages.append(np.where(begins, 0, ages[-1] + 1))
        lost += int(terminated.sum())
    found = 1e3 * np.array(errors)
    changes = np.where(np.array(ages[1:-1]) > TRANSIENT, (np.diff(np.array(torques), axis=0) ** 2).sum(axis=2), np.nan)
    logarithm = float(np.log1p(found / 0.1).mean())
    values = {"mean_mm": found.mean(), "median_mm": np.median(found), "p99_mm": np.quantile(found, 0.99)}
    return {name: round(float(value), 4) for name, value in values.items()} | {
        "log": round(logarithm, 4),
        "lost": lost,
        "torque_rate": round(float(np.median(np.sqrt(np.nanmean(changes, axis=0)))), 4),
    }


class HalfLate:
    """A policy at every second call, whose torque arrives a call later: half a sample of delay at half the period."""

    def __init__(self, policy: Predictor) -> None:
        """Wrap a policy."""
        self._policy, self._calls = policy, 0

    def predict(
        self, observation: np.ndarray, state: Any, episode_start: np.ndarray, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Return the torque that acts now (lanes, 2) [N m], and the state of the policy."""
        if self._calls % 2 == 0:
            torque, state = self._policy.predict(observation, state, episode_start)
            self._acting, self._next = (self._next if self._calls else torque), torque
        else:
            self._acting = self._next
        self._calls += 1
        return self._acting, state


def in_cases(policy: Policy, late: bool = False) -> dict[str, dict[str, float]]:
    """Return rms tip error [mm] and rms change of the torque per period [N m] in each case, on time or half late."""
    cases, calls = list(PAPER_CASES), 2 if late else 1
    envs = FuzzyArmVectorEnv(len(cases), case=cases, control_period=PERIOD / calls, threads=1)
    acts: Predictor = HalfLate(policy) if late else policy
    errors, torques = [], []
    for step in episodes(envs, acts, envs.reset(seed=0)):
        errors.append(np.where(step.running, step.info["tip_error"], np.nan))
        torques.append(step.info["torque"].copy())
    rms = 1e3 * np.sqrt(np.nanmean(np.array(errors) ** 2, axis=0))
    rate = np.sqrt((np.diff(np.array(torques)[::calls], axis=0)[TRANSIENT:] ** 2).sum(axis=2).mean(axis=0))
    return {
        case: {"rms_mm": round(float(rms[k]), 4), "torque_rate": round(float(rate[k]), 4)}
        for k, case in enumerate(cases)
    }


def measured(policy: Policy) -> dict[str, Any]:
    """Return all that is measured of a policy."""
    row: dict[str, Any] = {"development": development(policy), "cases": in_cases(policy)}
    row |= {"late": in_cases(policy, late=True), "radius": {}}
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
    return {**json.loads((folder / "run.json").read_text()), **measured(policy), "curve": curve_of(policy)}


def curve_of(policy: Policy) -> list[dict[str, float]]:
    """Return the rms errors [mm] of a learned policy over the steps of its training."""
    rows = policy.bundle.curve  # type: ignore[attr-defined]
    return [{"steps": row["steps"], **{case: round(row[f"{case}_rms_mm"], 4) for case in PAPER_CASES}} for row in rows]


def draw(document: dict[str, Any]) -> Figure:
    """Return the errors of the seeds over the steps, beside the elastic observer and without a model."""
    figure = Figure(figsize=(7.5, 6.0))
    upper, lower = figure.subplots(2, 2)
    for axes, (case, title) in zip(upper, SHOWN.items(), strict=True):
        _curves(axes, document, "told", case, "5 seeds, with the innovation", color="#D55E00")
        _curves(axes, document, "longer", case, None, color="#D55E00")
        _curves(axes, document, "observer", case, "5 seeds")
        _across(axes, document, case, "elastic-observer", "learned-observer")
        axes.set(title=f"preset observer: {title}", ylim=(0.0, 3.2))
    upper[0].legend(fontsize="small", loc="upper right")
    _curves(lower[0], document, "smooth", "machining", "every 2 ms", "acts every 2 ms", color=HELD)
    _curves(lower[0], document, "smooth", "machining", "every 1 ms (ppo-robust)", "acts every 1 ms")
    _across(lower[0], document, "machining", "fuzzy-4")
    lower[0].set(title="without a model: force (Case 2)", yscale="log", ylim=(2.0, None))
    lower[0].legend(fontsize="small")
    _aim(lower[1], document)
    return figure


def _curves(
    axes: Axes,
    document: dict[str, Any],
    group: str,
    case: str,
    label: str | None,
    setting: str | None = None,
    **look: Any,
) -> None:
    """Draw the rms error of every seed of a group in a case, or of a setting in it."""
    runs = [run for run in document["runs"][group] if setting in (None, run["setting"])]
    for number, run in enumerate(runs):
        steps = [row["steps"] / 1e6 for row in run["curve"]]
        errors = [row[case] for row in run["curve"]]
        axes.plot(steps, errors, label=None if number else label, **{**ONE_SEED, "linewidth": 1.4, **look})
    axes.set(xlabel="environment steps [million]", ylabel="rms tip error [mm]")


def _across(axes: Axes, document: dict[str, Any], case: str, *names: str) -> None:
    """Draw the rms errors of other policies as lines across."""
    for name, dashes in zip(names, ((0, (1, 2)), (0, (5, 2))), strict=False):
        error = document["references"][name]["cases"][case]["rms_mm"]
        axes.axhline(error, label=name, **{**BOUND, "linestyle": dashes})


def _aim(axes: Axes, document: dict[str, Any]) -> None:
    """Draw error over rate of the torque under the force, and what was aimed at without a model."""
    references = document["references"]
    largest = references["fuzzy-4"]["cases"]["machining"]["rms_mm"]
    fastest = 2.0 * references["computed-torque"]["cases"]["machining"]["torque_rate"]
    axes.add_patch(Rectangle((0.5, 1.0), fastest - 0.5, largest - 1.0, color="#009E73", alpha=0.15, lw=0, label="aim"))
    shown = {
        "model-based": [references[name] for name in ("fuzzy-4", "computed-torque", "elastic-observer")],
        "settings of robust, 2 million steps": document["runs"]["robust"],
        **{
            f"{setting}, 6 million steps": [run for run in document["runs"]["smooth"] if run["setting"] == setting]
            for setting in RUNS["smooth"]
        },
    }
    looks = (("s", None), ("x", None), ("^", HELD), ("o", ONE_SEED["color"]))
    for (label, rows), (mark, color) in zip(shown.items(), looks, strict=True):
        cases = [row["cases"]["machining"] for row in rows]
        axes.plot([c["torque_rate"] for c in cases], [c["rms_mm"] for c in cases], mark, label=label, color=color)
    axes.set(title="without a model: error and chatter", xlabel="torque rate [N m/ms]", xscale="log")
    axes.set(ylabel="rms tip error [mm]", yscale="log", ylim=(1.0, 1e5), xlim=(0.5, 1e3))
    axes.legend(fontsize="small", loc="upper right")


def folder_of(out: Path, group: str, name: str, config: PPOConfig) -> Path:
    """Return where a training is or will be; that of a shipped setting is stored with this repository."""
    if group == "smooth" and config == dataclasses.replace(_SHIPPED, seed=config.seed):
        return LEARNED / f"ppo-robust-{config.seed}"
    return out / f"{group}-{name}-seed-{config.seed}".replace(" ", "-").replace(",", "").replace("'", "")


def runs_of(groups: list[str]) -> Iterator[tuple[str, tuple[str, PPOConfig], int]]:
    """Yield groups, settings by name and seeds."""
    for group in groups:
        for setting, seed in itertools.product(RUNS[group].items(), SEEDS[group]):
            yield group, setting, seed


def main() -> None:
    """Train and measure what is asked for, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("ppo-observer-runs"), help="folder of the trainings")
    parser.add_argument("--groups", nargs="+", choices=list(RUNS), default=list(RUNS))
    arguments = parser.parse_args()
    known = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.is_file() else {"runs": {}}
    if "references" not in known:
        known["references"] = {name: measured(load_policy(name)) for name in REFERENCES_SHOWN}
        known |= current_provenance()
    for group, (name, config), seed in runs_of(arguments.groups):
        config = dataclasses.replace(config, seed=seed)
        row = {"setting": name, "steps": config.total_timesteps, "seed": seed}
        row |= trained(config, folder_of(arguments.out, group, name, config))
        row |= {"provenance": current_provenance()}
        others = [run for run in known["runs"].get(group, []) if (run["setting"], run["seed"]) != (name, seed)]
        known["runs"][group] = [*others, row]
        print(group, {key: value for key, value in row.items() if key != "curve"}, flush=True)
        write_atomically(RESULT, json.dumps({"command": "python benchmarks/ppo_observer.py", **known}, indent=1) + "\n")


if __name__ == "__main__":
    main()
