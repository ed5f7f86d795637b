"""`fuzzyarm paper`: reproduce the paper's figures and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli.usage import UsageError, check_writable, claimed_folder
from fuzzyarm.common.console import output, progress, say, say_json

__all__ = ["Options", "run"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Reproduce Figs. 2-10 and Table 2 of the paper from the controllers with 32 and 4 rules.

    A table compares what the paper says with what is measured here, and a line says how many numbers agree and which
    do not. The exit code is 1 if a number differs by more than its tolerance from the stored one, else 0, whether it
    agrees with the paper or not. It takes a quarter of a minute.
    """

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for paper.md, paper.json and the figures"""
    expected: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """File of stored numbers to compare with (default: the one in the package)"""
    renew: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Write the measured numbers to a file for --expected instead of comparing them; the exit code is then 0"""
    json: bool = False
    """Print the results as JSON instead of the tables"""


def run(options: Options) -> int:
    """Write tables and figures; return 1 if a number has drifted."""
    from fuzzyarm.eval.paper import report
    from fuzzyarm.eval.paper.evidence import STEPS, gather
    from fuzzyarm.eval.paper.figures import write_figures

    if options.renew and options.expected:
        raise UsageError("--renew writes new stored numbers and --expected compares with old ones; give one of them")
    stored = None if options.renew else report.load_expected(options.expected or report.EXPECTED)
    if options.renew:
        check_writable(options.renew.parent)
    with claimed_folder(options.out):
        with progress("runs and proofs", STEPS) as advance:
            evidence = gather(advance)
            comparison = report.compare(evidence, stored)
        if options.renew:
            report.store_expected(comparison.measured, comparison.made_with, options.renew)
        with progress("figures", None) as advance:
            figures = write_figures(evidence, options.out, advance)
        written = [*figures, *report.write_report(comparison, figures, options.out)]
    if options.json:
        say_json(comparison.to_dict())
    else:
        report.print_report(comparison, output())
        say(f"\n{len(written)} files in {options.out}")
    for moved in comparison.drifted:
        say(f"fuzzyarm paper: {moved}", error=True)
    return 1 if comparison.drifted else 0
