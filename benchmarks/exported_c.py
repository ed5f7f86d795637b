"""Exported C against its policies: bits over a million ticks, what a call takes on Cortex-M, and what float costs.

    python benchmarks/exported_c.py [--ticks N] [--laws NAME...] [--json FILE]

Half of the ticks are random states, see `fuzzyarm.export.c_files`, the other half closed loops of arms of the ranges
"robust" along the paper's circle. Torques and the last memories of C and Python are compared as 64 bits. A part of the
ticks runs on a Cortex-M7 and a Cortex-M4F of QEMU, which counts instructions and the stack of the deepest call
(``cortex_m.c``). With float, 300 calls of closed loops are compared, each from the same memory. Half an hour; with
--laws only these rows of FILE are replaced. With FILE, ``fuzzyarm/export/cortex_m.json`` is written, for headers.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measuring import options_of, printed, write_rows

from fuzzyarm import load_policy
from fuzzyarm.envs.vector import FuzzyArmVectorEnv
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.export.c_files import COSTS, compilers, digest_of, export_c
from fuzzyarm.export.c_files import _CompiledLaw as CompiledLaw
from fuzzyarm.export.c_files import _random_observations as random_observations
from fuzzyarm.fuzzy_policy.policy import Policy

LAWS = (
    *("fuzzy-4", "fuzzy-32", "computed-torque", "fuzzy-4-tip", "computed-torque-tip", "elastic-observer"),
    *("adaptive-observer", "ppo-nominal", "ppo-robust", "ppo-residual", "learned-observer"),
)
LANES, FLOAT_CALLS = 250, 300
CORES = {
    "Cortex-M7": ("mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16"), (13, None)),
    "Cortex-M4F": ("mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"), (1, 500)),
}
"""By core QEMU's machine, the compiler's flags, and how many lanes and calls of each run on it."""
Sets = dict[str, tuple[np.ndarray, np.ndarray]]
GCC = (
    *("arm-none-eabi-gcc", "-std=gnu99", "-O2", "-mthumb", "-mfloat-abi=hard", "-ffp-contract=off", "-nostartfiles"),
    *("-Wl,-e,run,--section-start=.vectors=0,-Ttext=0x400,-Tdata=0x20000000,-Tbss=0x20200000",),
)
QEMU = ("qemu-system-arm", "-nographic", "-semihosting-config", "enable=on,target=native", "-icount", "shift=6")


def random_ticks(policy: Policy, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Return observations (calls, lanes, 10) and where an episode begins (calls, lanes), at random states."""
    calls = ticks // LANES
    seen = np.stack([random_observations(policy, calls, seed) for seed in range(LANES)], axis=1)
    starts = np.zeros(seen.shape[:2], dtype=bool)
    starts[::500] = True
    return seen, starts


