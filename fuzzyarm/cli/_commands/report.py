"""`fuzzyarm report`: make one HTML page of an evaluation."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import output_file
from fuzzyarm.common.console import say, status

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Make one self-contained HTML page of an evaluation: tables, curves, and a replay of the arms.

    The page loads nothing from the network.
    """

    folder: Annotated[Path, Parameter(name="", metavar="DIR")]
    """Folder that fuzzyarm evaluate --out wrote"""
    _: KW_ONLY
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Page to write (.html; default: DIR/report.html)"""
    bound: Annotated[tuple[Path, ...], Parameter(metavar="FILE")] = ()
    """File written by fuzzyarm prove; it is checked again and drawn as a tube around the path, with the tip in it. May
    be repeated"""

    def run(self) -> int:
        """Write the page; return the exit code."""
        from fuzzyarm.eval.report.page import write_report

        output_file(self.out, ".html")
        out = self.out or self.folder / "report.html"
        with status("reading and drawing"):
            write_report(self.folder, out, self.bound)
        say(f"written to {out}")
        return 0
