"""``results.json`` read back and checked: what was run, the rows of metrics, and what they were made with.

The conditions of an evaluation: all that has to be the same where policies are ranked together.

Each field of `EvaluationConfig` is one, except `EXEMPT`: a field that is added is a condition without further ado.
"""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

from fuzzyarm.common.checks import instance, real, truth
from fuzzyarm.common.documents import read_checked, record
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.eval.declarations import read_declarations
from fuzzyarm.eval.evaluation.run import SCHEMA, EvaluationConfig
from fuzzyarm.policies import resolve
from fuzzyarm.policies.declared import Declared

__all__ = ["EXEMPT", "NAME", "Results", "conditions_in_words", "conditions_of", "read_results"]


EXEMPT = ("policies",)
"""The fields that are no conditions: those that say what is ranked."""

_ALWAYS_SAID = ("cases", "control_period", "seeds", "encoder_noise")  # the cases by the columns of the table
_SHOWN = 12  # digits of a digest


def conditions_of(config: EvaluationConfig) -> dict[str, Any]:
    """Return the conditions by name; two evaluations with the same are comparable."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        if field.name not in EXEMPT:
            found |= _conditions(field.name, getattr(config, field.name))
    return found


def conditions_in_words(config: EvaluationConfig) -> str:
    """Return control period, seeds and noise, and what else is not the default."""
    default, noise = EvaluationConfig(), "encoder noise {:g} rad and {:g} rad/s".format(*config.encoder_noise)
    said = [
        f"control period {1e3 * config.control_period:g} ms",
        f"{config.seeds} {'seed' if config.seeds == 1 else 'seeds'}",
        noise if any(config.encoder_noise) else "no noise",
    ]
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name not in (*EXEMPT, *_ALWAYS_SAID) and value != getattr(default, field.name):
            said.append(_words(field.name, value, getattr(default, field.name)))
    return ", ".join(said)


def _conditions(field: str, value: Any) -> dict[str, Any]:
    """Return the conditions that a field is, by name."""
    match field:
        case "cases":
            return {"cases": ", ".join(case for case in CASES if case in value)}
        case "seeds":
            return {"number of seeds": value}
        case "parameters":
            return {f"{name} of the arm": number for name, number in value.to_dict().items()}
        case "robot":
            return {"robot": "the two-joint arm" if value is None else f"{value.name} {value.digest[:_SHOWN]}"}
        case "points":
            return {"file of the path": "none" if value is None else _points(value)}
        case "force" | "payload":
            return {field: "that of the case" if value is None else value}
        case _:
            return {field.replace("_", " "): value}


def _words(field: str, value: Any, default: Any) -> str:
    """Return a field that is not the default in words."""
    match field:
        case "parameters":
            usual = default.to_dict()
            changed = [f"{name} {number}" for name, number in value.to_dict().items() if number != usual[name]]
            return f"an arm with {', '.join(changed)}"
        case "robot":
            return f"robot {value.name}"
        case "points":
            return f"path of {_points(value)}"
        case "force":
            return "force {:g} to {:g} N".format(*value)
        case "payload":
            return f"payload {value:g} kg"
        case "passes":
            return f"the last of {value} passes"
        case _:
            return f"{field.replace('_', ' ')} {value}"


def _points(path: GivenPath) -> str:
    """Return a path by points in a few words that tell it from others."""
    digest = hashlib.sha256(repr(dataclasses.astuple(path)).encode()).hexdigest()
    return f"{len(path.points)} points ({digest[:_SHOWN]})"


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
