"""The report of `fuzzyarm verify` on a controller file of the form "semidefinite"."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

from fuzzyarm.common.console import escaped
from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.fuzzy_policy.proof.certificate import Certificate
from fuzzyarm.fuzzy_policy.proof.scheduled_certificate import certify_scheduled
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController

__all__ = ["ScheduledVerification", "verify_scheduled"]


@dataclasses.dataclass(frozen=True)
class ScheduledVerification:
    """The certificate of one file, proven in exact rationals and, on covers of boxes, twice: in floats and in balls.

    Attributes:
        path: the file.
        controller: its content.
        certificate: its claims, each proven or not.
        seconds: time of the proof.
    """

    path: Path
    controller: ScheduledController
    certificate: Certificate
    seconds: float

    @property
    def proven(self) -> bool:
        """Whether every claim is proven."""
        return self.certificate.proven

    def to_text(self) -> str:
        """Return the report as text: a line for each claim, a summary, and the certificate in words."""
        claims, c = self.certificate.claims, self.controller
        proven = self.certificate.proven
        lines = [
            f"{escaped(str(self.path))}: {'PROVEN' if proven else 'NOT PROVEN'}",
            f"  semidefinite form, {escaped(c.robot.name)} of {len(c.robot)} joints (digest {c.robot.digest[:12]}), "
            f"{c.rules} rules (kept: {', '.join(premise.name for premise in c.premises) or 'none'}), with integral; "
            f"kappa = {at_most(c.kappa, 6)}, alpha = {at_least(c.alpha, 6)} 1/s, gamma = {at_most(c.gamma, 6)} s^2, "
            f"fastest pole = {at_most(c.fastest_pole, 6)} 1/s",
            f"  {sum(claim.proven for claim in claims)} of {len(claims)} claims proven, smallest margin "
            f"{self.certificate.proof_margin:.2g}, {self.seconds:.2f} s: the inequalities of the loop in exact "
            "rational arithmetic, the bounds of the inertia on covers of boxes, in floating point with a bound of all "
            "rounding errors and again in balls with outward rounding",
        ]
        lines += [
            f"  {'proven    ' if claim.proven else 'not proven'} {claim.name}, margin {claim.proof_margin:.2g}"
            for claim in claims
        ]
        if proven:
            lines.append(f"  {self.certificate.statement}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        proven = self.certificate.proven
        return {
            "file": str(self.path),
            "proven": proven,
            "margin": self.certificate.proof_margin,
            "seconds": self.seconds,
            "robot_digest": self.controller.robot.digest,
            "statement": self.certificate.statement if proven else None,
            "claims": [
                {"name": claim.name, "proven": claim.proven, "margin": claim.proof_margin}
                for claim in self.certificate.claims
            ],
        }


def verify_scheduled(path: Path, controller: ScheduledController) -> ScheduledVerification:
    """Prove the claims of a controller that was read from a file, each cover also in balls."""
    begin = time.perf_counter()
    certificate = certify_scheduled(controller, in_balls=True)
    return ScheduledVerification(path, controller, certificate, time.perf_counter() - begin)
