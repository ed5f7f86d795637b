"""Make the README's tables and every figure of the documentation from the stored results, and record what they show.

    python benchmarks/readme.py             from the results in benchmarks/results (two to three minutes)
    python benchmarks/readme.py --measure   measure everything again first, which takes hours

Pages make their tables from the same results when they are built. `published.json` records the digests of results,
figures and the policies in them. Measure with a clean checkout: the record reads the policies of a result from the
commit that the result names. The tables of finished studies, whose scripts are in the history, are in `studies`.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from figures import FIGURES
from measuring import RESULTS, stored
from published import publish
from tables_adaptive import ADAPTIVE
from tables_comparison import COMPARISON
from tables_estimate import ESTIMATE
from tables_proofs import PROOFS
from tables_results import EVALUATIONS, README, on_the_circle
from tables_robots import COMPARED_ROBOTS, ROBOTS
from tables_tools import TOOLS

ROOT = Path(__file__).parent.parent
BENCHMARKS = ROOT / "benchmarks"
NEAR_BOUNDS = ROOT / "fuzzyarm" / "eval" / "evaluation" / "near_bounds.json"
OBSERVERS = ("elastic-observer", "adaptive-observer", "learned-observer")
"""Policies of the sweeps of plants with noise and delays, one sweep each."""
SWEPT = ("fuzzy-4", "fuzzy-4-tip", "computed-torque-tip", "ppo-residual", *OBSERVERS)
"""Policies of the sweep of plants with loads, by which policies are ranked."""
SCRIPTS = (
    *("learned_comparison", "accuracy", "tip_feedforward", "identification", "exported_c"),
    *("adaptive_cases", "own_arms", "synthesis --large", "certified_bounds", "tip_bound"),
    *("tip_falsification", "comparison", "learning_curves", "robot_speed", "mujoco_arm", "soak"),
)
"""Benchmarks, with options, that write their result of the same name with ``--json``."""


def main() -> None:
    """Measure if asked to, then write figures, record and README."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measure", action="store_true", help="measure everything again first")
    if parser.parse_args().measure:
        measure()
    publish(FIGURES)
    NEAR_BOUNDS.write_text(json.dumps(near_bounds(), indent=1) + "\n", encoding="utf-8")
    readme = ROOT / "README.md"
    readme.write_text(fill(readme.read_text(encoding="utf-8")), encoding="utf-8")


def near_bounds() -> dict[str, Any]:
    """Return the bounds for arms near Table 1 [mm] that `fuzzyarm evaluate` shows, with the files that they are of."""
    document, published = stored("tip_bound"), json.loads((BENCHMARKS / "published.json").read_text(encoding="utf-8"))
    made = published["results"]["tip_bound"]["policies"]
    rows = [row for row in on_the_circle(document) if row["set"] == "near" and row["policy"] in made[row["commit"]]]
    bounds = {row["policy"]: {"bound_mm": row["bound_mm"], **made[row["commit"]][row["policy"]]} for row in rows}
    return {"command": document["command"], "bounds": bounds}


def measure() -> None:
    """Run all commands and benchmarks, and keep their results; those of trainings are run by hand."""
    RESULTS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _fuzzyarm("evaluate", "--out", folder)
        shutil.copy(folder / "results.json", RESULTS / "evaluate.json")
        _fuzzyarm("bench", "--lanes-sweep", "--out", folder)
        shutil.copy(folder / "bench.json", RESULTS / "bench.json")
        _fuzzyarm("score", "--out", RESULTS / "score.json")
        plants = ("--plants", "10000", "--seed", "200000")
        policies = [word for policy in SWEPT for word in ("--policy", policy)]
        _fuzzyarm("sweep", *policies, "--distribution", "loads", *plants, "--out", folder / "sweep")
        shutil.copy(folder / "sweep" / "sweep.json", RESULTS / "sweep.json")
        for policy in OBSERVERS:
            _fuzzyarm("sweep", "--policy", policy, "--distribution", "all", *plants, "--out", folder / policy)
            shutil.copy(folder / policy / "sweep.json", RESULTS / f"{policy.split('-')[0]}_all.json")
    _fuzzyarm("margins", "--out", RESULTS / "margins.json")
    _python("-m", "tests.mutants")
    for name in COMPARED_ROBOTS:
        _benchmark(f"robot_comparison {name}", f"robot_comparison_{name}")
    _benchmark("robot_comparison panda --friction 10", "robot_friction_panda")
    _benchmark("adaptive_robot ur5", "adaptive_robot_ur5")
    folders = sorted(path.relative_to(ROOT).as_posix() for path in BENCHMARKS.glob("learned/ppo-ur5-*"))
    _benchmark(f"robot_learned ur5 {' '.join(folders)}", "robot_learned_ur5")
    for words in SCRIPTS:
        _benchmark(words, words.split()[0])


def _benchmark(words: str, result: str) -> None:
    """Run a script with options and write its result."""
    name, *options = words.split()
    _python(BENCHMARKS / f"{name}.py", *options, "--json", RESULTS / f"{result}.json")


def _fuzzyarm(*arguments: str | Path) -> None:
    _python("-m", "fuzzyarm", *arguments)


def _python(*arguments: str | Path) -> None:
    subprocess.run([sys.executable, *map(str, arguments)], check=True)


def fill(text: str) -> str:
    """Return the README with each marked section replaced."""
    for name, content in readme_sections().items():
        begin, end = f"<!-- {name}: begin (python benchmarks/readme.py) -->", f"<!-- {name}: end -->"
        before, rest = text.split(begin)
        _, after = rest.split(end)
        text = before + begin + "\n" + content + "\n" + end + after
    return text


def readme_sections() -> dict[str, str]:
    """Return the marked sections of the README from the stored results."""
    return {name: section.text(stored) for name, section in README.items()}


def sections() -> dict[str, str]:
    """Return the tables of the documentation by the name that its directive gives them."""
    studies = {path.stem: path.read_text(encoding="utf-8") for path in (BENCHMARKS / "studies").glob("*.md")}
    tables = {**EVALUATIONS, **COMPARISON, **ADAPTIVE, **ESTIMATE, **PROOFS, **ROBOTS, **TOOLS}
    return studies | {name: section.text(stored) for name, section in tables.items()}


if __name__ == "__main__":
    main()
