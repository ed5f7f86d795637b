"""``results.json`` read back and checked: what was run, the rows of metrics, and what they were made with."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from fuzzyarm.common.checks import instance, real, truth
from fuzzyarm.common.documents import read_checked, record
from fuzzyarm.eval.declarations import read_declarations
from fuzzyarm.eval.evaluation.run import SCHEMA, EvaluationConfig
from fuzzyarm.policies import resolve
from fuzzyarm.policies.declared import Declared

__all__ = ["NAME", "Results", "read_results"]

NAME = "results.json"  # in the folder of an evaluation
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
        bounds: numbers of the certificates by policy; None in files made before they were stored.
        declared: by policy, see `policies.declared`; in files made before it was stored, of known names alone.
        policy_files: digests by policy, see `PolicySpec.files`; None in files made before they were stored.
        versions: of fuzzyarm and its libraries.
        commit, processor: what else it was made with.
        document: the whole content of the file, as parsed.
    """

    path: Path
    config: EvaluationConfig
    rows: list[dict[str, Any]]
    certificates: dict[str, str | None]
    bounds: dict[str, dict[str, Any] | None] | None
    declared: dict[str, Declared | None]
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
    return read_checked(path, SCHEMA, again, lambda document: _from_document(path, document))


@dataclasses.dataclass(frozen=True)
class _Document:
    """The keys of the file and their types; those with a default are missing in older files."""

    schema: str
    config: EvaluationConfig
    commit: str | None
    versions: dict[str, str | None]
    machine: dict[str, Any]
    certificates: dict[str, str | None]
    results: list[dict[str, Any]]
    certified_bounds: dict[str, dict[str, float | str] | None] | None = None
    declared: dict[str, dict[str, str] | None] | None = None
    policy_files: dict[str, dict[str, str]] | None = None
    command: str | None = None
    date: str = ""
    rollouts_sha256: str = ""
    arm: str = ""


def _from_document(path: Path, document: dict[str, Any]) -> Results:
    read = record(document, _Document)
    config, rows = read.config, read.results
    labels = [resolve(name).label for name in config.policies]
    if len(rows) != len(labels) * len(config.cases) * config.seeds:
        raise ValueError(f"{len(rows)} rows are not one for each policy, case and seed")
    planned = [(case, name, seed) for case in config.cases for name in labels for seed in range(config.seeds)]
    for row, episode in zip(rows, planned, strict=True):
        _check_row(row, episode)
    bounds, files = read.certified_bounds, read.policy_files
    return Results(
        path=path,
        config=config,
        rows=rows,
        certificates={name: read.certificates[name] for name in labels},
        bounds=None if bounds is None else {name: bounds[name] for name in labels},
        declared=read_declarations(read.declared, config.policies),
        policy_files=None if files is None else {name: files[name] for name in labels},
        versions={"fuzzyarm": read.versions["fuzzyarm"], **read.versions},
        commit=read.commit,
        processor=read.machine["cpu"],
        document=document,
    )


def _check_row(row: dict[str, Any], episode: tuple[str, str, int]) -> None:
    """Check that a row is that of an episode, (case, policy, seed), and that its metrics are numbers."""
    missing = [name for name in _NEEDED if name not in row]
    if missing:
        raise ValueError(f"a row lacks {', '.join(missing)}")
    identity = tuple(row[name] for name in _IDENTITY)
    if identity != episode:
        raise ValueError(f"where the row of {episode} belongs there is {identity}")
    truth("completed", row["completed"])
    instance("reason", row["reason"], str)
    for name, value in row.items():
        if name == "note":
            instance("note", value, str)
        elif name not in (*_IDENTITY, "completed", "reason"):
            real(f"{name} of {episode}", value)
