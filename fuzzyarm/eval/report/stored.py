"""An evaluation read back from its folder, and everything that can be wrong with its signals beside its results."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

from fuzzyarm import __version__
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.episodes.rollout_file import NAME, digest, read_rollouts
from fuzzyarm.eval.evaluation import results_file
from fuzzyarm.eval.evaluation.results_file import Results, read_results
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.policies import resolve


@dataclasses.dataclass(frozen=True)
class StoredEvaluation:
    """What `fuzzyarm evaluate` wrote, checked: as `Evaluation`, with its provenance as stored."""

    config: EvaluationConfig
    rollouts: list[Rollout]
    rows: list[dict[str, Any]]
    certificates: dict[str, str | None]
    bounds: dict[str, dict[str, Any] | None]
    made_with: dict[str, Any]


def read_evaluation(folder: Path) -> StoredEvaluation:
    """Return the evaluation of a folder.

    Raises:
        ValueError: there is none, its files are damaged, or they are of different evaluations or versions; the message
            names the file and the way out.
        OSError: a file cannot be read.
    """
    again = f"run fuzzyarm evaluate --out {folder} again"
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; make an evaluation with fuzzyarm evaluate --out {folder}")
    if not (folder / results_file.NAME).is_file():
        raise ValueError(f"{folder} holds no results.json; make an evaluation with fuzzyarm evaluate --out {folder}")
    results = read_results(folder)
    if results.versions["fuzzyarm"] != __version__:
        raise ValueError(
            f"{results.path} was made by fuzzyarm {results.versions['fuzzyarm']}, this is {__version__}; {again}"
        )
    if "rollouts_sha256" not in results.document:
        raise ValueError(f"{results.path} was made before fuzzyarm kept rollouts; {again}")
    if not (folder / NAME).is_file():
        raise ValueError(f"{folder} holds results.json but no {NAME}: the evaluation was interrupted; {again}")
    try:
        return _joined(results, read_rollouts(folder / NAME))
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        problem = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{results.path} is damaged ({problem}); {again}") from None
    except ValueError as error:
        raise ValueError(f"{folder}: {error}; {again}") from None


def _joined(results: Results, rollouts: list[Rollout]) -> StoredEvaluation:
    """Return results and rollouts together, which must be of the same episodes."""
    config, document = results.config, results.document
    if digest(rollouts) != document["rollouts_sha256"]:
        raise ValueError(f"{NAME} and results.json are of different evaluations")
    labels = [resolve(name).label for name in config.policies]
    period, seeds = config.control_period, range(config.seeds)
    planned = [(case, name, seed, period) for case in config.cases for name in labels for seed in seeds]
    if [(run.case, run.policy, run.seed, run.control_period) for run in rollouts] != planned:
        raise ValueError(f"{NAME} holds other episodes than its configuration asks for")
    for run, row in zip(rollouts, results.rows, strict=True):
        _check_row(run, row)
    if results.bounds is None:
        raise KeyError("certified_bounds")
    return StoredEvaluation(
        config,
        rollouts,
        results.rows,
        results.certificates,
        bounds={name: _bounds(claimed) for name, claimed in results.bounds.items()},
        made_with={"date": str(document["date"]), "commit": results.commit, "versions": document["versions"]}
        | {"machine": {key: document["machine"][key] for key in ("cpu", "cores", "system")}},
    )


def _bounds(claimed: Any) -> dict[str, Any] | None:
    if claimed is None:
        return None
    numbers = {key: float(claimed[key]) for key in ("alpha", "gamma")}
    if not all(math.isfinite(value) and value > 0.0 for value in numbers.values()):
        raise ValueError(f"certified bounds {numbers} are out of range; allowed: (0, inf)")
    return {"form": claimed["form"], **numbers, "controller_digest": claimed["controller_digest"]}


def _check_row(run: Rollout, row: dict[str, Any]) -> None:
    """See that a row of results is that of a rollout; its numbers are computed anew."""
    named = ("case", "policy", "seed", "completed", "reason")
    expected = {name: getattr(run, name) for name in named} | metrics_of(run)
    for key, value in expected.items():
        same = math.isclose(value, row[key], rel_tol=1e-9) if isinstance(value, float) else value == row[key]
        if not same and not (value != value and row[key] != row[key]):
            raise ValueError(f"{key} of {run.policy} in case {run.case} is {row[key]}, its rollout has {value}")
