"""A search for the scheduled inertia M̂ and constants D_low, D_high of a robot with a small κ.

    minimise κ:    D_low <= D <= D_high,    M̂ <= near + Jᵀ D_low J,    near + Jᵀ D_high J <= κ M̂

at sampled angles; `_Samples` explains near, D and J. Because κ M̂ is bilinear, each step solves a semidefinite program
instead: minimise t subject to near + Jᵀ D_high J <= κ M̂ + t M̂', with κ and M̂' from the previous step; the solution
gives the next κ (Dinkelbach). The program contains only samples with nearly active constraints; those that its solution
violates most are added. Finally the bounds are moved to be true at the worst angles that a search finds. None of
this is a proof.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import operator
from collections.abc import Callable, Sequence

import clarabel  # type: ignore[import-untyped]
import numpy as np
from scipy import sparse

from fuzzyarm.envs.physics.rigid_body import frames, mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.scheduled_controller import FUNCTIONS, TWIST, Premise, rule_weights, speeds_of
from fuzzyarm.proof.box_cover import TrigMatrix
from fuzzyarm.proof.definiteness import exact
from fuzzyarm.proof.inertia_bounds import angle_ranges, inertia_polynomial, plus, scheduled_polynomial
from fuzzyarm.synthesis._scalar_design import smallest_pole

__all__ = ["InertiaMetric", "best_premise", "fitted_metric", "relative"]


def _svec(matrix: np.ndarray) -> np.ndarray:
    """Return the upper triangles (..., s(s + 1)/2) of matrices (..., s, s) by columns; off-diagonal entries × √2."""
    column, row = np.tril_indices(matrix.shape[-1])
    return matrix[..., row, column] * np.where(row == column, 1.0, math.sqrt(2.0))


def _symmetric_units(size: int) -> np.ndarray:
    """Return a basis (s(s + 1)/2, s, s) of symmetric matrices, each with one entry and its mirror image 1, others 0."""
    row, column = np.tril_indices(size)
    units = np.zeros((len(row), size, size))
    every = np.arange(len(row))
    units[every, row, column] = units[every, column, row] = 1.0
    return units


def _minimise(
    sizes: dict[str, int], families: list[tuple[np.ndarray, dict[str, np.ndarray]]], sign: float = 1.0
) -> dict[str, np.ndarray] | None:
    """Return the variables, by name, that minimise `sign` times the last one; None if the solver has no answer.

    `sizes` are the numbers of entries of the variables. A family of constraints is F_0 + Σ x_k F_k >= 0 at B samples:
    F_0 (B, s, s) and, by name of the variable, F_k (B, size, s, s), omitted where it is 0.
    """
    rows, b, cones = [], [], []
    for constant, parts in families:
        every = [
            np.broadcast_to(parts.get(name, 0.0), (len(constant), size, *constant.shape[1:]))
            for name, size in sizes.items()
        ]
        rows.append(-np.swapaxes(_svec(np.concatenate(every, axis=1)), 1, 2).reshape(-1, sum(sizes.values())))
        b.append(_svec(constant).ravel())
        cones += [clarabel.PSDTriangleConeT(constant.shape[-1])] * len(constant)
    q = np.zeros(sum(sizes.values()))
    q[-1] = sign
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-7
    settings.direct_solve_method, settings.max_threads = "faer", 1
    A = sparse.csc_matrix(np.concatenate(rows))
    answer = clarabel.DefaultSolver(sparse.csc_matrix((len(q), len(q))), q, A, np.concatenate(b), cones, settings)
    x = np.array(answer.solve().x)
    ends = np.cumsum([*sizes.values()])[:-1]
    return dict(zip(sizes, np.split(x, ends), strict=True)) if np.isfinite(x).all() else None


@dataclasses.dataclass(frozen=True)
class _Samples:
    """The inertia M̄ = near + Jᵀ D J of a robot at B sampled angles: `near` of links 1 to a, D of the links beyond."""

    q: np.ndarray  # angles (B, n) [rad]
    near: np.ndarray  # inertia of the links up to a, with the rotors, (B, n, n) [kg m²]
    twist: np.ndarray  # J (B, 6 + n - a, n), from q̇ to the twist of link a in the frame of link a and the rates beyond
    distal: np.ndarray  # D (B, 6 + n - a, 6 + n - a), inertia of the links beyond; empty without a split

    @classmethod
    def of(cls, robot: Robot, split: int, count: int) -> _Samples:
        """Return samples at `count` postures within the robot's ranges, with its chain of links split after `split`."""
        n = len(robot)
        q = _angles_in(angle_ranges(robot), count, seed=0)
        whole = mass_matrix(robot, q) + np.diag(robot.drive("motor_inertia"))
        if split == n:
            return cls(q, whole, np.zeros((count, 0, n)), np.zeros((count, 0, 0)))
        twist = _twist_map(robot, q, split)
        distal = TrigMatrix(inertia_polynomial(robot, split, n)).at(q[:, split:])
        return cls(q, whole - np.swapaxes(twist, 1, 2) @ distal @ twist, twist, distal)

    def inertia(self, distal: np.ndarray | None = None) -> np.ndarray:
        """Return M̄ (B, n, n) [kg m²] at the B samples; `distal`, if given, is one matrix that replaces every D."""
        D = self.distal if distal is None else distal
        return np.asarray(self.near + np.swapaxes(self.twist, 1, 2) @ D @ self.twist)


