"""A ranking of the policies of several evaluations in one table, best first.

The score of a policy in one seed is the largest tip error of all cases [mm]: a user who does not know the next load
must allow for it. Over several seeds the score is the interquartile mean of the seeds' errors, with a bootstrap
interval of 95 % (`_statistics`). Smaller is better. Policies that lost the path, see `metrics.is_lost`, have no score
and rank last, ordered by the number of episodes in which they lost it.

Only comparable files are ranked together: the same version of fuzzyarm and the same conditions, see `results_file`.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from fuzzyarm.common.checks import listed, path_of, sequence_of
from fuzzyarm.common.console import Sheet, print_paragraphs
from fuzzyarm.envs.scenario.cases import CASES
from fuzzyarm.eval.declarations import ROW, declared_cells, print_declared
from fuzzyarm.eval.episodes.metrics import LOST, RESOLUTION, is_lost, millimetres, ranked
from fuzzyarm.eval.evaluation._statistics import MeanInterval, estimate, interquartile_mean
from fuzzyarm.eval.evaluation.results_file import conditions_of, read_results
from fuzzyarm.eval.evaluation.run import Evaluation
from fuzzyarm.policies.declared import Declared

__all__ = [
    "Leaderboard", "Standing", "check_comparable", "document", "markdown", "other_cells", "other_headings",
    "print_leaderboard", "rank_policies", "shown", "standings_of",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Standing:
    """The result of one policy in one results file."""

    policy: str  # its label
    source: str  # the file that contains it
    score: MeanInterval | None  # see the module [mm]; None if the path was lost
    rms: dict[str, float | None]  # interquartile mean over seeds of the rms tip error by case [mm]; None where lost
    lost: int  # number of episodes in which the path was lost
    episodes: int  # number of episodes
    certified: bool  # whether it has a certificate
    tip: str  # what is proven about its tip, in words; empty if no bound was given
    declared: Declared | None  # what it declares; None if it declares nothing
    others: dict[str, dict[str, float | None]]  # the metrics of `metrics.ranked` by their words, as for rms

    @property
    def order(self) -> tuple[int, float]:
        """Sort key: number of lost episodes, then the score [mm]; the best policy has the smallest."""
        return self.lost, math.inf if self.score is None else max(self.score.mean, RESOLUTION)

    @property
    def headings(self) -> list[str]:
        """Headings of the table's columns after the score."""
        return [*(f"rms, {case} [mm]" for case in self.rms), *other_headings(list(self.rms)), "proven", "from"]

    @property
    def cells(self) -> list[str]:
        """Cells of the table's row: the score, then those below `headings`."""
        return [
            f"lost in {self.lost} of {self.episodes}" if self.score is None else shown(self.score),
            *("lost" if value is None else millimetres(value) for value in self.rms.values()),
            *other_cells(self.others, "lost"),
            "; ".join(filter(None, ["rigid arm" if self.certified else "", self.tip])) or "-",
            self.source,
        ]

    @staticmethod
    def notes(standings: Sequence[Any]) -> str:
        """Return the notes below a table of these standings."""
        interval = any(standing.score and standing.score.low is not None for standing in standings)
        return (
            "Score: largest tip error of all cases"
            + (", interquartile mean over seeds with a bootstrap interval of 95 %" if interval else "")
            + f". Lost: an episode ended early, or the tip was more than {LOST:g} mm off; such policies rank last. "
            + "Proven: for the rigid arm, decay and L2 gain in its box; for the tip, what the files of --bound state."
        )


@dataclasses.dataclass(frozen=True)
class Leaderboard:
    """A ranking: standings of one kind (`Standing`, or `PlantStanding` of sweeps), best first, and their conditions."""

    standings: list[Any]
    conditions: str  # in words

    @property
    def ranks(self) -> list[int]:
        """Rank of each standing, from 1; policies of equal `order` share a rank."""
        orders = [standing.order for standing in self.standings]
        return [1 + orders.index(order) for order in orders]

    @property
    def sheet(self) -> Sheet:
        """The table, with a row for each standing."""
        headings = ["rank", "policy", "score [mm]", *self.standings[0].headings]
        rows = zip(self.ranks, self.standings, strict=True)
        cells = [[str(rank), standing.policy, *standing.cells] for rank, standing in rows]
        left = [column for column, heading in enumerate(headings) if heading in ("policy", "proven", "from")]
        return Sheet(headings, cells, left, fold=True, keys=2)

    @property
    def notes(self) -> str:
        """The notes below the table."""
        return f"{self.standings[0].notes(self.standings)} All: {self.conditions}."


def rank_policies(paths: Sequence[str | Path], tips: Mapping[str, str] | None = None) -> Leaderboard:
    """Rank the policies of results files, or of the folders that contain such files.

    `tips` maps policies to statements of what is proven about the tip.

    Raises:
        ValueError: a file is missing, damaged or given twice, or two files are not comparable; the message names the
            first difference.
        OSError: a file cannot be read.
    """
    read = [read_results(path_of("paths", path)) for path in sequence_of("paths", paths)]
    versions = [results.made_with["versions"]["fuzzyarm"] for results in read]
    conditions = [
        {"version of fuzzyarm": version, **conditions_of(results.config)[0]}
        for version, results in zip(versions, read, strict=True)
    ]
    check_comparable([results.path for results in read], conditions, "evaluate")
    standings = [one for results in read for one in standings_of(results, str(results.path), tips)]
    words = f"fuzzyarm {versions[0]}, {conditions_of(read[0].config)[1]}"
    return Leaderboard(sorted(standings, key=lambda standing: standing.order), words)


