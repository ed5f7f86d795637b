"""Make the README's tables and every figure of the documentation from the stored results, and record what they show.

    python benchmarks/readme.py             from the results in benchmarks/results (two to three minutes)
    python benchmarks/readme.py --measure   measure everything again first, which takes hours

Pages make their tables from the same results when they are built. `published.json` records the digests of results,
figures and the policies in them. Measure with a clean checkout: the record reads the policies of a result from the
commit that the result names.
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
from published import publish
from readme_adaptive import (
    adaptive_cases_table,
    adaptive_constants_table,
    adaptive_front_table,
    adaptive_margins_table,
    adaptive_noise_table,
    adaptive_passes_table,
    adaptive_plants_table,
    adaptive_robot_constants_table,
    adaptive_robot_table,
    adaptive_second_plant_table,
    adaptive_start_table,
    adaptive_swing_table,
)
from readme_arms import own_arm_tables, tuned_arms_table
from readme_comparison import comparison_table
from readme_design import (
    bounds_table,
    complexity_table,
    falsification_table,
    feedforward_table,
    gains_table,
    margins_table,
    synthesis_table,
    tip_bound_table,
    tip_gains_table,
    tip_gamma_table,
)
from readme_estimate import (
    estimate_front,
    estimate_parts,
    estimate_pushes,
    estimate_robot,
    estimate_seeds,
    estimate_sweeps,
    estimate_tables,
)
from readme_export import exported_table, misra_table
from readme_identification import identification_table
from readme_learning import dataset_table, gradients_table, observer_tables, training_speed_table
from readme_markdown import made_with
from readme_mutants import mutants_table
from readme_opponents import predictive_table, reward_table
from readme_results import (
    accuracy_table,
    leaderboard_table,
    learned_tables,
    markdown_table,
    overview_table,
    paper_line,
    peer_line,
    plants_leaderboard,
    saturation_table,
    soak_line,
    speed_lines,
    speed_table,
    sweep_table,
    tip_table,
)
from readme_robots import (
    robot_comparison_tables,
    robot_friction_table,
    robot_learned_table,
    robot_speed_table,
    robots_table,
)
from readme_speed import batch_threads_table, sweep_before_table

ROOT = Path(__file__).parent.parent
BENCHMARKS = ROOT / "benchmarks"
RESULTS = BENCHMARKS / "results"
OBSERVERS = ("elastic-observer", "adaptive-observer", "learned-observer")
"""Policies of the sweeps of plants with noise and delays, one sweep each."""
SWEPT = ("fuzzy-4", "fuzzy-4-tip", "computed-torque-tip", "ppo-residual", *OBSERVERS)
"""Policies of the sweep of plants with loads, by which policies are ranked."""
COMPARED_ROBOTS = ("cicese", "manutec-r3", "planar-3r", "ur5", "panda")
"""Robots whose whole comparison is measured; the documentation has what is stored of them."""
SCRIPTS: dict[str, list[str]] = {
    "learned_comparison": [],
    "accuracy": [],
    "computed_torque_tuning": [],
    "tip_feedforward": [],
    "saturation": [],
    "identification": [],
    "exported_c": [],
    "misra": [],
    "gain_choice": [],
    "observer_tuning": [],
    "adaptive_tuning": [],
    "adaptive_start": [],
    "adaptive_swing": [],
    "adaptive_constants": [],
    "adaptive_robot_constants": [],
    "adaptive_cases": [],
    "adaptive_margins": [],
    "adaptive_noise": [],
    "adaptive_plant": [],
    "estimate_front": [],
    "own_arms": [],
    "complexity": [],
    "synthesis": ["--large"],
    "certified_bounds": [],
    "tip_bound": [],
    "tip_falsification": [],
    "tip_gains": [],
    "tip_gamma": [],
    "tip_mutations": [],
    "predictive": [],
    "comparison": [],
    "classical_on_reward": [],
    "training_speed": [],
    "batch_threads": [],
    "paper_feedforward": [],
}
"""Benchmarks that write their result with ``--json``, and their other options."""
WRITTEN_OTHERWISE = (
    *("evaluate", "bench", "margins", "sweep", "sweep_before", "soak", "mujoco_arm", "mutants"),
    # of trainings, which are run by hand
    *("learned_observer", "estimate_seeds", "estimate_parts", "plant_gradients", "dataset_scores", "ppo_observer"),
)
"""Results that commands write, or benchmarks with options of their own."""


def main() -> None:
    """Measure if asked to, then write figures, record and README."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measure", action="store_true", help="measure everything again first")
    if parser.parse_args().measure:
        measure()
    publish(FIGURES)
    readme = ROOT / "README.md"
    readme.write_text(fill(readme.read_text(encoding="utf-8")), encoding="utf-8")


