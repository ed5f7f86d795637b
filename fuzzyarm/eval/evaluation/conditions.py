"""The conditions of an evaluation: all that has to be the same where policies are ranked together.

Each field of `EvaluationConfig` is one, except `EXEMPT`: a field that is added is a condition without further ado.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.envs.scenario.given_path import GivenPath
from fuzzyarm.eval.evaluation.run import EvaluationConfig

__all__ = ["EXEMPT", "conditions_in_words", "conditions_of"]

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
