"""`fuzzyarm export`: write a policy as C source, ONNX or an FMU, the plant as an FMU, or both as an automaton."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, claimed_folder
from fuzzyarm.common.console import say

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Write a policy as C99 source, ONNX or an FMU, the plant as an FMU, or both as an automaton.

    The source, with a header and test vectors, is made from the policy's Python source and gives the same numbers, bit
    for bit. It allocates no memory, calls no library and has no loop whose length depends on data. An FMU is for
    FMI 2.0 co-simulation; it has the same source and, with a C compiler, the library for this machine. An ONNX file
    has the same operations for many arms at once, with the memory as input and output. An automaton is the problem of
    `fuzzyarm prove` for other tools: the arm, its set of plants and initial states, the references, the law as ONNX.
    """

    what: Annotated[str, Parameter(name="", metavar="c|fmu|onnx|automaton")]
    """Format: c (source), fmu (functional mock-up unit), onnx (law and memory, needs the extra onnx) or automaton
    (hybrid automaton of the arm in SpaceEx's format, and the law as ONNX)"""
    policy: Annotated[str, Parameter(metavar="NAME|FILE")]
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, elastic-observer, a learned policy, or a controller
    file (.json, .json-tip); for fmu also plant, the arm itself"""
    _: KW_ONLY
    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the files, created if needed"""
    number: Literal["double", "float"] = "double"
    """Type of the numbers in C source; float is rounded, see the documentation for the effect"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name, or TOML file of another arm or robot, for the plant and for policies without a file (default:
    Table 1 of the paper)"""
    set: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """For automaton: set of plants, as for fuzzyarm prove (default: near)"""
    start: Annotated[tuple[str, ...] | None, Parameter(metavar="FILE|NUMBERS", consume_multiple=True)] = None
    """For automaton: box of initial states, as for fuzzyarm prove (default: at rest on the path)"""

    def run(self) -> int:
        """Write the files and print their names."""
        from fuzzyarm.cli._commands.show import loaded
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.export.automaton import export_automaton
        from fuzzyarm.export.c_files import export_c
        from fuzzyarm.export.fmu import PLANT, export_controller_fmu, export_plant_fmu
        from fuzzyarm.export.onnx_file import export_onnx
        from fuzzyarm.policies import resolve

        if self.what not in ("c", "fmu", "onnx", "automaton"):
            raise UsageError(f"{self.what} is not an export format; choose from: c, fmu, onnx, automaton")
        if self.what != "automaton" and (self.set or self.start):
            raise UsageError(f"--set and --start are for the format automaton, not for {self.what}; leave them out")
        if self.what != "c" and self.number != "double":
            raise UsageError(f"--number {self.number} is for C source only, and {self.what} uses double; leave it out")
        fmu, label = self.what == "fmu", self.policy
        if fmu and label == PLANT:
            arm = chosen_arm(self.robot, None)
        else:
            policy, label = loaded(label, self.robot), resolve(label).label
        with claimed_folder(self.out):
            if self.what == "automaton":
                files = export_automaton(label, policy, _problem(self), self.out)
            elif self.what == "onnx":
                files = [export_onnx(label, policy, self.out)]
            elif not fmu:
                files = export_c(label, policy, self.out, self.number)
            elif self.policy == PLANT:
                files = [export_plant_fmu(arm, self.out)]
            else:
                files = [export_controller_fmu(label, policy, self.out)]
        say("\n".join(f"written to {file}" for file in files))
        return 0


def _problem(options: Options) -> Any:
    """Return the problem of `fuzzyarm prove` for the policy, robot, set of plants and initial states in the options."""
    from fuzzyarm.envs.physics.equations import chosen_arm
    from fuzzyarm.envs.physics.parameters import ArmParameters
    from fuzzyarm.policies.tip_bound import TipClaim, problem_of
    from fuzzyarm.proof.tip.laps import StartBox
    from fuzzyarm.proof.tip.plant import find_set

    arm = None if options.robot is None else chosen_arm(options.robot, None)
    if not isinstance(arm, ArmParameters | None):
        raise UsageError(f"--robot {options.robot} has joint frames; the format automaton needs an arm without them")
    start = None if options.start is None else StartBox.of(options.start)
    claim = TipClaim(options.policy, plants=find_set(options.set or "near"), start=start, arm=arm)
    return problem_of(claim)
