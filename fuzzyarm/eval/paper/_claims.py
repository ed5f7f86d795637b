"""All numbers of the paper that are compared with ours.

``claims.json`` contains the paper's values, the tolerances within which ours may drift, and the reasons for
differences, with our measurements. Its groups are ``statements`` (the reference, the cases, the inequalities and the
gains), ``table_2`` (the size of the design problem by number of rules) and ``rollouts`` (the three cases).
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from importlib import resources
from typing import Any, Literal

from fuzzyarm.eval.paper.evidence import Evidence

__all__ = ["CLAIMS", "PaperNumber"]


@dataclasses.dataclass(frozen=True)
class PaperNumber:
    """A number of the paper, or several numbers of one kind.

    Our value may drift from the stored one by relative * |stored| + absolute. Numbers that need no simulation agree on
    all machines up to rounding; their relative tolerance is 1e-9. Simulated ones are reproducible on one machine: a
    relative change of the gains by 1e-6 changes them by up to 1e-4. Their relative tolerance is 1e-3, and lengths
    also have an absolute one of a micrometre. The relative tolerance of γ is 0.02, as its bisection stops at 1 %.
    """

    key: str  # name of the claim in the files
    where: str  # section, figure or table of the paper
    says: str  # what the paper says there
    quantity: str  # what is measured
    unit: str  # of the paper's and of our numbers; "-" for a pure number
    paper: float | Mapping[str, float] | None  # one number for all our values, or one for each label; None: no number
    measure: str  # the method of `Evidence` that returns our values by label, and its arguments
    # How our value must compare to agree. "equal": in all printed digits; "order": within a factor of ten.
    comparison: Literal["equal", "order", "at most", "more than"] = "equal"
    decimals: int = 0  # digits that the paper prints after the decimal point
    reason: str = ""  # why our value differs, or another remark
    tolerance: tuple[float, float] = (0.0, 0.0)  # relative [1] and absolute [unit] part of the allowed drift
    group: str = ""  # of the file

    def measured(self, evidence: Evidence) -> dict[str, float]:
        """Return our values by label."""
        name, *arguments = self.measure.split()
        return dict(getattr(evidence, name)(*arguments))

    def allowed(self, stored: float) -> float:
        """Return the largest allowed difference from a stored value, in the number's unit."""
        relative, absolute = self.tolerance
        return relative * abs(stored) + absolute

    def papers_number(self, label: str) -> float | None:
        """Return the paper's number for our value `label`; None if the paper gives none."""
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


_FILE: dict[str, Any] = json.loads(resources.files(__package__).joinpath("claims.json").read_text(encoding="utf-8"))
CLAIMS = tuple(
    PaperNumber(**entry | {"reason": _FILE["reasons"].get(entry.get("reason"), ""), "group": group})
    for group in ("statements", "table_2", "rollouts")
    for entry in _FILE[group]
)
"""All claims of the paper, in the order of the report."""
