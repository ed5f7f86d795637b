"""Output-error method: the parameters and the initial states for which simulated windows come closest to the logs.

    Σ_w ρ(|r_w(z, x_w)|² / s² + |(x_w - x̂_w) / σ_x|²) + |(z - ẑ) / σ_z|²,    r = simulated - measured

is minimised over the parameters z and the initial state x_w of each window w. x̂_w is the state from the filtered log,
ẑ are the parameters of the starting arm, σ_x and σ_z are assumed standard deviations, and s is the median of the
windows' rms residuals. Cauchy's function ρ gives little weight to windows that no arm explains. Each Gauss-Newton
step changes parameters and states together: states are eliminated from the normal equations (Schur complement), with
Levenberg-Marquardt damping. Derivatives are finite differences.

Different logs are independent; neighbouring samples are not. With the Hessian H of the cost and the gradient g_l of the
part of each of L logs, the sandwich estimator of the covariance is

    cov z = H⁻¹ (Σ_l g_l g_lᵀ) H⁻¹ L / (L - 1)

and the estimate has Student's distribution with L - 1 degrees of freedom. A single log gives no covariance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.stats import t as student

from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.identification._simulation import Simulator, Windows, simulated

__all__ = ["Fit", "Search", "fitted"]

_DIFFERENCE = 1e-4  # step of the finite differences, in scales of a parameter
_CAUCHY = 3.0  # scale of Cauchy's function, in medians of the windows' costs
_TRIES = 8  # largest number of attempts at a step, each with ten times the damping of the one before
_LEAST_DAMPING = 1e-6
_SMALL = 1e-9  # distance from a bound, in scales, below which a parameter counts as being at the bound
_TOLD = 0.1  # largest standard deviation of a parameter that the logs determine, in scales
_LEVEL = 0.975  # level of the quantile for a 95 % interval


@dataclasses.dataclass(frozen=True, eq=False)
class Search:
    """P unknowns z, and the map from z to the arm's parameters θ (17,): θ = T z + t, with some rows exponentiated."""

    names: tuple[str, ...]  # one for each unknown
    units: tuple[str, ...]
    matrix: np.ndarray  # T, (17, P)
    fixed: np.ndarray  # t, (17,)
    logarithmic: np.ndarray  # which rows of T z + t are logarithms, (17,)
    start: np.ndarray  # ẑ, (P,)
    likely: np.ndarray  # σ_z, (P,); inf where the starting arm gives no information
    scale: np.ndarray  # what counts as a large change, (P,)
    low: np.ndarray  # bounds on z, (P,)
    high: np.ndarray

    @property
    def exponential(self) -> np.ndarray:
        """Mask (P,) of the unknowns that are logarithms."""
        return np.asarray(self.matrix[self.logarithmic].any(axis=0))

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Return the arm's parameters θ (17, lanes) for the unknowns z (P, lanes)."""
        linear: np.ndarray = self.matrix @ z + self.fixed[:, np.newaxis]
        linear[self.logarithmic] = np.exp(np.minimum(linear[self.logarithmic], 50.0))
        return linear

    def without(self, which: np.ndarray) -> Search:
        """Return the search in which the unknowns in the mask `which` (P,) are fixed at their values in `start`."""
        kept, fixed = np.flatnonzero(~which), self.fixed + self.matrix[:, which] @ self.start[which]
        parts: dict[str, Any] = {
            name: getattr(self, name)[kept] for name in ("start", "likely", "scale", "low", "high")
        }
        parts |= {name: tuple(getattr(self, name)[k] for k in kept) for name in ("names", "units")}
        return dataclasses.replace(self, matrix=self.matrix[:, kept], fixed=fixed, **parts)


