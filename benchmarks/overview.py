"""The README's table: errors in the paper's cases, with noisy encoders, and over random plants.

    python benchmarks/overview.py [--plants N] [--only NAME...] [--json FILE]

The rms tip error of each policy in the three cases, without noise and with noise of 10 µrad and 1 mrad/s on the
encoders (median of five episodes), and the largest tip error that 99 % of the plants of `plant_errors` stay below in
the worst of the three cases. Of a policy that was trained with several seeds, all stored seeds run the cases; the
plants meet the shipped one.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from compared_policies import POLICIES
from measuring import made_now, options_of, printed, write_rows
from plant_errors import FIRST_SEED, errors_of

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.cases import CASES, PAPER_CASES
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.loop import episodes
from fuzzyarm.policies.spec import resolve

SHOWN = (
    *("paper-4-printed", "paper-4", "fuzzy-1", "fuzzy-4", "computed-torque", "fuzzy-4-tip", "computed-torque-tip"),
    *("elastic-observer", "smooth-observer", "adaptive-observer", "learned-observer", "ppo-robust", "ppo-residual"),
)
NOISE = EncoderNoise(1e-5, 1e-3)
EPISODES = 5  # with noise
QUANTILE = 0.99


def rms_mm(policy: Any, noise: EncoderNoise | None = None, count: int = 1) -> list[float]:
    """Return the rms tip error in each case [mm], the median of `count` episodes."""
    disturbances = [dataclasses.replace(CASES[case].disturbance, encoder_noise=noise) for case in PAPER_CASES]
    envs = FuzzyArmVectorEnv(
        count * len(PAPER_CASES), disturbance=disturbances * count, control_period=policy.control_period
    )
    squares, steps = np.zeros((2, count, len(PAPER_CASES)))
    for step in episodes(envs, policy, envs.reset(seed=0)):
        running = step.running.reshape(squares.shape)
        squares += np.where(running, step.info["tip_error"].reshape(squares.shape) ** 2, 0.0)
        steps += running
    return np.median(1e3 * np.sqrt(squares / steps), axis=0).tolist()


def row_of(name: str, plants: int, jobs: int | None) -> dict[str, Any]:
    """Return the row of a policy."""
    shipped = load_policy(name)
    compared = POLICIES.get(name)
    folders = compared.folders() if compared else []
    trained = [load_policy(folder) for folder in folders]
    largest = errors_of(shipped, plants, jobs, lambda done: None).largest_mm[: len(PAPER_CASES)]
    quantiles = np.quantile(largest, QUANTILE, axis=1, method="inverted_cdf")
    return {
        **made_now(),
        "policy": name,
        "files": resolve(name).files(),
        "rms_mm": rms_mm(shipped),
        "rms_mm_of_seeds": [rms_mm(policy) for policy in trained],
        "noisy_rms_mm": rms_mm(shipped, NOISE, EPISODES),
        "plants_mm": float(quantiles.max()) if np.isfinite(quantiles).all() else None,
    }


def main() -> None:
    """Measure, print and write."""
    parser = options_of(__doc__)
    parser.add_argument("--plants", type=int, default=2000, help="plants for each policy (default: %(default)s)")
    parser.add_argument("--jobs", type=int, help="processes (default: one per core)")
    parser.add_argument("--only", nargs="+", default=SHOWN, choices=SHOWN, help="measure these policies alone")
    options = parser.parse_args()
    rows = printed(row_of(name, options.plants, options.jobs) for name in options.only)
    command = f"overview.py --plants {options.plants}"
    write_rows(options.json, command, rows, SHOWN, lambda row: row["policy"], first_seed=FIRST_SEED)


if __name__ == "__main__":
    main()
