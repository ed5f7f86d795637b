"""What encoder noise does to the adaptive observer: which belief passes it on, and what the worst plants share.

    python benchmarks/adaptive_noise.py [--json FILE] [--plants N]

Beliefs: Case 1 with encoder noise of 1e-5 rad and 1e-3 rad/s, `EPISODES` episodes with other noise, with some of the
beliefs fixed to what is true there. The largest error of an episode, on average and the largest of all, and the rms.

Plants: N plants in Case 1 of the distribution ``all`` (payload, noise, up to two periods late), held out. For the
twentieth of them with the largest errors and for the others: how many are late, and by how much the noise that is read
in the angles, at its largest after `LATER` s, exceeds the encoders'. A vibration of the loop must not be read as noise.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.sweep.distributions import DISTRIBUTIONS
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import FACTORS
from fuzzyarm.fuzzy_policy.laws.adaptive.policy import AdaptiveObserverPolicy

NOISE, EPISODES = EncoderNoise(position=1e-5, velocity=1e-3), 16
FIXED: dict[str, tuple[str, ...]] = {
    "none": (),
    "travel_force": ("travel_force",),
    "force": ("force",),
    "both forces": ("travel_force", "force"),
    "payload": ("payload",),
    "factors": FACTORS,
    "offset": ("offset",),
    "lateness": ("lateness",),
    "all": ("travel_force", "force", "payload", *FACTORS, "offset", "lateness"),
}
SEED, PLANTS, WORST, LATER = 700000, 400, 0.05, 0.2
SURE = 1e-12  # standard deviation of a belief that is fixed


def fixed(names: tuple[str, ...]) -> AdaptiveObserverPolicy:
    """Return the policy with some of its beliefs fixed to the first guess."""
    policy = AdaptiveObserverPolicy()
    s, states = policy.settings, 4 * policy.joints
    noise, spread, shared, reopening = s.noise.copy(), s.spread.copy(), s.shared.copy(), s.reopening.copy()
    for name in names:
        part = getattr(policy.belief, name)
        noise[states:][part], spread[states:][part], shared[states:][part] = 0.0, SURE, 0.0
        if part.stop <= policy.belief.force.stop:
            reopening[part] = 0.0
    policy.settings = s.replaced(noise=noise, spread=spread, shared=shared, reopening=reopening)
    return policy


def run(policy: Any, envs: Any, seed: int, late: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tip errors [mm] and the read noise of the angles [rad], (steps, lanes) each; commands `late` periods."""
    observation, _ = envs.reset(seed=seed)
    lanes, sent, state, errors, read = np.arange(len(late)), [], None, [], []
    running = np.ones(len(late), dtype=bool)
    while running.any():
        action, state = policy.predict(observation, state)
        sent = [*sent, action][-int(late.max()) - 1 :]
        applied = np.array(sent)[np.maximum(len(sent) - 1 - late, 0), lanes]
        observation, _, terminated, truncated, info = envs.step(applied)
        running &= ~(terminated | truncated)
        errors.append(np.where(running, 1e3 * info["tip_error"], 0.0))
        read.append(np.sqrt(state[:, policy.memory.noise]).mean(axis=1))
    return np.array(errors), np.array(read)


def beliefs() -> list[dict[str, Any]]:
    """Return the errors in Case 1 with noise, with some of the beliefs fixed."""
    envs = gym.make_vec("FuzzyArm-v0", num_envs=EPISODES, disturbance=Disturbance(encoder_noise=NOISE))
    rows = []
    for name, parts in FIXED.items():
        errors, _ = run(fixed(parts), envs, SEED, np.zeros(EPISODES, dtype=int))
        largest = errors.max(axis=0)
        numbers = {"max_mean_mm": largest.mean(), "max_mm": largest.max(), "rms_mm": np.sqrt(np.mean(errors**2))}
        rows.append({"fixed": name, **{key: float(value) for key, value in numbers.items()}})
        print(rows[-1], flush=True)
    return rows


def plants(count: int) -> list[dict[str, Any]]:
    """Return what the worst plants have in common, and the others."""
    drawn, generator = DISTRIBUTIONS["all"], np.random.default_rng(SEED)
    late = generator.integers(int(drawn.delay[0]), int(drawn.delay[1]) + 1, count)
    noise = generator.uniform(*drawn.noise, count)
    loads = [Disturbance(encoder_noise=EncoderNoise(x * NOISE.position, x * NOISE.velocity)) for x in noise]
    envs = gym.make_vec("FuzzyArm-v0", num_envs=count, disturbance=loads, randomisation=drawn)
    policy = AdaptiveObserverPolicy()
    errors, read = run(policy, envs, SEED, late)
    largest, first = errors.max(axis=0), round(LATER / policy.control_period)
    beyond = read[first:].max(axis=0) / NOISE.position - noise  # in units of `NOISE`
    order, rows = np.argsort(largest)[::-1], []
    cut = max(1, round(WORST * count))
    for name, members in ("worst", order[:cut]), ("others", order[cut:]):
        row = {
            "group": name,
            "plants": len(members),
            "max_mm": float(largest[members].max()),
            "median_max_mm": float(np.median(largest[members])),
            "late": float(np.mean(late[members] > 0)),
            "read_beyond_noise_rad": float(np.median(beyond[members]) * NOISE.position),
        }
        rows.append(row)
        print(row, flush=True)
    return rows


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--plants", type=int, default=PLANTS, metavar="N", help=f"default: {PLANTS}")
    options = parser.parse_args()
    found = {"seed": SEED, "noise": dataclasses.asdict(NOISE), "beliefs": beliefs(), "plants": plants(options.plants)}
    if options.json:
        document = {"command": "python benchmarks/adaptive_noise.py", **current_provenance(), **found}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
