"""The arguments and results of every search of a tuning, and the search for the weights of an observer.

The search is over the logarithms of the weights: at the points of a Sobol set, then by Nelder-Mead from the best
of them. The weights for the arm of Table 1 are the first guess. They are kept unless a search lowers the objective by
more than the share `WORTH`, since a smaller difference says nothing about the weights.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from fuzzyarm.envs.fuzzy_arm import FuzzyArmEnv
from fuzzyarm.envs.physics.equations import AnyArm
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.eval.engine import Engine
from fuzzyarm.eval.episodes.metrics import metrics_of
from fuzzyarm.eval.episodes.rollout import record_rollout
from fuzzyarm.eval.stability._linearisation import Linearisable
from fuzzyarm.eval.stability.margins import policy_margins
from fuzzyarm.eval.tuning._finding import PERIOD, Finding, finite
from fuzzyarm.fuzzy_policy.policy import Policy

__all__ = ["WORTH", "Context", "Costs", "Found", "WeightSearch", "measured_radii", "motor_error", "nothing", "rounded"]

WORTH = 0.01
"""Relative difference from the best value of an objective up to which others are equally good."""

Costs = Callable[[np.ndarray], float]
"""The objective at logarithms (n,) of weights."""

_POINTS = 64  # of the Sobol set, of which a search uses the first ones; a power of two


@dataclasses.dataclass(frozen=True)
class Context:
    """What the steps of a tuning share: the arm, the folder, the worker processes, and the earlier findings."""

    arm: Any
    folder: Path  # of the tuning; a step may write its controller file there
    engine: Engine  # assesses candidates on several processes
    advance: Callable[[], None]  # called after each candidate
    earlier: Mapping[str, Finding]  # findings of the steps before, by policy

    def run(self, work: Callable[[Any], Any], candidates: Sequence[Any], steps: int = 1) -> list[Any]:
        """Return the result of `work` for each candidate, in order; each advances the progress bar by `steps`."""
        results = {}
        for number, result in self.engine.run(lambda number: work(candidates[number]), range(len(candidates))):
            results[number] = result
            for _ in range(steps):
                self.advance()
        return [results[number] for number in range(len(candidates))]


class Found(NamedTuple):
    """The outcome of a search; the fields are those of `Finding`."""

    chosen: dict[str, float | None] | None
    measured: Mapping[str, float | None]
    radii: dict[str, float | None]
    tried: int
    notes: Sequence[str] = ()


def nothing(reason: str, tried: int) -> Found:
    """Return the outcome of a search without a result, with the reason and the number of candidates assessed."""
    return Found(None, {}, {}, tried, (reason,))


def measured_radii(policy: Linearisable, arm: AnyArm) -> dict[str, float | None]:
    """Return a policy's spectral radius by condition of `fuzzyarm margins`; None where it cannot be linearised."""
    return finite(policy_margins(policy, arm, PERIOD)["spectral_radius"])


def motor_error(policy: Policy, arm: ArmParameters) -> float:
    """Return the rms motor-side joint error in the nominal case [mrad]; inf if the episode ends early.

    The motor side is used because these policies measure only the motors. The error includes the start, with the motors
    at their static deflection.
    """
    run = record_rollout(FuzzyArmEnv("nominal", parameters=arm), policy, policy_name="", case="nominal", seed=0)
    return metrics_of(run)["joint_error_rms_mrad"] if run.completed else math.inf


def rounded(weights: Sequence[float] | np.ndarray, digits: int) -> list[float]:
    """Return weights (n,), in their own units, rounded to `digits` significant digits."""
    return [float(f"{value:.{digits}g}") for value in weights]


class _Point(NamedTuple):
    """A point of a search: logarithms of the weights, and the objective there."""

    logarithms: tuple[float, ...]
    cost: float


@dataclasses.dataclass(frozen=True)
class WeightSearch:
    """The settings of a search for the weights of a law; `find` runs the search."""

    usual: Any  # the weights of Table 1
    guess: np.ndarray  # (n,), their logarithms in the coordinates of `box`
    weights_of: Callable[[np.ndarray], Any]  # returns the weights with these logarithms (n,)
    box: Mapping[str, tuple[float, float]]  # where the Sobol set lies; Nelder-Mead may leave it
    seed: int  # of the Sobol set
    unfit: float  # smallest cost of weights that violate the constraint
    points: int  # of the Sobol set that are tried
    searches: int = 0  # runs of Nelder-Mead
    evaluations: int = 0  # of the objective in each of them
    first_step: float = 1.0  # edge of the first simplex

    @property
    def total(self) -> int:
        """The largest possible number of evaluations of the objective."""
        return self.points + 1 + self.searches * self.evaluations

    def find(
        self,
        context: Context,
        law: Callable[[Any], Linearisable],
        objective: Callable[[], Costs],
        notes: Sequence[str] = (),
    ) -> Found:
        """Return the best weights for the policy `law(weights)`, with `notes`; `objective` is as in `best`."""
        best, first = self.best(context, objective)
        weights = self.usual if best is first else self.weights_of(np.array(best.logarithms))
        try:
            radii = measured_radii(law(weights), context.arm)
        except ValueError as error:
            return nothing(f"There are no gains: {error}.", self.total)
        if best.cost >= self.unfit:
            notes = (*notes, "No weights have the margins that the rule requires; these come nearest.")
        usual = None if first.cost >= self.unfit else first.cost
        measured = {"objective_mm": best.cost, "objective_of_table_1_weights_mm": usual}
        return Found(dataclasses.asdict(weights), measured, radii, self.total, notes)

    def best(self, context: Context, objective: Callable[[], Costs]) -> tuple[_Point, _Point]:
        """Return the best point and the first guess; they are equal if no point is better by `WORTH`.

        `objective` builds the objective; it is called for each candidate in the worker that assesses it, and should be
        cached there.
        """
        low, high = np.log(np.array([*self.box.values()])).T
        sobol = qmc.scale(qmc.Sobol(len(low), seed=self.seed).random(_POINTS), low, high)[: self.points]
        edge, evaluations = self.first_step, self.evaluations
        starts = [self.guess, *sobol]
        costs = context.run(lambda start: objective()(start), starts)
        first, *others = (_Point(tuple(start.tolist()), cost) for start, cost in zip(starts, costs, strict=True))
        begins = sorted(others, key=lambda point: point.cost)[: self.searches]
        others += context.run(lambda begin: _descend(objective(), begin, edge, evaluations), begins, steps=evaluations)
        best = min([first, *others], key=lambda point: point.cost)
        return best if best.cost < (1.0 - WORTH) * first.cost else first, first


def _descend(objective: Costs, begin: _Point, edge: float, evaluations: int) -> _Point:
    """Return the best point that Nelder-Mead finds from `begin`; `edge` is the edge length of the first simplex."""
    best = _Point(begin.logarithms, math.inf)

    def watched(logarithms: np.ndarray) -> float:
        nonlocal best
        cost = objective(logarithms)
        if cost < best.cost:
            best = _Point(tuple(logarithms.tolist()), cost)
        return cost

    start = np.array(begin.logarithms)
    simplex = start + np.vstack([np.zeros(len(start)), edge * np.eye(len(start))])
    minimize(watched, start, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": evaluations})
    return best
