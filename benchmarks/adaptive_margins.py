"""Margins of the adaptive observer: the loop with adaptation frozen, the losses of the adapting one, and the front.

    python benchmarks/adaptive_margins.py [--json FILE]

Frozen: spectral radius and limits of the loop gain of the linear loop of `laws.adaptive.frozen`, in time and half a
sample later, as `fuzzyarm margins` measures them.

Adapting: of `LANES` random plants in each of the paper's cases, for how many the episode ends early or the tip is once
more than `CAP_MM` off ("lost" in the file), with lateness, a factor on the torque of both motors, or encoder noise.

Front: the same weights with the regulator and the walks of the forces slowed down together, from those in use to four
times slower. For each, the range of the frozen loop's gain, the mean over random arms (`adaptive_tuning`, another seed)
of the largest tip error, the errors of Cases 2 and 3, and, with adaptation, how many plants end early or are beyond
`CAP_MM` at `HARD`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.figure import Figure

from fuzzyarm import metrics_of, run_episode
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.cases import PAPER_CASES, find_case
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.linearisation import gain_limits, largest_radius, linearise_path
from fuzzyarm.eval.tuning.adaptive_search import GROUPS, RandomArms
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import AdaptiveWeights
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

ARM, PERIOD, LANES, SEED, CAP_MM = ArmParameters(), 1e-3, 100, 77, 50.0
LOADED = ("machining", "payload")
LATENESS = (1, 2, 3)  # control periods
TORQUE = (0.5, 0.6, 0.67, 0.8, 1.25, 1.5, 1.75, 2.0)
NOISE = (2.0, 8.0, 16.0, 32.0, 64.0)  # times 1e-5 rad and 1e-3 rad/s
SLOWER = (1.0, 1.5, 2.5, 4.0)
HARD: tuple[dict[str, Any], ...] = ({"torque": 0.6}, {"torque": 1.5}, {"late": 3})
FRONT_SEED = 21
PANELS = {
    "radius_gain_0.8": "loop gain 0.8",
    "radius_gain_1.25": "loop gain 1.25",
    "radius_half_a_sample_later": "half a sample later",
}
OFFSET: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": 8}


def slowed(factor: float) -> AdaptiveWeights:
    """Return the weights with walks `factor` times slower and a regulator `factor` times softer, in its weight."""
    own = AdaptiveWeights()
    return dataclasses.replace(
        own,
        travel_walk=own.travel_walk / factor,
        force_walk=own.force_walk / factor,
        link_angle=own.link_angle * math.sqrt(factor),
    )


def frozen(weights: AdaptiveWeights) -> dict[str, Any]:
    """Return the margins of the frozen loop."""
    loops = linearise_path(AdaptiveObserverPolicy(ARM, PERIOD, weights), ARM, PERIOD)
    limits = gain_limits(loops)
    return {
        "radius": largest_radius(loops),
        "radius_gain_0.8": largest_radius(loops, 0.8),
        "radius_gain_1.25": largest_radius(loops, 1.25),
        "radius_half_a_sample_later": largest_radius(loops, 1.0, 0.5),
        "gain": [None if not math.isfinite(limit) else limit for limit in limits],
    }


def beyond(
    weights: AdaptiveWeights | None = None, late: int = 0, torque: float = 1.0, noise: float = 0.0
) -> dict[str, int]:
    """Return for how many of `LANES` plants the episode ends early or the tip is beyond `CAP_MM`, in each case."""
    policy, found = AdaptiveObserverPolicy(ARM, PERIOD, weights), {}
    encoder = EncoderNoise(1e-5 * noise, 1e-3 * noise)
    for case in PAPER_CASES:
        load = dataclasses.replace(find_case(case).disturbance, encoder_noise=encoder)
        envs = gym.make_vec("FuzzyArm-v0", num_envs=LANES, disturbance=load, randomisation="plants")
        observation, _ = envs.reset(seed=SEED)
        state, gone, ended, sent = None, np.zeros(LANES, bool), np.zeros(LANES, bool), []
        while not ended.all():
            action, state = policy.predict(observation, state)
            sent = [*sent, action][-late - 1 :]
            observation, _, terminated, truncated, info = envs.step(torque * sent[0])
            far = ~truncated & (1e3 * info["tip_error"] > CAP_MM)
            gone |= ~ended & (terminated | far)
            ended |= terminated | truncated
        found[case] = int(gone.sum())
    return found


def front() -> list[dict[str, Any]]:
    """Return margins and errors of slower and slower weights."""
    arms, rows = {group: RandomArms(FRONT_SEED, group) for group in GROUPS}, []
    for factor in SLOWER:
        weights = slowed(factor)
        policy = AdaptiveObserverPolicy(ARM, PERIOD, weights)
        errors = {group: float(drawn.largest_errors(policy).mean()) for group, drawn in arms.items()}
        adapting = [{**hard, "lost": sum(beyond(weights, **hard).values())} for hard in HARD]
        row = {"slower": factor, "frozen": frozen(weights), "mean_largest_error_mm": errors, "adapting": adapting}
        rows.append(row | {"cases": {case: case_errors(policy, case) for case in LOADED}})
        print(rows[-1], flush=True)
    return rows


def case_errors(policy: AdaptiveObserverPolicy, case: str) -> dict[str, float]:
    """Return largest and rms tip error in a case [mm]."""
    found = metrics_of(run_episode(policy, case))
    return {"max_mm": float(found["tip_error_max_mm"]), "rms_mm": float(found["tip_error_rms_mm"])}


def draw(document: dict[str, Any]) -> Figure:
    """Return the front: error over the spectral radius of the frozen loop, stable below 1, in each of `PANELS`."""
    rows, figure = document["front"], Figure(figsize=(9.0, 3.4))
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for axes, (key, title) in zip(panels, PANELS.items(), strict=True):
        radii = [row["frozen"][key] for row in rows]
        for group in GROUPS:
            errors = [row["mean_largest_error_mm"][group] for row in rows]
            axes.plot(radii, errors, "o-", markersize=4, markeredgewidth=0.0, label=f"{group} arms")
        for row, radius in zip(rows, radii, strict=True):
            axes.annotate(f"× {row['slower']:g}", (radius, row["mean_largest_error_mm"]["known"]), (0, -14), **OFFSET)
        axes.axvline(1.0, color="0.6", linestyle="--", linewidth=1.0)
        axes.margins(x=0.08)
        axes.set_title(title)
        axes.set_xlabel("spectral radius, frozen")
        axes.set_ylim(0.0, 3.3)
    panels[0].set_ylabel("largest tip error, mean over arms [mm]")
    panels[-1].legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    options = parser.parse_args()
    found: dict[str, Any] = {"lost_mm": CAP_MM, "frozen": frozen(AdaptiveWeights()), "adapting": []}
    print(found["frozen"])
    for name, values in {"late": LATENESS, "torque": TORQUE, "noise": NOISE}.items():
        for value in values:
            counts = beyond(**{name: value})
            found["adapting"].append({"what": name, "value": value, "of": LANES, "lost": counts})
            print(name, value, counts, flush=True)
    found["front"] = front()
    if options.json:
        document = {"command": "python benchmarks/adaptive_margins.py", **current_provenance(), **found}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
