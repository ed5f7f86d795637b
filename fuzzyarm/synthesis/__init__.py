"""Controllers by linear matrix inequalities: from a specification to gains with a proof.

    from fuzzyarm.synthesis import Specification, design
    result = design(Specification(gamma=1.4e-4, fastest_pole=200.0))
    result.controller.save("controller.json")

`design` is for the two-joint arm, `design_scheduled` for serial robots of any number of joints.

The solver, Clarabel, is loaded here and nowhere else; it is loaded with the first name that needs it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzyarm.synthesis.description import describe
    from fuzzyarm.synthesis.designer import Design, DesignFailed, design, find_design
    from fuzzyarm.synthesis.scheduled_description import describe_scheduled
    from fuzzyarm.synthesis.scheduled_design import ScheduledDesign, ScheduledSpecification, design_scheduled
    from fuzzyarm.synthesis.specification import Specification

__all__ = [
    "Design",
    "DesignFailed",
    "ScheduledDesign",
    "ScheduledSpecification",
    "Specification",
    "describe",
    "describe_scheduled",
    "design",
    "design_scheduled",
    "find_design",
]

_HOMES = {
    "Design": "designer",
    "DesignFailed": "designer",
    "ScheduledDesign": "scheduled_design",
    "ScheduledSpecification": "scheduled_design",
    "Specification": "specification",
    "describe": "description",
    "describe_scheduled": "scheduled_description",
    "design": "designer",
    "design_scheduled": "scheduled_design",
    "find_design": "designer",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
