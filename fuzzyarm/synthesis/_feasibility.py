"""The search for a point that meets a specification or, if there is no such point, for the requirement to relax.

Problems are compiled once for each structure and arm (`structure_of`) and kept, since changing parameters takes a
millisecond, but compiling a tenth of a second.
"""

import dataclasses
import functools
import math
import threading
from typing import Any

from fuzzyarm.common.arithmetic import last_that_works
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES
from fuzzyarm.fuzzy_policy.ts_model import DEFAULT_KEPT, TSModel
from fuzzyarm.proof.vertices import error_vertices
from fuzzyarm.synthesis._design_problem import CERTAIN, PAPER_GAMMA, DesignProblem, NoPoint, Point, structure_of
from fuzzyarm.synthesis._scaling import Scaling
from fuzzyarm.synthesis.specification import FIRST_ALPHA, Specification, gamma_for

__all__ = ["best_point", "why_infeasible"]

_FACTORS = (1.0, 3.0, 0.3, 10.0, 0.1, 30.0, 0.03)  # factors on the unit of P, tried in turn until a point is found
_KEPT = 8  # compiled problems
_MANY = 4  # rules from which one infeasible vertex rules out a scale: 0.02 to 2 s instead of up to a minute
_MOST_SEARCHED = 4  # most rules for a search for a limit with the whole model; a design with 32 takes ten seconds
_STRICT = 0.5  # share of the arm's usual γ below which γ is relaxed before α
_LESS = 0.25  # factor on a parameter of the arm that may cause the infeasibility
_LOOSEST = 1e6  # γ of the consistent form in the units of an arm, far above any use
# For each limit: its name in words, which end of the range of feasible values is sought, the format and unit of values;
# the factor between the values that are tried, and the relative resolution of the bisection that follows.
_LIMITS = {
    "fastest_pole": ("fastest_pole", "smallest", ".3g", " 1/s", 2.0, 0.05),
    "gain_bound": ("the gain bound", "smallest", ".3g", " N m/rad", 1.5, 0.1),
    "gamma": ("gamma", "smallest", ".2g", "", 10.0, 0.3),
    "alpha": ("alpha", "largest", ".3g", " 1/s", 0.25, 0.02),
}


def best_point(specification: Specification, arm: ArmParameters, vertex: int | None = None) -> Point | NoPoint:
    """Return a solution of a specification, or a `NoPoint` that says why not; with `vertex`, only for this vertex of A.

    Several scales of P are tried in turn. In the paper's form, γ is lowered in steps as long as there is a point: a
    cone program that minimises γ² would be too badly scaled, since d and r differ by orders of magnitude.
    """
    if specification.gamma is None and specification.form == "paper":
        best, gamma, ratio = None, PAPER_GAMMA, 4.0
        while ratio > 1.05 and gamma / ratio > GAINS[0]:
            better = best_point(dataclasses.replace(specification, gamma=gamma / ratio), arm, vertex)
            if isinstance(better, NoPoint):
                ratio = math.sqrt(ratio)
            else:
                best, gamma = better, gamma / ratio
        return best or best_point(dataclasses.replace(specification, gamma=gamma), arm, vertex)
    failed = None
    for factor in _FACTORS:
        failed = _refuted(specification, arm, factor) if vertex is None else None
        if failed is None:
            try:
                return _asked(specification, arm, vertex, factor).point()
            except NoPoint as error:
                failed = error
    assert failed is not None
    return failed


def _refuted(specification: Specification, arm: ArmParameters, factor: float) -> NoPoint | None:
    """Return the solver's proof that a single vertex of a large model is infeasible by itself; None without a proof.

    Further vertices are tried only if the first has neither a solution nor such a proof. A free γ is bounded by
    `_LOOSEST`, as the solver rarely proves infeasibility if only the objective limits γ. `factor` multiplies P's unit.
    """
    if 1 << len(specification.kept) < _MANY:  # small models are solved as quickly as refuted
        return None
    if specification.gamma is None:
        specification = dataclasses.replace(specification, gamma=_LOOSEST / _units(arm).stiffness)
    for number in range(2 ** len([name for name in specification.kept if name != "z1"])):
        try:
            _asked(specification, arm, number, factor).point()
        except NoPoint as error:
            if error.ray is not None and (number == 0 or error.status == CERTAIN):
                return error
        else:
            return None
    return None


def _asked(specification: Specification, arm: ArmParameters, vertex: int | None, factor: float) -> DesignProblem:
    """Return the problem of a specification for one vertex of A or all (None); `factor` multiplies P's unit."""
    problem = _compiled(structure_of(specification), arm, vertex, threading.get_ident())
    problem.ask(specification, factor)
    return problem


@functools.lru_cache(_KEPT)
def _compiled(structure: Specification, arm: ArmParameters, vertex: int | None, thread: int) -> DesignProblem:
    """Return the problem of a structure (`structure_of`), for one vertex of A or all (None).

    Each `thread` has its own problem, since callers set its parameters.
    """
    return DesignProblem(structure, arm, vertex=vertex)


def _units(arm: ArmParameters) -> Scaling:
    return Scaling.of(error_vertices(TSModel(arm, ()), integral=True), arm)


# What would have to be relaxed ----------------------------------------------------------------------------------------


