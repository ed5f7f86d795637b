"""Controllers by linear matrix inequalities: from a specification to gains with a proof.

    from fuzzyarm.synthesis import Specification, design
    result = design(Specification(gamma=1.4e-4, fastest_pole=200.0))
    result.controller.save("controller.json")

The solver, Clarabel, is loaded here and nowhere else; it is loaded with the first name that needs it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzyarm.synthesis.description import describe
    from fuzzyarm.synthesis.designer import Design, DesignFailed, design
    from fuzzyarm.synthesis.specification import Specification

__all__ = ["Design", "DesignFailed", "Specification", "describe", "design"]

_HOMES = {
    "Design": "designer",
    "DesignFailed": "designer",
    "Specification": "specification",
    "describe": "description",
    "design": "designer",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
