"""What the adaptive observer reaches: the paper's cases, passes over one path, and plants that it was not tuned on.

    python benchmarks/adaptive_cases.py [--json FILE] [--plants N] [--pass-plants M]

Cases: the three cases without and with encoder noise of 1e-5 rad and 1e-3 rad/s, seed 0.

Passes: five passes of Cases 2 and 3, beside classical iterative learning control of `fuzzy-4-tip`; then four passes of
M random plants in each case, and of how many the largest error grew from a pass to the next, by more than
`NOTICED` mm.

Plants: N held-out plants in each case. "corner" draws from the distribution ``all``, with twice the noise and two
periods of lateness for each; "torque" from ``plants``, with the torque of both motors times a factor; "10 kg" adds that
payload to Case 1 from the first instant on. A plant whose episode ends early, or whose tip is once more than `CAP_MM`
off, counts as that; "lost" in the file says how many.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.figure import Figure
from measuring import options_of, write

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.scenario.cases import PAPER_CASES, find_case
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.envs.scenario.randomisation import DomainRandomisation
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_passes, record_rollout
from fuzzyarm.eval.sweep._distributions import DISTRIBUTIONS

NAME, BASELINE, NOISE = "adaptive-observer", "fuzzy-4-tip", EncoderNoise(position=1e-5, velocity=1e-3)
LOADED, PASSES, PLANT_PASSES, NOTICED = ("machining", "payload"), 5, 4, 0.05
SEED, PLANTS, PASS_PLANTS, CAP_MM = 400000, 100, 1000, 50.0
TORQUE, HEAVY, LATEST = (0.67, 1.5), 10.0, 2


def paper_cases() -> list[dict[str, Any]]:
    """Return the tip errors of the three cases, without and with noise."""
    rows = []
    for noise in (None, NOISE):
        for case in PAPER_CASES:
            load = dataclasses.replace(find_case(case).disturbance, encoder_noise=noise)
            run = record_rollout(FuzzyArmEnv(disturbance=load), load_policy(NAME), policy_name=NAME, case=case, seed=0)
            metrics = metrics_of(run)
            names = "tip_error_max_mm", "tip_error_max_mid_mm", "tip_error_rms_mm"
            rows.append({"case": case, "noise": noise is not None, **{name: metrics[name] for name in names}})
            print(rows[-1], flush=True)
    return rows


def passes() -> list[dict[str, Any]]:
    """Return the errors of each pass of the loaded cases."""
    rows = []
    for name in (NAME, BASELINE):
        for case in LOADED:
            runs = record_passes(FuzzyArmEnv(case=case), load_policy(name), PASSES, policy_name=name, case=case, seed=0)
            largest = [1e3 * float(run.tip_error.max()) for run in runs]
            rms = [1e3 * float(np.sqrt(np.mean(run.tip_error**2))) for run in runs]
            rows.append({"policy": name, "case": case, "max_mm": largest, "rms_mm": rms})
            print(rows[-1], flush=True)
    return rows


def episode(policy: Any, envs: Any, seed: int, late: np.ndarray, torque: float, state: Any) -> tuple[np.ndarray, Any]:
    """Return the largest tip error of each lane [mm], `CAP_MM` at most, and the last state.

    `late` (lanes,) are periods, `torque` the factor on the torques.
    """
    observation, _ = envs.reset(seed=seed)
    lanes = np.arange(len(late))
    largest, running, sent = np.zeros(len(lanes)), np.ones(len(lanes), dtype=bool), []
    while running.any():
        action, state = policy.predict(observation, state)
        sent = [*sent, action][-LATEST - 1 :]
        applied = np.array(sent)[np.maximum(len(sent) - 1 - late, 0), lanes]
        observation, _, terminated, truncated, info = envs.step(torque * applied)
        live = running & ~terminated & ~truncated
        largest[live] = np.maximum(largest, 1e3 * info["tip_error"])[live]
        largest[running & terminated] = CAP_MM
        running &= ~(terminated | truncated)
    return np.minimum(largest, CAP_MM), state


def plants(case: str, drawn: DomainRandomisation | str, count: int, noise: float = 0.0) -> Any:
    """Return a batch of random plants in a case; `noise` in multiples of `NOISE`."""
    encoder = EncoderNoise(noise * NOISE.position, noise * NOISE.velocity)
    load = dataclasses.replace(find_case(case).disturbance, encoder_noise=encoder)
    return gym.make_vec("FuzzyArm-v0", num_envs=count, disturbance=load, randomisation=drawn)


def populations(count: int) -> list[dict[str, Any]]:
    """Return what happens to held-out plants."""
    spread = DISTRIBUTIONS["plants"]
    runs: list[tuple[str, str, Any, float, int, float]] = []
    for case in PAPER_CASES:
        runs.append(("corner", case, DISTRIBUTIONS["all"], 2.0, LATEST, 1.0))
        runs += [(f"torque x {factor:g}", case, spread, 0.0, 0, factor) for factor in TORQUE]
    heavy = dataclasses.replace(spread, payload=(HEAVY, HEAVY))
    runs.append((f"{HEAVY:g} kg from the first instant", "nominal", heavy, 0.0, 0, 1.0))
    policy, rows = load_policy(NAME), []
    for what, case, drawn, noise, late, torque in runs:
        errors, _ = episode(policy, plants(case, drawn, count, noise), SEED, np.full(count, late), torque, None)
        numbers = {
            "median_mm": float(np.median(errors)),
            "quantile_99_mm": float(np.quantile(errors, 0.99)),
            "worst_mm": float(errors.max()),
            "lost": int((errors >= CAP_MM).sum()),
        }
        rows.append({"what": what, "case": case, "plants": count, **numbers})
        print(rows[-1], flush=True)
    return rows


def passes_of_plants(count: int) -> list[dict[str, Any]]:
    """Return the largest errors of plants in each pass, and how many grew."""
    rows = []
    for case in LOADED:
        envs = plants(case, "plants", count)
        repeated, state, errors = load_policy(NAME).repeated(), None, []
        for _ in range(PLANT_PASSES):
            largest, state = episode(repeated, envs, SEED, np.zeros(count, dtype=int), 1.0, state)
            state = repeated.begin_pass(state)
            errors.append(largest)
        row = {"case": case, "plants": count, "median_mm": [float(np.median(largest)) for largest in errors]}
        row["quantile_99_mm"] = [float(np.quantile(largest, 0.99)) for largest in errors]
        row["larger_than_before"] = [int((b > a + NOTICED).sum()) for a, b in itertools.pairwise(errors)]
        rows.append(row)
        print(rows[-1], flush=True)
    return rows


def draw(document: dict[str, Any]) -> Figure:
    """Return the figure: the largest error over the passes."""
    figure = Figure(figsize=(6.0, 3.4))
    axes = figure.subplots()
    for row in document["passes"]:
        title = find_case(row["case"]).title
        look = {"markersize": 4, "markeredgewidth": 0.0, "label": f"{row['policy']}, {title}"}
        axes.semilogy(range(1, PASSES + 1), row["max_mm"], "o-", **look)
    axes.margins(x=0.03)
    axes.set_xticks(range(1, PASSES + 1))
    axes.set_xlabel("pass over the same path")
    axes.set_ylabel("largest tip error [mm]")
    axes.legend(frameon=False, fontsize=8)
    return figure


def main() -> None:
    """Measure, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("--plants", type=int, default=PLANTS, metavar="N", help=f"of each kind (default: {PLANTS})")
    parser.add_argument(
        "--pass-plants", type=int, default=PASS_PLANTS, metavar="M", help=f"in passes (default: {PASS_PLANTS})"
    )
    options = parser.parse_args()
    found: dict[str, Any] = {"seed": SEED, "lost_mm": CAP_MM, "cases": paper_cases(), "passes": passes()}
    found["passes_of_plants"] = passes_of_plants(options.pass_plants)
    found["populations"] = populations(options.plants)
    write(options.json, "adaptive_cases.py", **found)


if __name__ == "__main__":
    main()
