"""The search for a solution of a specification: over the scale of the Lyapunov function, γ, α and the fastest pole."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize_scalar

from fuzzyarm.common.bisection import last_that_works
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.fuzzy_policy.controller import GAINS, RATES, Controller
from fuzzyarm.fuzzy_policy.ts_model import TSModel
from fuzzyarm.synthesis.conic import Problem
from fuzzyarm.synthesis.error_model import ErrorModel, OneVertex, consistent_form, paper_form
from fuzzyarm.synthesis.minimise import Infeasible, Solution, solve, solve_for_largest_alpha
from fuzzyarm.synthesis.scaling import Scaling
from fuzzyarm.synthesis.specification import FIRST_ALPHA, PAPER_WEIGHT, Specification

__all__ = [
    "best_solution", "error_system", "largest_feasible_alpha", "lightness", "scaled_gain", "scaled_problem",
    "slowest_tried", "smallest_feasible_gain_bound", "smallest_feasible_gamma", "smallest_feasible_pole",
]  # fmt: skip

# The scale c of the Lyapunov function cannot be a variable, because γ ties it to P. In the consistent form it goes with
# σ/(γU)²; 0.37 of that gives the smallest gains with z1 kept, 0.6 with z1 dropped (α = 20, γ = 2e-4). In the paper's
# form 1e-4 at γ = 1000 suits every model. Factors on it are tried in turn where the first is infeasible; where γ is
# minimised, c is searched for.
BEST_SCALE = {True: 0.37, False: 0.6}
PAPER_SCALE, PAPER_GAMMA = 1e-4, 1000.0
FACTORS = (1.0, 3.0, 0.3, 10.0, 0.1, 30.0, 0.03)
NONE = 1e12  # far above any γ; the search of scipy wants a number
MANY = 4  # rules, from which a scale is given up if one vertex is infeasible: 0.02 to 2 s instead of up to a minute
CERTAIN = "PrimalInfeasible"  # the solver's status, to its full accuracy


def best_solution(model: TSModel, specification: Specification) -> tuple[Scaling, Solution] | None:
    """Return the solution of a specification and its scaling; None if none was found."""
    if specification.gamma is not None:
        return first_solution(model, specification)
    smallest = _smallest_gamma_paper if specification.form == "paper" else _smallest_gamma_consistent
    return smallest(model, specification)


def first_solution(model: TSModel, specification: Specification) -> tuple[Scaling, Solution] | None:
    """Return the solution at the first Lyapunov scale that has one."""
    find = solve_for_largest_alpha if specification.alpha is None else solve
    for factor in FACTORS:
        scaling, system, problem = scaled_problem(model, specification, factor)
        if _refuted(model, specification, factor):
            continue
        try:
            return scaling, find(system, problem)
        except Infeasible:
            continue
    return None


def _refuted(model: TSModel, specification: Specification, factor: float) -> bool:
    """Return whether the solver gives a proof that already one vertex of a large model has no solution.

    The others are asked only where the first neither has a solution nor a proof that there is none.
    """
    if model.rules < MANY or isinstance(model, OneVertex):  # which is solved as quickly as it is refuted
        return False
    for number in range(len(model.A_vertices)):
        vertex = OneVertex(model.parameters, model.kept, number)
        _, system, problem = scaled_problem(vertex, specification, factor)
        try:
            solve(system, problem)
        except Infeasible as error:
            if error.ray is not None and (number == 0 or error.status == CERTAIN):
                return True
            continue
        return False
    return False


def _smallest_gamma_paper(model: TSModel, specification: Specification) -> tuple[Scaling, Solution] | None:
    """Return the solution with the smallest γ of the paper's form, by lowering γ as long as there is a solution.

    The cone program that minimises γ² is too badly scaled here: d and r are decades apart.
    """
    best, gamma, ratio = None, PAPER_GAMMA, 4.0
    while ratio > 1.05 and gamma / ratio > GAINS[0]:
        better = first_solution(model, dataclasses.replace(specification, gamma=gamma / ratio))
        if better is None:
            ratio = math.sqrt(ratio)
        else:
            best, gamma = better, gamma / ratio
    return best or first_solution(model, dataclasses.replace(specification, gamma=gamma))


def _smallest_gamma_consistent(model: TSModel, specification: Specification) -> tuple[Scaling, Solution] | None:
    """Return the solution with the smallest γ of the consistent form.

    The cone program minimises γ² at a scale c; a coarse scan and a bounded search around its best find c.
    """
    found: dict[float, tuple[Scaling, Solution]] = {}

    def gamma_at(exponent: float) -> float:
        scaling, system, problem = scaled_problem(model, specification, 10.0**exponent)
        if _refuted(model, specification, 10.0**exponent):
            return NONE
        try:
            found[exponent] = scaling, solve(system, problem)
        except Infeasible:
            return NONE
        return found[exponent][1].gamma

    scan = np.arange(-3.0, 3.5, 0.5)
    values = [gamma_at(float(exponent)) for exponent in scan]
    if not found:
        return None
    middle = float(scan[int(np.argmin(values))])
    minimize_scalar(gamma_at, bounds=(middle - 0.5, middle + 0.5), method="bounded", options={"xatol": 0.02})
    return min(found.values(), key=lambda entry: entry[1].gamma)


def error_system(model: TSModel, specification: Specification) -> ErrorModel:
    """Return the error dynamics of a specification's form, in SI units."""
    if specification.form == "consistent":
        return consistent_form(model, specification.integral)
    return paper_form(
        model,
        specification.integral,
        np.array(PAPER_WEIGHT),
        common_multiplier=specification.common_multiplier,
        share=specification.feedforward,
    )


