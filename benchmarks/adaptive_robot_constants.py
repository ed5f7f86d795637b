"""The two numbers of the adaptive observer that differ on a robot, chosen under random loads.

    python benchmarks/adaptive_robot_constants.py [ROBOT] [--json FILE] [--loads N]

The numbers are the largest share of a sample in the noise that is read, and the c from which on a load is significant.
Each pair of `SHARES` and `SIGNIFICANT` meets the known robot on its default path under N loads: a constant force of
random direction and size, from a random instant on, and a random payload, up to those that the cases have. Each load is
met twice, without and with encoder noise, in two passes over the path. The objective is the mean of all largest tip
errors, and a tenth of the worst; the pair with the smallest is chosen. No case with a load is run.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from fuzzyarm import load_policy
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.physics.robot import Robot, robot_named
from fuzzyarm.envs.scenario.cases import case_for
from fuzzyarm.envs.scenario.default_reference import default_reference
from fuzzyarm.envs.scenario.disturbances import ConstantForce, Disturbance, EncoderNoise
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.tuning.adaptive_search import CAP, NOISE, TAIL

SHARES, SIGNIFICANT = (0.01, 0.03, 0.1, 1.0), (0.0, 1.25)
SEED, LOADS, PASSES = 41, 12, 2


def loads(robot: Robot, count: int, noise: EncoderNoise | None) -> list[Disturbance]:
    """Return random loads, the same ones with and without noise."""
    generator, found = np.random.default_rng(SEED), []
    force: Any = case_for("machining", robot).disturbance.tip_force
    heaviest = case_for("payload", robot).disturbance.payload.mass
    duration = default_reference(robot).duration
    for _ in range(count):
        direction = generator.normal(size=3)
        size = generator.uniform(0.0, force.base + force.swing)
        push = ConstantForce(
            tuple(size * direction / np.linalg.norm(direction)), generator.uniform(0.0, 0.5 * duration)
        )
        found.append(Disturbance(push, Payload(generator.uniform(0.0, heaviest)), encoder_noise=noise))
    return found


def largest_errors(policy: Any, envs: Any, count: int) -> list[np.ndarray]:
    """Return the largest tip errors (loads,) [mm] of each pass, `CAP` at most."""
    acting, state, errors = policy.repeated(), None, []
    for number in range(PASSES):
        observation, _ = envs.reset(seed=SEED + number)
        state = None if state is None else acting.begin_pass(state)
        largest, running = np.zeros(count), np.ones(count, dtype=bool)
        while running.any():
            torque, state = acting.predict(observation, state)
            observation, _, terminated, truncated, info = envs.step(torque)
            live = running & ~terminated & ~truncated
            largest[live] = np.maximum(largest, 1e3 * info["tip_error"])[live]
            largest[running & terminated] = CAP
            running &= ~(terminated | truncated)
        errors.append(np.minimum(largest, CAP))
    return errors


def measure(robot: Robot, count: int) -> list[dict[str, Any]]:
    """Return the objective and its parts for every pair."""
    policy: Any = load_policy("adaptive-observer", robot=robot)
    noises = {"without noise": None, "with noise": NOISE}
    envs = {
        name: gym.make_vec("FuzzyArm-v0", num_envs=count, robot=robot, disturbance=loads(robot, count, noise))
        for name, noise in noises.items()
    }
    rows = []
    for share, significant in itertools.product(SHARES, SIGNIFICANT):
        policy.settings = policy.settings._replace(first_share=share, insignificant=significant**2)
        errors = {name: largest_errors(policy, one, count) for name, one in envs.items()}
        means = {name: [float(passed.mean()) for passed in found] for name, found in errors.items()}
        every = np.array(list(errors.values()))
        objective = float(every.mean() + TAIL * every.max())
        rows.append({"share": share, "c": significant, "mean_mm": means, "objective_mm": objective})
        rows[-1] |= {"worst_mm": float(every.max()), "capped": int((every >= CAP).sum())}
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="ur5", help="name or file (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--loads", type=int, default=LOADS, metavar="N", help="default: %(default)s")
    options = parser.parse_args()
    robot = robot_named(options.robot)
    rows = measure(robot, options.loads)
    chosen = min(rows, key=lambda row: row["objective_mm"])
    print("chosen:", chosen["share"], chosen["c"])
    if options.json:
        command = f"python benchmarks/adaptive_robot_constants.py {options.robot} --loads {options.loads}"
        document = {
            "command": command,
            **current_provenance(),
            "robot": robot.name,
            "seed": SEED,
            "loads": options.loads,
        }
        document |= {"chosen": {"share": chosen["share"], "c": chosen["c"]}, "rows": rows}
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
