"""Why there is no solution, and what would have to be relaxed, in words."""

from __future__ import annotations

from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.synthesis.error_model import OneVertex
from fuzzyarm.synthesis.search import (
    MANY,
    best_solution,
    largest_feasible_alpha,
    lightness,
    slowest_tried,
    smallest_feasible_gain_bound,
    smallest_feasible_gamma,
    smallest_feasible_pole,
)
from fuzzyarm.synthesis.specification import Specification

__all__ = ["why_infeasible"]

MOST_SEARCHED = 4
"""Rules up to which a limit is searched for with the whole model; one design with 32 takes ten seconds."""

LIGHT = 2.0
"""Inertia of Table 1 over an arm's, above which the default of γ is too much to ask."""


def why_infeasible(model: TSModel, specification: Specification) -> str:
    """Return the specification in words and the first limit that would do alone, and by how much.

    The fastest pole is tried first, then α, the gain bound and γ; γ before α where it suits a heavier arm.

    Where already one vertex of a large model allows too little, its limit is searched for and named: it takes seconds,
    and the limit of all vertices is no larger.
    """
    s, alpha = specification, specification.first_alpha
    given = "" if s.gain_bound is None else f", gain bound {s.gain_bound:g} N m/rad"
    given += "" if s.fastest_pole is None else f", fastest pole {s.fastest_pole:g} 1/s"
    head = (
        f"infeasible: {model.rules} rules (kept: {', '.join(model.kept) or 'none'}), {s.form} form, "
        f"alpha = {alpha:g} 1/s, gamma = {'free' if s.gamma is None else f'{s.gamma:g}'}{given}"
    )
    works = "works"
    if model.rules >= MANY:
        one = OneVertex(model.parameters, model.kept)
        if best_solution(one, specification) is None:
            model, works = one, "works for one vertex of the model alone"
        elif model.rules > MOST_SEARCHED:
            return f"{head}; each of the model's vertices alone may allow this, all together do not: {_relaxed(s)}"
    pole = smallest_feasible_pole(model, specification)
    if pole is not None:
        return f"{head}; fastest_pole would have to give: the smallest that {works} is about {pole:.3g} 1/s"
    factor = lightness(model, s) if s.form == "consistent" and s.gamma is not None else 1.0
    too_small = factor > LIGHT and s.gamma < factor * Specification.gamma  # type: ignore[operator]
    if too_small and (gamma := smallest_feasible_gamma(model, specification)) is not None:
        natural = f"{factor * Specification.gamma:.2g} asks the same of this arm as the default does of Table 1"  # type: ignore[operator]
        return f"{head}; gamma would have to give: the smallest that {works} is about {gamma:.2g}, and {natural}"
    largest = largest_feasible_alpha(model, specification)
    if largest is not None:
        return f"{head}; alpha would have to give: the largest that {works} is about {largest:.3g} 1/s"
    head += f"; no decay rate down to {slowest_tried(s):g} 1/s helps"
    bound = smallest_feasible_gain_bound(model, specification)
    if bound is not None:
        return f"{head}: the gain bound would have to give: the smallest that {works} is about {bound:.3g} N m/rad"
    gamma = smallest_feasible_gamma(model, specification)
    if gamma is not None:
        return f"{head}: gamma would have to give: the smallest that {works} is about {gamma:.2g}"
    others = {"gamma": s.gamma, "the gain bound": s.gain_bound, "fastest_pole": s.fastest_pole}
    return f"{head}: raise {' or '.join(name for name, value in others.items() if value is not None)}"


def _relaxed(specification: Specification) -> str:
    """Return which of the given limits may be relaxed."""
    s = specification
    raised = {"gamma": s.gamma, "the gain bound": s.gain_bound, "fastest_pole": s.fastest_pole}
    given = [f"raise {name} above {value:g}" for name, value in raised.items() if value is not None]
    return " or ".join([f"lower alpha below {s.first_alpha:g}", *given, "keep fewer premises"])
