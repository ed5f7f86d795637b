"""`fuzzyarm leaderboard`: rank the policies of several evaluations or sweeps."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError
from fuzzyarm.common.console import output, say, say_json

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Rank the policies in results files by their largest tip error over all cases.

    Sweeps are ranked by the error that 99 % of the plants stay below in every case. Files of different kinds,
    conditions or versions are refused.
    """

    files: Annotated[tuple[Path, ...], Parameter(name="", metavar="FILE...")]
    """File results.json or sweep.json, or the folder that fuzzyarm evaluate --out or fuzzyarm sweep --out wrote"""
    _: KW_ONLY
    bound: Annotated[tuple[Path, ...], Parameter(metavar="FILE")] = ()
    """File written by fuzzyarm prove, which is checked again; the table then states what is proven about the tip. May
    be repeated; not for sweeps"""
    declared: bool = False
    """Also print what each policy declares: its objective, what it was tuned on, what it knows about the arm, what it
    observes and remembers"""
    markdown: bool = False
    """Print the table as Markdown"""
    json: bool = False
    """Print the ranking as JSON, which always includes what the policies declare"""

    def run(self) -> int:
        """Print the table."""
        from fuzzyarm.eval.evaluation.ranking import document, markdown, print_leaderboard, rank_policies
        from fuzzyarm.eval.report.certificates import checked_bounds
        from fuzzyarm.eval.sweep.ranking import is_sweep, rank_sweeps

        if self.markdown and self.json:
            raise UsageError("--markdown and --json are two formats of the same table: leave out one")
        sweeps = [path for path in self.files if is_sweep(path)]
        if sweeps and len(sweeps) < len(self.files):
            (other, *_) = (path for path in self.files if path not in sweeps)
            raise ValueError(f"{sweeps[0]} is a sweep and {other} is not: rank sweeps and evaluations separately")
        if sweeps and self.bound:
            raise ValueError("--bound is for one known arm, but a sweep has many plants: leave out --bound")
        tips: dict[str, list[str]] = {}
        for check in checked_bounds(self.bound):
            tips.setdefault(check.claim.policy, []).append(check.sentence)
        proven = {policy: "; ".join(sentences) for policy, sentences in tips.items()}
        board = rank_sweeps(sweeps) if sweeps else rank_policies(self.files, proven)
        if self.json:
            say_json(document(board))
        elif self.markdown:
            say(markdown(board, declared=self.declared))
        else:
            print_leaderboard(board, output(), declared=self.declared)
        return 0