def check_comparable(files: Sequence[Path], conditions: Sequence[Mapping[str, Any]], verb: str) -> None:
    """Raise ValueError if a file is given twice, or differs from the first in a condition.

    The message asks the user to run the command `verb` again.
    """
    for number, (file, theirs) in enumerate(zip(files, conditions, strict=True)):
        if any(file.samefile(earlier) for earlier in files[:number]):
            raise ValueError(f"{file} is given twice; leave one out")
        for name, value in conditions[0].items():
            if theirs[name] != value:
                raise ValueError(
                    f"{files[0]} and {file} are not comparable: {name} is {listed([value])} in the first and "
                    f"{listed([theirs[name]])} in the second; {verb} again under the same conditions"
                )


def standings_of(evaluation: Evaluation, source: str = "", tips: Mapping[str, str] | None = None) -> list[Standing]:
    """Return the standing of each policy of an evaluation, in the order of its configuration.

    `source` names the file in the table; `tips` as for `rank_policies`.
    """
    standings, config = [], evaluation.config
    for policy, certificate in evaluation.certificates.items():
        own = [row for row in evaluation.rows if row["policy"] == policy]
        by_case = {case: [row for row in own if row["case"] == case] for case in CASES if case in config.cases}
        lost = sum(map(is_lost, own))
        rms, *others = (
            {
                case: None
                if any(map(is_lost, runs))
                else float(interquartile_mean(np.array([run[key] for run in runs])))
                for case, runs in by_case.items()
            }
            for key in ("tip_error_rms_mm", *(metric.name for metric in ranked().values()))
        )
        scores = [max(row["tip_error_max_mm"] for row in own if row["seed"] == seed) for seed in range(config.seeds)]
        standings.append(
            Standing(
                policy=policy,
                source=source,
                score=None if lost else estimate(scores),
                rms=rms,
                others=dict(zip(ranked(), others, strict=True)),
                lost=lost,
                episodes=len(own),
                certified=certificate is not None,
                tip=(tips or {}).get(policy, ""),
                declared=evaluation.declared[policy],
            )
        )
    return standings


def other_headings(cases: Sequence[str], what: str = "") -> list[str]:
    """Return a heading for each metric of `metrics.ranked` in each case; every heading begins with `what`."""
    return [f"{what}{words}, {case} [{metric.unit}]" for words, metric in ranked().items() for case in cases]


def other_cells(others: Mapping[str, Mapping[str, float | None]], without: str) -> list[str]:
    """Return the cells below `other_headings` for values by metric and case; `without` replaces None."""
    known = ranked()
    return [
        without if value is None else known[words].text(value)
        for words, by_case in others.items()
        for value in by_case.values()
    ]


def shown(score: MeanInterval) -> str:
    """Return a score [mm] with its interval, if it has one."""
    mean, low, high = score
    return millimetres(mean) + ("" if low is None or high is None else f" ({millimetres(low)} to {millimetres(high)})")


def print_leaderboard(board: Leaderboard, console: Console, *, declared: bool = False) -> None:
    """Print the table and its notes; if `declared`, print what each policy declares about itself."""
    board.sheet.print(console)
    print_paragraphs(console, [board.notes])
    if declared:
        print_declared(_declared_rows(board), ROW, console)


def markdown(board: Leaderboard, *, declared: bool = False) -> str:
    """Return the table and its notes as Markdown, and with `declared` a table of what the policies declare."""
    tables = [Sheet(ROW, _declared_rows(board), range(len(ROW))).markdown()] if declared else []
    return "\n\n".join([board.sheet.markdown(), board.notes, *tables])


def document(board: Leaderboard) -> dict[str, Any]:
    """Return the ranking ready for JSON: conditions, notes, and each standing with its rank and its declaration."""
    standings = []
    for rank, one in zip(board.ranks, board.standings, strict=True):
        fields = _plain(dataclasses.asdict(one))
        others = fields.pop("others")
        standings.append({"rank": rank, **fields, **others})
    return {"conditions": board.conditions, "notes": board.notes, "standings": standings}


def _declared_rows(board: Leaderboard) -> list[tuple[str, ...]]:
    """Return rows of cells under the headings `ROW`, one for each declaration of a policy.

    If a policy has several, the first cell also names the results file.
    """
    sources = {(one.policy, declared_cells(one.declared)): one.source for one in reversed(board.standings)}
    names = [policy for policy, _ in sources]
    return [
        (policy if names.count(policy) == 1 else f"{policy} ({source})", *cells)
        for (policy, cells), source in reversed(sources.items())
    ]


def _plain(value: Any) -> Any:
    """Return named tuples as mappings, and numbers that JSON lacks as None."""
    if isinstance(value, MeanInterval | Declared):
        return _plain(value._asdict())
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
