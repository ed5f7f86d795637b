"""An evaluation read back from its folder, and everything that can be wrong with it."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

from fuzzyarm import __version__
from fuzzyarm.envs.disturbances import EncoderNoise
from fuzzyarm.envs.parameters import ArmParameters
from fuzzyarm.eval.evaluate import SCHEMA, EvaluationConfig
from fuzzyarm.eval.metrics import metrics
from fuzzyarm.eval.rollout import Rollout
from fuzzyarm.eval.rollout_file import NAME, digest, read_rollouts
from fuzzyarm.policies import policy_label

AGAIN = "run fuzzyarm evaluate --out {} again"


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
    results, rollouts_path = folder / "results.json", folder / NAME
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; make an evaluation with fuzzyarm evaluate --out {folder}")
    if not results.is_file():
        raise ValueError(f"{folder} holds no results.json; make an evaluation with fuzzyarm evaluate --out {folder}")
    document = _document(results)
    if not rollouts_path.is_file():
        raise ValueError(
            f"{folder} holds results.json but no {NAME}: the evaluation was interrupted; {AGAIN.format(folder)}"
        )
    try:
        stored = _from_document(document, read_rollouts(rollouts_path))
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        problem = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{results} is damaged ({problem}); {AGAIN.format(folder)}") from None
    except ValueError as error:
        raise ValueError(f"{folder}: {error}; {AGAIN.format(folder)}") from None
    return stored


def _document(path: Path) -> dict[str, Any]:
    """Return the content of ``results.json``, of this schema and this version."""
    again = AGAIN.format(path.parent)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON ({str(error)[:80]}); {again}") from None
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else None
        raise ValueError(f"{path}: the schema is {found!r}, this version reads {SCHEMA!r}; {again}")
    versions = document.get("versions")
    version = versions.get("fuzzyarm") if isinstance(versions, dict) else None
    if version != __version__:
        raise ValueError(f"{path} was made by fuzzyarm {version}, this is {__version__}; {again}")
    if "rollouts_sha256" not in document:
        raise ValueError(f"{path} was made before fuzzyarm kept rollouts; {again}")
    return document


def _from_document(document: dict[str, Any], rollouts: list[Rollout]) -> StoredEvaluation:
    if digest(rollouts) != document["rollouts_sha256"]:
        raise ValueError(f"{NAME} and results.json are of different evaluations")
    given = document["config"]
    position, velocity = given["encoder_noise"]
    EncoderNoise(position, velocity)  # checks the numbers
    config = EvaluationConfig(
        policies=tuple(given["policies"]),
        cases=tuple(given["cases"]),
        seeds=given["seeds"],
        encoder_noise=(position, velocity),
        control_period=given["control_period"],
        parameters=ArmParameters.from_dict(given["parameters"]),
    )
    labels = [policy_label(name) for name in config.policies]
    rows = document["results"]
    period, seeds = config.control_period, range(config.seeds)
    planned = [(case, name, seed, period) for case in config.cases for name in labels for seed in seeds]
    if [(run.case, run.policy, run.seed, run.control_period) for run in rollouts] != planned:
        raise ValueError(f"{NAME} holds other episodes than its configuration asks for")
    for run, row in zip(rollouts, rows, strict=True):
        _check_row(run, row)
    return StoredEvaluation(
        config,
        rollouts,
        rows,
        certificates={name: _text_or_none(document["certificates"][name]) for name in labels},
        bounds={name: _bounds(document["certified_bounds"][name]) for name in labels},
        made_with={"date": str(document["date"]), "commit": document["commit"], "versions": document["versions"]}
        | {"machine": {key: document["machine"][key] for key in ("cpu", "cores", "system")}},
    )


def _text_or_none(value: Any) -> str | None:
    if not (value is None or isinstance(value, str)):
        raise ValueError(f"certificate {value!r} is no text")
    return value


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
    expected = {name: getattr(run, name) for name in named} | metrics(run)
    for key, value in expected.items():
        same = math.isclose(value, row[key], rel_tol=1e-9) if isinstance(value, float) else value == row[key]
        if not same and not (value != value and row[key] != row[key]):
            raise ValueError(f"{key} of {run.policy} in case {run.case} is {row[key]}, its rollout has {value}")
