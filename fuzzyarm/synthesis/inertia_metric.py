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
from fuzzyarm.synthesis.extremes import smallest_value
from fuzzyarm.synthesis.inertia_samples import InertiaSamples
from fuzzyarm.synthesis.metric_search import MetricSearch, relative
from fuzzyarm.synthesis.scalar_design import smallest_pole

__all__ = ["Metric", "fitted_metric", "ranked_premises", "split_of"]

UNSPLIT = 4  # joints of a robot whose chain needs no split
FAR = 3  # most angles beyond the split
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


def fitted_metric(robot: Robot, premises: tuple[Premise, ...], split: int, *, count: int, seed: int = 0) -> Metric:
    """Return the metric with the smallest κ found.

    Args:
        robot: the robot.
        premises: the kept ones.
        split: a.
        count: samples.
        seed: of the samples.
    """
    samples = InertiaSamples.of(robot, split, count, seed)
    search = MetricSearch(samples)
    search.run()
    if premises:
        search.schedule(rule_weights(premises, samples.q))
        search.run()
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
    n, samples = len(robot), InertiaSamples.of(robot, len(robot), count, seed)
    constant = MetricSearch(samples)
    constant.run()
    ranked = []
    for candidate in candidates:
        premises, search = (*kept, candidate), constant.copy()
        weights = rule_weights(premises, samples.q)
        search.schedule(weights)
        search.run()
        inertia, *_ = search.found()
        hat = np.tensordot(weights, inertia, axes=1)
        shares = relative(samples.inertia(), hat)
        kappa = float(shares[:, -1].max() / shares[:, 0].min())
        rate = 0.0
        for premise in premises:
            step = STEP * np.eye(n)[premise.joint]
            change = rule_weights(premises, samples.q + step) - rule_weights(premises, samples.q - step)
            slope = relative(np.tensordot(change / (2.0 * STEP), inertia, axes=1), hat)
            rate += 0.5 * float(np.abs(slope).max()) * robot.joints[premise.joint].velocity_limit
        ranked.append((smallest_pole(kappa, alpha + rate), candidate))
    return sorted(ranked, key=lambda entry: entry[0])


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
