"""``results.json`` read back: what was run, the rows, and everything that can be wrong with the file."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.disturbances import EncoderNoise
from fuzzyarm.eval.evaluation.run import SCHEMA, EvaluationConfig
from fuzzyarm.policies import resolve

NAME = "results.json"
_IDENTITY = ("case", "policy", "seed")
_NEEDED = (*_IDENTITY, "completed", "reason", "tip_error_max_mm", "tip_error_rms_mm")


@dataclasses.dataclass(frozen=True)
class Results:
    """What `fuzzyarm evaluate` wrote, checked.

    Attributes:
        path: of the file.
        config: what was run.
        rows: one for each episode: case, policy, seed, completed, reason, and finite numbers.
        certificates: by policy, in words; None without one.
        bounds: numbers of the certificates by policy; None in a file that is older than they.
        policy_files: digests by policy, see `PolicySpec.files`; None in a file that is older than they.
        versions: of fuzzyarm and its libraries.
        commit, processor: what else it was made with.
        document: the file as it is, for what else it says.
    """

    path: Path
    config: EvaluationConfig
    rows: list[dict[str, Any]]
    certificates: dict[str, str | None]
    bounds: dict[str, dict[str, Any] | None] | None
    policy_files: dict[str, dict[str, str]] | None
    versions: dict[str, str | None]
    commit: str | None
    processor: str | None
    document: dict[str, Any]


def read_results(path: Path) -> Results:
    """Return the results of a file, or of the folder that `fuzzyarm evaluate --out` wrote it to. Nothing is imported.

    Raises:
        ValueError: there are none, they are damaged, or of another schema; the message names the file and the way out.
        OSError: the file cannot be read.
    """
    path = path / NAME if path.is_dir() else path
    again = f"make it anew with fuzzyarm evaluate --out {path.parent}"
    if not path.is_file():
        raise ValueError(f"{path} is not there; {again}")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON ({str(error)[:80]}); {again}") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise ValueError(f"{path}: the schema is {str(schema)[:80]!r}, this version reads {SCHEMA!r}; {again}")
    try:
        return _from_document(path, document)
    except (KeyError, TypeError, AttributeError, IndexError, ValueError, OverflowError) as error:
        problem = f"{error} is missing" if isinstance(error, KeyError) else str(error)[:200]
        raise ValueError(f"{path} is damaged ({problem}); {again}") from None


def _from_document(path: Path, document: dict[str, Any]) -> Results:
    config = _config(document["config"])
    labels = [resolve(name).label for name in config.policies]
    rows = document["results"]
    if len(rows) != len(labels) * len(config.cases) * config.seeds:
        raise ValueError(f"{len(rows)} rows are not one for each policy, case and seed")
    planned = [(case, name, seed) for case in config.cases for name in labels for seed in range(config.seeds)]
    for row, episode in zip(rows, planned, strict=True):
        _check_row(row, episode)
    bounds, files = document.get("certified_bounds"), document.get("policy_files")
    return Results(
        path=path,
        config=config,
        rows=rows,
        certificates={name: _text_or_none(document["certificates"][name]) for name in labels},
        bounds=None if bounds is None else {name: _checked_bounds(bounds[name]) for name in labels},
        policy_files=None if files is None else {name: dict(files[name].items()) for name in labels},
        versions={"fuzzyarm": document["versions"]["fuzzyarm"], **document["versions"]},
        commit=document["commit"],
        processor=document["machine"]["cpu"],
        document=document,
    )


def _config(given: dict[str, Any]) -> EvaluationConfig:
    position, velocity = given["encoder_noise"]
    EncoderNoise(position, velocity)  # checks the numbers
    if not (_is_number(given["control_period"]) and all(isinstance(name, str) for name in given["policies"])):
        raise ValueError("control_period must be a number, policies must be names")
    return EvaluationConfig(
        policies=tuple(given["policies"]),
        cases=tuple(given["cases"]),
        seeds=given["seeds"],
        encoder_noise=(position, velocity),
        control_period=given["control_period"],
        parameters=ArmParameters.from_dict(given["parameters"]),
    )


def _check_row(row: dict[str, Any], episode: tuple[str, str, int]) -> None:
    missing = [name for name in _NEEDED if name not in row]
    if missing:
        raise ValueError(f"a row lacks {', '.join(missing)}")
    if tuple(row[name] for name in _IDENTITY) != episode:
        raise ValueError(f"where the row of {episode} belongs there is {tuple(row[name] for name in _IDENTITY)}")
    if not (isinstance(row["completed"], bool) and isinstance(row["reason"], str)):
        raise ValueError(f"completed = {row['completed']!r}, reason = {row['reason']!r} are no truth value and text")
    for name, value in row.items():
        if name not in (*_IDENTITY, "completed", "reason") and not _is_number(value):
            raise ValueError(f"{name} of {episode} is {value!r}, no finite number")


def _text_or_none(value: Any) -> str | None:
    if not (value is None or isinstance(value, str)):
        raise ValueError(f"certificate {value!r} is no text")
    return value


def _checked_bounds(claimed: Any) -> dict[str, Any] | None:
    if claimed is None:
        return None
    if not all(isinstance(value, str) or _is_number(value) for value in claimed.values()):
        raise ValueError(f"certified bounds {claimed} are no finite numbers and texts")
    return dict(claimed)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