def scaled_problem(model: TSModel, specification: Specification, factor: float) -> tuple[Scaling, ErrorModel, Problem]:
    """Return the problem at a Lyapunov scale, `factor` times its natural size."""
    system = error_system(model, specification)
    unit = Scaling.of(system, model.parameters, 1.0)
    if specification.form == "paper":
        gamma = specification.gamma if specification.gamma is not None else PAPER_GAMMA
        natural = PAPER_SCALE * (PAPER_GAMMA / gamma) ** 2
    else:
        gamma = specification.gamma if specification.gamma is not None else 1.0 / _stiffness(unit)
        natural = BEST_SCALE["z1" in model.kept] * unit.time / (gamma * unit.torque.mean()) ** 2
    scaling = Scaling.of(system, model.parameters, factor * natural)
    gain_bound = None if specification.gain_bound is None else specification.gain_bound / _stiffness(unit)
    problem = Problem(
        alpha=specification.first_alpha / scaling.time,
        gamma=specification.gamma,
        gain_bound=gain_bound,
        minimise="gamma" if specification.gamma is None else "gain_bound" if gain_bound is None else "nothing",
        fastest_pole=None if specification.fastest_pole is None else specification.fastest_pole / scaling.time,
    )
    return scaling, scaling.apply(system), problem


def _stiffness(scaling: Scaling) -> float:
    """Return the unit of joint 1's position gain, U_1/T_1 [N m/rad]."""
    return float(scaling.torque[0] / scaling.state[0])


def lightness(model: TSModel, specification: Specification) -> float:
    """Return the inertia of Table 1 over an arm's, a pure number; γ of the consistent form times it asks the same."""
    system = error_system(model, specification)
    paper, own = (_stiffness(Scaling.of(system, arm, 1.0)) for arm in (ArmParameters(), model.parameters))
    return paper / own


def scaled_gain(controller: Controller) -> float:
    """Return the gain bound [N m/rad] that a controller just meets, see `Specification`."""
    system = consistent_form(controller.model, controller.integral)
    unit = Scaling.of(system, controller.model.parameters, 1.0)
    scaled = controller.gains * unit.state[: controller.gains.shape[-1]] / unit.torque[:, np.newaxis]
    return float(np.linalg.norm(scaled, ord=2, axis=(-2, -1)).max()) * _stiffness(unit)


def smallest_feasible_pole(model: TSModel, specification: Specification, resolution: float = 0.05) -> float | None:
    """Return the smallest feasible bound of the fastest pole [1/s] from the specified one up, by bisection.

    None if none is specified or no larger one is feasible either.
    """
    specified = specification.fastest_pole

    def works(pole: float | None) -> bool:
        return best_solution(model, dataclasses.replace(specification, fastest_pole=pole)) is not None

    if specified is None or not works(None):
        return None
    return _nearest_that_works(
        works, specified, factor=2.0, limit=min(1e3 * specified, RATES[1]), resolution=resolution
    )


def smallest_feasible_gain_bound(model: TSModel, specification: Specification, resolution: float = 0.1) -> float | None:
    """Return the smallest feasible gain bound [N m/rad], by bisection from the smallest gains on.

    None if none is specified, if another limit is left open too, or if the rest is not feasible with any.
    """

    def works(bound: float) -> bool:
        return best_solution(model, dataclasses.replace(specification, gain_bound=bound)) is not None

    if specification.gain_bound is None or None in (specification.alpha, specification.gamma):
        return None
    best = best_solution(model, dataclasses.replace(specification, gain_bound=None))
    if best is None:
        return None
    least = best[1].largest_gain * _stiffness(best[0])
    return _nearest_that_works(works, least, factor=1.5, limit=10.0 * least, resolution=resolution)


def smallest_feasible_gamma(model: TSModel, specification: Specification, resolution: float = 0.3) -> float | None:
    """Return the smallest feasible γ, in its unit, from the specified one to its millionfold, by bisection; or None."""
    specified = specification.gamma

    def works(gamma: float) -> bool:
        return best_solution(model, dataclasses.replace(specification, gamma=gamma)) is not None

    if specified is None:
        return None
    limit = min(1e6 * specified, GAINS[1])
    return _nearest_that_works(works, specified, factor=10.0, limit=limit, resolution=resolution)


def largest_feasible_alpha(model: TSModel, specification: Specification, resolution: float = 0.02) -> float | None:
    """Return the largest feasible α [1/s] up to the specified one, by bisection; None if there is none."""

    def works(alpha: float) -> bool:
        return best_solution(model, dataclasses.replace(specification, alpha=alpha)) is not None

    lowest = slowest_tried(specification)
    return _nearest_that_works(works, specification.first_alpha, factor=0.25, limit=lowest, resolution=resolution)


def slowest_tried(specification: Specification) -> float:
    """Return where the search for a feasible α ends [1/s]: a thousandth of the specified one, at most `FIRST_ALPHA`."""
    return max(min(1e-3 * specification.first_alpha, FIRST_ALPHA), RATES[0])


def _nearest_that_works(
    works: Callable[[float], bool], start: float, *, factor: float, limit: float, resolution: float
) -> float | None:
    """Return the number nearest to `start` that works, in steps of `factor` up to `limit`; None if there is none."""
    if works(start):
        return start
    if (factor * start - limit) * (factor - 1.0) > 0.0:
        return None
    found = None

    def fails(value: float) -> bool:
        nonlocal found
        if works(value):
            found = value
            return False
        return True

    # The bisection follows what fails, from `start` on; each number found to work is nearer than the one before.
    last_that_works(fails, start, factor * start, resolution=resolution, limit=limit)
    return found