@dataclasses.dataclass(eq=False)
class Fit:
    """The best values z that a search has found for its unknowns, with the data for their covariance."""

    search: Search
    z: np.ndarray  # (P,)
    states: list[np.ndarray]  # initial states for each `Windows` object, (n, S)
    hessian: np.ndarray  # H, (P, P), with the prior
    slopes: np.ndarray  # g_l of each log, (L, P)
    interrupted: bool = False

    @property
    def theta(self) -> np.ndarray:
        """Parameters θ (17,) of the arm that was found."""
        return self.search.theta(self.z[:, np.newaxis])[:, 0]

    def named(self) -> dict[str, float]:
        """Return the unknowns by name, not as logarithms, and the inertia of rotor 1 plus link 1 if both are free."""
        values = np.where(self.search.exponential, np.exp(np.minimum(self.z, 50.0)), self.z)
        found = dict(zip(self.search.names, values.tolist(), strict=True))
        parts = ("inertia[0]", "motor_inertia[0]")
        return {" + ".join(parts): sum(found[part] for part in parts)} | found if set(parts) <= set(found) else found

    def _free(self) -> np.ndarray:
        near = _SMALL * self.search.scale
        return (self.z > self.search.low + near) & (self.z < self.search.high - near)

    def told(self) -> np.ndarray:
        """Return the mask (P,) of unknowns at a bound, or determined by the logs to a small standard deviation."""
        deviation = np.sqrt(np.abs(np.diag(np.linalg.pinv(self.hessian, hermitian=True))))
        return np.asarray((deviation < _TOLD * self.search.scale) | ~self._free())

    def half_widths(self) -> np.ndarray | None:
        """Return half the widths of the 95 % intervals of z, (P,), nan at a bound; None if there is only one log."""
        logs, free = len(self.slopes), self._free()
        widths = np.full(len(self.z), np.nan)
        if logs < 2:
            return None
        inverse = np.linalg.pinv(self.hessian[np.ix_(free, free)], hermitian=True)
        slopes = self.slopes[:, free] @ inverse
        widths[free] = student.ppf(_LEVEL, logs - 1) * np.sqrt(np.sum(slopes**2, axis=0) * logs / (logs - 1))
        return widths


@dataclasses.dataclass(frozen=True, eq=False)
class _Step:
    """The normal equations for a step from given unknowns z, with the initial states of the windows eliminated."""

    hessian: np.ndarray  # (P, P), without the prior
    slope: np.ndarray  # gradient, (P,)
    by_log: np.ndarray  # the contribution of each log to `slope`, (L, P)
    back: list[tuple[np.ndarray, np.ndarray, np.ndarray]]  # H_xx⁻¹ (S, n, n), g_x (S, n) and H_zx (S, P, n)


class _Problem:
    """The residuals of the windows, simulated minus measured angles, and their derivatives."""

    def __init__(self, windows: Sequence[Windows], simulator: Simulator, search: Search, arm: ArmParameters) -> None:
        self.windows, self.simulator, self.search, self.arm = windows, simulator, search, arm
        theta = search.theta(search.start[:, np.newaxis])[:, 0]
        self.guess = [simulator.states(one, theta, arm) for one in windows]
        self.logs = sorted({one.log for one in windows})

    def residuals(self, z: np.ndarray, states: list[np.ndarray]) -> list[np.ndarray]:
        """Return an array of residuals (S, rows) [rad] for each `Windows` object, for z (P,) and initial `states`."""
        theta, found = self.search.theta(z[:, np.newaxis]), []
        for one, lanes in zip(self.windows, states, strict=True):
            angles = simulated(self.simulator, one, np.repeat(theta, len(one), axis=1), lanes, self.arm)
            found.append((angles - one.measured).reshape(-1, len(one)).T)
        return found

    def costs(self, residuals: list[np.ndarray], states: list[np.ndarray], s: float) -> np.ndarray:
        """Return the costs (windows,) of all logs' windows, given `residuals` [rad], `states` and scale s [rad]."""
        known = self.simulator.known[:, np.newaxis]
        parts = zip(residuals, states, self.guess, strict=True)
        return np.concatenate(
            [np.sum(r**2, axis=1) / s**2 + np.sum(((x - guess) / known) ** 2, axis=0) for r, x, guess in parts]
        )

    def linearised(
        self, z: np.ndarray, states: list[np.ndarray], residuals: list[np.ndarray], weights: np.ndarray, s: float
    ) -> _Step:
        """Return the normal equations at z and `states`, for the scale s [rad] and a weight for each window."""
        count, n, turn, known = len(z), len(self.simulator.known), self.simulator.turn, self.simulator.known
        steps = _DIFFERENCE * self.search.scale
        moved = np.concatenate([z[:, np.newaxis] + np.diag(steps), np.tile(z[:, np.newaxis], (1, n))], axis=1)
        theta = self.search.theta(moved)
        hessian, by_log, back, first = np.zeros((count, count)), np.zeros((len(self.logs), count)), [], 0
        for one, x, guess, r in zip(self.windows, states, self.guess, residuals, strict=True):
            lanes = np.tile(x[:, np.newaxis], (1, count + n, 1))
            lanes[range(n), range(count, count + n)] += turn[:, np.newaxis]
            lanes = lanes.reshape(n, -1)
            ahead = simulated(self.simulator, one, np.repeat(theta, len(one), axis=1), lanes, self.arm)
            ahead = ahead.reshape(*ahead.shape[:2], count + n, len(one)) - one.measured[:, :, np.newaxis]
            over = (ahead.reshape(-1, count + n, len(one)).transpose(2, 0, 1) - r[..., np.newaxis]) / s
            over_z, over_x, residual = over[..., :count] / steps, over[..., count:] / turn, r / s
            h_xx = over_x.transpose(0, 2, 1) @ over_x + np.diag(known**-2.0)
            g_x = np.einsum("srk,sr->sk", over_x, residual) + (x - guess).T / known**2
            h_zx, inverse = over_z.transpose(0, 2, 1) @ over_x, np.linalg.inv(h_xx)
            weight = weights[first : first + len(one)]
            reduced = over_z.transpose(0, 2, 1) @ over_z - h_zx @ inverse @ h_zx.transpose(0, 2, 1)
            slope = np.einsum("srp,sr->sp", over_z, residual) - np.einsum("spk,skl,sl->sp", h_zx, inverse, g_x)
            hessian += np.einsum("s,spq->pq", weight, reduced)
            by_log[self.logs.index(one.log)] += weight @ slope
            back.append((inverse, g_x, h_zx))
            first += len(one)
        return _Step(hessian, by_log.sum(axis=0), by_log, back)