def measure() -> None:
    """Run all commands and benchmarks, and keep their results."""
    RESULTS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _fuzzyarm("evaluate", "--out", folder)
        shutil.copy(folder / "results.json", RESULTS / "evaluate.json")
        _fuzzyarm("bench", "--lanes-sweep", "--out", folder)
        shutil.copy(folder / "bench.json", RESULTS / "bench.json")
        plants = ("--plants", "10000", "--seed", "200000")
        policies = [word for policy in SWEPT for word in ("--policy", policy)]
        _fuzzyarm("sweep", *policies, "--distribution", "loads", *plants, "--out", folder / "sweep")
        shutil.copy(folder / "sweep" / "sweep.json", RESULTS / "sweep.json")
        for policy in OBSERVERS:
            _fuzzyarm("sweep", "--policy", policy, "--distribution", "all", *plants, "--out", folder / policy)
            shutil.copy(folder / policy / "sweep.json", _swept_by(policy))
    _fuzzyarm("margins", "--out", RESULTS / "margins.json")
    for name in ("mujoco_arm", "soak"):  # these write their results themselves
        _python(BENCHMARKS / f"{name}.py")
    _python("-m", "tests.mutants")
    for name in COMPARED_ROBOTS:
        result = RESULTS / f"robot_comparison_{name}.json"
        _python(BENCHMARKS / "robot_comparison.py", name, "--json", result)
    friction = ("panda", "--friction", "10", "--json", RESULTS / "robot_friction_panda.json")
    _python(BENCHMARKS / "robot_comparison.py", *friction)
    _python(BENCHMARKS / "adaptive_robot.py", "ur5", "--json", RESULTS / "adaptive_robot_ur5.json")
    learned = sorted(BENCHMARKS.glob("learned/ppo-ur5-*"))
    _python(BENCHMARKS / "robot_learned.py", "ur5", *learned, "--json", RESULTS / "robot_learned_ur5.json")
    _python(BENCHMARKS / "robot_speed.py", "--json", RESULTS / "robot_speed.json")
    for name, options in SCRIPTS.items():
        _python(BENCHMARKS / f"{name}.py", "--json", RESULTS / f"{name}.json", *options)


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
    return {
        "results": overview_table(_stored("evaluate"), _stored("tip_bound")),
        "speed": speed_lines(_stored("bench")),
    }