def _nearest_feasible(
    specification: Specification, arm: ArmParameters, name: str, vertex: int | None = None
) -> float | None:
    """Return the feasible value of the limit `name` nearest to the specified one, for one vertex of A or all (None).

    The search raises the fastest pole up to a thousandfold, γ up to a millionfold and the gain bound up to ten times
    the smallest gains, and lowers α [1/s] to `_slowest_tried`. None if all of these fail or the limit is not given.
    """
    found = None

    def solved(value: float | None) -> Point | NoPoint:
        changed: dict[str, Any] = {name: value}
        return best_point(dataclasses.replace(specification, **changed), arm, vertex)

    def fails(value: float) -> bool:
        nonlocal found
        failed = isinstance(solved(value), NoPoint)
        found = found if failed else value
        return failed

    start = specification.first_alpha if name == "alpha" else getattr(specification, name)
    if start is None or (name == "gain_bound" and None in (specification.alpha, specification.gamma)):
        return None
    if name in ("fastest_pole", "gain_bound"):  # first without this limit
        free = solved(None)
        if isinstance(free, NoPoint):
            return None
        start = free.largest_gain * _units(arm).stiffness if name == "gain_bound" else start
    limit = {
        "fastest_pole": min(1e3 * start, RATES[1]),
        "gain_bound": 10.0 * start,
        "gamma": min(1e6 * start, GAINS[1]),
        "alpha": _slowest_tried(specification),
    }[name]
    factor, resolution = _LIMITS[name][-2:]
    if fails(start) and (factor * start - limit) * (factor - 1.0) <= 0.0:
        # The bisection moves away from `start`, which fails; each feasible value is nearer to it than the one before.
        last_that_works(fails, start, factor * start, resolution=resolution, limit=limit)
    return found


def _slowest_tried(specification: Specification) -> float:
    """Return the α [1/s] at which the search ends: a thousandth of the specified one, at most `FIRST_ALPHA`."""
    return max(min(1e-3 * specification.first_alpha, FIRST_ALPHA), RATES[0])


def why_infeasible(specification: Specification, arm: ArmParameters) -> str:
    """Return the specification in words, the first limit that suffices if relaxed alone, and the value it needs.

    The limits are tried in this order: fastest pole, γ if it is below half of `gamma_for(arm, α)`, α, gain bound, γ.
    If a single vertex of a large model is already infeasible, only that vertex is considered.
    If a change of a single parameter of the arm would suffice, the message also names this parameter.
    """
    s, alpha, rules, vertex = specification, specification.first_alpha, 1 << len(specification.kept), None
    limits = {_LIMITS[name][0]: getattr(s, name) for name in ("gamma", "gain_bound", "fastest_pole")}
    limits = {name: value for name, value in limits.items() if value is not None}
    given = "" if s.gain_bound is None else f", gain bound {s.gain_bound:g} N m/rad"
    given += "" if s.fastest_pole is None else f", fastest pole {s.fastest_pole:g} 1/s"
    head = (
        f"infeasible: {rules} rules (kept: {', '.join(sorted(s.kept)) or 'none'}), {s.form} form, "
        f"alpha = {alpha:g} 1/s, gamma = {'free' if s.gamma is None else f'{s.gamma:g}'}{given}"
    )
    works = "works"
    if rules >= _MANY:
        if isinstance(best_point(specification, arm, 0), NoPoint):
            vertex, works = 0, "works for one vertex of the model alone"
        elif rules > _MOST_SEARCHED:
            raised = [f"raise {name} above {value:g}" for name, value in limits.items()]
            ways = " or ".join([f"lower alpha below {alpha:g}", *raised, "keep fewer premises"])
            return f"{head}; each vertex of the model alone may allow this, but all vertices together do not: {ways}"

    def relaxed(name: str) -> str:
        value = _nearest_feasible(specification, arm, name, vertex)
        words, end, form, unit = _LIMITS[name][:4]
        return "" if value is None else f"relax {words} to about {value:{form}}{unit}, the {end} that {works}"

    usual = gamma_for(arm, alpha) if s.form == "consistent" else 0.0
    strict = s.gamma is not None and s.gamma < _STRICT * usual
    if text := relaxed("fastest_pole"):
        return f"{head}; {text}"
    if strict and (text := relaxed("gamma")):
        return f"{head}; {text}; gamma = {usual:.2g} is usual for this arm's inertia"
    if text := relaxed("alpha"):
        return f"{head}; {text}{_in_the_way(specification, arm, vertex)}"
    text = relaxed("gain_bound") or relaxed("gamma") or _with_more_rules(s, arm) or f"raise {' or '.join(limits)}"
    return f"{head}; lowering alpha, even to {_slowest_tried(s):g} 1/s, does not help: {text}"


def _with_more_rules(specification: Specification, arm: ArmParameters) -> str:
    """Return the advice to keep the default premises, too; "" if these are kept or do not make a design feasible."""
    kept = tuple(sorted({*specification.kept, *DEFAULT_KEPT}))
    wanted = dataclasses.replace(specification, kept=kept)
    if kept == tuple(sorted(specification.kept)) or isinstance(best_point(wanted, arm), NoPoint):
        return ""
    return f"keep more premises; the design succeeds with {', '.join(kept)}"


def _in_the_way(specification: Specification, arm: ArmParameters, vertex: int | None) -> str:
    """Return advice to change a parameter of the arm so that `vertex` of A (None: all) is feasible; "" if none does."""
    slower = tuple(_LESS * speed for speed in arm.velocity_limit)
    heavier = tuple(inertia / _LESS for inertia in arm.motor_inertia)
    changed: dict[str, dict[str, Any]] = {
        f"velocity_limit = {list(slower)} rad/s": {"velocity_limit": slower},
        "gravity = 0": {"gravity": 0.0},
        f"motor_inertia = {list(heavier)} kg m^2": {"motor_inertia": heavier},
    }
    for words, numbers in changed.items():
        if not isinstance(best_point(specification, dataclasses.replace(arm, **numbers), vertex), NoPoint):
            return f"; or change the arm: {words} would be enough"
    return ""
