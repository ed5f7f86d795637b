"""`fuzzyarm tune`: find the parameters of every model-based policy for an arm."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.cli._usage import claimed_folder, stopped
from fuzzyarm.common.console import output, progress, say

__all__ = ["Options"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Find the parameters of every model-based policy for an arm, by the rules used for the shipped ones.

    Writes one folder: a proven controller file, the parameters of the other laws, their margins and a page with the
    decisions. evaluate, margins and sweep --robot DIR then run its policies. This takes minutes; finished steps are
    kept.
    """

    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name (paper, cicese, manutec-r3, planar-3r, ur5, panda), or TOML file of another arm or robot (default:
    Table 1 of the paper)"""
    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder to write, new or empty"""
    resume: bool = False
    """Continue the tuning in the folder, for the same arm; the result is that of an uninterrupted run"""
    jobs: Annotated[int | None, Parameter(metavar="N")] = None
    """Number of processes (default: one per core)"""

    def run(self) -> int:
        """Tune; return 1 if no policy has stable gains."""
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.eval.engine import Engine, WorkersLost
        from fuzzyarm.eval.stability.margins import print_margins
        from fuzzyarm.eval.tuning.readme import decision
        from fuzzyarm.eval.tuning.run import NothingFound, begin, ranges_of, resumed_arm, tune

        engine = Engine(jobs=self.jobs)
        arm = chosen_arm(self.robot, None)
        if self.resume:
            arm = resumed_arm(self.out, None if self.robot is None else arm)
        with claimed_folder(self.out):
            if not self.resume:
                begin(arm, self.out, ranges_of(self.robot))
            try:
                tuned = tune(
                    arm,
                    self.out,
                    engine=engine,
                    bar=progress,
                    finished=lambda finding: say(f"{finding.policy}: {decision(finding)}"),
                )
            except (KeyboardInterrupt, WorkersLost) as error:
                return stopped("tune", self.out, error)
            except NothingFound as error:
                say(f"fuzzyarm tune: {error}", error=True)
                return 1
        print_margins(tuned.margins, output())
        say(f"\nwritten to {self.out}: {', '.join(tuned.laws.policies)}; {self.out / 'README.md'} states the choices")
        say(f"to compare these policies, run fuzzyarm evaluate --robot {self.out}")
        return 0
