"""One number of the paper as a record, and when ours agrees with it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from fuzzyarm.eval.paper.measures import Measure


class Tolerance(NamedTuple):
    """How far a number may be from the stored one: relative * |stored| + absolute [the claim's unit]; 0 by default."""

    relative: float = 0.0
    absolute: float = 0.0

    def of(self, stored: float) -> float:
        """Return the distance allowed from a stored value."""
        return self.relative * abs(stored) + self.absolute


@dataclasses.dataclass(frozen=True)
class Claim:
    """One number, or a few of a kind, of the paper.

    Attributes:
        key: its name in the files.
        where: the place in the paper.
        says: what the paper says there.
        quantity: what is measured.
        unit: of the paper's and of our numbers; "-" for none.
        paper: the paper's number, one for all our values or by label; None or no such label where it gives none.
        measure: from the evidence to our values by label.
        comparison: when ours agrees: "equal" to the digits printed, of the same "order" (within a factor of ten),
            "at most" or "more than" the paper's number.
        decimals: digits the paper prints after the point.
        reason: why ours differs, or what else is to be said; may be empty.
        tolerance: how far ours may drift from what is stored (`drift`).
    """

    key: str
    where: str
    says: str
    quantity: str
    unit: str
    paper: float | Mapping[str, float] | None
    measure: Measure
    comparison: Literal["equal", "order", "at most", "more than"] = "equal"
    decimals: int = 0
    reason: str = ""
    tolerance: Tolerance = Tolerance()

    def papers_number(self, label: str) -> float | None:
        """Return what the paper has beside our value `label`, None if nothing."""
        return self.paper.get(label) if isinstance(self.paper, Mapping) else self.paper

    def agrees(self, label: str, value: float) -> bool | None:
        """Return whether our value is the paper's in the sense of `comparison`; None if the paper gives no number."""
        paper = self.papers_number(label)
        if paper is None:
            return None
        if self.comparison == "order":
            return value > 0.0 and abs(math.log10(value / paper)) < 1.0
        if self.comparison == "equal":
            return abs(value - paper) <= 0.5 * 10.0**-self.decimals
        return value <= paper if self.comparison == "at most" else value > paper
