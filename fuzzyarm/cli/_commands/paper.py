"""`fuzzyarm paper`: reproduce the paper's figures and numbers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, check_writable, claimed_folder
from fuzzyarm.common.console import output, progress, say, say_json

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Reproduce Figs. 2-10 and Table 2 of the paper from the controllers with 32 and 4 rules.

    A table compares the paper's numbers with ours, and a line states how many agree and which do not. The exit code is
    1 if a number differs by more than its tolerance from the stored one, else 0, regardless of agreement with the
    paper. This takes about 15 seconds.
    """

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for paper.md, paper.json and the figures"""
    expected: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """File of stored numbers to compare with (default: the one in the package)"""
    renew: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Write the measured numbers to a file for --expected instead of comparing them; the exit code is then 0"""
    json: bool = False
    """Print the results as JSON instead of the tables"""

    def run(self) -> int:
        """Write tables and figures; return 1 if a number is too far from the stored one, else 0."""
        from fuzzyarm.eval.paper import _report as report
        from fuzzyarm.eval.paper.evidence import gather
        from fuzzyarm.eval.paper.figures import write_figures

        if self.renew and self.expected:
            raise UsageError("--renew replaces the stored numbers, and --expected compares with them; give only one")
        stored = None if self.renew else report.load_expected(self.expected or report.EXPECTED)
        if self.renew:
            check_writable(self.renew.parent)
        with claimed_folder(self.out):
            with progress("runs and proofs", None) as advance:
                evidence = gather(advance)
                comparison = report.compare(evidence, stored)
            if self.renew:
                report.store_expected(comparison.measured, comparison.made_with, self.renew)
            with progress("figures", None) as advance:
                figures = write_figures(evidence, self.out, advance)
            written = [*figures, *report.write_report(comparison, figures, self.out)]
        if self.json:
            say_json(comparison.to_dict())
        else:
            report.print_report(comparison, output())
            say(f"\n{len(written)} files written to {self.out}")
        for moved in comparison.drifted:
            say(f"fuzzyarm paper: {moved}", error=True)
        return 1 if comparison.drifted else 0
