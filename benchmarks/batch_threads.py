"""When a second thread pays: a step of a batch with one thread and with two, by its size and by the pause before it.

    python benchmarks/batch_threads.py [--json FILE]

Two batches of the same arms take turns, one with one thread, one with two. A pause stands for what a learner does
between two steps; it is spent computing. Times are medians over `ROUNDS` turns of `STEPS` steps each, observation,
reward, `info` and the resets that are due included.
"""

from __future__ import annotations

import os
import time
from typing import Any

import gymnasium as gym
import numpy as np
from measuring import options_of, write

LANES, PAUSES = (256, 512, 1024, 4096, 16384), (0.0, 1e-4, 3e-4, 1e-3)  # arms; s
ROUNDS, STEPS, THREADS = 6, 150, (1, 2)


def spend(pause: float) -> None:
    """Compute for so long [s]."""
    end = time.perf_counter() + pause
    while time.perf_counter() < end:
        pass


def durations(envs: gym.vector.VectorEnv, torque: np.ndarray, pause: float) -> list[float]:
    """Return how long each step of a turn takes [s]."""
    envs.reset(seed=0)
    found = []
    for _ in range(STEPS):
        spend(pause)
        begin = time.perf_counter()
        envs.step(torque)
        found.append(time.perf_counter() - begin)
    return found


def measured(lanes: int) -> list[dict[str, Any]]:
    """Return a row for each pause."""
    batches = {
        threads: gym.make_vec("fuzzyarm:FuzzyArm-v0", num_envs=lanes, randomisation="plants", threads=threads)
        for threads in THREADS
    }
    torque = np.random.default_rng(0).uniform(-1.0, 1.0, (lanes, 2)) * [50.0, 25.0]  # N m
    rows = []
    for pause in PAUSES:
        taken: dict[int, list[float]] = {threads: [] for threads in THREADS}
        for _ in range(ROUNDS):
            for threads, envs in batches.items():
                taken[threads] += durations(envs, torque, pause)
        one, two = (1e6 * float(np.median(taken[threads])) for threads in THREADS)
        rows.append({"lanes": lanes, "pause_us": 1e6 * pause, "one_us": one, "two_us": two, "ratio": one / two})
        print(rows[-1], flush=True)
    for envs in batches.values():
        envs.close()
    return rows


def main() -> None:
    """Measure, print and optionally write."""
    options = options_of(__doc__).parse_args()
    load = os.getloadavg()[0]
    rows = [row for lanes in LANES for row in measured(lanes)]
    write(options.json, "batch_threads.py", load_average=load, rounds=ROUNDS, steps=STEPS, rows=rows)


if __name__ == "__main__":
    main()
