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

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.cases import PAPER_CASES, case_for
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.provenance import current_provenance

POLICIES, NOISE = ("adaptive-observer", "elastic-observer"), EncoderNoise(position=1e-5, velocity=1e-3)
METRICS = "tip_error_max_mm", "tip_error_max_mid_mm", "tip_error_rms_mm"
SEED, PLANTS, CAP_MM = 600000, 20, 50.0


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
            errors = largest_errors(load_policy(name, robot=robot), envs, count)
            numbers = {
                "median_mm": float(np.median(errors)),
                "worst_mm": float(errors.max()),
                "lost": int((errors >= CAP_MM).sum()),
            }
            rows.append({"policy": name, "case": case, "plants": count, **numbers})
            print(rows[-1], flush=True)
    return rows


def largest_errors(policy: Any, envs: Any, count: int) -> np.ndarray:
    """Return the largest tip error of each lane (count,) [mm], `CAP_MM` at most."""
    observation, _ = envs.reset(seed=SEED)
    largest, running, state = np.zeros(count), np.ones(count, dtype=bool), None
    while running.any():
        action, state = policy.predict(observation, state)
        observation, _, terminated, truncated, info = envs.step(action)
        live = running & ~terminated & ~truncated
        largest[live] = np.maximum(largest, 1e3 * info["tip_error"])[live]
        largest[running & terminated] = CAP_MM
        running &= ~(terminated | truncated)
    return np.minimum(largest, CAP_MM)


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="ur5", help="name of a robot that comes with fuzzyarm")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--plants", type=int, default=PLANTS, metavar="N", help=f"in each case (default: {PLANTS})")
    options = parser.parse_args()
    robot = robot_named(options.robot)
    found = {"robot": options.robot, "seed": SEED, "lost_mm": CAP_MM, "cases": cases(robot)}
    found["plants"] = plants(robot, options.plants)
    if options.json:
        command = f"python benchmarks/adaptive_robot.py {options.robot} --plants {options.plants}"
        document = {"command": command, **current_provenance(), **found}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
