"""The scheduled inertia M̂ and the constants D_low, D_high of a robot, proposed for a small κ; nothing here is a proof.

`metric_search` finds them for samples. Here the samples' bounds are moved to what a search for the worst angles finds,
so that little is left for the proof to widen.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.proof.box_cover import widened
from fuzzyarm.fuzzy_policy.proof.definiteness import exact
from fuzzyarm.fuzzy_policy.proof.inertia_bounds import scheduled_polynomial
from fuzzyarm.fuzzy_policy.proof.kinetic_energy import inertia_polynomial
from fuzzyarm.fuzzy_policy.proof.trigonometric import TrigMatrix
from fuzzyarm.fuzzy_policy.scheduled import Premise, rule_weights
from fuzzyarm.synthesis.inertia_samples import InertiaSamples, smallest_value
from fuzzyarm.synthesis.metric_search import ROUNDS, MetricSearch, relative
from fuzzyarm.synthesis.scalar_design import smallest_pole

__all__ = ["Metric", "fitted_metric", "ranked_premises", "split_of"]

UNSPLIT = 4  # joints of a robot whose chain needs no split
FAR = 3  # most angles beyond the split
SCREENED, FINALISTS = 2, 4  # rounds for all candidates, and the number of them that are searched to the end
BLENDS = 11  # schedules tried between one with fewer premises and the one with the smallest κ
STEP = 1e-5  # rad, of central differences
SLACK = 1e-3  # of D_low and D_high, in units of the mean of D


@dataclasses.dataclass(frozen=True)
class Metric:
    """A proposal of bounds; quantities as in `ScheduledController`, whose `kappa`, `floor` and `rates` are wider.

    Attributes:
        premises: the kept ones.
        split: a.
        inertia: S_r, (N, n, n).
        distal_low: D_low.
        distal_high: D_high.
        kappa: κ of the angles searched.
        floor: σ, likewise.
        rates: μ_k, likewise, (premises,).
    """

    premises: tuple[Premise, ...]
    split: int
    inertia: np.ndarray
    distal_low: np.ndarray
    distal_high: np.ndarray
    kappa: float
    floor: float
    rates: np.ndarray

    def rate(self, robot: Robot) -> float:
        """Return μ = Σ μ_k |q̇_k| [1/s] at the largest speeds of the kept angles."""
        speeds = [robot.joints[premise.joint].velocity_limit for premise in self.premises]
        return float(self.rates @ np.array(speeds)) if speeds else 0.0


def split_of(robot: Robot, premises: Sequence[Premise]) -> int:
    """Return a, the link behind which the chain is split: two or three angles from the end, and no kept one beyond."""
    n = len(robot)
    if n <= UNSPLIT:
        return n
    return max([min(n - 2, UNSPLIT), n - FAR, *(premise.joint + 1 for premise in premises)])


def fitted_metric(
    robot: Robot, premises: tuple[Premise, ...], split: int, *, alpha: float, count: int, seed: int = 0
) -> Metric:
    """Return the metric found, whose κ and (3κ - 2)(α + μ) are no larger than with fewer of the premises.

    Args:
        robot: the robot.
        premises: the kept ones, added in their order.
        split: a.
        alpha: α [1/s].
        count: samples.
        seed: of the samples.
    """
    samples = InertiaSamples.of(robot, split, count, seed)
    search = MetricSearch(samples)
    search.run()
    for number in range(1, len(premises) + 1):
        search, _ = _with_premise(search, robot, premises[:number], alpha)
        search.fix_distal()  # they are fitted to the first premise, which changes most
    search.raise_floor([_slopes(premises, k, samples.q) for k in range(len(premises))])
    inertia, low, high, unit = search.found()
    ranges = widened(np.array([joint.angle_range for joint in robot.joints]))
    near, n = ranges[1:split], len(robot)
    rotors = exact(np.diag(robot.drive("motor_inertia")))
    if split < n:
        distal = TrigMatrix(inertia_polynomial(robot, split, n))
        low = low + (min(_smallest(distal, ranges[split:], low, unit), 0.0) - SLACK) * unit
        high = high - (min(_smallest(distal, ranges[split:], high, -unit), 0.0) - SLACK) * unit
    lowest, highest = (
        _with_constant(inertia_polynomial(robot, 0, split, exact(tail) if split < n else None), rotors)
        for tail in ((low, high) if split < n else (low, low))
    )
    scheduled = TrigMatrix(scheduled_polynomial(premises, inertia, split))
    share = smallest_value(lambda q: relative(lowest.at(q), scheduled.at(q))[:, 0], near)
    kappa = -smallest_value(lambda q: -relative(highest.at(q), scheduled.at(q))[:, -1], near)
    floor = smallest_value(lambda q: np.linalg.eigvalsh(scheduled.at(q))[:, 0], near)
    rates = [_rate(scheduled, premise, near) for premise in premises]
    return Metric(premises, split, share * inertia, low, high, kappa / share, share * floor, np.array(rates))


def ranked_premises(
    robot: Robot, kept: tuple[Premise, ...], candidates: Sequence[Premise], *, alpha: float, count: int, seed: int = 0
) -> list[tuple[float, Premise]]:
    """Return candidates for one more premise, the best first, each with its (3κ - 2)(α + μ) [1/s] at samples.

    Args:
        robot: the robot, whose chain is not split here.
        kept: the premises there are.
        candidates: premises of other joints.
        alpha: α [1/s].
        count: samples.
        seed: of the samples.
    """
    search = MetricSearch(InertiaSamples.of(robot, len(robot), count, seed))
    search.run()
    for number in range(1, len(kept) + 1):
        search, _ = _with_premise(search, robot, kept[:number], alpha)

    def ranked(among: Sequence[Premise], rounds: int) -> list[tuple[float, Premise]]:
        poles = [_with_premise(search, robot, (*kept, candidate), alpha, rounds)[1] for candidate in among]
        return sorted(zip(poles, among, strict=True), key=lambda entry: entry[0])

    first = ranked(candidates, SCREENED)
    return [*ranked([candidate for _, candidate in first[:FINALISTS]], ROUNDS), *first[FINALISTS:]]


def _with_premise(
    search: MetricSearch, robot: Robot, premises: tuple[Premise, ...], alpha: float, rounds: int = ROUNDS
) -> tuple[MetricSearch, float]:
    """Return a search with one more premise, the last one, and its (3κ - 2)(α + μ) [1/s] at samples.

    The smallest κ may cost a large μ. On the line to it from the M̂ of before, κ rises nowhere above that of before;
    the M̂ with the smallest product is taken, and it is no larger than before either.
    """
    q = search.samples.q
    before = search.copy()
    before.schedule(rule_weights(premises, q))
    after = before.copy()
    after.run(rounds)
    slopes = [_slopes(premises, k, q) for k in range(len(premises))]
    speeds = [robot.joints[premise.joint].velocity_limit for premise in premises]

    def pole(found: MetricSearch) -> float:
        rates = [found.rate(slope) for slope in slopes]
        return smallest_pole(found.kappa, alpha + float(np.dot(rates, speeds)))

    tried = [before.blended(after, share) for share in np.linspace(0.0, 1.0, BLENDS).tolist()]
    poles = [pole(found) for found in tried]
    best = int(np.argmin(poles))
    return tried[best], poles[best]


def _slopes(premises: tuple[Premise, ...], k: int, q: np.ndarray) -> np.ndarray:
    """Return ∂h/∂q (B, 2^premises) [1/rad] by the angle of premise k at angles (B, n) [rad], by central differences."""
    step = STEP * np.eye(q.shape[-1])[premises[k].joint]
    change = rule_weights(premises, q + step) - rule_weights(premises, q - step)
    return np.asarray(change / (2.0 * STEP))


def _rate(scheduled: TrigMatrix, premise: Premise, ranges: np.ndarray) -> float:
    """Return μ_k of a premise [1/rad]."""
    slope = scheduled.derivative(premise.joint - 1)
    return -0.5 * smallest_value(lambda q: -np.abs(relative(slope.at(q), scheduled.at(q))).max(axis=1), ranges)


def _smallest(distal: TrigMatrix, ranges: np.ndarray, bound: np.ndarray, unit: np.ndarray) -> float:
    """Return the smallest eigenvalue of ±(D - bound) relative to |unit|, with the sign of `unit`."""
    scale = 1.0 / np.sqrt(np.abs(np.diag(unit)))
    sign = np.sign(unit[0, 0])
    return smallest_value(
        lambda q: np.linalg.eigvalsh(sign * (distal.at(q) - bound) * scale[:, np.newaxis] * scale)[:, 0], ranges
    )


def _with_constant(polynomial: np.ndarray, constant: np.ndarray) -> TrigMatrix:
    result = polynomial.copy()
    place = (0,) * (polynomial.ndim - 2)
    result[place] = result[place] + constant
    return TrigMatrix(result)
