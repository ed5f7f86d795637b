"""`fuzzyarm margins`: measure how far policies are from instability."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import output_file
from fuzzyarm.common.console import output, progress, say, say_json

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Linearise, for each policy, its closed loop with the sampled elastic arm along the arm's default path.

    Print the loop's spectral radius, nominal and with changed loop gain, delay, stiffness or payload, and its gain
    margins.
    """

    policy: Annotated[tuple[str, ...], Parameter(metavar="NAME...")] = ()
    """Policy: fuzzy-4, computed-torque, ..., a controller file (.json), a learned policy's folder, or your own code as
    package.module:factory, which must act on batches. May be repeated (default: all named policies; for another robot
    computed-torque, with and without -tip, and elastic-observer)"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Another robot: cicese, manutec-r3, planar-3r, ur5, panda, or the TOML file of a robot or of a two-joint arm
    (default: Table 1 of the paper)"""
    control_period: Annotated[float, Parameter(metavar="SECONDS")] = 1e-3
    """Time between two torques [s]"""
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Results file to write (.json; default: none)"""
    json: bool = False
    """Print the results as JSON instead of the table"""

    def run(self) -> int:
        """Print the table, and write the file."""
        from fuzzyarm.common.files import write_atomically
        from fuzzyarm.eval.stability.margins import MarginsConfig, measure_margins, print_margins

        output_file(self.out, ".json")
        config = MarginsConfig(policies=self.policy or None, robot=self.robot, control_period=self.control_period)
        with progress("policies", len(config.names())) as advance:
            document = measure_margins(config, advance)
        if self.out is not None:
            write_atomically(self.out, json.dumps(document, indent=1) + "\n")
        if self.json:
            say_json(document)
            return 0
        print_margins(document, output())
        if self.out is not None:
            say(f"\nwritten to {self.out}")
        return 0
