"""The search for weights that two laws share: a Sobol set in their logarithms, then Nelder-Mead from its best points.

The weights of Table 1 are the first guess, and stay unless a search lowers the objective by `WORTH` of its value: what
is closer says nothing about the weights.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from fuzzyarm.eval.engine import Engine

__all__ = ["WORTH", "Budget", "Costs", "Descent", "best_of", "found_weights", "rounded", "run_in_order", "sobol_points"]

WORTH = 0.01
"""Share of the first guess's objective by which others must be better."""

Costs = Callable[[np.ndarray], float]
"""The objective at logarithms (n,) of weights."""


@dataclasses.dataclass(frozen=True)
class Budget:
    """How much is tried."""

    sobol: int  # points of the Sobol set
    searches: int  # runs of Nelder-Mead, from the best of these points
    evaluations: int  # of the objective in each of them
    from_guess: bool = False  # whether the last of them begins at the first guess instead

    @property
    def total(self) -> int:
        """Evaluations of the objective, at most."""
        return self.sobol + 1 + self.searches * self.evaluations


class Descent(NamedTuple):
    """The best point of a search: logarithms of the weights, and the objective there."""

    point: tuple[float, ...]
    cost: float


def sobol_points(box: Sequence[tuple[float, float]], count: int, seed: int) -> np.ndarray:
    """Return points (count, n), logarithms, of a Sobol set in a box."""
    low, high = np.log(np.array(box)).T
    return np.asarray(qmc.scale(qmc.Sobol(len(box), seed=seed).random(count), low, high))


def _descend(objective: Costs, start: np.ndarray, first_step: float, evaluations: int) -> Descent:
    """Return the best point that Nelder-Mead meets from `start` (n,); `first_step` is the edge of the first simplex."""
    best = Descent(tuple(start.tolist()), math.inf)

    def watched(point: np.ndarray) -> float:
        nonlocal best
        cost = objective(point)
        if cost < best.cost:
            best = Descent(tuple(point.tolist()), cost)
        return cost

    simplex = start + np.vstack([np.zeros(len(start)), first_step * np.eye(len(start))])
    minimize(watched, start, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": evaluations})
    return best


def best_of(first: Descent, others: Sequence[Descent]) -> Descent:
    """Return the best point, but the first guess where no other is better by `WORTH`."""
    best = min([first, *others], key=lambda descent: descent.cost)
    return best if best.cost < (1.0 - WORTH) * first.cost else first


def rounded(weights: Sequence[float] | np.ndarray, digits: int) -> list[float]:
    """Return weights (n,), in their own units, rounded to so many digits."""
    return [float(f"{value:.{digits}g}") for value in weights]


def found_weights(
    objective_for: Callable[[Any], Costs],
    arm: Any,
    guess: np.ndarray,
    points: np.ndarray,
    first_step: float,
    budget: Budget,
    *,
    engine: Engine,
    advance: Callable[[int], None] = lambda done: None,
) -> tuple[Descent, Descent]:
    """Return the best point and the first guess; both, like the Sobol set `points` (points, n), are of logarithms.

    `objective_for` returns the objective of an arm; it is called in each worker, and cached there. `advance` is called
    with the number of evaluations that were done.
    """
    starts = np.vstack([guess, points[: budget.sobol]])
    costs = run_in_order(engine, lambda number: objective_for(arm)(starts[number]), len(starts), advance)
    known = [Descent(tuple(start.tolist()), cost) for start, cost in zip(starts, costs, strict=True)]
    best = sorted(known[1:], key=lambda descent: descent.cost)[: budget.searches - budget.from_guess]
    begins = [np.array(descent.point) for descent in (*best, *known[: int(budget.from_guess)])]

    def search(number: int) -> Descent:
        return _descend(objective_for(arm), begins[number], first_step, budget.evaluations)

    descents = run_in_order(engine, search, len(begins), lambda done: advance(budget.evaluations * done))
    return best_of(known[0], [*known[1:], *descents]), known[0]


def run_in_order(engine: Engine, work: Callable[[int], Any], count: int, advance: Callable[[int], None]) -> list[Any]:
    """Return work(0), work(1), ..., done on the engine; `advance` is called with 1 after each."""
    results = {}
    for number, result in engine.run(work, range(count)):
        results[number] = result
        advance(1)
    return [results[number] for number in range(count)]
