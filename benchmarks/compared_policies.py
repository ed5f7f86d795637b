"""The policies of `comparison.py`: what each knows, what its numbers were chosen on, and in how much time.

The tables take these from here by name, so a stored comparison need not be measured again when their words change.
"""

from __future__ import annotations

import dataclasses
import json
import statistics
from pathlib import Path
from typing import Any

__all__ = ["POLICIES", "Compared", "preparation_s"]

RESULTS = Path(__file__).parent / "results"
RIGID, ELASTIC, NONE = "rigid arm of Table 1", "elastic arm of Table 1", "no model"
RANGES = ELASTIC + ", ranges of plants and loads"


@dataclasses.dataclass(frozen=True)
class Compared:
    """A policy, what it knows, and what its numbers were chosen on.

    Attributes:
        name: of the policy.
        knows: its model, in words.
        chosen_on: what its numbers were chosen or trained on, in words.
        rules: of a fuzzy controller whose synthesis alone made it; None for other policies.
        learned: whether it was trained.
        seeds: folders of all its trainings, as a pattern below ``benchmarks``; none for a policy that is not learned.
    """

    name: str
    knows: str
    chosen_on: str
    rules: int | None = None
    learned: bool = False
    seeds: str | None = None

    def folders(self) -> list[Path]:
        """Return the folders of all stored trainings."""
        return [] if self.seeds is None else sorted(RESULTS.parent.glob(self.seeds))


def _ppo(name: str, knows: str, chosen_on: str) -> Compared:
    return Compared(name, knows, chosen_on, learned=True, seeds=f"learned/{name}-[0-9]/policy")


def _fuzzy(name: str, rules: int | None) -> tuple[Compared, Compared]:
    """Return a fuzzy controller without and with the tip's feedforward."""
    proven = "inequalities, proven"
    return Compared(name, RIGID, proven, rules=rules), Compared(f"{name}-tip", ELASTIC, proven, rules=rules)


_FUZZY = (
    *(_fuzzy(f"fuzzy-{rules}", rules) for rules in (1, 2, 4, 8, 16, 32)),
    _fuzzy("fuzzy-4-sampled", None),  # a search chose the factors of its gains
)
_ROWS = (
    *(without for without, _ in _FUZZY),
    Compared("computed-torque", RIGID, "margins"),
    *(with_feedforward for _, with_feedforward in _FUZZY),
    Compared("computed-torque-tip", ELASTIC, "margins"),
    Compared("elastic-observer", ELASTIC, "random loads, within margins"),
    Compared("adaptive-observer", RANGES, "random plants and loads"),
    _ppo("ppo-nominal", NONE, "the paper's circle, unloaded"),
    _ppo("ppo-robust", NONE, "random plants, loads and references"),
    _ppo("ppo-residual", ELASTIC, "random plants, loads and references"),
    Compared(
        "learned-observer",
        RANGES,
        "random plants, loads, forces and references",
        learned=True,
        seeds="estimates/seed-[0-9]",
    ),
)

POLICIES = {one.name: one for one in _ROWS}
"""The compared policies by name, in the order of the table."""


def preparation_s(name: str) -> float | None:
    """Return the stored processor time of a policy's training (median over seeds), or of its synthesis and proof [s].

    None for laws whose numbers a search found: no result has the time of these searches.
    """
    one = POLICIES[name]
    if one.rules is not None:
        row = next(row for row in _stored("synthesis")["rows"] if row["rules"] == one.rules)
        return float(row["build_s"] + row["solve_s"] + row["proof_s"])
    if name == "learned-observer":
        return statistics.median(float(row["training"]["cpu_time_s"]) for row in _stored("learned_observer")["seeds"])
    if one.learned:
        (trained,) = [row for row in _stored("learned_comparison")["learned"] if row["name"] == name]
        return statistics.median(float(run["cpu_time_s"]) for run in trained["runs"])
    return None


def _stored(name: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return document
