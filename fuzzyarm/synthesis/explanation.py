"""What came out of a design, or why none did, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.synthesis.search import largest_feasible_alpha, smallest_feasible_pole
from fuzzyarm.synthesis.specification import Specification

if TYPE_CHECKING:
    from fuzzyarm.synthesis.designer import Design

__all__ = ["describe", "why_infeasible"]


def describe(result: Design) -> str:
    """Return what was solved and what came out, for a person."""
    controller, certificate = result.controller, result.certificate
    model = controller.model
    kept, dropped = ", ".join(model.kept) or "none", ", ".join(u.premise for u in model.uncertainties) or "none"
    multipliers = "one multiplier for all of A" if controller.common_multiplier else "one multiplier each"
    pole = "" if controller.fastest_pole is None else f"fastest pole {controller.fastest_pole:g} 1/s, "
    names = ["K q1", "K q2", "K dq1", "K dq2"] + (["H q1", "H q2"] if controller.integral else [])
    lines = [
        f"{model.rules} rules: kept {kept}; as uncertainty: {dropped}, {multipliers}; {controller.form} form, "
        f"{'with' if controller.integral else 'without'} integral",
        f"alpha = {controller.alpha:g} 1/s, gamma = {controller.gamma:.4g}, {pole}{controller.origin['objective']}; "
        f"{result.variables} variables, {result.rows} cone rows, solved in {result.solve_seconds:.2f} s",
        f"all {len(certificate.claims)} inequalities proven in exact rational arithmetic from the stored gains in "
        f"{result.proof_seconds:.2f} s, smallest margin {certificate.proof_margin:.2g}",
        "",
        "gains [N m/rad, N m s/rad, N m/(rad s)]:",
        "vertex  torque " + "".join(f"{name:>12}" for name in names),
    ]
    for i, per_k in enumerate(controller.gains):
        for k, gain in enumerate(per_k):
            for joint in range(2):
                head = f"i={i + 1} k={k + 1}   {joint + 1}     " if joint == 0 else f"           {joint + 1}     "
                lines.append(head + "".join(f"{value:12.1f}" for value in gain[joint]))
    return "\n".join([*lines, "", certificate.statement])


def why_infeasible(model: TSModel, specification: Specification) -> str:
    """Return the specification in words and what would have to be relaxed: the fastest pole if that helps, else α."""
    s, alpha = specification, specification.first_alpha
    bound = "" if s.gain_bound is None else f", gain bound {s.gain_bound:g} N m/rad"
    bound += "" if s.fastest_pole is None else f", fastest pole {s.fastest_pole:g} 1/s"
    head = (
        f"infeasible: {model.rules} rules (kept: {', '.join(model.kept) or 'none'}), {s.form} form, "
        f"alpha = {alpha:g} 1/s, gamma = {'free' if s.gamma is None else f'{s.gamma:g}'}{bound}"
    )
    pole = smallest_feasible_pole(model, specification)
    if pole is not None:
        return f"{head}; fastest_pole would have to give: the smallest that works is about {pole:.3g} 1/s"
    largest = largest_feasible_alpha(model, specification)
    if largest is None:
        return f"{head}; no decay rate down to {1e-3 * alpha:g} 1/s helps: raise gamma or the gain bound"
    return f"{head}; alpha would have to give: the largest that works is about {largest:.3g} 1/s"
