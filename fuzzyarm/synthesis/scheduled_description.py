"""What came out of a design of the form "semidefinite", in words."""

from __future__ import annotations

from fuzzyarm.common.rounding import at_least, at_most
from fuzzyarm.fuzzy_policy.proof.scheduled_certificate import schedule_rate
from fuzzyarm.synthesis.scheduled_design import ScheduledDesign

__all__ = ["describe_scheduled"]


def describe_scheduled(result: ScheduledDesign) -> str:
    """Return what was found and proven, for a person."""
    c, certificate = result.controller, result.certificate
    kept = ", ".join(premise.name for premise in c.premises) or "none"
    rate = schedule_rate(c)
    fixed, speed, integral = c.feedback
    lines = [
        f"{c.robot.name}, {len(c.robot)} joints; {c.rules} rule{'s' if c.rules > 1 else ''}, kept premises: {kept}; "
        "semidefinite form, with integral",
        f"kappa = {at_most(c.kappa, 5)}, mu = {at_most(int(rate.p) / int(rate.q), 4)} 1/s; alpha = "
        f"{at_least(c.alpha, 6)} 1/s, fastest pole {at_most(c.fastest_pole, 6)} 1/s, gamma = {at_most(c.gamma, 4)} s^2 "
        f"in the norms of the inertia; {c.origin['objective']}",
        f"premises and inertia found in {result.metric_seconds:.1f} s, all {len(certificate.claims)} claims proven in "
        f"{result.proof_seconds:.1f} s, smallest margin {certificate.proof_margin:.2g}",
        f"feedback -M_hat(q) (k_p e + k_d de/dt + k_i x_I): k_p = {fixed:.6g} 1/s^2, k_d = {speed:.6g} 1/s, "
        f"k_i = {integral:.6g} 1/s^3",
        "",
        "M_hat of each rule [kg m^2]:",
    ]
    for rule, inertia in enumerate(c.inertia):
        for row, entries in enumerate(inertia):
            head = f"{rule + 1:>4}  " if row == 0 else "      "
            lines.append(head + "".join(f"{entry:10.4f}" for entry in entries))
    return "\n".join([*lines, "", certificate.statement])
