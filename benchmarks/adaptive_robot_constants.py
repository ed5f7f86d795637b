"""The two numbers of the adaptive observer that differ on a robot, chosen over random courses and loads.

    python benchmarks/adaptive_robot_constants.py [ROBOT ...] [--json FILE] [--courses N] [--seed N] [--c C ...]

The numbers are the largest share of a sample in the noise that is read, and the c from which on a load is significant.
Each pair of `SHARES` and `SIGNIFICANT` meets every known robot on N courses with a payload and a force, drawn as those
of `fuzzyarm train estimate` are (the cases with a load are not among them), without and with encoder noise, in two
passes over each course. The objective of a robot is the mean of all largest tip errors plus a tenth of the worst. Each
is divided by the smallest that a pair reaches on that robot, and the pair with the smallest mean over the robots is
chosen. Twenty minutes. `--c` measures fewer pairs, to tell those that are close apart on more courses.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_passes
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.tuning.adaptive_search import CAP, NOISE, TAIL
from fuzzyarm.rl_baselines.estimate.courses import draw_scenarios

ROBOTS = ("planar-3r", "ur5")
SHARES, SIGNIFICANT = (0.03, 0.1, 1.0), (0.0, 1.25)
SEED, COURSES, PASSES = 41, 10, 2


def environments(robot: Robot, count: int, seed: int) -> list[FuzzyArmEnv]:
    """Return environments of the known robot, one for each course, without noise and then with it."""
    drawn = draw_scenarios(robot, count, np.random.default_rng(seed))
    return [
        FuzzyArmEnv(
            robot=robot,
            reference=scenario.reference,
            disturbance=dataclasses.replace(scenario.disturbance, encoder_noise=noise),
        )
        for noise in (None, NOISE)
        for scenario in drawn
    ]


def largest_errors(policy: Any, env: FuzzyArmEnv) -> list[float]:
    """Return the largest tip errors [mm] of each pass over a course, `CAP` at most."""
    runs = record_passes(env, policy, PASSES, policy_name="adaptive-observer", case="random", seed=SEED)
    return [min(metrics_of(run)["tip_error_max_mm"], CAP) if run.completed else CAP for run in runs]


def measure(robot: Robot, count: int, seed: int, pairs: list[tuple[float, float]]) -> list[dict[str, Any]]:
    """Return the objective and its parts for every pair."""
    policy: Any = load_policy("adaptive-observer", robot=robot)
    envs, rows = environments(robot, count, seed), []
    for share, significant in pairs:
        policy.settings = policy.settings.replaced(first_share=share, insignificant=significant**2)
        errors = np.array([largest_errors(policy, env) for env in envs]).reshape(2, count, PASSES)
        means = dict(zip(("without noise", "with noise"), errors.mean(axis=1).tolist(), strict=True))
        objective = float(errors.mean() + TAIL * errors.max())
        rows.append({"share": share, "c": significant, "mean_mm": means, "objective_mm": objective})
        rows[-1] |= {"worst_mm": float(errors.max()), "capped": int((errors >= CAP).sum())}
        print(robot.name, rows[-1], flush=True)
    return rows


def relative(robots: dict[str, list[dict[str, Any]]]) -> list[dict[str, float]]:
    """Return every pair with its objective, divided by the robot's smallest, on average over the robots."""
    smallest = {name: min(row["objective_mm"] for row in rows) for name, rows in robots.items()}
    return [
        {
            "share": found[0]["share"],
            "c": found[0]["c"],
            "objective": float(
                np.mean([row["objective_mm"] / smallest[name] for name, row in zip(robots, found, strict=True)])
            ),
        }
        for found in zip(*robots.values(), strict=True)
    ]


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    usual = f"names or files (default: {' '.join(ROBOTS)})"
    parser.add_argument("robots", nargs="*", default=ROBOTS, metavar="ROBOT", help=usual)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--courses", type=int, default=COURSES, metavar="N", help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="of the courses (default: %(default)s)")
    parser.add_argument("--c", type=float, nargs="+", default=SIGNIFICANT, choices=SIGNIFICANT, help="only these c")
    options = parser.parse_args()
    if options.courses < 1 or options.seed < 0:
        parser.error("--courses must be 1 or more, and --seed 0 or more")
    try:
        known = [robot_named(name) for name in options.robots]
    except ValueError as error:
        parser.error(str(error))
    asked = list(itertools.product(SHARES, options.c))
    robots = {robot.name: measure(robot, options.courses, options.seed, asked) for robot in known}
    pairs = relative(robots)
    chosen = min(pairs, key=lambda pair: pair["objective"])
    print("chosen:", chosen)
    if options.json:
        words = (
            f"{' '.join(robots)} --courses {options.courses} --seed {options.seed} --c {' '.join(map(str, options.c))}"
        )
        command = f"python benchmarks/adaptive_robot_constants.py {words}"
        document = {"command": command, **current_provenance(), "seed": options.seed, "courses": options.courses}
        document |= {"chosen": chosen, "pairs": pairs, "robots": robots}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
