"""All policies, model-based and learned, in one table and one figure: eight tasks, plants and forces not trained on.

    python benchmarks/comparison.py [--plants N] [--seed-plants N] [--jobs N] [--json FILE] [--figure FILE.png]

The tasks are those of `learned_tasks`. The plants are those of `comparison_plants`, in the paper's cases and under two
forces that no training has drawn; each plant meets all policies. Of a policy that was trained with several seeds, each
of which is stored, all seeds run the tasks and the first `--seed-plants` plants, and the shipped one all plants.

The score of a policy in a case is the interquartile mean, over the plants, of the rms tip error; an episode that ended
early is larger than any error. Over seeds it is the interquartile mean of the scores with a bootstrap interval of 95 %
(`fuzzyarm.eval.evaluation.statistics`), otherwise the interval is over plants (`scipy.stats.bootstrap`). The rank of a
policy is one more than the number of policies whose interval lies wholly below its own: where intervals overlap,
policies share a rank. The probability of improvement of one policy over another is the share of plants and cases in
which its rms error is smaller, equal ones counting half, with a bootstrap interval over the plants.

Processor time: of the training, the median over seeds; of the synthesis with its proof; otherwise of making the policy.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from comparison_figure import draw_comparison
from comparison_plants import COMPARED_CASES, SEED, errors_of
from comparison_statistics import improvements, ranks_of, score
from learned_figures import png
from learned_tasks import assess

from fuzzyarm import load_policy
from fuzzyarm.common.console import progress
from fuzzyarm.common.files import write_atomically
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.evaluation.statistics import LEVEL, estimate
from fuzzyarm.eval.provenance import current_provenance
from fuzzyarm.eval.stability.margins import MarginsConfig, measure_margins

SCHEMA = "fuzzyarm-comparison/1"
ROOT = Path(__file__).resolve().parents[1]
RESULTS, TRAININGS = ROOT / "benchmarks" / "results", ROOT / "benchmarks" / "learned"
SEED_PLANTS = 1000
RIGID, ELASTIC, NONE = "rigid arm of Table 1", "elastic arm of Table 1", "no model"


@dataclasses.dataclass(frozen=True)
class Compared:
    """A policy, what it knows, and what its numbers were chosen on."""

    name: str
    knows: str
    chosen_on: str
    rules: int | None = None
    learned: bool = False


POLICIES = (
    Compared("fuzzy-1", RIGID, "inequalities, proven", rules=1),
    Compared("fuzzy-4", RIGID, "inequalities, proven", rules=4),
    Compared("fuzzy-4-tip", ELASTIC, "inequalities, proven", rules=4),
    Compared("computed-torque", RIGID, "margins"),
    Compared("computed-torque-tip", ELASTIC, "margins"),
    Compared("elastic-observer", ELASTIC, "random loads, within margins"),
    Compared("adaptive-observer", ELASTIC + ", ranges of plants and loads", "random plants and loads"),
    Compared("ppo-nominal", NONE, "the paper's circle, unloaded", learned=True),
    Compared("ppo-robust", NONE, "random plants, loads and references", learned=True),
    Compared("ppo-residual", ELASTIC, "random plants, loads and references", learned=True),
    Compared("learned-observer", ELASTIC, "random plants, loads, forces and references", learned=True),
)


def compare(plants: int, seed_plants: int, jobs: int | None) -> dict[str, Any]:
    """Run everything and return the document."""
    shipped, made = {}, {}
    for one in POLICIES:
        begin = time.process_time()
        shipped[one.name] = load_policy(one.name)
        made[one.name] = time.process_time() - begin
    seeds = {one.name: _seeds(one.name) for one in POLICIES}
    tasks = {name: _tasks(name, policy, seeds[name]) for name, policy in shipped.items()}
    of_seeds = {f"{name}/{k}": policy for name, group in seeds.items() for k, policy in enumerate(group)}
    with progress("plants", plants + seed_plants) as advance:
        rms, largest = errors_of(shipped, plants, jobs, lambda done: advance("shipped", completed=done))
        by_seed, _ = errors_of(of_seeds, seed_plants, jobs, lambda done: advance("seeds", completed=plants + done))
    scores = {
        name: {
            case: score(rms[p, c], [by_seed[k, c] for k, label in enumerate(of_seeds) if label.startswith(f"{name}/")])
            for c, case in enumerate(COMPARED_CASES)
        }
        for p, name in enumerate(shipped)
    }
    margins = {row["policy"]: row for row in measure_margins(MarginsConfig(policies=tuple(shipped)))["rows"]}
    ranks = {case: ranks_of({name: scores[name][case] for name in shipped}) for case in COMPARED_CASES}
    rows = [
        {
            **dataclasses.asdict(one),
            "seeds": len(seeds[one.name]),
            "processor_s": _preparation(one, made[one.name]),
            "tasks": tasks[one.name],
            "plants": {
                case: {
                    "score_mm": scores[one.name][case],
                    "rank": ranks[case][one.name],
                    "quantiles_mm": [_finite(v) for v in np.quantile(largest[p, c], QUANTILES, method="inverted_cdf")],
                    "ended_early": int(np.isinf(largest[p, c]).sum()),
                }
                for c, case in enumerate(COMPARED_CASES)
            },
            "spectral_radius": margins[one.name]["spectral_radius"],
        }
        for p, one in enumerate(POLICIES)
    ]
    return {
        "schema": SCHEMA,
        "command": f"python benchmarks/comparison.py --plants {plants} --seed-plants {seed_plants}",
        **current_provenance(),
        "method": {"plants": plants, "seed_plants": seed_plants, "first_seed": SEED, "level": LEVEL},
        "cases": {case: CASES[case].title for case in COMPARED_CASES},
        "quantiles": list(QUANTILES),
        "rows": rows,
        "improvement": improvements(list(shipped), rms),
    }


QUANTILES = (0.01, 0.5, 0.99)


def _seeds(name: str) -> list[Any]:
    """Return the policies of all stored seeds of a training; none where they are not stored."""
    return [load_policy(folder / "policy") for folder in sorted(TRAININGS.glob(f"{name}-[0-9]"))]


def _tasks(name: str, policy: Any, seeds: Sequence[Any]) -> dict[str, dict[str, Any]]:
    """Return by task the rms error [mm] over the runs that did not fail, and how many failed."""
    runs = [record for one in (seeds or [policy]) for record in assess(one, name, None)]
    found: dict[str, dict[str, Any]] = {}
    for task in dict.fromkeys(record["task"] for record in runs):
        own = [record for record in runs if record["task"] == task]
        errors = [record["tip_error_rms_mm"] for record in own if record["failed"] is None]
        mean = estimate(errors)._asdict() if errors else None
        found[task] = {"rms_mm": mean, "failed": len(own) - len(errors), "runs": len(own)}
    return found


def _preparation(one: Compared, made: float) -> float:
    """Return the processor time of training, of synthesis with proof, or of making the policy [s]."""
    if one.rules is not None:
        row = next(row for row in _stored("synthesis")["rows"] if row["rules"] == one.rules)
        return float(row["build_s"] + row["solve_s"] + row["proof_s"])
    if one.name == "learned-observer":
        return statistics.median(float(row["training"]["cpu_time_s"]) for row in _stored("learned_observer")["seeds"])
    if one.learned:
        (trained,) = [row for row in _stored("learned_comparison")["learned"] if row["name"] == one.name]
        return statistics.median(float(run["cpu_time_s"]) for run in trained["runs"])
    return made


def _stored(name: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return document


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def main() -> int:
    """Run all, print and optionally write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=10_000, help="for each shipped policy (default: %(default)s)")
    parser.add_argument("--seed-plants", type=int, default=SEED_PLANTS, help="for each seed (default: %(default)s)")
    parser.add_argument("--jobs", type=int, help="processes (default: one per core)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result here")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="also draw the figure")
    options = parser.parse_args()
    if options.plants < 1 or options.seed_plants < 1:
        parser.error("--plants and --seed-plants must be 1 or more")
    document = compare(options.plants, options.seed_plants, options.jobs)
    if options.json:
        write_atomically(options.json, json.dumps(document, indent=1, allow_nan=False) + "\n")
    if options.figure:
        write_atomically(options.figure, png(lambda: draw_comparison(document)))
    for row in document["rows"]:
        print(row["name"], {case: (found["score_mm"], found["rank"]) for case, found in row["plants"].items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
