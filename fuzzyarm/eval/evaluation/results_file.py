"""Reading and checking of an evaluation's folder: ``results.json`` and the rollouts.

All fields of `EvaluationConfig` except the policies are conditions, which must be equal for policies to be ranked
together.
"""

import dataclasses
import hashlib
import math
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from fuzzyarm import __version__
from fuzzyarm.common.checks import instance, real, truth
from fuzzyarm.common.documents import read_checked, record
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.declarations import read_declarations
from fuzzyarm.eval.episodes import rollout_file
from fuzzyarm.eval.episodes.rollout import Rollout
from fuzzyarm.eval.evaluation.run import SCHEMA, Evaluation, EvaluationConfig, row_of
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES
from fuzzyarm.policies import resolve

__all__ = ["Results", "conditions_of", "read_evaluation", "read_results", "same"]


_ALWAYS_SAID = ("cases", "number of seeds", "encoder noise", "control period")  # cases are in the table's headings
_SHOWN = 12  # digits of a digest


def conditions_of(config: EvaluationConfig) -> tuple[dict[str, Any], str]:
    """Return the conditions by name, and in words; two evaluations with the same conditions are comparable.

    The words state control period, seeds and noise, and every other condition that is not the default.
    """
    conditions, usual = _conditions(config), _conditions(EvaluationConfig())
    noise = "encoder noise {:g} rad and {:g} rad/s".format(*config.encoder_noise)
    said = [
        f"control period {1e3 * config.control_period:g} ms",
        f"{config.seeds} {'seed' if config.seeds == 1 else 'seeds'}",
        noise if any(config.encoder_noise) else "no noise",
        *(f"{k} {v}" for k, v in conditions.items() if k not in _ALWAYS_SAID and v != usual[k]),
    ]
    return conditions, ", ".join(said)


def _conditions(config: EvaluationConfig) -> dict[str, Any]:
    robot, points = config.robot, config.points
    digest = hashlib.sha256(repr(points and dataclasses.astuple(points)).encode()).hexdigest()
    return {
        "cases": ", ".join(case for case in CASES if case in config.cases),
        "number of seeds": config.seeds,
        "encoder noise": config.encoder_noise,
        "control period": config.control_period,
        **{f"{name} of the arm": number for name, number in config.parameters.to_dict().items()},
        "robot": "the two-joint arm" if robot is None else f"{robot.name} {robot.digest[:_SHOWN]}",
        "path": config.path,
        "file of the path": "none" if points is None else f"{len(points.points)} points ({digest[:_SHOWN]})",
        "force [N]": "that of the case" if config.force is None else config.force,
        "payload [kg]": "that of the case" if config.payload is None else config.payload,
        "number of passes": config.passes,
    }


_NAME = "results.json"  # in the folder of an evaluation
_IDENTITY = ("case", "policy", "seed")
_NEEDED = (*_IDENTITY, "completed", "reason", "tip_error_max_mm", "tip_error_rms_mm")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Results(Evaluation):
    """An evaluation whose ``results.json`` was read and checked; it has no rollouts yet."""

    path: Path  # of the file
    rollouts_sha256: str  # of the rollouts that belong to it


@dataclasses.dataclass(frozen=True)
class _Machine:
    """The machine that ran an evaluation."""

    cpu: str | None
    cores: int | None
    system: str


@dataclasses.dataclass(frozen=True)
class _Bounds:
    """Certified bounds of a policy, see `PolicyCertificate.bounds`."""

    form: str
    alpha: Annotated[float, Meta(ge=RATES[0], le=RATES[1])]  # [1/s]
    gamma: Annotated[float, Meta(ge=GAINS[0], le=GAINS[1])]
    controller_digest: str


@dataclasses.dataclass(frozen=True)
class _ResultsDocument:
    """The keys of ``results.json`` and the types of their values."""

    schema: str
    config: EvaluationConfig
    arm: str
    command: str | None
    date: str
    commit: str | None
    versions: dict[str, str | None]
    machine: _Machine
    policy_files: dict[str, dict[str, str]]
    rollouts_sha256: str
    certificates: dict[str, str | None]
    certified_bounds: dict[str, _Bounds | None]
    declared: dict[str, dict[str, str] | None]
    results: list[dict[str, Any]]


def read_results(path: Path) -> Results:
    """Return the results of a file, or of the folder that `fuzzyarm evaluate --out` wrote; no code is imported."""
    path = path / _NAME if path.is_dir() else path
    again = f"make it again with fuzzyarm evaluate --out {path.parent}"
    return read_checked(path, SCHEMA, again, lambda document: _from_document(path, document))


