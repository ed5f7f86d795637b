"""Controller synthesis by linear matrix inequalities: from a specification to proven gains.

    from fuzzyarm.synthesis import Specification, design
    result = design(Specification(gamma=1.4e-4, fastest_pole=200.0))
    result.controller.save("controller.json")

`design` is for the two-joint arm, `design_scheduled` for serial robots of any number of joints. `DesignProblem` is what
`design` solves; it accepts user-defined cvxpy constraints and objectives. cvxpy and its solver Clarabel are loaded only
here, at the first use of a name that needs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fuzzyarm.common.registry import lazily

if TYPE_CHECKING:
    from fuzzyarm.synthesis._design_problem import DesignProblem
    from fuzzyarm.synthesis._designer import Design, DesignFailed, describe, design
    from fuzzyarm.synthesis._scheduled_design import (
        ScheduledDesign,
        ScheduledSpecification,
        describe_scheduled,
        design_scheduled,
    )
    from fuzzyarm.synthesis.specification import Specification

__all__ = [
    "Design",
    "DesignFailed",
    "DesignProblem",
    "ScheduledDesign",
    "ScheduledSpecification",
    "Specification",
    "describe",
    "describe_scheduled",
    "design",
    "design_scheduled",
]

_HOMES = {
    name: home
    for home, names in {
        "_design_problem": "DesignProblem",
        "_designer": "Design DesignFailed describe design",
        "_scheduled_design": "ScheduledDesign ScheduledSpecification describe_scheduled design_scheduled",
        "specification": "Specification",
    }.items()
    for name in names.split()
}
__getattr__ = lazily(__name__, _HOMES)
