"""Reading of an evaluation from its folder: its results and its rollouts, checked against each other."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

from fuzzyarm import __version__
from fuzzyarm.common import checks, documents
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.episodes.rollout_file import NAME, digest, read_rollouts
from fuzzyarm.eval.evaluation import results_file
from fuzzyarm.eval.evaluation.results_file import Results, read_results
from fuzzyarm.eval.evaluation.run import EvaluationConfig
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES
from fuzzyarm.policies import resolve
from fuzzyarm.policies.declared import Declared

__all__ = ["StoredEvaluation", "read_evaluation"]


@dataclasses.dataclass(frozen=True)
class StoredEvaluation:
    """A checked evaluation of `fuzzyarm evaluate`, with the fields of `Evaluation` and the stored provenance."""

    config: EvaluationConfig
    rollouts: list[Rollout]
    rows: list[dict[str, Any]]
    certificates: dict[str, str | None]
    bounds: dict[str, dict[str, Any] | None]
    made_with: dict[str, Any]
    declared: dict[str, Declared | None]


@dataclasses.dataclass(frozen=True)
class _Machine:
    """The machine that ran an evaluation."""

    cpu: str | None
    cores: int | None
    system: str


@dataclasses.dataclass(frozen=True)
class _MadeWith:
    """The provenance of an evaluation."""

    date: str
    commit: str | None
    versions: dict[str, str | None]
    machine: _Machine


@dataclasses.dataclass(frozen=True)
class _Bounds:
    """Certified bounds of a policy, see `PolicyCertificate.bounds`."""

    form: str
    alpha: float
    gamma: float
    controller_digest: str

    def __post_init__(self) -> None:
        """Check the numbers."""
        checks.real("alpha", self.alpha, "1/s", low=RATES[0], high=RATES[1])
        checks.real("gamma", self.gamma, low=GAINS[0], high=GAINS[1])


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
    except ValueError as error:
        raise ValueError(f"{folder}: {error}; {again}") from None


def _joined(results: Results, rollouts: list[Rollout]) -> StoredEvaluation:
    """Return results and rollouts together; ValueError if they are not of the same episodes."""
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
        raise ValueError("certified_bounds is missing in results.json")
    provenance = {field.name: document[field.name] for field in dataclasses.fields(_MadeWith) if field.name in document}
    return StoredEvaluation(
        config,
        rollouts,
        results.rows,
        results.certificates,
        bounds={name: _bounds(claimed) for name, claimed in results.bounds.items()},
        made_with=dataclasses.asdict(documents.record(provenance, _MadeWith)),
        declared=results.declared,
    )


def _bounds(claimed: Any) -> dict[str, Any] | None:
    return None if claimed is None else dataclasses.asdict(documents.record(claimed, _Bounds))


def _check_row(run: Rollout, row: dict[str, Any]) -> None:
    """Raise ValueError unless a row of results is that of a rollout; its metrics are computed again."""
    expected = {name: getattr(run, name) for name in ("case", "policy", "seed", "completed", "reason")} | metrics_of(
        run
    )
    for key, value in expected.items():
        stored: Any = row.get(key)
        both_real = isinstance(value, float) and isinstance(stored, float | int)
        if not (math.isclose(value, stored, rel_tol=1e-9) if both_real else value == stored):
            raise ValueError(f"{key} of {run.policy} in case {run.case} is {stored}, its rollout has {value}")
    if row.get("note", "") != run.note:
        raise ValueError(f"the note on {run.policy} in case {run.case} is not that of its rollout")
