"""`fuzzyarm score`: score policies on the held-out set."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import output_file
from fuzzyarm.common.console import output, say, say_json, status
from fuzzyarm.policies import COMPARED

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Run policies on the 128 held-out episodes of this version, and print their scores N.

    computed-torque has N = 0 and learned-observer N = 100. The episodes' paths, arms, pushes and payloads are never
    used in training.
    """

    policy: Annotated[tuple[str, ...], Parameter(metavar="NAME...")] = COMPARED
    """Policy: a name, a controller file (.json), a learned policy's folder, another library's model as sb3:model.zip or
    onnx:model.onnx, or your own code as package.module:factory, which must act on batches. May be repeated, for example
    for several seeds of one training (default: those that evaluate compares)"""
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """Results file to write (.json; default: none)"""
    json: bool = False
    """Print the results as JSON instead of the table"""

    def run(self) -> int:
        """Run the policies, print their scores, and write the file if one is given."""
        from fuzzyarm.common.files import write_atomically
        from fuzzyarm.eval.score import print_scores, scores
        from fuzzyarm.policies import resolve_all

        output_file(self.out, ".json")
        policies = {label: spec.load() for label, spec in resolve_all(self.policy, run_code=True).items()}
        with status("running 128 held-out episodes of each policy"):
            document = scores(policies)
        if self.out is not None:
            write_atomically(self.out, json.dumps(document, indent=1) + "\n")
        if self.json:
            say_json(document)
            return 0
        print_scores(document, output())
        for line in document["remarks"]:
            say(line, error=True)
        if self.out is not None:
            say(f"\nwritten to {self.out}")
        return 0
