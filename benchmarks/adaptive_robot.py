"""The adaptive observer on a robot of more joints, beside the elastic observer.

    python benchmarks/adaptive_robot.py [ROBOT] [--json FILE] [--plants N]

Cases: the three cases with the robot's loads, without and with encoder noise of 1e-5 rad and 1e-3 rad/s, seed 0.

Plants: N plants drawn around the robot ("plants": masses and motor inertias within 10 %, stiffness within 20 %, damping
and friction within 50 %) in each case, without noise. A plant whose episode ends early, or whose tip is once more than
`CAP_MM` off, counts as that; "lost" in the file says how many.

Nothing is tuned on the robot: both policies have the weights of the two-joint arm of Table 1, softened for robots as
`weights_for` and `adaptive_weights_for` do it.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium as gym
import numpy as np
from adaptive_cases import CAP_MM, NOISE, episode
from measuring import options_of, write

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.cases import PAPER_CASES, case_for
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout

POLICIES = ("adaptive-observer", "elastic-observer")
METRICS = "tip_error_max_mm", "tip_error_max_mid_mm", "tip_error_rms_mm"
SEED, PLANTS = 600000, 20


def cases(robot: Robot) -> list[dict[str, Any]]:
    """Return the tip errors of the three cases, without and with noise."""
    rows = []
    for name in POLICIES:
        policy = load_policy(name, robot=robot)
        for noise in (None, NOISE):
            for case in PAPER_CASES:
                load = dataclasses.replace(case_for(case, robot).disturbance, encoder_noise=noise)
                env = FuzzyArmEnv(robot=robot, disturbance=load)
                run = record_rollout(env, policy, policy_name=name, case=case, seed=0)
                metrics = {key: metrics_of(run)[key] for key in METRICS}
                row = {"policy": name, "case": case, "noise": noise is not None, "completed": run.completed, **metrics}
                rows.append(row)
                print(row, flush=True)
    return rows


def plants(robot: Robot, count: int) -> list[dict[str, Any]]:
    """Return the largest tip errors of random plants."""
    rows = []
    for case in PAPER_CASES:
        load = case_for(case, robot).disturbance
        envs = gym.make_vec("FuzzyArm-v0", num_envs=count, robot=robot, disturbance=load, randomisation="plants")
        for name in POLICIES:
            errors, _ = episode(load_policy(name, robot=robot), envs, SEED, np.zeros(count, dtype=int), 1.0, None)
            numbers = {
                "median_mm": float(np.median(errors)),
                "worst_mm": float(errors.max()),
                "lost": int((errors >= CAP_MM).sum()),
            }
            rows.append({"policy": name, "case": case, "plants": count, **numbers})
            print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("robot", nargs="?", default="ur5", help="name of a robot that comes with fuzzyarm")
    parser.add_argument("--plants", type=int, default=PLANTS, metavar="N", help=f"in each case (default: {PLANTS})")
    options = parser.parse_args()
    robot = robot_named(options.robot)
    found = {"robot": options.robot, "seed": SEED, "lost_mm": CAP_MM, "cases": cases(robot)}
    found["plants"] = plants(robot, options.plants)
    write(options.json, f"adaptive_robot.py {options.robot} --plants {options.plants}", **found)


if __name__ == "__main__":
    main()
