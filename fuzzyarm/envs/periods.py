"""Control periods and sub-steps: what is allowed, and how many of the ones make the other. Nothing heavy is loaded."""

from __future__ import annotations

import math
from typing import Any

from fuzzyarm.common import checks

__all__ = [
    "LONGEST_PERIOD",
    "MAX_DEFAULT_SUBSTEP",
    "MOST_STEPS",
    "MOST_SUBSTEPS",
    "SHORTEST_PERIOD",
    "checked_period",
    "checked_periods",
    "default_substeps",
    "whole_substeps",
]

SHORTEST_PERIOD, LONGEST_PERIOD = 1e-6, 0.1
"""Allowed control periods [s]."""

MOST_SUBSTEPS = 10_000
"""Sub-steps that a control period may have: a step then takes about a millisecond."""

MOST_STEPS = 1_000_000
"""Control steps that a reference may have: its table then takes 170 MB."""

MAX_DEFAULT_SUBSTEP = 2e-4
"""Largest sub-step [s] if none is asked for; `benchmarks/accuracy.py` has the error it costs."""


def checked_period(name: str, period: Any) -> float:
    """Return a control period [s] as float.

    Raises:
        TypeError: it is no real number.
        ValueError: it is not from `SHORTEST_PERIOD` to `LONGEST_PERIOD`.
    """
    return checks.real(name, period, "s", low=SHORTEST_PERIOD, high=LONGEST_PERIOD)


def checked_periods(control_period: Any, substep: Any) -> tuple[float, int]:
    """Return a control period [s] as float, and its number of sub-steps; see `whole_substeps`."""
    return checked_period("control_period", control_period), whole_substeps(control_period, substep)


def default_substeps(duration: float) -> int:
    """Return how many sub-steps a duration [s] has by default, none longer than `MAX_DEFAULT_SUBSTEP`."""
    return math.ceil(duration / MAX_DEFAULT_SUBSTEP - 1e-9)


def whole_substeps(control_period: Any, substep: Any) -> int:
    """Return how many sub-steps [s] make a control period [s]; without a sub-step the default number.

    Raises:
        TypeError: one of them is no real number.
        ValueError: one of them is out of range, or the control period is no multiple of the sub-step.
    """
    period = checked_period("control_period", control_period)
    if substep is None:
        return default_substeps(period)
    part = checks.real("substep", substep, "s", low=period / MOST_SUBSTEPS, high=period)
    count = round(period / part)
    if not math.isclose(count * part, period, rel_tol=1e-9):
        raise ValueError(
            f"control_period = {period:g} s is no multiple of substep = {part:g} s; use substep = {period / count:g} s"
        )
    return count
