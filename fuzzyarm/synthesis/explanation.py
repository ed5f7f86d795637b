"""Why there is no solution, and what would have to be relaxed, in words."""

from __future__ import annotations

from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.synthesis.search import largest_feasible_alpha, smallest_feasible_pole
from fuzzyarm.synthesis.specification import Specification

__all__ = ["why_infeasible"]


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
