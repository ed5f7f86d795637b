"""`fuzzyarm verify`: prove controller files again in exact arithmetic, and files of bounds in ball arithmetic."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fuzzyarm.common.console import progress, say, say_json

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Form every matrix inequality of controller files from the stored gains; prove it in exact rational arithmetic.

    In the semidefinite form the bounds of the robot's inertia are proven on covers of boxes, in balls with outward
    rounding. A file of `fuzzyarm prove` is checked period by period, in ball arithmetic. The exit code is 0 only if
    everything is proven.
    """

    files: Annotated[tuple[Path, ...], Parameter(name="", metavar="FILE...")]
    """Controller file, or file of a bound (.json)"""
    _: KW_ONLY
    json: bool = False
    """Print the claims as JSON"""
    twice: bool = False
    """Also check a bound with the second checker, which shares no code with the first; it knows three laws"""

    def run(self) -> int:
        """Print the claims; return 1 if one is not proven."""
        from fuzzyarm.policies.tip_files import BoundCheck, check_bound, is_bound
        from fuzzyarm.proof import second
        from fuzzyarm.proof.verification import Verification, verify_file

        reports: list[Verification | BoundCheck | second.SecondCheck] = []
        if self.twice and (other := next((path for path in self.files if not is_bound(path)), None)):
            raise ValueError(f"--twice is for files of bounds, and {other} is not one; leave out --twice")
        with progress("verifying", len(self.files)) as advance:
            for path in self.files:
                check = check_bound if is_bound(path) else verify_file
                reports += [check(path), *([second.check(path)] if self.twice else [])]
                advance()
        if self.json:
            say_json([report.to_dict() for report in reports])
        else:
            say("\n\n".join(report.to_text() for report in reports))
        return 0 if all(report.proven for report in reports) else 1
