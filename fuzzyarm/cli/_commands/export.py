"""`fuzzyarm export`: write a policy as C source or as ONNX, or a policy or the plant as an FMU."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from fuzzyarm.cli._usage import UsageError, claimed_folder
from fuzzyarm.common.console import say

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Write a policy as C99 source, with a header and test vectors, or as ONNX, or a policy or the plant as an FMU.

    The source is generated from the policy's own Python source and gives the same numbers, bit for bit. It allocates
    nothing, calls no library and has no loop whose length depends on data. An FMU is for co-simulation by FMI 2.0; it
    holds the same source, and where there is a C compiler, the library for this machine. An ONNX file holds the same
    operations for many arms at once, with the memory as an input and an output.
    """

    what: Annotated[str, Parameter(name="", metavar="c|fmu|onnx")]
    """What is written: c (source), fmu (functional mock-up unit) or onnx (law and memory, needs the extra onnx)"""
    policy: Annotated[str, Parameter(metavar="NAME|FILE")]
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, elastic-observer, a learned policy, or a controller
    file (.json, .json-tip); after fmu also plant, the arm itself"""
    _: KW_ONLY
    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the files, made if needed"""
    number: Literal["double", "float"] = "double"
    """Type of the numbers of C source; float is rounded, see the documentation for how much that changes"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name, or TOML file of another arm or robot, for the plant and for policies without a file (default:
    Table 1 of the paper)"""

    def run(self) -> int:
        """Write the files and say which."""
        from fuzzyarm.cli._commands.show import loaded
        from fuzzyarm.envs.physics.equations import chosen_arm
        from fuzzyarm.export.c_files import export_c
        from fuzzyarm.export.fmu import PLANT, export_controller_fmu, export_plant_fmu
        from fuzzyarm.export.onnx_file import export_onnx
        from fuzzyarm.policies import resolve

        if self.what not in ("c", "fmu", "onnx"):
            raise UsageError(f"{self.what} is not an export language; choose from: c, fmu, onnx")
        if self.what != "c" and self.number != "double":
            raise UsageError(f"--number {self.number} is for C source; {self.what} computes in double")
        fmu, label = self.what == "fmu", self.policy
        if fmu and label == PLANT:
            arm = chosen_arm(self.robot, None)
        else:
            policy, label = loaded(label, self.robot), resolve(label).label
        with claimed_folder(self.out):
            if self.what == "onnx":
                files = [export_onnx(label, policy, self.out)]
            elif not fmu:
                files = export_c(label, policy, self.out, self.number)
            elif self.policy == PLANT:
                files = [export_plant_fmu(arm, self.out)]
            else:
                files = [export_controller_fmu(label, policy, self.out)]
        say("\n".join(f"written to {file}" for file in files))
        return 0
