"""A ranking of policies over random plants, from the files of sweeps, best first.

The score of a policy [mm] is the largest, over the cases, of the plants' 99 % quantile of the largest tip error. Its
interval reaches from the largest of the lower ends of the quantiles' 95 % intervals (`summary`) to the largest of the
upper ends. A policy that ends more than one in a hundred episodes of a case early has no score and ranks after all that
have one, by the share of such episodes.

Only comparable files are ranked together: they share cases, distribution of plants, arm and version of fuzzyarm. The
number of plants may differ.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fuzzyarm.common.checks import real, whole
from fuzzyarm.common.documents import DocumentError, read_checked, read_json
from fuzzyarm.envs.scenario.cases import find_case
from fuzzyarm.eval.declarations import read_declarations
from fuzzyarm.eval.episodes.metrics import RESOLUTION, millimetres, ranked
from fuzzyarm.eval.evaluation._statistics import MeanInterval
from fuzzyarm.eval.evaluation.ranking import Leaderboard, check_comparable, other_cells, other_headings, shown
from fuzzyarm.eval.sweep.summary import SCHEMA, SUMMARY
from fuzzyarm.policies.declared import Declared

__all__ = ["is_sweep", "rank_sweeps"]

_LEVEL = "0.99"  # the quantile over the plants, as a sweep's file names it


@dataclasses.dataclass(frozen=True)
class _PlantStanding:
    """The result of one policy in one sweep over random plants."""

    policy: str  # its label
    source: str  # the file that contains it
    score: MeanInterval | None  # see the module [mm]; None if too many episodes ended early
    cases: dict[str, float | None]  # the 99 % quantile of each case [mm], by its name; None as for `score`
    ended_early: int  # number of episodes
    plants: int  # number in each case
    declared: Declared | None
    others: dict[str, dict[str, float | None]]  # the quantiles of the metrics of `metrics.ranked` that sweeps have

    @property
    def order(self) -> tuple[int, float]:
        """Sort key: policies with a score by the score [mm], then others by the share of episodes ended early."""
        return (1, self.ended_early / self.plants) if self.score is None else (0, max(self.score.mean, RESOLUTION))

    @property
    def headings(self) -> list[str]:
        """Headings of the table's columns after the score."""
        what = "99 % of plants, "
        found = [f"{what}{case} [mm]" for case in self.cases]
        if self.others:
            found += other_headings(list(self.cases), what)
        return [*found, "ended early", "plants", "from"]

    @property
    def cells(self) -> list[str]:
        """Cells of the table's row: the score, then those below `headings`."""
        return [
            "ended early" if self.score is None else shown(self.score),
            *("ended early" if value is None else millimetres(value) for value in self.cases.values()),
            *other_cells(self.others, "ended early"),
            f"{self.ended_early} of {self.plants * len(self.cases)}",
            str(self.plants),
            self.source,
        ]

    @staticmethod
    def notes(standings: Sequence[Any]) -> str:
        """Return the notes below a table of these standings."""
        return (
            "Score: 99 % quantile of the largest tip error over the plants, in the worst case, with its 95 % interval. "
            "Ended early: more than 1 % of the episodes of a case ended early; such policies rank last."
        )


def is_sweep(path: Path) -> bool:
    """Return whether a path is the folder of a sweep or its summary, of any version."""
    if path.is_dir():
        return (path / SUMMARY).is_file()
    try:
        document = read_json(path)
    except (DocumentError, OSError):
        return False
    return isinstance(document, dict) and str(document.get("schema")).startswith(SCHEMA.partition("/")[0])


def rank_sweeps(paths: Sequence[str | Path]) -> Leaderboard:
    """Rank the policies of sweeps, given as `SUMMARY` files of `fuzzyarm sweep` or the folders that contain them.

    It raises the exceptions of `rank_policies`.
    """
    files = [path / SUMMARY if path.is_dir() else path for path in map(Path, paths)]
    again = "make it again with fuzzyarm sweep --out {}"
    read = [read_checked(one, SCHEMA, again.format(one.parent), functools.partial(_read, one)) for one in files]
    check_comparable(files, [conditions for _, conditions, _ in read], "sweep")
    standings = itertools.chain(*(own for own, _, _ in read))
    return Leaderboard(sorted(standings, key=lambda standing: standing.order), read[0][2])


def _read(file: Path, document: dict[str, Any]) -> tuple[list[_PlantStanding], dict[str, Any], str]:
    """Return a file's standings, the conditions by name that ranked files must share, and version and arm in words."""
    config, method, rows = document["config"], document["method"], document["rows"]
    plants, cases = whole("plants", method["plants"], low=1), list(config["cases"])
    for case in cases:
        find_case(case)
    policies = list(dict.fromkeys(str(row["policy"]) for row in rows))
    if not rows or [(row["policy"], row["case"]) for row in rows] != [(p, c) for p in policies for c in cases]:
        raise ValueError("it must have one row for each case of each policy, in the order of policies and cases")
    declared = read_declarations(document.get("declared"), config["policies"])
    standings = []
    for policy in policies:
        own = {row["case"]: row for row in rows if row["policy"] == policy}
        found = {case: _ends(row["max_mm"][_LEVEL]) for case, row in own.items()}
        ended = sum(whole("ended_early", row["ended_early"], low=0, high=plants) for row in own.values())
        quantiles = {case: None if value == math.inf else value for case, (value, *_) in found.items()}
        swept = {words: metric.key for words, metric in ranked().items() if metric.swept}
        others = {w: {case: row[key][_LEVEL]["value"] for case, row in own.items()} for w, key in swept.items()}
        score = _largest(list(found.values()))
        standings.append(_PlantStanding(policy, str(file), score, quantiles, ended, plants, declared[policy], others))
    robot = "the two-joint arm" if config["robot"] is None else str(config["robot"]["name"])
    release, distribution = document["versions"]["fuzzyarm"], config["distribution"]
    conditions = {
        "version of fuzzyarm": release,
        "cases": cases,
        "distribution": method["distribution"],
        "grid": config["grid"],
        "arm": config["parameters"],
        "robot": config["robot"],
    }
    return standings, conditions, f"fuzzyarm {release}, {robot}, plants of the distribution {distribution}"


def _ends(quantile: dict[str, Any]) -> list[float]:
    """Return a quantile [mm] read from a file and the two ends of its confidence interval; inf replaces None."""
    names = ("value", "low", "high")
    return [math.inf if quantile[name] is None else real(name, quantile[name], "mm", low=0.0) for name in names]


def _largest(found: Sequence[Sequence[float]]) -> MeanInterval | None:
    """Return the largest value, the largest low end and the largest high end over the cases.

    `found` has a row (value, low end, high end) for each case. Return None if the largest value is infinite.
    """
    value, low, high = map(max, zip(*found, strict=True))
    if value == math.inf:
        return None
    return (
        MeanInterval(value, low, high) if low < math.inf else MeanInterval(value, None, None)
    )  # a single plant: no interval
