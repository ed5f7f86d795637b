"""Forged files of proven bounds, made by the package's own `save_bound`, so that they follow every change of format."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from fuzzyarm.policies.tip_bound import TipBound
from fuzzyarm.policies.tip_files import BoundCheck, check_bound, save_bound
from fuzzyarm.proof.tip.centre import Segment
from fuzzyarm.proof.tip.period import Closed

__all__ = ["Understated", "checked", "with_part"]


class Understated(TipBound):
    """A bound whose largest value is said to be half of what its samples have."""

    @property
    def largest(self) -> float:
        """Half the largest tip error [m]."""
        return 0.5 * super().largest


def checked(bound: TipBound, path: Path) -> BoundCheck:
    """Return what the checker says of the file that `save_bound` writes of a bound, true or forged."""
    save_bound(bound, path)
    return check_bound(path)


def with_part(bound: TipBound, k: int, change: Callable[[Segment, Closed], tuple[Segment, Closed]]) -> TipBound:
    """Return a bound with another first segment in its k-th control step (from 0)."""
    step = bound.steps[k]
    segment, closed = change(step.segments[0], step.closed[0])
    changed = dataclasses.replace(step, segments=(segment, *step.segments[1:]), closed=(closed, *step.closed[1:]))
    return dataclasses.replace(bound, steps=(*bound.steps[:k], changed, *bound.steps[k + 1 :]))
