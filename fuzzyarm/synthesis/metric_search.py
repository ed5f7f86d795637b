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

__all__ = ["MetricSearch", "relative"]

FIRST = 24  # samples to begin with
ADDED = 5  # of each constraint and round
ROUNDS = 14
ACTIVE = 0.02  # smallest eigenvalue of a constraint in scaled coordinates that keeps its sample in the program
CLOSE = 2e-3  # violation of the samples outside of the program, relative, at which the search ends
FIRST_KAPPA = 50.0


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
        self.kappa = FIRST_KAPPA
        self.near, self.far = set(range(FIRST)), set(range(FIRST)) if self.distal else set()

    def copy(self) -> MetricSearch:
        """Return a search that goes on from here on its own."""
        other = copy.copy(self)
        other.near, other.far = set(self.near), set(self.far)
        return other

    def schedule(self, weights: np.ndarray) -> None:
        """Go on with rules of weights (B, N) from the constant inertia found before; D_low and D_high are settled."""
        self.weights, self.inertia, self.far = weights, np.repeat(self.inertia, weights.shape[1], axis=0), set()
        if self.distal:
            self._settle()

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

    def found(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return S_r (N, n, n), D_low, D_high and the diagonal matrix of the units of D, in SI units."""
        distal = self.distal_row[:, np.newaxis] * self.distal_row
        unit = np.diag(1.0 / self.distal_row**2)
        return self.inertia / (self.row[:, np.newaxis] * self.row), self.low / distal, self.high / distal, unit

    def _settle(self) -> None:
        """Move D_low and D_high to where all samples allow them."""
        D, unit = self.samples.distal, np.eye(self.distal)
        self.low = self.low + min(np.linalg.eigvalsh(D - self.low)[:, 0].min(), 0.0) * unit
        self.high = self.high - min(np.linalg.eigvalsh(self.high - D)[:, 0].min(), 0.0) * unit

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