def loop_ticks(policy: Policy, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Return observations and starts of closed loops."""
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


def on_core(core: str, number: str, policy: Policy, folder: Path, calls: np.ndarray) -> tuple[dict[str, Any], Any]:
    """Return the cost of a law on one of `CORES`, and its torques (calls, n) [N m]; `calls` as in ``cortex_m.c``."""
    (machine, flags, _), kind, joints = CORES[core], {"double": np.float64, "float": np.float32}[number], policy.joints
    (aside := folder / f"{core}-{number}").mkdir()
    source = export_c("law", policy, aside, number)[1]
    calls.astype(kind).tofile(aside / "calls.bin")
    words = [*GCC, *flags, f"-DREAL={number}", f"-DINPUTS={5 * joints}", f"-DJOINTS={joints}", f"-I{aside}"]
    said([*words, "-c", str(source)], aside)
    said([*words, str(Path(__file__).with_name("cortex_m.c")), "law.o", "-o", "law.elf"], aside)
    said([*QEMU, "-M", machine, "-kernel", "law.elf"], aside)
    *found, last = np.fromfile(aside / "found.bin", dtype=kind).reshape(-1, joints + 2).astype(float)
    torque, status, counted = np.split(np.array(found), [joints, joints + 1], axis=1)
    assert len(counted) == len(calls) and not status.any()
    (flash, *_), (_, _, state, *_) = map(str.split, said(["arm-none-eabi-size", "law.o", "law.elf"], aside)[1:])
    row = {"sha256": digest_of(source.read_text(encoding="utf-8"), "law"), "calls": len(calls)}
    row |= {"flash": int(flash), "stack": int(last[-1]), "state": int(state)}
    row |= {"mean": round(counted.mean()), "largest": int(counted.max())}
    return row, torque


def cortex(policy: Policy, folder: Path, sets: Sets, expected: Sets) -> dict[str, Any]:
    """Return the cost of a law by core and type of its numbers."""
    costs: dict[str, Any] = {}
    for core, (*_, (lanes, most)) in CORES.items():
        parts = [[part[:most, :lanes].swapaxes(0, 1) for part in pair] for pair in sets.values()]
        calls = np.concatenate([np.dstack([starts, seen]) for seen, starts in parts]).reshape(-1, 1 + 5 * policy.joints)
        torques = np.concatenate([one[:most, :lanes].swapaxes(0, 1) for one, _ in expected.values()])
        costs[f"{core} double"], found = on_core(core, "double", policy, folder, calls)
        costs[f"{core} double"]["differing"] = differing(found.copy(), torques.reshape(found.shape))
        with contextlib.suppress(ValueError):  # of no use in float
            costs[f"{core} float"], _ = on_core(core, "float", policy, folder, calls)
    return costs


def said(words: Sequence[str], folder: Path | None = None) -> list[str]:
    """Return the lines that a command prints."""
    return subprocess.run(words, check=True, stdout=-1, text=True, stdin=-3, cwd=folder).stdout.splitlines()


def assess(name: str, ticks: int) -> dict[str, Any]:
    """Return the row of a law."""
    policy = load_policy(name)
    sets = {"random": random_ticks(policy, ticks // 2), "closed loop": loop_ticks(policy, ticks // 2)}
    expected = {key: answers(policy, *pair) for key, pair in sets.items()}
    row: dict[str, Any] = {"law": name, "commit": current_provenance()["commit"], "differing": 0}
    row["ticks"] = sum(starts.size for _, starts in sets.values())
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for compiler in compilers():
            _, source, _ = export_c(name, policy, folder)
            law = CompiledLaw(source, policy.joints, policy.memory_size, "double", compiler)
            for key, pair in sets.items():
                row["differing"] += sum(map(differing, law.run(*pair), expected[key]))
        row["cortex"] = cortex(policy, folder, sets, expected)
        row["float"] = None
        if "Cortex-M7 float" in row["cortex"]:
            _, source, _ = export_c("single", policy, folder, "float")
            single = CompiledLaw(source, policy.joints, policy.memory_size, "float", compilers()[0])
            error = float_errors(policy, single, *sets["closed loop"])
            row["float"] = {"torque_rms": float(np.sqrt(np.mean(error**2))), "torque_max": float(error.max())}
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
    parser.add_argument("--laws", nargs="+", default=LAWS, metavar="NAME", help="which; any policy (default: LAWS)")
    options = parser.parse_args()
    if missing := [one for one in (GCC[0], QEMU[0]) if not shutil.which(one)]:
        parser.error(f"there is no {missing[0]}: apt install gcc gcc-arm-none-eabi qemu-system-arm")
    rows = printed(assess(name, options.ticks) for name in options.laws)
    made = {name: said([name, "--version"])[0] for name in (*compilers(), GCC[0], QEMU[0])}
    write_rows(options.json, "exported_c.py", rows, LAWS, lambda row: row["law"], compilers=made)
    if options.json:
        found = json.loads(options.json.read_text(encoding="utf-8"))
        versions = f"{found['compilers'][GCC[0]]}, -O2; {found['compilers'][QEMU[0]]}"
        costs = {"made": versions, "laws": {row["law"]: row["cortex"] for row in found["rows"]}}
        COSTS.write_text(json.dumps(costs, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