def _from_document(path: Path, document: dict[str, Any]) -> Results:
    read = record(document, _ResultsDocument)
    config, rows = read.config, read.results
    labels = [resolve(name).label for name in config.policies]
    if "fuzzyarm" not in read.versions:
        raise KeyError("fuzzyarm")
    needed = len(labels) * len(config.cases) * config.seeds
    if len(rows) != needed:
        raise ValueError(f"its number of rows is {len(rows)}; needed: {needed}, one for each policy, case and seed")
    planned = [(case, name, seed) for case in config.cases for name in labels for seed in range(config.seeds)]
    for row, episode in zip(rows, planned, strict=True):
        _check_row(row, episode)
    plain = dataclasses.asdict(read)
    files = {name: read.policy_files[name] for name in labels}
    return Results(
        config=config,
        rollouts=[],
        rows=rows,
        certificates={name: read.certificates[name] for name in labels},
        bounds={name: plain["certified_bounds"][name] for name in labels},
        made_with={name: plain[name] for name in ("command", "date", "commit", "versions", "machine")}
        | {"policy_files": files},
        declared=read_declarations(read.declared, config.policies),
        path=path,
        rollouts_sha256=read.rollouts_sha256,
    )


def _check_row(row: dict[str, Any], episode: tuple[str, str, int]) -> None:
    """Raise an error unless a row belongs to an episode (case, policy, seed) and its metrics are numbers."""
    if missing := [name for name in _NEEDED if name not in row]:
        raise ValueError(f"a row of its results lacks {', '.join(missing)}")
    identity = tuple(row[name] for name in _IDENTITY)
    if identity != episode:
        raise ValueError(f"its rows are out of order: (case, policy, seed) is {identity} instead of {episode}")
    truth("completed", row["completed"])
    for name, value in row.items():
        if name in ("reason", "note"):
            instance(name, value, str)
        elif name not in (*_IDENTITY, "completed"):
            real(f"{name} of {episode}", value)


def read_evaluation(folder: Path) -> Results:
    """Return the evaluation of a folder, with its rollouts; ValueError names what is missing or does not fit."""
    again = f"run fuzzyarm evaluate --out {folder} again"
    if not (folder / _NAME).is_file():
        what = f"contains no {_NAME}" if folder.is_dir() else "is not a folder"
        raise ValueError(f"{folder} {what}; run an evaluation with fuzzyarm evaluate --out {folder}")
    results = read_results(folder)
    made_by = results.made_with["versions"]["fuzzyarm"]
    if made_by != __version__:
        raise ValueError(f"{results.path} was made by fuzzyarm {made_by}, but this is version {__version__}; {again}")
    rollouts = folder / rollout_file.NAME
    if not rollouts.is_file():
        raise ValueError(f"{folder} contains {_NAME} but no {rollouts.name}: the evaluation was interrupted; {again}")
    try:
        return _joined(results, rollout_file.read_rollouts(rollouts))
    except ValueError as error:
        raise ValueError(f"{folder}: {error}; {again}") from None


def _joined(results: Results, rollouts: list[Rollout]) -> Results:
    """Return the results with the rollouts added; ValueError if they do not belong to the same episodes."""
    if rollout_file.digest(rollouts) != results.rollouts_sha256:
        raise ValueError(f"{rollout_file.NAME} and {_NAME} come from different evaluations")
    period, own = results.config.control_period, [tuple(row[name] for name in _IDENTITY) for row in results.rows]
    if [(run.case, run.policy, run.seed, run.control_period) for run in rollouts] != [(*one, period) for one in own]:
        raise ValueError(f"{rollout_file.NAME} does not contain the episodes of the configuration in {_NAME}")
    for run, row in zip(rollouts, results.rows, strict=True):
        _check_rollout(run, row)
    return dataclasses.replace(results, rollouts=rollouts)


def _check_rollout(run: Rollout, row: dict[str, Any]) -> None:
    """Raise ValueError unless the metrics computed from a rollout match its row of results."""
    for key, value in ({"note": ""} | row_of(run)).items():
        stored = row.get(key, "")
        if not same(value, stored, relative=1e-9):
            raise ValueError(f"{key} of {run.policy} in case {run.case} is {stored!r}, but its rollout gives {value!r}")


def same(one: Any, other: Any, *, relative: float, absolute: float = 0.0) -> bool:
    """Return whether two values are the same: numbers within tolerances, others exactly."""
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=relative, abs_tol=absolute)
    return bool(one == other)
