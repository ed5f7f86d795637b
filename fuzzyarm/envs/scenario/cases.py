"""Named cases: the three of the paper (section 6.2), and any others that are added."""

from __future__ import annotations

import dataclasses

from fuzzyarm.common.checks import instance, shown
from fuzzyarm.envs.physics.dynamics import Payload
from fuzzyarm.envs.scenario.disturbances import Disturbance, MachiningForce

__all__ = ["CASES", "PAPER_CASES", "Case", "add_case", "find_case"]


@dataclasses.dataclass(frozen=True)
class Case:
    """A named test case.

    Attributes:
        name: its key, as in ``gym.make(..., case=name)``.
        title: for tables and figures.
        disturbance: what acts on the arm.
    """

    name: str
    title: str
    disturbance: Disturbance

    def __post_init__(self) -> None:
        """Check the type of each part; TypeError otherwise."""
        instance("name", self.name, str)
        instance("title", self.title, str)
        instance("disturbance", self.disturbance, Disturbance)


_PAPER = (
    Case("nominal", "Case 1: nominal", Disturbance()),
    Case("machining", "Case 2: machining force", Disturbance(tip_force=MachiningForce())),
    Case("payload", "Case 3: 5 kg payload", Disturbance(payload=Payload(5.0))),
)

PAPER_CASES: tuple[str, ...] = tuple(case.name for case in _PAPER)
"""The cases of the paper. Evaluations, trainings and comparisons use these unless other cases are named."""

CASES: dict[str, Case] = {case.name: case for case in _PAPER}
"""All known cases by name; `add_case` adds one."""


def add_case(case: Case) -> None:
    """Register a case under its name; ValueError if the name is taken."""
    if case.name in CASES:
        raise ValueError(f"there is a case {case.name!r} already: {CASES[case.name].title}; choose another name")
    CASES[case.name] = case


def find_case(name: str) -> Case:
    """Return the case called `name`; ValueError names the choices."""
    if not isinstance(name, str) or name not in CASES:
        raise ValueError(f"unknown case {shown(name)}; choose from: {', '.join(CASES)}")
    return CASES[name]
