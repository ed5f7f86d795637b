"""Control periods and sub-steps: their allowed values, and how many sub-steps a period has. Imports no heavy module."""

import math
from typing import Any

from fuzzyarm.common import checks

__all__ = [
    "MAX_DEFAULT_SUBSTEP", "MOST_STEPS", "SHORTEST_PERIOD", "checked_period", "checked_periods", "default_substeps",
    "whole_substeps",
]  # fmt: skip

SHORTEST_PERIOD, _LONGEST_PERIOD = 1e-6, 0.1  # allowed control periods [s]
_MOST_SUBSTEPS = 10_000  # most sub-steps of a control period; they take about a millisecond to simulate
MOST_STEPS = 1_000_000  # most control steps of a reference; its table then takes 170 MB
MAX_DEFAULT_SUBSTEP = 2e-4  # largest default sub-step [s]; `benchmarks/accuracy.py` measures the resulting error

_RESOLVED, _STABLE = 1.0, 2.0
"""Limits on sub-step times fastest rate: for the default sub-step, and for stable modes; see `fastest_mode`."""


def checked_period(name: str, period: Any) -> float:
    """Return a control period [s] as a float if it is from 1e-6 to 0.1; otherwise the error calls it `name`."""
    return checks.real(name, period, "s", low=SHORTEST_PERIOD, high=_LONGEST_PERIOD)


def checked_periods(control_period: Any, substep: Any, rate: float = 0.0) -> tuple[float, int]:
    """Return a control period [s] as a float, and its number of sub-steps; see `whole_substeps`."""
    return checked_period("control_period", control_period), whole_substeps(control_period, substep, rate)


def default_substeps(duration: float, rate: float = 0.0) -> int:
    """Return the default number of sub-steps in `duration` [s] for an arm whose fastest mode has `rate` [rad/s]."""
    needed = duration * rate / _RESOLVED
    if needed > _MOST_SUBSTEPS:
        raise ValueError(
            f"the arm's fastest mode, {rate:.3g} rad/s, needs sub-steps of {_RESOLVED / rate:.3g} s or less, but "
            f"a period of {duration:g} s may have at most {_MOST_SUBSTEPS} sub-steps; choose a shorter control_period, "
            "or an arm with less stiffness, damping or viscous friction, or heavier rotors and links"
        )
    return max(math.ceil(duration / MAX_DEFAULT_SUBSTEP - 1e-9), math.ceil(needed - 1e-9))


def whole_substeps(control_period: Any, substep: Any, rate: float = 0.0) -> int:
    """Return the number of sub-steps in a control period; `control_period` and `substep` are in s.

    If `substep` is None, the number is the default for an arm whose fastest mode has `rate` [rad/s].
    """
    period = checked_period("control_period", control_period)
    if substep is None:
        return default_substeps(period, rate)
    part = checks.real("substep", substep, "s", low=period / _MOST_SUBSTEPS, high=period)
    count = round(period / part)
    if not math.isclose(count * part, period, rel_tol=1e-9):
        raise ValueError(
            f"control_period = {period:g} s is not a multiple of substep = {part:g} s; "
            f"use substep = {period / count:g} s"
        )
    if part * rate >= _STABLE:
        raise ValueError(
            f"substep = {part:g} s is too long: the simulation of the arm's fastest mode, {rate:.3g} rad/s, would be "
            f"unstable; use substep = {period / default_substeps(period, rate):.6g} s"
        )
    return count
