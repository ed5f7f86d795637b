"""The inertia M̂ of some rules and the constants D_low, D_high that make κ small, by programs over samples.

    minimise κ:    D_low <= D <= D_high,    M̂ <= near + Jᵀ D_low J,    near + Jᵀ D_high J <= κ M̂

at sampled angles, see `inertia_samples`. κ M̂ is bilinear: with κ and M̂' of the step before, one minimises t in
near + Jᵀ D_high J <= κ M̂ + t M̂', which is a semidefinite program, and takes the κ of its solution (Dinkelbach).
Only samples whose constraint is nearly active are in the program; those that its solution violates most are added.
Nothing of this is a proof.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from fuzzyarm.synthesis.inertia_samples import InertiaSamples
from fuzzyarm.synthesis.semidefinite_program import Family, minimise, symmetric_units

__all__ = ["ROUNDS", "MetricSearch", "relative"]

ROUNDS = 20
"""Programs that are solved for one schedule at most."""

FIRST = 24  # samples to begin with
ADDED = 5  # of each constraint and round
FLOOR_ROUNDS, FLOOR_COST = 4, 2e-3  # and the share by which κ and the rates may rise for a larger floor
SHARES = (1.0, 0.6, 0.3, 0.1)  # of the way from the best M̂ so far to an answer of the program
ACTIVE = 0.02  # smallest eigenvalue of a constraint in scaled coordinates that keeps its sample in the program
CLOSE = 2e-3  # what κ might still fall by, relative, at which the search ends


def relative(matrices: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return the eigenvalues (B, s), ascending, of matrices relative to positive definite ones, (B, s, s) each."""
    inverse = np.linalg.inv(np.linalg.cholesky(to))
    return np.linalg.eigvalsh(inverse @ matrices @ np.swapaxes(inverse, -1, -2))


