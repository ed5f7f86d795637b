"""One number of the paper as a record: how ours is measured, when the two agree, and how far ours may drift."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from fuzzyarm.eval.paper.measures import Measure

__all__ = ["BISECTED", "COMPUTED", "SIMULATED", "SIMULATED_MM", "Claim", "Tolerance"]


class Tolerance(NamedTuple):
    """How far a number may differ from its stored value: relative * |stored| + absolute [the claim's unit]."""

    relative: float = 0.0
    absolute: float = 0.0

    def of(self, stored: float) -> float:
        """Return the largest allowed difference from a stored value."""
        return self.relative * abs(stored) + self.absolute


# Computed without simulation: equal on all machines up to rounding.
COMPUTED = Tolerance(relative=1e-9)
# Simulated: reproducible on one machine. If the gains change by a relative 1e-6, the most sensitive value, that of the
# episode that leaves the box, changes by a relative 1e-4; most others change by less than 1e-5.
SIMULATED = Tolerance(relative=1e-3)
BISECTED = Tolerance(relative=0.02)  # the bisection stops at 1 %
SIMULATED_MM = Tolerance(relative=1e-3, absolute=1e-3)  # of lengths in mm: a micrometre is allowed besides


@dataclasses.dataclass(frozen=True)
class Claim:
    """A number of the paper, or several numbers of one kind.

    Attributes:
        key: name of the claim in the files.
        where: section, figure or table of the paper.
        says: what the paper says there.
        quantity: what is measured.
        unit: of the paper's and of our numbers; "-" for none.
        paper: the paper's number: one for all our values, or one for each label. None, or a label that is missing: the
            paper gives no number.
        measure: function from the evidence to our values by label.
        comparison: the relation to the paper's number in which ours agrees: "equal" in all printed digits, of the same
            "order" (within a factor of ten), "at most" or "more than".
        decimals: number of digits the paper prints after the decimal point.
        reason: why ours differs, or another remark; may be empty.
        tolerance: how far ours may drift from the stored value, see `drift`.
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
        """Return the paper's number for our value `label`; None if it gives none."""
        return self.paper.get(label) if isinstance(self.paper, Mapping) else self.paper

    def agrees(self, label: str, value: float) -> bool | None:
        """Return whether our value agrees with the paper's, see `comparison`; None if the paper gives no number."""
        paper = self.papers_number(label)
        if paper is None:
            return None
        if self.comparison == "order":
            return value > 0.0 and abs(math.log10(value / paper)) < 1.0
        if self.comparison == "equal":
            return abs(value - paper) <= 0.5 * 10.0**-self.decimals
        return value <= paper if self.comparison == "at most" else value > paper
