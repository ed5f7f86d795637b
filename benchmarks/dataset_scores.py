"""Scores of behaviour cloning and of TD3+BC on the data sets of `fuzzyarm dataset`.

python benchmarks/dataset_scores.py [--seconds 60] [--levels expert mixed] [--conditions nominal loads] [--json FILE]

Writes the data sets to a temporary folder, runs examples/clone_policy.py and examples/offline_td3_bc.py on each for the
same processor time of learning, and writes FILE after every run.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from measuring import options_of, write

from fuzzyarm.eval.dataset.config import CONDITIONS, LEVELS, DatasetConfig
from fuzzyarm.eval.dataset.store import open_dataset, provenance_of, write_dataset

ROOT = Path(__file__).parent.parent
LEARNERS = {"behaviour cloning": "clone_policy.py", "TD3+BC": "offline_td3_bc.py"}
FOUND = r"N (\S+), mean tip error (\S+) mm, (\d+) of (\d+) episodes"


def scored(script: str, folder: Path, seconds: float, seed: int) -> dict[str, Any]:
    """Return N, mean tip error [mm] and the share of episodes that a learner's policy completes."""
    command = [sys.executable, str(ROOT / "examples" / script), str(folder), "--seconds", str(seconds)]
    done = subprocess.run([*command, "--seed", str(seed)], capture_output=True, text=True, check=True)
    found = re.search(FOUND, done.stdout)
    if found is None:
        raise ValueError(f"{script} printed no score: {done.stdout[-300:]}")
    score, error, completed, episodes = map(float, found.groups())
    return {"seed": seed, "score": score, "tip_error_mm": error, "completed": int(completed), "of": int(episodes)}


def of_data(folder: Path) -> dict[str, Any]:
    """Return what the data itself has."""
    dataset = open_dataset(folder)
    return {"steps": int(dataset.total_steps), "score": provenance_of(dataset)["N"]}


def main() -> None:
    """Measure and write."""
    parser = options_of(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--levels", nargs="+", default=list(LEVELS), choices=list(LEVELS))
    parser.add_argument("--conditions", nargs="+", default=list(CONDITIONS), choices=list(CONDITIONS))
    arguments = parser.parse_args()
    lists = {name: " ".join(map(str, getattr(arguments, name))) for name in ("seeds", "levels", "conditions")}
    words = " ".join(f"--{name} {values}" for name, values in lists.items())
    command = f"dataset_scores.py --seconds {arguments.seconds:g} {words}"
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as work:
        for level in arguments.levels:
            for condition in arguments.conditions:
                config = DatasetConfig(level=level, condition=condition)
                folder = write_dataset(config, Path(work))
                row = {"data": of_data(folder), "learners": {name: [] for name in LEARNERS}}
                rows[config.name] = row
                for seed in arguments.seeds:
                    for name, script in LEARNERS.items():
                        row["learners"][name].append(scored(script, folder, arguments.seconds, seed))
                        print(config.name, name, row["learners"][name][-1], flush=True)
                        write(arguments.json, command, seconds=arguments.seconds, rows=rows)


if __name__ == "__main__":
    main()