class MetricSearch:
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
        self.kappa = np.inf
        self.near, self.far = set(range(FIRST)), set(range(FIRST)) if self.distal else set()

    def copy(self) -> MetricSearch:
        """Return a search that goes on from here on its own."""
        other = copy.copy(self)
        other.near, other.far = set(self.near), set(self.far)
        return other

    def schedule(self, weights: np.ndarray) -> None:
        """Go on with one more premise: rules of weights (B, N), each with the inertia that it had without."""
        copies = weights.shape[1] // len(self.inertia)
        self.weights, self.inertia = weights, np.tile(self.inertia, (copies, 1, 1))

    def fix_distal(self) -> None:
        """Leave D_low and D_high what they are from now on, which makes the programs small."""
        self.far = set()

    def run(self, rounds: int = ROUNDS) -> None:
        """Iterate until the samples in the program allow no smaller κ; what is found holds for all samples.

        The M̂, D_low and D_high that reach a κ are a convex set. Where an answer of the program violates the samples
        outside of it, a point between it and the best one so far may not. So κ never rises, and more rules have none
        that is larger than that of the fewer rules a search goes on from.
        """
        self._settle()
        self.kappa, best = self._kappa(), self._proposal()
        self._add_violated()
        for _ in range(rounds):
            gain = self._step(sorted(self.near), sorted(self.far))
            answer, start = self._proposal(), best
            self._add_violated()
            for share in SHARES:
                self.inertia, self.low, self.high = (
                    share * new + (1.0 - share) * old for new, old in zip(answer, start, strict=True)
                )
                self._settle()
                kappa = self._kappa()
                if kappa < self.kappa:
                    self.kappa, best = kappa, self._proposal()
            self.inertia, self.low, self.high = best
            self._add_violated()
            if gain < CLOSE * self.kappa:
                break

    def raise_floor(self, slopes: list[np.ndarray]) -> None:
        """Raise the smallest eigenvalue of M̂ as far as κ and the rates μ_k allow, κ a little larger than it is.

        Many M̂ have the same κ. The gain γ/σ between Euclidean norms is the smaller, the larger the floor σ.

        Args:
            slopes: ∂h/∂q_k (B, N) [1/rad] of each kept angle.
        """
        largest = (1.0 + FLOOR_COST) * self.kappa
        rates, best = np.array([self.rate(slope) for slope in slopes]), self.copy()
        for _ in range(FLOOR_ROUNDS):
            self._floor_step(sorted(self.near), slopes, (1.0 + FLOOR_COST) * rates, largest)
            self._add_violated()
            start = best
            for share in SHARES:
                found = start.blended(self, share)
                within = found.kappa <= largest and all(
                    found.rate(slope) <= (1.0 + FLOOR_COST) * rate for slope, rate in zip(slopes, rates, strict=True)
                )
                if within and found._floors().min() > best._floors().min():
                    best = found
            self.near |= {int(k) for k in np.argsort(best._floors())[:ADDED]}
            self.inertia, self.kappa = best.inertia, best.kappa

    def rate(self, slope: np.ndarray) -> float:
        """Return μ_k [1/rad]: half the largest eigenvalue of ∂M̂/∂q_k relative to M̂, from ∂h/∂q_k, shape (B, N)."""
        hat, change = (np.tensordot(weights, self.inertia, axes=1) for weights in (self.weights, slope))
        return 0.5 * float(np.abs(relative(change, hat)).max())

    def blended(self, end: MetricSearch, share: float) -> MetricSearch:
        """Return this search with S_r, D_low and D_high moved by a share towards those of another one."""
        other = self.copy()
        other.inertia, other.low, other.high = (
            old + share * (new - old) for new, old in zip(end._proposal(), self._proposal(), strict=True)
        )
        other._settle()
        other.kappa = other._kappa()
        return other

    def found(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return S_r (N, n, n), D_low, D_high and the diagonal matrix of the units of D, in SI units."""
        distal = self.distal_row[:, np.newaxis] * self.distal_row
        unit = np.diag(1.0 / self.distal_row**2)
        return self.inertia / (self.row[:, np.newaxis] * self.row), self.low / distal, self.high / distal, unit

    def _proposal(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.inertia, self.low, self.high

    def _settle(self) -> None:
        """Move D_low and D_high to where all samples allow them, and scale M̂ to where it touches the lower inertia."""
        if self.distal:
            D, unit = self.samples.distal, np.eye(self.distal)
            self.low = self.low + min(np.linalg.eigvalsh(D - self.low)[:, 0].min(), 0.0) * unit
            self.high = self.high - min(np.linalg.eigvalsh(self.high - D)[:, 0].min(), 0.0) * unit
        scheduled = np.tensordot(self.weights, self.inertia, axes=1)
        if np.linalg.eigvalsh(scheduled)[:, 0].min() > 0.0:
            share = relative(self.samples.inertia(self.low), scheduled)[:, 0].min()
            self.inertia = max(share, 0.0) * self.inertia

    def _add_violated(self) -> None:
        """Add the samples to the program that violate its constraints most."""
        gaps, distal_gaps = self._gaps()
        self.near |= {int(k) for gap in gaps for k in np.argsort(gap)[:ADDED]}
        if self.far:
            self.far = {k for k in self.far if min(gap[k] for gap in distal_gaps) < ACTIVE}
            self.far |= {int(k) for gap in distal_gaps for k in np.argsort(gap)[:ADDED]}

    def _kappa(self) -> float:
        """Return κ of all samples, inf where M̂ or the lower inertia is not positive definite."""
        scheduled = np.tensordot(self.weights, self.inertia, axes=1)
        if np.linalg.eigvalsh(scheduled)[:, 0].min() <= 0.0:
            return np.inf
        low = float(relative(self.samples.inertia(self.low), scheduled)[:, 0].min())
        high = float(relative(self.samples.inertia(self.high), scheduled)[:, -1].max())
        return high / low if low > 0.0 else np.inf

    def _gaps(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return the smallest eigenvalues of each constraint at all samples, relative where κ is concerned."""
        scheduled = np.tensordot(self.weights, self.inertia, axes=1)
        if np.linalg.eigvalsh(scheduled)[:, 0].min() <= 0.0:  # nothing is relative to such a metric
            gaps = [np.linalg.eigvalsh(scheduled)[:, 0]]
        else:
            low = relative(self.samples.inertia(self.low), scheduled)[:, 0]
            high = relative(self.samples.inertia(self.high), scheduled)[:, -1]
            gaps = [low - 1.0, 1.0 - high / self.kappa]
        if not self.distal:
            return gaps, []
        D = self.samples.distal
        return gaps, [np.linalg.eigvalsh(D - self.low)[:, 0], np.linalg.eigvalsh(self.high - D)[:, 0]]

    def _floors(self) -> np.ndarray:
        """Return the smallest eigenvalue of M̂ (B,) in SI units."""
        scheduled = np.tensordot(self.weights, self.inertia, axes=1) / (self.row[:, np.newaxis] * self.row)
        return np.asarray(np.linalg.eigvalsh(scheduled)[:, 0])

    def _floor_step(self, near: list[int], slopes: list[np.ndarray], rates: np.ndarray, kappa: float) -> None:
        """Take the S_r with the largest σ in σ I <= M̂ under which bounds of κ and of the rates hold at some samples."""

        def times(weights: np.ndarray) -> np.ndarray:
            shape = len(near), len(self.inertia) * len(self.units), self.size, self.size
            return np.asarray((weights[near][:, :, np.newaxis, np.newaxis, np.newaxis] * self.units).reshape(shape))

        hat = times(self.weights)
        nothing = np.zeros((len(near), self.size, self.size))
        none = nothing[:, np.newaxis]
        lowest, highest = (self.samples.inertia(D)[near] for D in (self.low, self.high))
        families = [
            Family(lowest, np.concatenate([-hat, none], axis=1)),
            Family(-highest, np.concatenate([kappa * hat, none], axis=1)),
            Family(nothing, np.concatenate([hat, none - np.diag(self.row**2)], axis=1)),
        ]
        for slope, rate in zip(slopes, rates.tolist(), strict=True):
            families += [
                Family(nothing, np.concatenate([2.0 * rate * hat + sign * times(slope), none], axis=1))
                for sign in (1.0, -1.0)
            ]
        x, _ = minimise(-np.eye(hat.shape[1] + 1)[-1], families)
        if np.isfinite(x).all():
            self.inertia = np.tensordot(x[:-1].reshape(-1, len(self.units)), self.units, axes=1)

    def _step(self, near: list[int], far: list[int]) -> float:
        """Solve the program of some samples and take its S_r and, if those are not yet fixed, D_low and D_high.

        Returns how much smaller κ might get, -t; 0 where the solver has no answer.
        """
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
            return 0.0
        self.inertia = np.tensordot(x[:columns].reshape(-1, len(units)), units, axes=1)
        if far:
            self.low = np.tensordot(x[columns : columns + others], distal, axes=1)
            self.high = np.tensordot(x[columns + others : -1], distal, axes=1)
        return -float(x[-1])
