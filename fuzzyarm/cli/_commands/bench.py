"""`fuzzyarm bench`: measure control steps per second."""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._options import chosen, with_fields_of
from fuzzyarm.cli._usage import UsageError, claimed_folder
from fuzzyarm.common.console import output, progress, say, say_json
from fuzzyarm.eval.bench.run import BenchConfig

__all__ = ["Options"]


@with_fields_of(BenchConfig)
@dataclass(frozen=True, kw_only=True)
class Options:
    """Measure the speed of this project's environments and comparable ones, in turn, and print a table.

    This takes about three minutes. To install the comparable environments, run pip install -c constraints.txt -e
    ".[bench]" in the repository; for torch, use ".[rl]" instead.
    """

    out: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """Folder for bench.json and the figure (default: none)"""
    json: bool = False
    """Print the results as JSON instead of the table"""

    def run(self) -> int:
        """Print the table, and write the file and the figure."""
        from fuzzyarm.eval.bench.run import run_bench, write_document
        from fuzzyarm.eval.bench.speed_table import print_speeds

        config = chosen(self, BenchConfig())
        if config.lanes_sweep and self.out is None:
            raise UsageError("--lanes-sweep needs --out DIR, the folder for its figure throughput.png")
        with contextlib.nullcontext() if self.out is None else claimed_folder(self.out):
            # The bar is drawn between the turns: nothing else may run while a turn is timed.
            with progress("", config.turns(), between_steps=True) as advance:
                document = run_bench(config, advance)
            written = write_document(document, self.out) if self.out is not None else []
        if self.json:
            say_json(document)
            return 0
        print_speeds(document, output())
        if written:
            say(f"\nwritten to {self.out}: {', '.join(path.name for path in written)}")
        return 0
