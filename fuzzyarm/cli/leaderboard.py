"""`fuzzyarm leaderboard`: rank the policies of several evaluations."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from cyclopts import Parameter

__all__ = ["Options", "run"]


@dataclass(frozen=True)
class Options:
    """Rank the policies of results files by the largest tip error of all cases.

    Files of different conditions or versions are refused.
    """

    arguments: ClassVar[str] = "FILE..."

    files: Annotated[tuple[Path, ...], Parameter(name="", metavar=arguments)]
    """File results.json, or the folder that fuzzyarm evaluate --out wrote"""
    _: KW_ONLY
    bound: Annotated[tuple[Path, ...], Parameter(metavar="FILE")] = ()
    """File of fuzzyarm prove, checked again: what is proven of the tip; may be repeated"""
    markdown: bool = False
    """Print the table as Markdown"""


def run(options: Options) -> int:
    """Print the table."""
    from fuzzyarm.common.console import output, say
    from fuzzyarm.eval.evaluation.ranking import markdown, print_leaderboard, rank_policies
    from fuzzyarm.eval.report.tubes import checked_bounds

    tips: dict[str, list[str]] = {}
    for check in checked_bounds(options.bound):
        tips.setdefault(check.claim.policy, []).append(check.sentence)
    board = rank_policies(options.files, {policy: "; ".join(sentences) for policy, sentences in tips.items()})
    if options.markdown:
        say(markdown(board))
    else:
        print_leaderboard(board, output())
    return 0
