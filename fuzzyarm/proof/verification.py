"""The report of `fuzzyarm verify`: the claims of a controller file, whether they are proven, and their meaning."""

import contextlib
import dataclasses
import time
from pathlib import Path
from typing import Any

from fuzzyarm.common.arithmetic import at_least, at_most
from fuzzyarm.common.checks import path_of
from fuzzyarm.common.console import escaped
from fuzzyarm.envs.scenario.reference import JointReference
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.scheduled_controller import ScheduledController, load_controller
from fuzzyarm.proof._residual import Residual, feedforward_residual
from fuzzyarm.proof.certificate import Certificate, certify
from fuzzyarm.proof.invariant_set import InvariantSet, invariant_set
from fuzzyarm.proof.policy_certificate import tip_statement
from fuzzyarm.proof.scheduled_certificate import certify_scheduled

__all__ = ["Verification", "verify_file"]

_LISTED = 20  # claims in the printed report


@dataclasses.dataclass(frozen=True)
class Verification:
    """The certificate of one controller file; statements that depend on the reference are for the paper's circle."""

    path: Path  # the file
    certificate: Certificate  # claims of the file, each proven or not
    seconds: float  # time of the proof
    controller: Controller | ScheduledController  # the content of the file
    # the feedforward residual; None unless the form is the consistent one and the arm reaches the circle
    residual: Residual | None = None
    tip: str | None = None  # statement for the policy of this file with the suffix -tip
    invariant: InvariantSet | None = None  # the set from which the arm stays in the box; None without a proof

    @property
    def proven(self) -> bool:
        """Whether every claim is proven."""
        return self.certificate.proven

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        own: dict[str, Any] = {"statement": self.certificate.statement if self.proven else None}
        if isinstance(self.controller, ScheduledController):
            own = {"robot_digest": self.controller.robot.digest, **own}
        else:
            bound = None if self.residual is None or self.residual.bound is None else self.residual.bound.tolist()
            own = {"residual_bound": bound, **own, "tip_statement": self.tip if self.proven else None}
        claims = [{"name": c.name, "proven": c.proven, "margin": c.proof_margin} for c in self.certificate.claims]
        own["invariant_set"] = self.invariant and self.invariant._asdict()
        margin = self.certificate.proof_margin
        head = {"file": str(self.path), "proven": self.proven, "margin": margin, "seconds": self.seconds}
        return {**head, **own, "claims": claims}

    def to_text(self) -> str:
        """Return the report as text: verdict, content of the file, proof, the main claims, certificate."""
        c, every = self.controller, self.certificate.claims
        proven = sum(claim.proven for claim in every)
        if isinstance(c, ScheduledController):
            claims, what = every, "claims proven"
            how = (
                ": the inequalities of the loop in exact rational arithmetic, the bounds on the inertia on covers of "
                "boxes, in floating point with a bound on all rounding errors and again in balls with outward rounding"
            )
            about = (
                f"semidefinite form, {escaped(c.robot.name)} of {len(c.robot)} joints (digest {c.robot.digest[:12]}), "
                f"{c.rules} rules (kept: {', '.join(premise.name for premise in c.premises) or 'none'}), with "
                f"integral; kappa = {at_most(c.kappa, 6)}, alpha = {at_least(c.alpha, 6)} 1/s, gamma = "
                f"{at_most(c.gamma, 6)} s^2, fastest pole = {at_most(c.fastest_pole, 6)} 1/s"
            )
        else:
            # Claims that fail come first, then the smallest margins; a large model has hundreds of claims.
            claims = tuple(sorted(every, key=lambda claim: (claim.proven, claim.proof_margin))[:_LISTED])
            what, how = "inequalities proven in exact rational arithmetic", ""
            pole = "" if c.fastest_pole is None else f", fastest pole = {at_most(c.fastest_pole, 6)} 1/s"
            about = (
                f"{c.form} form, {c.model.rules} rules (kept: {', '.join(c.model.kept) or 'none'}), one multiplier for "
                f"{'all of A' if c.common_multiplier else 'each dropped premise'}, "
                f"{'with' if c.integral else 'without'} integral; alpha = {at_least(c.alpha, 6)} 1/s, "
                f"gamma = {at_most(c.gamma, 6)}{pole}"
            )
        margin = f"smallest margin {self.certificate.proof_margin:.2g}, {self.seconds:.2f} s"
        lines = [
            f"{escaped(str(self.path))}: {'PROVEN' if self.proven else 'NOT PROVEN'}",
            f"  {about}",
            f"  {proven} of {len(every)} {what}, {margin}{how}",
        ]
        for claim in claims:
            verdict = "proven    " if claim.proven else "not proven"
            lines.append(f"  {verdict} {claim.name}, margin {claim.proof_margin:.2g}")
        if len(every) > len(claims):
            lines.append(f"  and {len(every) - len(claims)} more with larger margins, all of them with --json")
        if self.proven:
            lines.append(f"  {self.certificate.statement}")
        if self.invariant is not None:
            lines.append(f"  {self.invariant.statement}")
        if self.residual is not None and self.residual.sampled.any():
            lines.append(f"  {self.residual.statement}")
        if self.tip is not None and self.proven:
            lines.append(f"  {self.tip} (Reference: the paper's circle; the policy: this file with the ending -tip.)")
        return "\n".join(lines)


def verify_file(path: str | Path) -> Verification:
    """Load a controller file of any form and prove its claims; ValueError or OSError if it cannot be read.

    For the form "semidefinite", the bounds on the inertia are also proven in balls on each box of angles.
    """
    path = path_of("path", path)
    controller = load_controller(path)
    begin = time.perf_counter()
    if isinstance(controller, ScheduledController):
        certificate = certify_scheduled(controller, in_balls=True)
    else:
        certificate = certify(controller)
    seconds = time.perf_counter() - begin
    invariant = invariant_set(controller) if certificate.proven else None
    residual = tip = None
    if isinstance(controller, Controller) and controller.form == "consistent":
        # Another arm may not reach the paper's circle; then there is no residual to bound.
        with contextlib.suppress(ValueError):
            circle = JointReference(parameters=controller.model.parameters)
            residual, tip = feedforward_residual(controller.model, circle), tip_statement(circle)
    return Verification(path, certificate, seconds, controller, residual, tip, invariant)
