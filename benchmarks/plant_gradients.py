"""Learning by gradients through the arm beside PPO, at equal processor time, on one task and one kind of network.

python benchmarks/plant_gradients.py [--seconds 60] [--seeds 0 1 2] [--resume]

Runs examples/train_gradients.py and examples/train_torch.py (PPO), which learn to follow the paper's circle with
torques held for 10 ms, each for the same processor time of learning, in turns; one episode without exploration at the
end gives the figure. Setting up, which for the gradients includes compiling, is counted apart. Writes
benchmarks/results/plant_gradients.json after every run.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

from fuzzyarm.common.files import write_atomically
from fuzzyarm.eval.provenance import current_provenance

ROOT = Path(__file__).parent.parent
RESULT = ROOT / "benchmarks" / "results" / "plant_gradients.json"
LEARNERS = {"gradients through the arm": "train_gradients.py", "PPO": "train_torch.py"}
UNLIMITED = 10**9  # steps


def measured(script: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return steps, tip error [mm] and processor time [s] of a run."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, str(ROOT / "examples" / script), str(UNLIMITED), "--seconds", str(seconds)]
    done = subprocess.run([*command, "--seed", str(seed)], capture_output=True, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = re.search(r"after (\d+) steps .*: mean tip error (\S+) mm", done.stdout)
    if found is None:
        raise ValueError(f"{script} printed no result: {done.stdout[-300:]}")
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seed": seed, "steps": int(found[1]), "tip_error_mm": float(found[2]), "cpu_s": round(spent, 1)}


def main() -> None:
    """Run what is missing and write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--resume", action="store_true", help="keep the runs of a result that was begun")
    arguments = parser.parse_args()
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in LEARNERS}
    if arguments.resume:
        runs = json.loads(RESULT.read_text(encoding="utf-8"))["runs"]
    for seed in arguments.seeds:
        for name, script in LEARNERS.items():
            if seed not in [run["seed"] for run in runs[name]]:
                runs[name].append(measured(script, seed, arguments.seconds))
                print(name, runs[name][-1], flush=True)
                write(arguments.seconds, runs)
    write(arguments.seconds, runs)


def write(seconds: float, runs: dict[str, list[dict[str, Any]]]) -> None:
    """Write the result with the command that gives it."""
    seeds = " ".join(str(run["seed"]) for run in next(iter(runs.values())))
    command = f"python benchmarks/plant_gradients.py --seconds {seconds:g} --seeds {seeds}"
    content = {"command": command, "seconds": seconds, "runs": runs, **current_provenance()}
    write_atomically(RESULT, json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
