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
    markdown: bool = False
    """Print the table as Markdown"""


def run(options: Options) -> int:
    """Print the table."""
    from fuzzyarm.common.console import output, say
    from fuzzyarm.eval.evaluation.ranking import markdown, print_leaderboard, rank_policies

    board = rank_policies(options.files)
    if options.markdown:
        say(markdown(board))
    else:
        print_leaderboard(board, output())
    return 0
