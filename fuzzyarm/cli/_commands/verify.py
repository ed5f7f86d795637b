"""`fuzzyarm verify`: prove controller files again in exact arithmetic, and files of bounds in ball arithmetic."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fuzzyarm.common.console import escaped, progress, say, say_json

if TYPE_CHECKING:
    from fuzzyarm.proof.second import SecondCheck

__all__ = ["Options"]


@dataclass(frozen=True)
class Options:
    """Build every matrix inequality of controller files from the stored gains; prove it in exact rational arithmetic.

    For a controller in the semidefinite form of `fuzzyarm design`, bounds on the robot's inertia are proven on boxes
    that cover its joint angles, in ball arithmetic with outward rounding. A file of `fuzzyarm prove` is checked period
    by period, in ball arithmetic. The exit code is 0 only if everything is proven.
    """

    files: Annotated[tuple[Path, ...], Parameter(name="", metavar="FILE...")]
    """Controller file, or file of a bound (.json)"""
    _: KW_ONLY
    json: bool = False
    """Print the claims as JSON"""
    twice: bool = False
    """Also check a bound with the second checker, which shares no code with the first and supports three laws"""

    def run(self) -> int:
        """Print the claims; return 1 if one is not proven."""
        from fuzzyarm.policies.tip_files import check_bound, is_bound
        from fuzzyarm.proof import second
        from fuzzyarm.proof.verification import verify_file

        reports = list[tuple[bool, str, dict[str, Any]]]()
        if self.twice and (other := next((path for path in self.files if not is_bound(path)), None)):
            raise ValueError(
                f"--twice is only for files written by fuzzyarm prove, and {other} is not one; leave out --twice"
            )
        with progress("verifying", len(self.files)) as advance:
            for path in self.files:
                found = check_bound(path) if is_bound(path) else verify_file(path)
                reports.append((found.proven, found.to_text(), found.to_dict()))
                if self.twice:
                    reports.append(_report_of(second.check(path)))
                advance()
        if self.json:
            say_json([data for _, _, data in reports])
        else:
            say("\n\n".join(text for _, text, _ in reports))
        return 0 if all(proven for proven, _, _ in reports) else 1


def _report_of(found: SecondCheck) -> tuple[bool, str, dict[str, Any]]:
    """Return whether the second checker proves a bound, then its result as text and as plain data."""
    said = f"tip within {1.0005e3 * found.bound:.4g} mm" if found.proven else escaped(found.reason)
    verdict = f"{escaped(str(found.path))}: {found.verdict} by the second checker ({found.seconds:.1f} s)"
    data = {"file": str(found.path), "checker": "second", "verdict": found.verdict, "proven": found.proven}
    data |= {"bound": found.bound if found.proven else None, "reason": found.reason, "about": found.about}
    return found.proven, f"{verdict}\n  {found.about}: {said}", data | {"seconds": found.seconds}