def fitted(
    windows: Sequence[Windows],
    simulator: Simulator,
    search: Search,
    arm: ArmParameters,
    *,
    noise: float,
    steps: int,
    begin: np.ndarray | None = None,
    close: float = 1e-4,
    advance: Callable[[], None] = lambda: None,
) -> Fit:
    """Return the fit: the unknowns z of `search` that minimise the cost in the docstring of the module.

    `arm` contains the parameters that θ does not contain; `noise` is that of the angles [rad], a lower bound on s. The
    search begins at z = `begin` (default: `search.start`). It ends after `steps` Gauss-Newton steps, when the cost
    decreases by a share below `close`, or at a KeyboardInterrupt. `advance` is called after each step.
    """
    problem = _Problem(windows, simulator, search, arm)
    z, states = np.clip(search.start if begin is None else begin, search.low, search.high), problem.guess
    known, damping = search.likely**-2.0, 1e-3
    count = len(z)
    found = Fit(search, z, states, np.diag(known), np.zeros((len(problem.logs), count)))
    try:
        residuals, done = problem.residuals(z, states), False
        for k in range(steps + 1):
            spread = np.concatenate([np.sqrt(np.mean(r**2, axis=1)) for r in residuals])
            s = max(float(np.median(spread)), noise)
            costs = problem.costs(residuals, states, s)
            knee = _CAUCHY * float(np.median(costs))
            step = problem.linearised(z, states, residuals, 1.0 / (1.0 + costs / knee), s)
            hessian, slope = step.hessian + np.diag(known), step.slope + known * (z - search.start)
            found.hessian, found.slopes = hessian, step.by_log
            if done or k == steps:
                break
            total = _total(costs, knee, known, z - search.start)
            for _ in range(_TRIES):
                moved = _moved(z, hessian, slope, damping, search)
                ahead = [
                    x - np.einsum("skl,sl->ks", inverse, g_x + (moved - z) @ h_zx)
                    for x, (inverse, g_x, h_zx) in zip(states, step.back, strict=True)
                ]
                after = problem.residuals(moved, ahead)
                reached = _total(problem.costs(after, ahead, s), knee, known, moved - search.start)
                if reached < total:
                    break
                damping *= 10.0
            else:
                break
            z, states, residuals, damping = moved, ahead, after, max(0.1 * damping, _LEAST_DAMPING)
            found.z, found.states = z, states
            done = total - reached < close * total
            advance()
    except KeyboardInterrupt:
        found.interrupted = True
    return found


def _total(costs: np.ndarray, knee: float, known: np.ndarray, away: np.ndarray) -> float:
    """Return the sum of Cauchy's function, with the scale `knee`, over `costs`, plus Σ `known` · `away`².

    `away` (P,) is z - ẑ, and `known` (P,) is 1/σ_z².
    """
    return knee * float(np.sum(np.log1p(costs / knee))) + float(np.sum(known * away**2))


def _moved(z: np.ndarray, hessian: np.ndarray, slope: np.ndarray, damping: float, search: Search) -> np.ndarray:
    """Return z after a damped Newton step; an unknown at a bound stays there if the cost falls beyond the bound."""
    near = _SMALL * search.scale
    stuck = ((z <= search.low + near) & (slope > 0.0)) | ((z >= search.high - near) & (slope < 0.0))
    free, step = ~stuck, np.zeros(len(z))
    part = hessian[np.ix_(free, free)]
    part = part + np.diag(damping * np.diag(part) + 1e-300)
    step[free] = np.linalg.lstsq(part, -slope[free], rcond=None)[0]
    moved: np.ndarray = np.clip(z + step, search.low, search.high)
    return moved
