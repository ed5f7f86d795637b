"""Exported C against its policies: bits over a million ticks, the time of a tick, and what float costs.

    python benchmarks/exported_c.py [--ticks N] [--laws NAME...] [--json FILE]

Half of the ticks are random states, see `fuzzyarm.export.c_files`, the other half closed loops: arms with random
masses, friction, stiffness, payloads and starts (the package's ranges "robust") that the policy leads along the paper's
circle. The torques of C and of Python are compared as 64 bits, and so is what both remember at the end, with every
compiler that is there. The time of a tick is that of a call in a loop of 1000, for 300 such loops, beside that of
`predict` of one arm. With float, a call from the same memory is compared, in the first 300 calls of the closed loops,
and the nominal case is run with the float law in it.
Twenty minutes, most of them for adaptive-observer. With --laws only these are assessed, and in FILE only their rows are
replaced; each row says at which commit it was measured.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measuring import options_of, printed, write_rows

from fuzzyarm import load_policy
from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.export.c_files import _CompiledLaw as CompiledLaw
from fuzzyarm.export.c_files import compilers
from fuzzyarm.export.c_files import _random_observations as random_observations
from fuzzyarm.export.c_files import export_c
from fuzzyarm.fuzzy_policy.policy import Policy

LAWS = (
    *("fuzzy-4", "fuzzy-32", "computed-torque", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer"),
    *("adaptive-observer", "ppo-nominal", "ppo-robust", "ppo-residual", "learned-observer"),
)
LANES, LOOP, LOOPS, FLOAT_CALLS = 250, 1000, 300, 300


def random_ticks(policy: Policy, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Return observations (calls, lanes, 10) and where an episode begins (calls, lanes), at random states."""
    calls = ticks // LANES
    seen = np.stack([random_observations(policy, calls, seed) for seed in range(LANES)], axis=1)
    starts = np.zeros(seen.shape[:2], dtype=bool)
    starts[::500] = True
    return seen, starts


def loop_ticks(policy: Policy, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of closed loops."""
    envs = FuzzyArmVectorEnv(LANES, randomisation="robust")
    observation, _ = envs.reset(seed=0)
    seen, starts, state, begins = [], [], None, np.ones(LANES, dtype=bool)
    for _ in range(ticks // LANES):
        seen.append(observation.copy())
        starts.append(begins)
        torque, state = policy.predict(observation, state, begins)
        observation, _, terminated, truncated, _ = envs.step(torque)
        begins = np.asarray(terminated | truncated)
    return np.array(seen), np.array(starts)


def answers(policy: Policy, seen: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return torques (calls, lanes, 2) [N m] and the last memories of the policy itself."""
    torques, state = np.empty((*starts.shape, 2)), None
    for call, (observation, start) in enumerate(zip(seen, starts, strict=True)):
        torques[call], state = policy.predict(observation, state, start)
    assert state is not None
    return torques, state


def differing(first: np.ndarray, second: np.ndarray) -> int:
    """Return how many numbers differ in a bit."""
    return int(np.count_nonzero(first.view(np.int64) != second.view(np.int64)))


def seconds_per_tick(law: CompiledLaw, seen: np.ndarray) -> list[float]:
    """Return the mean times of a tick in each loop [s]."""
    starts, times = np.zeros((LOOP, 1), dtype=bool), []
    starts[0] = True
    chosen = np.resize(seen[:, 0], (LOOP, 1, seen.shape[-1]))
    for _ in range(LOOPS):
        begin = time.perf_counter()
        law.run(chosen, starts)
        times.append((time.perf_counter() - begin) / LOOP)
    return times


def python_seconds(policy: Policy, seen: np.ndarray) -> float:
    """Return the median time of `predict` for one arm [s]."""
    state, times = None, []
    for observation in seen[:LOOP, 0]:
        begin = time.perf_counter()
        _, state = policy.predict(observation, state)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def assess(name: str, ticks: int) -> dict[str, Any]:
    """Return the row of a law."""
    policy = load_policy(name)
    sets = {"random": random_ticks(policy, ticks // 2), "closed loop": loop_ticks(policy, ticks // 2)}
    expected = {key: answers(policy, *pair) for key, pair in sets.items()}
    row: dict[str, Any] = {"law": name, "commit": current_provenance()["commit"], "ticks": 0}
    row |= {"differing": {}, "nanoseconds": {}}
    loop = sets["closed loop"]
    with tempfile.TemporaryDirectory() as folder:
        for compiler in compilers():
            _, source, _ = export_c(name, policy, Path(folder))
            law = CompiledLaw(source, policy.joints, policy.memory_size, "double", compiler)
            row["differing"][compiler] = 0
            for key, pair in sets.items():
                found = law.run(*pair)
                row["differing"][compiler] += sum(map(differing, found, expected[key]))
            times = 1e9 * np.array(seconds_per_tick(law, loop[0]))
            p5, median, p95, most = np.percentile(times, (5, 50, 95, 100)).tolist()
            row["nanoseconds"][compiler] = {"p5": p5, "median": median, "p95": p95, "max": most}
        row["ticks"] = sum(starts.size for _, starts in sets.values())
        row["at_limit"] = float(np.mean([(np.abs(t) >= [500.0, 250.0]).any(-1).mean() for t, _ in expected.values()]))
        row["python_nanoseconds"] = 1e9 * python_seconds(policy, loop[0])
        try:
            (aside := Path(folder) / "float").mkdir()
            _, source, _ = export_c(name, policy, aside, "float")
        except ValueError as refusal:  # of no use in float
            print(refusal)
            return row | {"float": None}
        single = CompiledLaw(source, policy.joints, policy.memory_size, "float", compilers()[0])
        error = float_errors(policy, single, *loop)
        row["float"] = {"torque_rms": float(np.sqrt(np.mean(error**2))), "torque_max": float(error.max())}
        for key, one in (("tip_double_mm", policy), ("tip_float_mm", single)):
            values = metrics_of(record_rollout(FuzzyArmEnv(), one, policy_name=name, case="nominal", seed=0))
            row["float"][key] = values["tip_error_max_mm"]
    return row


def float_errors(policy: Policy, single: CompiledLaw, seen: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return how far the torques of the float law are off (calls, lanes, 2) [N m], each call from the same memory."""
    errors, state = [], np.zeros((LANES, policy.memory_size))
    for observation, start in zip(seen[:FLOAT_CALLS], starts[:FLOAT_CALLS], strict=True):
        own, _ = single.run(observation[np.newaxis], start[np.newaxis], state)
        torque, state = policy.predict(observation, state, start)
        errors.append(np.abs(own[0] - torque))
    return np.array(errors)


def main() -> None:
    """Assess all laws, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("--ticks", type=int, default=1_000_000, metavar="N", help="ticks of each law")
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=LAWS, help="which (default: all)")
    options = parser.parse_args()
    if not compilers():
        parser.error("there is no C compiler: install gcc or clang")
    rows = printed(assess(name, options.ticks) for name in options.laws)
    write_rows(options.json, "exported_c.py", rows, LAWS, lambda row: row["law"], compilers=versions())


def versions() -> dict[str, str]:
    """Return the first line of what each compiler says of itself."""
    return {
        name: subprocess.run([name, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
        for name in compilers()
    }


if __name__ == "__main__":
    main()
