"""`fuzzyarm bench`: measure steps per second."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli.options import chosen, with_fields_of
from fuzzyarm.cli.usage import UsageError, writable_folder
from fuzzyarm.eval.bench.config import BenchConfig

__all__ = ["Options", "run"]


@with_fields_of(BenchConfig, without=("sweep",))
@dataclass(frozen=True, kw_only=True)
class Options:
    """Measure environment steps per second, this project's environments and their peers in turns; print a table.

    It takes about two minutes. The peers are installed by: pip install 'fuzzyarm[bench]', torch by 'fuzzyarm[rl]'.
    """

    lanes_sweep: bool = False
    """measure batches of 1, 4, 16, ... 262144 lanes too and draw throughput.png; takes a few minutes, needs --out"""
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """folder for bench.json and the figure (default: none)"""
    json: bool = False
    """print the results as JSON instead of the table"""