def _twist_map(robot: Robot, q: np.ndarray, split: int) -> np.ndarray:
    """Return J of `_Samples` (B, 6 + n - a, n) at angles (B, n) [rad], with a = `split`."""
    n = len(robot)
    links = frames(robot, q)
    back = np.swapaxes(links.rotation[..., split - 1, :, :], -1, -2)
    directions = np.einsum("...kij,kj->...ik", links.rotation, robot.arrays.axis)[..., :split]
    arms = np.swapaxes(links.origin[..., split - 1 : split, :] - links.origin[..., :split, :], -1, -2)
    result = np.zeros((*q.shape[:-1], TWIST + n - split, n))
    result[..., :TWIST, :split] = np.concatenate(
        [back @ np.cross(directions, arms, axis=-2), back @ directions], axis=-2
    )
    result[..., TWIST:, split:] = np.eye(n - split)
    return result


def _angles_in(ranges: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return angles (count, d) in `ranges` (d, 2) [rad]: half at random, half on multiples of π/4 and on the faces."""
    generator = np.random.default_rng(seed)
    low, high = ranges.T
    q = generator.uniform(low, high, (count, len(ranges)))
    snapped = np.clip(np.round(q * 4.0 / np.pi) * np.pi / 4.0, low, high)
    ends = np.where(generator.random(q.shape) < 0.5, low, high)
    snapped = np.where(generator.random(q.shape) < 0.15, ends, snapped)
    return np.where((np.arange(count) % 2 == 0)[:, np.newaxis], q, snapped)


def _smallest_value(function: Callable[[np.ndarray], np.ndarray], ranges: np.ndarray) -> float:
    """Return the smallest value found of a function from angles (B, d) [rad], in `ranges` (d, 2), to numbers (B,)."""
    q = _angles_in(ranges, 3000, seed=1)
    values = function(q)
    best = np.argsort(values)[:40]
    q, values = q[best], values[best]
    d = len(ranges)
    directions = np.concatenate([np.eye(d), -np.eye(d)])
    step = 0.2  # rad, halved if no step lowers a value
    for _ in range(25 if d else 0):
        tried = np.clip(q[:, np.newaxis] + step * directions, ranges[:, 0], ranges[:, 1])
        found = function(tried.reshape(-1, d)).reshape(len(q), -1)
        place, every = np.argmin(found, axis=1), np.arange(len(q))
        better = found[every, place] < values
        q = np.where(better[:, np.newaxis], tried[every, place], q)
        values = np.where(better, found[every, place], values)
        if not better.any():
            step *= 0.5
    return float(values.min())


_ROUNDS = 20  # largest number of programs solved for one schedule
_FIRST = 24  # samples in the first program
_ADDED = 5  # samples added for each constraint in a round
_FLOOR_ROUNDS, _FLOOR_COST = 4, 2e-3  # rounds; relative rise of κ and the rates that is allowed for a larger floor
_SHARES = (1.0, 0.6, 0.3, 0.1)  # shares of the way from the best M̂ so far to the answer of a program
_ACTIVE = 0.02  # a sample stays in the program while the smallest eigenvalue of a scaled constraint is below this
_CLOSE = 2e-3  # relative decrease of κ still possible below which the search ends


def relative(matrices: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return the eigenvalues (B, s), ascending, of matrices relative to positive definite ones, (B, s, s) each."""
    inverse = np.linalg.inv(np.linalg.cholesky(to))
    return np.linalg.eigvalsh(inverse @ matrices @ np.swapaxes(inverse, -1, -2))


def _lowest(*values: np.ndarray) -> frozenset[int]:
    """Return the indices of the samples with the `_ADDED` smallest values in each array (B,)."""
    return frozenset(int(k) for one in values for k in np.argsort(one)[:_ADDED])


class _Search:
    """The iteration of the module's docstring, in coordinates in which the mean of each inertia has a unit diagonal."""

    def __init__(self, samples: _Samples) -> None:
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
        self.units, self.distal_units = _symmetric_units(self.size), _symmetric_units(self.distal)
        self.inertia = 0.1 * np.eye(self.size)[np.newaxis]
        self.low, self.high = np.zeros((self.distal, self.distal)), 10.0 * np.eye(self.distal)
        self.kappa = np.inf
        self.near = frozenset(range(_FIRST))  # samples in the program, of M̂ and of D
        self.far = self.near if self.distal else frozenset()

    def schedule(self, weights: np.ndarray) -> None:
        """Add a premise, which splits every rule; each new rule gets the inertia of the rule that was split.

        `weights` (B, N) are those of the new rules at the samples.
        """
        copies = weights.shape[1] // len(self.inertia)
        self.weights, self.inertia = weights, np.tile(self.inertia, (copies, 1, 1))

    def run(self, rounds: int = _ROUNDS) -> None:
        """Solve at most `rounds` programs, until κ hardly falls; the result satisfies the constraints at all samples.

        The M̂, D_low and D_high that reach a given κ form a convex set. If a solution of the program violates the
        constraints at other samples, points between this solution and the best one so far are tried. The best one is
        replaced only if κ falls, so κ never rises.
        """
        self.kappa, best = self._settled(), self._proposal
        self._add_violated()
        for _ in range(rounds):
            gain = self._step()
            answer, start = self._proposal, best
            self._add_violated()
            for share in _SHARES:
                self._proposal = [share * new + (1.0 - share) * old for new, old in zip(answer, start, strict=True)]
                kappa = self._settled()
                if kappa < self.kappa:
                    self.kappa, best = kappa, self._proposal
            self._proposal = best
            self._add_violated()
            if gain < _CLOSE * self.kappa:
                break

    def raise_floor(self, slopes: list[np.ndarray]) -> None:
        """Raise the smallest eigenvalue of M̂ as far as slightly larger κ and rates μ_k allow.

        A larger floor σ gives a smaller gain γ/σ between Euclidean norms. `slopes` are ∂h/∂q_k (B, N) [1/rad] of the
        rule weights h, for each kept angle q_k.
        """
        largest = (1.0 + _FLOOR_COST) * self.kappa
        rates, best = [(1.0 + _FLOOR_COST) * self.rate(slope) for slope in slopes], copy.copy(self)
        for _ in range(_FLOOR_ROUNDS):
            self._floor_step(slopes, rates, largest)
            self._add_violated()
            start = best
            for share in _SHARES:
                found = start.blended(self, share)
                within = found.kappa <= largest and all(map(operator.le, map(found.rate, slopes), rates))
                if within and found._floors().min() > best._floors().min():
                    best = found
            self.near |= _lowest(best._floors())
            self.inertia, self.kappa = best.inertia, best.kappa

    def scheduled(self) -> np.ndarray:
        """Return the scheduled inertia M̂ (B, n, n) at all samples, in the scaled coordinates."""
        return np.asarray(np.tensordot(self.weights, self.inertia, axes=1))

    def rate(self, slope: np.ndarray) -> float:
        """Return μ_k [1/rad]: half the largest eigenvalue of ∂M̂/∂q_k relative to M̂, from ∂h/∂q_k, shape (B, N)."""
        hat, change = (np.tensordot(weights, self.inertia, axes=1) for weights in (self.weights, slope))
        return 0.5 * float(np.abs(relative(change, hat)).max())

    def blended(self, end: _Search, share: float) -> _Search:
        """Return a copy with S_r, D_low and D_high moved by the fraction `share` towards those of the search `end`."""
        other = copy.copy(self)
        other._proposal = [old + share * (new - old) for new, old in zip(end._proposal, self._proposal, strict=True)]
        other.kappa = other._settled()
        return other

    def found(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return S_r (N, n, n) and three matrices like D, in SI units: D_low, D_high, the diagonal of D's mean."""
        distal = self.distal_row[:, np.newaxis] * self.distal_row
        unit = np.diag(1.0 / self.distal_row**2)
        return self.inertia / (self.row[:, np.newaxis] * self.row), self.low / distal, self.high / distal, unit

    @property
    def _proposal(self) -> list[np.ndarray]:
        return [self.inertia, self.low, self.high]

    @_proposal.setter
    def _proposal(self, values: list[np.ndarray]) -> None:
        self.inertia, self.low, self.high = values

    def _settled(self) -> float:
        """Shift D_low and D_high until they bound D at all samples, and scale M̂ until it touches the lower inertia.

        Return κ over all samples; inf if M̂ or the lower inertia is not positive definite at a sample.
        """
        if self.distal:
            below, above = self._distal_gaps()
            self.low = self.low + min(below.min(), 0.0) * np.eye(self.distal)
            self.high = self.high - min(above.min(), 0.0) * np.eye(self.distal)
        scheduled = self.scheduled()
        if np.linalg.eigvalsh(scheduled)[:, 0].min() > 0.0:
            share = relative(self.samples.inertia(self.low), scheduled)[:, 0].min()
            self.inertia = max(share, 0.0) * self.inertia
        low, high = self._shares()
        return float(high.max()) / float(low.min()) if low.min() > 0.0 else np.inf

    def _shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest eigenvalues of the lower inertia, and the largest of the upper one, relative to M̂.

        Both arrays are (B,), for B samples. If M̂ is not positive definite at one, both are M̂'s smallest eigenvalues.
        """
        scheduled = self.scheduled()
        least = np.linalg.eigvalsh(scheduled)[:, 0]
        if least.min() <= 0.0:
            return least, least
        low, high = (relative(self.samples.inertia(D), scheduled) for D in (self.low, self.high))
        return low[:, 0], high[:, -1]

    def _distal_gaps(self) -> list[np.ndarray]:
        D = self.samples.distal
        return [np.linalg.eigvalsh(gap)[:, 0] for gap in (D - self.low, self.high - D)]

    def _add_violated(self) -> None:
        """Add to the program the samples that violate its constraints most."""
        low, high = self._shares()
        self.near |= _lowest(low) | (_lowest(1.0 - high / self.kappa) if high is not low else frozenset())
        if self.far:
            gaps = self._distal_gaps()
            active = frozenset(k for k in self.far if min(gap[k] for gap in gaps) < _ACTIVE)
            self.far = active | _lowest(*gaps)

    def _floors(self) -> np.ndarray:
        """Return the smallest eigenvalue of M̂ in SI units at each of the B samples, (B,)."""
        scheduled = self.scheduled() / (self.row[:, np.newaxis] * self.row)
        return np.asarray(np.linalg.eigvalsh(scheduled)[:, 0])

    def _times_units(self, weights: np.ndarray) -> np.ndarray:
        """Return the derivatives (B, N n(n + 1)/2, n, n) of Σ_r h_r S_r with respect to the triangles of the S_r.

        `weights` (B, N) are the h_r at the B samples.
        """
        shape = len(weights), self.weights.shape[1] * len(self.units), self.size, self.size
        return np.asarray((weights[:, :, np.newaxis, np.newaxis, np.newaxis] * self.units).reshape(shape))

    def _floor_step(self, slopes: list[np.ndarray], rates: list[float], kappa: float) -> None:
        """Set the S_r that maximise σ, subject to σ I <= M̂, κ <= `kappa`, μ_k <= rates[k] at the program's samples.

        `slopes` are ∂h/∂q_k (B, N) [1/rad] of the rule weights h, for each kept angle q_k.
        """
        near = sorted(self.near)
        hat = self._times_units(self.weights[near])
        lowest, highest = (self.samples.inertia(D)[near] for D in (self.low, self.high))
        families = [
            (lowest, {"inertia": -hat}),
            (-highest, {"inertia": kappa * hat}),
            (np.zeros_like(lowest), {"inertia": hat, "floor": -np.diag(self.row**2)}),
        ]
        for slope, rate in zip(slopes, rates, strict=True):
            change = self._times_units(slope[near])
            families += [(np.zeros_like(lowest), {"inertia": 2.0 * rate * hat + sign * change}) for sign in (1.0, -1.0)]
        found = _minimise({"inertia": hat.shape[1], "floor": 1}, families, sign=-1.0)
        if found is not None:
            self.inertia = np.tensordot(found["inertia"].reshape(-1, len(self.units)), self.units, axes=1)

    def _step(self) -> float:
        """Solve the program at its samples, and adopt its S_r and, unless they are fixed, its D_low and D_high.

        Return -t, an estimate of the decrease of κ that is still possible; 0 if the solver has no answer.
        """
        near, far = sorted(self.near), sorted(self.far)
        distal = self.distal_units if far else self.distal_units[:0]
        hat = self._times_units(self.weights[near])
        before = np.tensordot(self.weights[near], self.inertia, axes=1)[:, np.newaxis]
        J = self.samples.twist[near]
        tail = np.swapaxes(J, -1, -2)[:, np.newaxis] @ distal @ J[:, np.newaxis]
        lowest = highest = self.samples.near[near]
        if not far:
            lowest, highest = (self.samples.inertia(D)[near] for D in (self.low, self.high))
        families = [
            (lowest, {"inertia": -hat, "low": tail}),
            (-highest, {"inertia": self.kappa * hat, "high": -tail, "t": before}),
        ]
        if far:
            D = self.samples.distal[far]
            families += [(D, {"low": -distal}), (-D, {"high": distal})]
        sizes = {"inertia": hat.shape[1], "low": len(distal), "high": len(distal), "t": 1}
        found = _minimise(sizes, families)
        if found is None:
            return 0.0
        self.inertia = np.tensordot(found["inertia"].reshape(-1, len(self.units)), self.units, axes=1)
        if far:
            self.low, self.high = (np.tensordot(found[name], distal, axes=1) for name in ("low", "high"))
        return -float(found["t"][0])


_UNSPLIT = 4  # most joints of a chain without a split
_FAR = 3  # most angles beyond the split
_SCREENED, _FINALISTS = 2, 4  # rounds for every candidate; number of candidates that are searched to the end
_BLENDS = 11  # schedules tried between one with fewer premises and the one with the smallest κ
_STEP = 1e-5  # rad, of central differences
_SLACK = 1e-3  # of D_low and D_high, in units of the mean of D


@dataclasses.dataclass(frozen=True)
class InertiaMetric:
    """Bounds on the inertia at the angles searched; the attributes mean the same as in `ScheduledController`.

    The controller's `kappa` and `rates` are larger and its `floor` is smaller, to be true at all angles.
    """

    premises: tuple[Premise, ...]  # the kept premises
    split: int  # a
    inertia: np.ndarray  # S_r, (N, n, n)
    distal_low: np.ndarray  # D_low
    distal_high: np.ndarray  # D_high
    kappa: float  # κ at the angles searched
    floor: float  # σ at these angles
    rates: np.ndarray  # μ_k at these angles, (premises,)


def fitted_metric(robot: Robot, premises: tuple[Premise, ...], *, alpha: float, count: int) -> InertiaMetric:
    """Return the metric found for premises and a decay rate α [1/s] from samples at `count` postures.

    The premises are added one by one; none of them raises κ or (3κ - 2)(α + μ) at the samples.
    """
    n = split = len(robot)
    if n > _UNSPLIT:  # two or three angles from the end, with no kept angle beyond
        split = max([min(n - 2, _UNSPLIT), n - _FAR, *(premise.joint + 1 for premise in premises)])
    search = _searched(robot, premises, alpha, split, count)
    search.raise_floor(_slopes(premises, search.samples.q))
    inertia, low, high, unit = search.found()
    ranges = angle_ranges(robot)
    near = ranges[1:split]
    rotors = exact(np.diag(robot.drive("motor_inertia")))
    if split < n:
        distal, scale = TrigMatrix(inertia_polynomial(robot, split, n)), 1.0 / np.sqrt(np.diag(unit))

        def gap(bound: np.ndarray, sign: float) -> float:
            """Return the least eigenvalue of `sign` (D - `bound`) relative to `unit` over all angles; 0 if positive."""

            def least(q: np.ndarray) -> np.ndarray:
                scaled = sign * (distal.at(q) - bound) * scale[:, np.newaxis] * scale
                return np.asarray(np.linalg.eigvalsh(scaled)[:, 0])

            return min(_smallest_value(least, ranges[split:]), 0.0)

        low, high = low + (gap(low, 1.0) - _SLACK) * unit, high - (gap(high, -1.0) - _SLACK) * unit
    lowest, highest = (
        TrigMatrix(plus(inertia_polynomial(robot, 0, split, exact(tail) if split < n else None), rotors))
        for tail in ((low, high) if split < n else (low, low))
    )
    scheduled = TrigMatrix(scheduled_polynomial(premises, inertia, split))
    share = _smallest_value(lambda q: relative(lowest.at(q), scheduled.at(q))[:, 0], near)
    kappa = -_smallest_value(lambda q: -relative(highest.at(q), scheduled.at(q))[:, -1], near)
    floor = _smallest_value(lambda q: np.linalg.eigvalsh(scheduled.at(q))[:, 0], near)
    rates = [
        -0.5 * _smallest_value(lambda q, s=slope: -np.abs(relative(s.at(q), scheduled.at(q))).max(axis=1), near)  # type: ignore[misc]
        for slope in (scheduled.derivative(premise.joint - 1) for premise in premises)
    ]
    return InertiaMetric(premises, split, share * inertia, low, high, kappa / share, share * floor, np.array(rates))


def best_premise(robot: Robot, kept: tuple[Premise, ...], *, alpha: float, count: int) -> Premise:
    """Return the premise to add to the kept ones that gives the smallest (3κ - 2)(α + μ) [1/s].

    Its joint has no kept premise. `alpha` is α [1/s]; the search uses samples at `count` postures.
    """
    left = sorted({*range(1, len(robot))} - {premise.joint for premise in kept})
    candidates = [Premise(joint, function) for joint in left for function in FUNCTIONS]
    search = _searched(robot, kept, alpha, len(robot), count)

    def ranked(among: Sequence[Premise], rounds: int) -> list[Premise]:
        return sorted(among, key=lambda candidate: _with_premise(search, robot, (*kept, candidate), alpha, rounds)[1])

    return ranked(ranked(candidates, _SCREENED)[:_FINALISTS], _ROUNDS)[0]


def _searched(robot: Robot, premises: tuple[Premise, ...], alpha: float, split: int, count: int) -> _Search:
    """Return the finished search with these premises, added one by one, on `_Samples.of(robot, split, count)`."""
    search = _Search(_Samples.of(robot, split, count))
    search.run()
    for number in range(1, len(premises) + 1):
        search, _ = _with_premise(search, robot, premises[:number], alpha)
        search.far = frozenset()  # D_low and D_high stay: they are fitted to the first premise, which changes most
    return search


def _with_premise(
    search: _Search, robot: Robot, premises: tuple[Premise, ...], alpha: float, rounds: int = _ROUNDS
) -> tuple[_Search, float]:
    """Return a search with the last of `premises` added, and its (3κ - 2)(α + μ) [1/s] at the samples.

    The M̂ with the smallest κ may have a large μ. On the line from the previous M̂ to it, κ never exceeds its previous
    value; the M̂ on this line with the smallest product is chosen, and the product is no larger than before.
    """
    q = search.samples.q
    before = copy.copy(search)
    before.schedule(rule_weights(premises, q))
    after = copy.copy(before)
    after.run(rounds)
    slopes, speeds = _slopes(premises, q), speeds_of(robot, premises)

    def pole(found: _Search) -> float:
        rates = [found.rate(slope) for slope in slopes]
        return smallest_pole(found.kappa, alpha + float(np.dot(rates, speeds)))

    tried = [before.blended(after, share) for share in np.linspace(0.0, 1.0, _BLENDS).tolist()]
    poles = [pole(found) for found in tried]
    best = int(np.argmin(poles))
    return tried[best], poles[best]


def _slopes(premises: tuple[Premise, ...], q: np.ndarray) -> list[np.ndarray]:
    """Return ∂h/∂q_k (B, 2^premises) [1/rad] of the rule weights h, for each premise's angle q_k, at q (B, n)."""
    steps = [_STEP * np.eye(q.shape[-1])[premise.joint] for premise in premises]
    return [(rule_weights(premises, q + step) - rule_weights(premises, q - step)) / (2.0 * _STEP) for step in steps]
