"""`fuzzyarm prove`: a proven bound of the tip error of a policy on the elastic, sampled arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from fuzzyarm.cli.usage import output_file

__all__ = ["Options", "run"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Prove a bound of the largest tip error at any sample of a motion, for every plant of a set.

    The elastic joints, the held torque, the limits of the torque and the dry friction are part of what is proven. The
    exit code is 1, with one line that says why, where no bound is found.
    """

    policy: Annotated[str, Parameter(metavar="NAME")] = "fuzzy-4-tip"
    """Policy: fuzzy-4, computed-torque, ... with or without -tip, or a controller file (.json, .json-tip)"""
    case: Annotated[str, Parameter(metavar="NAME")] = "nominal"
    """Case: nominal, machining or payload"""
    set: Annotated[str, Parameter(metavar="NAME|FILE")] = "table-1"
    """Set of plants: table-1, any-friction, near, near-late, or a TOML file with ranges of factors"""
    path: Literal["circle", "lemniscate"] = "circle"
    """Path of the tip"""
    duration: float = 1.5
    """Of the motion [s]"""
    steps: Annotated[int | None, Parameter(metavar="N")] = None
    """Bound the first N control steps of the motion (default: all)"""
    out: Annotated[Path | None, Parameter(metavar="FILE")] = None
    """File of the bound to write (.json; default: none), which fuzzyarm verify checks again"""
    json: bool = False
    """Print the result as JSON"""


def run(options: Options) -> int:
    """Print the bound, and write its file."""
    import json

    from fuzzyarm.common.console import escaped, progress, say
    from fuzzyarm.eval.certified.tip.bound import TipClaim, find_bound, problem_of
    from fuzzyarm.eval.certified.tip.bound_file import save_bound
    from fuzzyarm.eval.certified.tip.enclosures import NoBound
    from fuzzyarm.eval.certified.tip.plant_set import find_set

    if options.out is not None:
        output_file(options.out, ".json")
    plants = find_set(options.set)
    claim = TipClaim(options.policy, options.case, options.set, plants, options.path, options.duration, options.steps)
    try:
        with progress("proving", problem_of(claim).schedule.steps) as advance:
            bound = find_bound(claim, advance)
    except NoBound as error:
        failed = {"policy": options.policy, "case": options.case, "set": options.set, "proven": False, "bound": None}
        if options.json:
            say(json.dumps(failed | {"reason": str(error)}, indent=1))
        else:
            say(escaped(str(error)), error=True)
        return 1
    if options.out is not None:
        save_bound(bound, options.out)
    say(json.dumps(bound.to_dict(), indent=1) if options.json else bound.to_text())
    return 0
