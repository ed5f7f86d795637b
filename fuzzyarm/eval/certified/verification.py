"""The report of `fuzzyarm verify`: which claims of a controller file are proven, and what they mean."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from pathlib import Path
from typing import Any

from fuzzyarm.common.checks import path_of
from fuzzyarm.common.console import escaped
from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.envs.scenario.reference import CHECKED_INSTANTS, JointReference
from fuzzyarm.eval.certified.scheduled_verification import ScheduledVerification, verify_scheduled
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.controller_files import load_controller
from fuzzyarm.fuzzy_policy.laws.tip import tip_statement
from fuzzyarm.fuzzy_policy.proof.certificate import Certificate, certify
from fuzzyarm.fuzzy_policy.proof.residual import Residual, feedforward_residual
from fuzzyarm.fuzzy_policy.scheduled import ScheduledController

__all__ = ["Verification", "residual_statement", "verify_file"]

LISTED = 20  # claims in the printed report


@dataclasses.dataclass(frozen=True)
class Verification:
    """The certificate of one file; what depends on the reference is given for the paper's circle.

    Attributes:
        path: the file.
        controller: its content.
        certificate: its claims, each proven or not.
        residual: the feedforward residual; None in the form of the paper, and where the arm does not reach the circle.
        tip: what holds for the policy of this file with the ending -tip.
        seconds: time of the proof.
    """

    path: Path
    controller: Controller
    certificate: Certificate
    residual: Residual | None
    tip: str | None
    seconds: float

    @property
    def proven(self) -> bool:
        """Whether every claim is proven."""
        return self.certificate.proven

    def to_text(self) -> str:
        """Return the report as text: a line for each claim that fails, a summary, and the certificate in words."""
        claims, c = self.certificate.claims, self.controller
        failed = [claim for claim in claims if not claim.proven]
        multipliers = (
            "one multiplier for all of A" if c.common_multiplier else "one multiplier for each dropped premise"
        )
        pole = "" if c.fastest_pole is None else f", fastest pole = {at_most(c.fastest_pole, 6)} 1/s"
        lines = [
            f"{escaped(str(self.path))}: {'PROVEN' if not failed else 'NOT PROVEN'}",
            f"  {c.form} form, {c.model.rules} rules (kept: {', '.join(c.model.kept) or 'none'}), {multipliers}, "
            f"{'with' if c.integral else 'without'} integral; alpha = {at_least(c.alpha, 6)} 1/s, "
            f"gamma = {at_most(c.gamma, 6)}{pole}",
            f"  {len(claims) - len(failed)} of {len(claims)} inequalities proven in exact rational arithmetic, "
            f"smallest margin {self.certificate.proof_margin:.2g}, {self.seconds:.2f} s",
        ]
        # What fails first, then the smallest margins; a large model has hundreds of claims.
        ranked = sorted(claims, key=lambda claim: (claim.proven, claim.proof_margin))
        lines += [
            f"  {'proven    ' if claim.proven else 'not proven'} {claim.name}, margin {claim.proof_margin:.2g}"
            for claim in ranked[:LISTED]
        ]
        if len(claims) > LISTED:
            lines.append(f"  and {len(claims) - LISTED} more with larger margins, all of them with --json")
        if not failed:
            lines.append(f"  {self.certificate.statement}")
        if self.residual is not None and self.residual.sampled.any():
            lines.append(f"  {residual_statement(self.residual)}")
        if self.tip is not None and not failed:
            lines.append(f"  {self.tip} (Reference: the paper's circle; the policy: this file with the ending -tip.)")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        bound = None if self.residual is None else self.residual.bound
        return {
            "file": str(self.path),
            "proven": self.certificate.proven,
            "margin": self.certificate.proof_margin,
            "seconds": self.seconds,
            "residual_bound": None if bound is None else bound.tolist(),
            "statement": self.certificate.statement if self.certificate.proven else None,
            "tip_statement": self.tip if self.certificate.proven else None,
            "claims": [
                {"name": claim.name, "proven": claim.proven, "margin": claim.proof_margin}
                for claim in self.certificate.claims
            ],
        }


def residual_statement(residual: Residual) -> str:
    """Return what is known of the feedforward residual along the paper's circle."""
    torques = residual.sampled if residual.bound is None else residual.bound
    largest = f"({', '.join(at_most(torque, 3) for torque in torques)}) N m"
    place = "along the paper's circle, for any state in the box"
    if residual.bound is not None:
        return f"The feedforward residual in d is at most {largest} {place}."
    return (
        f"The feedforward residual in d reaches {largest} {place}: sampled at {CHECKED_INSTANTS} instants, not bounded "
        "between them."
    )


def verify_file(path: str | Path) -> Verification | ScheduledVerification:
    """Load a controller file of any form and prove its claims; ValueError or OSError if it cannot be read."""
    path = path_of("path", path)
    controller = load_controller(path)
    if isinstance(controller, ScheduledController):
        return verify_scheduled(path, controller)
    begin = time.perf_counter()
    certificate = certify(controller)
    seconds = time.perf_counter() - begin
    residual = tip = None
    if controller.form == "consistent":
        # Another arm may not reach the paper's circle; then there is no residual to bound.
        with contextlib.suppress(ValueError):
            circle = JointReference(parameters=controller.model.parameters)
            residual, tip = feedforward_residual(controller.model, circle), tip_statement(circle)
    return Verification(path, controller, certificate, residual, tip, seconds)
