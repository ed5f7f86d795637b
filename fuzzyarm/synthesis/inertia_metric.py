"""The scheduled inertia M̂ and the constants D_low, D_high that make κ small, by semidefinite programs over samples.

    minimise κ:    D_low <= D <= D_high,    M̂ <= near + Jᵀ D_low J,    near + Jᵀ D_high J <= κ M̂

at sampled angles, see `inertia_samples`. κ M̂ is bilinear: with κ and M̂' of the step before, one minimises t in
near + Jᵀ D_high J <= κ M̂ + t M̂', which is a semidefinite program, and takes the κ of its solution (Dinkelbach's method).
Only samples whose constraint is nearly active are in the program; those that its solution violates most are added.
Nothing of this is a proof.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.proof.inertia_bounds import scheduled_polynomial
from fuzzyarm.fuzzy_policy.proof.trigonometric import TrigMatrix
from fuzzyarm.fuzzy_policy.scheduled import Premise, rule_weights
from fuzzyarm.synthesis.inertia_samples import InertiaSamples
from fuzzyarm.synthesis.semidefinite_program import Family, minimise, symmetric_units

__all__ = ["Metric", "fitted_metric", "split_of"]

FIRST = 24  # samples to begin with
ADDED = 5  # of each constraint and round
ROUNDS = 14
ACTIVE = 0.02  # smallest eigenvalue of a constraint in scaled coordinates that keeps its sample in the program
CLOSE = 2e-3  # violation of the samples outside of the program, relative, at which the search ends
UNSPLIT = 4  # joints of a robot whose chain needs no split
FIRST_KAPPA = 50.0


@dataclasses.dataclass(frozen=True)
class Metric:
    """A proposal of bounds; quantities as in `ScheduledController`, whose `kappa`, `floor` and `rates` it widens.

    Attributes:
        premises: the kept ones.
        split: a.
        inertia: S_r, (N, n, n).
        distal_low: D_low.
        distal_high: D_high.
        kappa: κ of the samples.
        floor: σ of the samples.
        rates: μ_k of the samples, (premises,).
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
    """Return a, the link behind which the chain is split: half-way, but not before the last kept angle."""
    n = len(robot)
    if n <= UNSPLIT:
        return n
    return max([(n + 1) // 2, *(premise.joint + 1 for premise in premises)])


def fitted_metric(
    robot: Robot, premises: tuple[Premise, ...], split: int, *, count: int, seed: int = 0, slack: float = 1e-3
) -> Metric:
    """Return the metric with the smallest κ found.

    Args:
        robot: the robot.
        premises: the kept ones.
        split: a.
        count: samples.
        seed: of the samples.
        slack: how far D_low and D_high are moved from what the samples need, relative to their units.
    """
    samples = InertiaSamples.of(robot, split, count, seed)
    search, weights = _Search(samples), rule_weights(premises, samples.q)
    search.run()
    if premises:
        search.schedule(weights)
        search.run()
    inertia, low, high = search.found(slack)
    scheduled = np.tensordot(weights, inertia, axes=1)
    lowest, highest = samples.inertia(low), samples.inertia(high)
    share = _relative(lowest, scheduled)[:, 0].min()
    inertia, scheduled = share * inertia, share * scheduled
    polynomial = TrigMatrix(scheduled_polynomial(premises, inertia, split))
    rates = [
        0.5 * np.abs(_relative(polynomial.derivative(p.joint - 1).at(samples.q[:, 1:split]), scheduled)).max()
        for p in premises
    ]
    return Metric(
        premises=premises,
        split=split,
        inertia=inertia,
        distal_low=low,
        distal_high=high,
        kappa=float(_relative(highest, scheduled)[:, -1].max()),
        floor=float(np.linalg.eigvalsh(scheduled)[:, 0].min()),
        rates=np.array(rates),
    )


def _relative(matrices: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return the eigenvalues (B, s), ascending, of matrices relative to positive definite ones, (B, s, s) each."""
    inverse = np.linalg.inv(np.linalg.cholesky(to))
    return np.linalg.eigvalsh(inverse @ matrices @ np.swapaxes(inverse, -1, -2))


class _Search:
    """The iteration of the module's docstring, in coordinates in which the mean of each inertia has a unit diagonal."""

    def __init__(self, samples: InertiaSamples) -> None:
        self.row = 1.0 / np.sqrt(np.diagonal(samples.inertia().mean(axis=0)))
        self.distal_row = 1.0 / np.sqrt(np.diagonal(samples.distal.mean(axis=0)))
        self.samples = dataclasses.replace(
            samples,
            near=samples.near * self.row[:, np.newaxis] * self.row,
            twist=samples.twist * self.row / self.distal_row[:, np.newaxis],
            distal=samples.distal * self.distal_row[:, np.newaxis] * self.distal_row,
        )
        self.weights = np.ones((len(samples.q), 1))
        self.size, self.distal = len(self.row), len(self.distal_row)
        self.units, self.distal_units = symmetric_units(self.size), symmetric_units(self.distal)
        self.inertia = 0.1 * np.eye(self.size)[np.newaxis]
        self.low, self.high = np.zeros((self.distal, self.distal)), 10.0 * np.eye(self.distal)
        self.kappa = FIRST_KAPPA
        self.near, self.far = set(range(FIRST)), set(range(FIRST)) if self.distal else set()

    def schedule(self, weights: np.ndarray) -> None:
        """Go on with rules of weights (B, N), from the constant inertia found before, which has settled D_low, D_high."""
        self.weights, self.inertia, self.far = weights, np.repeat(self.inertia, weights.shape[1], axis=0), set()
        self.low, self.high = self._settled(0.0)

    def run(self) -> None:
        """Iterate until the samples outside of the program are hardly violated."""
        best = np.inf
        for _ in range(ROUNDS):
            self._step(sorted(self.near), sorted(self.far))
            gaps, distal_gaps = self._gaps()
            kappa = self._kappa()
            violated = min([gap.min() for gap in distal_gaps], default=0.0) < -CLOSE
            if kappa < np.inf and not violated and kappa > best * (1.0 - CLOSE):
                break
            if kappa < np.inf:
                self.kappa = kappa
                best = best if violated else min(best, kappa)
            self.near |= {int(k) for gap in gaps for k in np.argsort(gap)[:ADDED]}
            if self.far:
                self.far = {k for k in self.far if min(gap[k] for gap in distal_gaps) < ACTIVE}
                self.far |= {int(k) for gap in distal_gaps for k in np.argsort(gap)[:ADDED]}

    def found(self, slack: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return S_r (N, n, n), D_low and D_high in SI units; the last two moved to where all samples allow them."""
        low, high = self._settled(slack)
        distal = self.distal_row[:, np.newaxis] * self.distal_row
        return self.inertia / (self.row[:, np.newaxis] * self.row), low / distal, high / distal

    def _settled(self, slack: float) -> tuple[np.ndarray, np.ndarray]:
        """Return D_low and D_high, moved to where all samples allow them and by `slack` beyond."""
        if not self.distal:
            return self.low, self.high
        D, unit = self.samples.distal, np.eye(self.distal)
        down = min(np.linalg.eigvalsh(D - self.low)[:, 0].min(), 0.0) - slack
        up = min(np.linalg.eigvalsh(self.high - D)[:, 0].min(), 0.0) - slack
        return self.low + down * unit, self.high - up * unit

    def _kappa(self) -> float:
        """Return κ of all samples, inf where M̂ or the lower inertia is not positive definite."""
        scheduled = np.tensordot(self.weights, self.inertia, axes=1)
        if np.linalg.eigvalsh(scheduled)[:, 0].min() <= 0.0:
            return np.inf
        low = float(_relative(self.samples.inertia(self.low), scheduled)[:, 0].min())
        high = float(_relative(self.samples.inertia(self.high), scheduled)[:, -1].max())
        return high / low if low > 0.0 else np.inf

    def _gaps(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the smallest eigenvalues of each constraint at all samples, relative where κ is concerned."""
        scheduled = np.tensordot(self.weights, self.inertia, axes=1)
        if np.linalg.eigvalsh(scheduled)[:, 0].min() <= 0.0:  # nothing is relative to such a metric
            gaps = [np.linalg.eigvalsh(scheduled)[:, 0]]
        else:
            low = _relative(self.samples.inertia(self.low), scheduled)[:, 0]
            high = _relative(self.samples.inertia(self.high), scheduled)[:, -1]
            gaps = [low - 1.0, 1.0 - high / self.kappa]
        if not self.distal:
            return gaps, []
        D = self.samples.distal
        return gaps, [np.linalg.eigvalsh(D - self.low)[:, 0], np.linalg.eigvalsh(self.high - D)[:, 0]]

    def _step(self, near: list[int], far: list[int]) -> None:
        """Solve the program of some samples and take its S_r and, if those are not yet fixed, D_low and D_high."""
        n, units = self.size, self.units
        distal = self.distal_units if far else self.distal_units[:0]
        columns, others = len(self.inertia) * len(units), len(distal)
        before = np.tensordot(self.weights[near], self.inertia, axes=1)[:, np.newaxis]
        hat = (self.weights[near][:, :, np.newaxis, np.newaxis, np.newaxis] * units).reshape(len(near), columns, n, n)
        J = self.samples.twist[near]
        tail = np.swapaxes(J, -1, -2)[:, np.newaxis] @ distal @ J[:, np.newaxis]
        none, nothing = np.zeros_like(tail), np.zeros_like(before)
        lowest = highest = self.samples.near[near]
        if not far:
            lowest, highest = (self.samples.inertia(D)[near] for D in (self.low, self.high))
        families = [
            Family(lowest, np.concatenate([-hat, tail, none, nothing], axis=1)),
            Family(-highest, np.concatenate([self.kappa * hat, none, -tail, before], axis=1)),
        ]
        if far:
            D = self.samples.distal[far]
            every = np.broadcast_to(distal, (len(far), *distal.shape))
            wide = np.zeros((len(far), columns, self.distal, self.distal))
            zero, one = np.zeros_like(every), np.zeros_like(D)[:, np.newaxis]
            families += [
                Family(D, np.concatenate([wide, -every, zero, one], axis=1)),
                Family(-D, np.concatenate([wide, zero, every, one], axis=1)),
            ]
        q = np.zeros(columns + 2 * others + 1)
        q[-1] = 1.0
        x, _ = minimise(q, families)
        if not np.isfinite(x).all():
            return
        self.inertia = np.tensordot(x[:columns].reshape(-1, len(units)), units, axes=1)
        if far:
            self.low = np.tensordot(x[columns : columns + others], distal, axes=1)
            self.high = np.tensordot(x[columns + others : -1], distal, axes=1)