def sections() -> dict[str, str]:
    """Return the tables of the documentation from the stored results, by the name that its directive gives them."""
    stored = {name: _stored(name) for name in (*WRITTEN_OTHERWISE, *SCRIPTS)}
    return {
        "results": f"{markdown_table(stored['evaluate']['results'])}\n\n"
        f"`fuzzyarm evaluate`, 1 kHz, seed 0 (nothing is random in these cases); {made_with(stored['evaluate'])}\n\n"
        f"{paper_line(stored['evaluate'])}",
        "tip": tip_table(stored["tip_feedforward"]),
        "saturation": saturation_table(stored["saturation"]),
        "identification": identification_table(stored["identification"]),
        "exported-c": exported_table(stored["exported_c"]),
        "misra": misra_table(stored["misra"]),
        "leaderboard": leaderboard_table(RESULTS / "evaluate.json", stored["tip_bound"]),
        "leaderboard-plants": plants_leaderboard(RESULTS / "sweep.json"),
        "sweep": sweep_table(stored["sweep"]),
        "comparison": comparison_table(stored["comparison"], stored["margins"]),
        "learned": learned_tables(stored["learned_comparison"]),
        "estimate": estimate_tables(stored["learned_observer"]),
        "estimate-seeds": estimate_seeds(stored["estimate_seeds"]),
        "estimate-pushes": estimate_pushes(stored["estimate_seeds"]),
        "estimate-front": estimate_front(stored["estimate_front"]),
        "estimate-parts": estimate_parts(stored["estimate_parts"]),
        "estimate-sweeps": estimate_sweeps([_stored(_swept_by(policy).stem) for policy in OBSERVERS]),
        "estimate-robot": estimate_robot(_stored("learned_observer_planar-3r")),
        "plant-gradients": gradients_table(stored["plant_gradients"]),
        "ppo-observer": observer_tables(stored["ppo_observer"]),
        "batch-threads": batch_threads_table(stored["batch_threads"]),
        "sweep-before": sweep_before_table(stored["sweep_before"]),
        "training-speed": training_speed_table(stored["training_speed"]),
        "dataset-scores": dataset_table(stored["dataset_scores"]),
        "speed": f"{speed_table(stored['bench'])}\n\n{peer_line(stored['mujoco_arm'])} {soak_line(stored['soak'])}",
        "accuracy": accuracy_table(stored["accuracy"]),
        "margins": margins_table(stored["margins"], stored["computed_torque_tuning"]),
        "gains": gains_table(stored["gain_choice"]),
        "complexity": complexity_table(stored["complexity"]),
        "synthesis": synthesis_table(stored["synthesis"]),
        "bounds": bounds_table(stored["certified_bounds"]),
        "tip-bound": tip_bound_table(stored["tip_bound"]),
        "tip-gains": tip_gains_table(stored["tip_gains"]),
        "tip-gamma": tip_gamma_table(stored["tip_gamma"]),
        "tip-falsification": falsification_table(stored["tip_falsification"]),
        "paper-feedforward": feedforward_table(stored["paper_feedforward"]),
        "predictive": predictive_table(stored["predictive"]),
        "classical-on-reward": reward_table(stored["classical_on_reward"]),
        "mutants": mutants_table(stored["mutants"]),
        "adaptive-cases": adaptive_cases_table(stored["adaptive_cases"]),
        "adaptive-passes": adaptive_passes_table(stored["adaptive_cases"]),
        "adaptive-plants": adaptive_plants_table(
            stored["adaptive_cases"], [stored["sweep"], _stored(_swept_by("adaptive-observer").stem)]
        ),
        "adaptive-margins": adaptive_margins_table(stored["adaptive_margins"]),
        "adaptive-front": adaptive_front_table(stored["adaptive_margins"]),
        "adaptive-start": adaptive_start_table(stored["adaptive_start"]),
        "adaptive-swing": adaptive_swing_table(stored["adaptive_swing"]),
        "learned-swing": adaptive_swing_table(_stored("learned_swing")),
        "adaptive-constants": adaptive_constants_table(stored["adaptive_constants"]),
        "adaptive-robot-constants": "\n\n".join(
            adaptive_robot_constants_table(document)
            for document in (stored["adaptive_robot_constants"], _stored("adaptive_robot_shares"))
        ),
        "adaptive-noise": adaptive_noise_table(stored["adaptive_noise"]),
        "adaptive-second-plant": adaptive_second_plant_table(stored["adaptive_plant"]),
        "adaptive-robot": adaptive_robot_table(_stored("adaptive_robot_ur5")),
        "own-arm": own_arm_tables(stored["own_arms"]),
        "own-arms": tuned_arms_table(stored["own_arms"]),
        "robots": robots_table(),
        "robot-speed": robot_speed_table(_stored("robot_speed")),
        "robot-friction": robot_friction_table(_stored("robot_friction_panda")),
        "robot-learned": robot_learned_table(_stored("robot_learned_ur5")),
        "robot-comparison": robot_comparison_tables(
            [_stored(name) for name in map("robot_comparison_{}".format, COMPARED_ROBOTS) if _is_stored(name)]
        ),
    }


def _swept_by(policy: str) -> Path:
    """Return the stored sweep of a policy over plants with noise and delays."""
    return RESULTS / f"{policy.split('-')[0]}_all.json"


def _is_stored(name: str) -> bool:
    return (RESULTS / f"{name}.json").is_file()


def _stored(name: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return document


if __name__ == "__main__":
    main()
