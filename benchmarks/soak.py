"""Soak: 1e8 env-steps of random and as many of controlled actions, without a number that is not finite.

Every episode draws its plant, load, start and reference (randomisation "robust", machining force). Sensors are noisy,
and lanes reset themselves. The memory in use is recorded and must not grow. `python benchmarks/soak.py [--json FILE]`
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from measuring import options_of, printed, write
from rich.console import Console
from rich.progress import track

from fuzzyarm import load_policy
from fuzzyarm.envs.scenario.disturbances import Disturbance, EncoderNoise, MachiningForce

LANES = 4096
NOISY_MACHINING = Disturbance(tip_force=MachiningForce(), encoder_noise=EncoderNoise(1e-5, 1e-3))


def main() -> None:
    """Run both kinds, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("--steps", type=float, default=1e8, help="env-steps of each kind (default: 1e8)")
    options = parser.parse_args()
    if not options.steps >= 10 * LANES:
        parser.error(f"--steps {options.steps:g} is out of range; allowed: {10 * LANES} or more")
    kinds = {"random torques": random_torques(), "fuzzy-4": controlled()}
    rows = printed(soak(name, act, options.steps) for name, act in kinds.items())
    write(options.json, "soak.py", lanes=LANES, seed=0, rows=rows)


def random_torques() -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return torques drawn from the whole action space, a tenth of them far beyond it."""
    generator, limit = np.random.default_rng(0), np.array([500.0, 250.0])

    def act(observation: np.ndarray, _: np.ndarray) -> np.ndarray:
        beyond = np.where(generator.random(len(observation)) < 0.1, 1e6, 1.0)[:, np.newaxis]
        return beyond * limit * generator.uniform(-1.0, 1.0, (len(observation), 2))

    return act


def controlled() -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the shipped 4-rule controller, its memory begun again with every episode."""
    policy, memory = load_policy("fuzzy-4"), None

    def act(observation: np.ndarray, begun: np.ndarray) -> np.ndarray:
        nonlocal memory
        torque, memory = policy.predict(observation, memory, episode_start=begun)
        return torque

    return act


def soak(name: str, act: Callable[[np.ndarray, np.ndarray], np.ndarray], steps: float) -> dict[str, Any]:
    """Step until `steps` env-steps are done; raise ArithmeticError at the first number that is not finite."""
    envs = gym.make_vec("FuzzyArm-v0", num_envs=LANES, disturbance=NOISY_MACHINING, randomisation="robust")
    observation, _ = envs.reset(seed=0)
    begun, episodes, reasons, memory = np.ones(LANES, dtype=bool), 0, {}, []
    rounds, begin = int(np.ceil(steps / LANES)), time.perf_counter()
    for k in track(range(rounds), description=f"{name}, {steps:.0e} env-steps", console=Console(stderr=True)):
        observation, reward, terminated, truncated, info = envs.step(act(observation, begun))
        if not (np.isfinite(observation).all() and np.isfinite(reward).all() and np.isfinite(info["tip"]).all()):
            raise ArithmeticError(f"{name}: a number is not finite after {k} control steps")
        begun = terminated | truncated
        episodes += int(begun.sum())
        if terminated.any():
            for reason in info["final_info"]["reason"][terminated]:
                reasons[reason] = reasons.get(reason, 0) + 1
        if k % max(1, rounds // 20) == 0:
            memory.append(resident())
    return {
        "actions": name,
        "env_steps": rounds * LANES,
        "seconds": round(time.perf_counter() - begin, 1),
        "episodes": episodes,
        "terminated": reasons,
        "resident_MB": memory,
    }


def resident() -> float | None:
    """Return the memory of this process [MB]; None where the system does not tell this way."""
    if not Path("/proc/self/statm").exists():
        return None
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return round(pages * 4096 / 1e6, 1)


if __name__ == "__main__":
    main()
