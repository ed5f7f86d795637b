"""`fuzzyarm export`: a policy as C source for a controller board."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from cyclopts import Parameter

from fuzzyarm.cli.usage import UsageError, claimed_folder

__all__ = ["LANGUAGES", "Options", "run"]

LANGUAGES = ("c",)
"""What a policy can be written in."""


@dataclass(frozen=True)
class Options:
    """Write a policy as C99 source: a header, a source file and test vectors.

    The source is made from the policy's own Python source and gives the same numbers, bit by bit. It allocates nothing,
    calls no library and has no loop whose length depends on data.
    """

    arguments: ClassVar[str] = "c NAME|FILE"

    what: Annotated[str, Parameter(name="", metavar="c")]
    """Language of the source: c"""
    policy: Annotated[str, Parameter(metavar="NAME|FILE")]
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, elastic-observer, or a controller file (.json,
    .json-tip)"""
    _: KW_ONLY
    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the files, made if needed"""
    number: Literal["double", "float"] = "double"
    """Type of the numbers; float is rounded, see the documentation for how much that changes"""
    robot: Annotated[str | None, Parameter(metavar="NAME|FILE")] = None
    """Robot by name, or TOML file of another arm or robot, for policies without a file (default: Table 1 of the
    paper)"""


def run(options: Options) -> int:
    """Write the files and say which."""
    from fuzzyarm.cli.show import loaded
    from fuzzyarm.common.console import escaped, say
    from fuzzyarm.export.c_files import export_c
    from fuzzyarm.policies import resolve

    if options.what not in LANGUAGES:
        raise UsageError(f"{options.what} is no language of an export; choose from: {', '.join(LANGUAGES)}")
    policy = loaded(options.policy, options.robot)
    with claimed_folder(options.out):
        files = export_c(resolve(options.policy).label, policy, options.out, options.number)
    say(escaped("\n".join(f"written to {file}" for file in files), lines=True))
    return 0
