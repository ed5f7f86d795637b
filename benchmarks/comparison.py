"""Model-based and learned policies in one table and one figure: eight tasks, new plants, forces not trained on.

    python benchmarks/comparison.py [--plants N] [--seed-plants N] [--jobs N] [--errors FOLDER] [--json FILE]

The policies are those of `compared_policies`, the tasks those of `learned_tasks`. The plants are those of
`plant_errors`, in the paper's cases and under two forces that no training has drawn; each plant meets all
policies. Of a policy that was trained with several seeds, each of which is stored, all seeds run the tasks and the
first `--seed-plants` plants, and the shipped one all plants.

The score of a policy in a case is the interquartile mean, over the plants, of the rms tip error; an episode that ended
early is larger than any error. Over seeds it is the interquartile mean of the scores with a bootstrap interval of 95 %
(`fuzzyarm.eval.evaluation._statistics`), otherwise the interval is over plants (`scipy.stats.bootstrap`). The rank of a
policy is one more than the number of policies whose interval lies wholly below its own: where intervals overlap,
policies share a rank.

With `--errors` each policy's errors are kept in a folder and taken from there by the next run with as many plants, so
that a run can be interrupted, or a policy added, without measuring the others again; the result names the commit of
each. Delete the files of a policy that has changed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from compared_policies import POLICIES
from comparison_statistics import ranks_of, score
from learned_tasks import assess
from measuring import options_of, printed, write
from plant_errors import COMPARED_CASES, FIRST_SEED, measured

from fuzzyarm import load_policy
from fuzzyarm.common.console import progress
from fuzzyarm.eval.evaluation._statistics import LEVEL, estimate

SCHEMA = "fuzzyarm-comparison/3"
SEED_PLANTS, QUANTILES = 1000, (0.01, 0.5, 0.99)


def compare(plants: int, seed_plants: int, jobs: int | None, folder: Path | None) -> dict[str, Any]:
    """Run everything and return the document.

    Args:
        plants: for each shipped policy.
        seed_plants: for each seed of a trained policy.
        jobs: processes; None: one per core.
        folder: of errors that a run before has measured, and where those of this one are kept; None: nowhere.
    """
    shipped = {name: load_policy(name) for name in POLICIES}
    seeds = {name: [load_policy(folder) for folder in one.folders()] for name, one in POLICIES.items()}
    runs = [(name, policy, plants) for name, policy in shipped.items()]
    runs += [(f"{name}-{k}", policy, seed_plants) for name, group in seeds.items() for k, policy in enumerate(group)]
    errors = {}
    with progress("plants", sum(count for *_, count in runs)) as advance:
        done = 0
        for label, policy, count in runs:
            path = None if folder is None else folder / f"{label}-{count}.npz"
            errors[label] = measured(
                path, policy, count, jobs, lambda k, label=label, done=done: advance(label, completed=done + k)
            )
            done += count
            advance(label, completed=done)
    tasks = {name: _tasks(name, policy, seeds[name]) for name, policy in shipped.items()}
    scores = {
        name: {
            case: score(errors[name].rms_mm[c], [errors[f"{name}-{k}"].rms_mm[c] for k in range(len(group))])
            for c, case in enumerate(COMPARED_CASES)
        }
        for name, group in seeds.items()
    }
    ranks = {case: ranks_of({name: scores[name][case] for name in shipped}) for case in COMPARED_CASES}
    rows = [
        {
            "name": name,
            "seeds": len(group),
            "commits": sorted({errors[label].commit for label in (name, *(f"{name}-{k}" for k in range(len(group))))}),
            "tasks": tasks[name],
            "plants": {
                case: {
                    "score_mm": scores[name][case],
                    "rank": ranks[case][name],
                    "quantiles_mm": [_finite(v) for v in np.quantile(largest, QUANTILES, method="inverted_cdf")],
                    "ended_early": int(np.isinf(largest).sum()),
                }
                for case, largest in zip(COMPARED_CASES, errors[name].largest_mm, strict=True)
            },
        }
        for name, group in seeds.items()
    ]
    return {
        "schema": SCHEMA,
        "method": {"plants": plants, "seed_plants": seed_plants, "first_seed": FIRST_SEED, "level": LEVEL},
        "cases": COMPARED_CASES,
        "quantiles": list(QUANTILES),
        "rows": rows,
    }


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


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def main() -> None:
    """Run all, print and optionally write."""
    parser = options_of(__doc__)
    parser.add_argument("--plants", type=int, default=10_000, help="for each shipped policy (default: %(default)s)")
    parser.add_argument("--seed-plants", type=int, default=SEED_PLANTS, help="for each seed (default: %(default)s)")
    parser.add_argument("--jobs", type=int, help="processes (default: one per core)")
    parser.add_argument("--errors", type=Path, metavar="FOLDER", help="keep errors here, and use those that are here")
    options = parser.parse_args()
    if options.plants < 1 or options.seed_plants < 1:
        parser.error("--plants and --seed-plants must be 1 or more")
    if options.errors is not None:
        options.errors.mkdir(parents=True, exist_ok=True)
    document = compare(options.plants, options.seed_plants, options.jobs, options.errors)
    write(options.json, f"comparison.py --plants {options.plants} --seed-plants {options.seed_plants}", **document)
    printed(document["rows"])


if __name__ == "__main__":
    main()
