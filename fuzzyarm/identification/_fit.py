"""Output error of the elastic arm: θ that brings the simulated motors closest to the logged ones, with intervals.

The residuals are weighted by the noise of each measured quantity, estimated from the log's fourth
differences at first, then from the residuals of each fit. With white noise the estimate is normal with covariance

    cov θ = s² (Jᵀ J)⁻¹,    s² = |r|² / (rows - states - |θ|)

A few segments whose initial state is not found, because a joint sticks, are left out of the last search. A parameter
counts as determined if the half width of its 95 % interval is at most its value. The one with the widest interval is
fixed at the value of the start, and the others are fitted again, until all are determined.

By multiple shooting each segment of the log is simulated from its own initial state under the logged torques:

    r(θ, x) = (measured - simulated) / σ,    x the states at the beginnings of the segments

The links are not measured, and a simulation without feedback diverges from an arm held against gravity within a second;
over short segments the two stay close. The states are eliminated (variable projection): for each θ a few Gauss-Newton
steps find the best x of each segment, and the derivative of the remaining residual with respect to θ is that of r,
projected onto the complement of the derivatives with respect to x (Kaufman's approximation). Derivatives are
differences of simulations, which run as lanes of one batch. The plant is that of the environment: elastic joints, exact
stick, torques held between samples.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from fuzzyarm.envs.fastest_mode import fastest_rate
from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Arm, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import two_joints
from fuzzyarm.envs.physics.integrator import force_line, hold_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import filled, size
from fuzzyarm.identification._rigid import UNKNOWNS, bounds_of, constants_of, start_of
from fuzzyarm.identification.log import Log, Motion

__all__ = ["DEVIATIONS", "Fit", "fit_elastic"]

_STATES = 8
_MEASURED = np.array([0, 1, 4, 5])  # motor angles and velocities in a state
_SMALL_TURN = 1e-6  # of a scale, for differences
_REACH = np.array([0.05] * 4 + [1.0] * 4)[:, np.newaxis]  # rad and rad/s that a state may be from its first guess
_PASSES = 40
_LEAST = 1e-6  # damping beside slopes of 10³ and more
_LOST = 1e9  # residual of a simulation that has run away
_GOOD = 1e-7  # decrease of the cost, as a share of it, at which the states count as found


@dataclasses.dataclass(eq=False)
class _Shooting:
    """The segments of a log; the search for their initial states begins at those of the last linearisation."""

    measured: np.ndarray  # angles [rad] and, if there are any, velocities [rad/s] of the motors, (steps + 1, 2 or 4, S)
    torque: np.ndarray  # held from an instant to the next [N m], (steps, 2, S)
    period: float  # between two instants [s]
    states: np.ndarray  # first guesses of the states at the beginnings, (8, S); kept at the best found so far
    noise: np.ndarray  # σ of each measured quantity, (2 or 4,)
    constants: Callable[[np.ndarray], np.ndarray]  # returns those of the arm, (21, lanes), for θ (|θ|, lanes)
    rate: float  # the fastest of the arm [rad/s], which limits the sub-step, see `fastest_mode`

    def __post_init__(self) -> None:
        self.kept = self.states
        self._hold, self.count = hold_of(two_joints()), len(self.states.T)
        self._substeps = default_substeps(self.period, self.rate)

    def linearised(self, theta: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (rows, S) and their derivatives (rows, |θ|, S) with respect to θ (|θ|,), states eliminated.

        Neither has a unit: θ is in units of `scale` (|θ|,).
        """
        residual, over_states = self.eliminated(theta)
        self.kept, steps = self.states, _DIFFERENCE * scale
        moved = theta[:, np.newaxis] + np.diag(steps)
        lanes, every = np.tile(self.states, (1, len(theta))), np.arange(self.count)
        ahead = self._simulated(np.repeat(moved, self.count, axis=1), lanes, every)
        ahead = ahead.reshape(len(residual), len(theta), self.count)
        over_theta = (ahead - residual[:, np.newaxis]) / steps[:, np.newaxis]
        normal, slope = _normal(over_states, np.full(self.count, _LEAST))
        shared = np.linalg.solve(normal, np.einsum("rks,rps->skp", slope, over_theta))
        return residual, (over_theta - np.einsum("rks,skp->rps", slope, shared)) * scale[:, np.newaxis]

    def eliminated(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (rows, S) and their derivatives over the states (rows, 8, S) at the best states; keep these.

        Levenberg's method runs separately in each segment: a step that raises the cost is rejected, and the next is
        shorter.
        """
        states, damping, open_ = self.kept.copy(), np.ones(self.count), np.arange(self.count)
        residual, over_states = self._over_states(theta, states, open_)
        for _ in range(_PASSES):
            cost = np.sum(residual[:, open_] ** 2, axis=0)
            normal, slope = _normal(over_states[..., open_], damping[open_])
            gain = np.einsum("rks,rs->sk", slope, residual[:, open_])
            step = np.linalg.solve(normal, gain[..., np.newaxis])[..., 0]
            far = np.sum(step * gain, axis=1) > _GOOD * cost
            open_, cost, step = open_[far], cost[far], step[far]
            if not open_.size:
                break
            moved = states[:, open_] - _REACH * step.T
            ahead, slopes = self._over_states(theta, moved, open_)
            better = np.sum(ahead**2, axis=0) < cost
            damping[open_] *= np.where(better, 0.1, 30.0)
            won = open_[better]
            states[:, won], residual[:, won], over_states[..., won] = (
                part[..., better] for part in (moved, ahead, slopes)
            )
        self.states = states
        return residual, over_states

    def _over_states(self, theta: np.ndarray, states: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (rows, C) and derivatives over the states (rows, 8, C) for C chosen segments."""
        count, steps = len(chosen), _SMALL_TURN * _REACH
        lanes = np.tile(states, (1, _STATES + 1))
        for k in range(_STATES):
            lanes[k, (k + 1) * count : (k + 2) * count] += steps[k]
        found = self._simulated(np.repeat(theta[:, np.newaxis], lanes.shape[1], axis=1), lanes, chosen)
        found = found.reshape(len(found), _STATES + 1, count)
        residual = found[:, 0]
        return residual, (found[:, 1:] - residual[:, np.newaxis]) / steps

    def _simulated(self, theta: np.ndarray, states: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return residuals (rows, lanes) for θ (|θ|, lanes) and states (8, lanes).

        The lanes go through the chosen segments (C,), once or several times.
        """
        copies, channels = states.shape[1] // len(chosen), self.measured.shape[1]
        constants, lanes = np.ascontiguousarray(self.constants(theta)), np.array(states, order="C")
        force = np.zeros((size(force_line(two_joints().axes)), lanes.shape[1]))
        torque = np.ascontiguousarray(np.tile(self.torque[..., chosen], (1, 1, copies)))
        found = np.empty((len(self.measured), channels, lanes.shape[1]))
        h = self.period / self._substeps
        for k in range(len(found)):
            found[k] = lanes[_MEASURED[:channels]]
            if k < len(torque):
                self._hold(lanes, torque[k], force, constants, h, self._substeps)
        found -= np.tile(self.measured[..., chosen], (1, 1, copies))
        found /= self.noise[:, np.newaxis]
        flat = found.reshape(-1, lanes.shape[1])
        return flat if np.isfinite(flat).all() else np.nan_to_num(flat, nan=_LOST, posinf=_LOST, neginf=-_LOST)


def _normal(over_states: np.ndarray, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return damped normal matrices (S, 8, 8) of the states in units of `_REACH`, and the slopes behind them."""
    slope = over_states * _REACH
    return np.einsum("rks,rls->skl", slope, slope) + damping[:, np.newaxis, np.newaxis] * np.eye(_STATES), slope


def _segments_of(log: Log, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return instants of the beginnings (S,), measurements (steps + 1, 2 or 4, S) and torques (steps, 2, S).

    The segments have a length [s] and follow one another; samples after the last whole segment are not used.
    """
    samples = max(round(length / log.period), 20)
    beginnings = np.arange(0, len(log.angle) - samples + 1, samples)
    rows = beginnings + np.arange(samples)[:, np.newaxis]
    measured = np.ascontiguousarray(log.measured[rows].transpose(0, 2, 1))
    return beginnings, measured, log.torque[rows[:-1]].transpose(0, 2, 1)


def _starts_of(motion: Motion, beginnings: np.ndarray, arm: Arm) -> np.ndarray:
    """Return first guesses of the states (8, S) [rad, rad/s]: the smooth motion, with joints bent by its torque."""
    load = rigid_inverse_dynamics(motion.q, motion.dq, motion.ddq, arm)
    bending = load / np.array([arm.stiffness1, arm.stiffness2])
    parts = motion.q, motion.q - bending, motion.dq, motion.dq
    return np.concatenate([part[beginnings].T for part in parts])


DEVIATIONS = 1.959963984540054  # half width of a 95 % interval in standard deviations
# Lengths of the segments [s], one search after the other. Short ones stay with the log wherever the search begins. Long
# ones have fewer states to find, which narrows the intervals and removes a bias: encoder noise reaches the torques
# through the controller, so that the errors of a segment's state and the slopes after it are correlated.
_SEGMENTS = (0.1, 0.4, 0.8, 0.8)
_DIFFERENCE = 1e-5  # of the scale of a parameter
_MOST_STEPS = 40
_WORSE, _MOST_LOST = 6.0, 0.1  # standard deviations; share of all
_NOTHING = 1e-100  # a singular value of 0
_CLOSE = 1e-7
_FOURTH = 70.0  # sum of squares of the coefficients 1, -4, 6, -4, 1
_MEDIAN = 0.6744897501960817  # of |x| for x normal
_LEAST_NOISE = 1e-9  # share of the range of a signal, for logs without noise


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """The estimate by output error."""

    theta: np.ndarray  # θ (17,), in the order of `UNKNOWNS`, each in its unit
    error: np.ndarray  # standard errors (17,); nan where θ is the start's
    determined: np.ndarray  # which entries of θ the log determines, (17,)
    at_bound: np.ndarray  # which entries lie at the end of their range, (17,)
    condition: float  # condition number of the information matrix of the determined entries, in units of the values
    noise: np.ndarray  # root mean square of the residual angles [rad] and velocities [rad/s], (2 or 4,)
    correlation: float  # of a residual with the one a sample later; near 0 if the model explains the log
    residual: np.ndarray  # measured less simulated, in its units, (samples, 2 or 4), segments one after the other


def _noise_of(log: Log) -> np.ndarray:
    """Return σ of the noise on angles [rad] and velocities [rad/s], shape (2 or 4,), from fourth differences."""
    values = log.measured
    rough = np.median(np.abs(np.diff(values, 4, axis=0)), axis=0) / (_MEDIAN * np.sqrt(_FOURTH))
    return np.asarray(np.maximum(rough, _LEAST_NOISE * np.maximum(np.ptp(values, axis=0), 1e-3)))


def fit_elastic(
    log: Log, motion: Motion, rough: ArmParameters, start: ArmParameters, progress: Callable[[], None] | None = None
) -> Fit:
    """Return the output-error estimate from a log and its smooth motion.

    The search begins at the arm `rough`; parameters that the log does not determine keep the values of `start`.
    `progress` is called after each step. ValueError: the log determines no parameter.
    """
    theta, known = start_of(rough), start_of(start)
    scale, noise = _scale(known, motion), _noise_of(log)
    constants = functools.partial(constants_of, arm=start)
    bounds = bounds_of(start, scale)
    determined = np.ones(len(theta), dtype=bool)
    lost, rate = None, fastest_rate([start])

    def whole(z: np.ndarray) -> np.ndarray:
        """Return θ with the determined entries replaced by z, which is in units of the scale."""
        full = theta.copy()
        full[determined] = z * scale[determined]
        return full

    def residual(z: np.ndarray) -> np.ndarray:
        return shooting.eliminated(whole(z))[0].ravel()

    def slope(z: np.ndarray) -> np.ndarray:
        if progress is not None:
            progress()
        return _stacked(shooting.linearised(whole(z), scale)[1], determined)

    for length in _SEGMENTS:
        theta = np.where(determined, np.clip(theta, *bounds), known)
        beginnings, measured, torque = _segments_of(log, length)
        if lost is not None and len(lost) == len(beginnings):
            beginnings, measured, torque = beginnings[~lost], measured[..., ~lost], torque[..., ~lost]
        states = _starts_of(motion, beginnings, filled(Arm, constants(theta[:, np.newaxis])[:, 0]))
        shooting = _Shooting(measured, torque, log.period, states, noise, constants, rate)
        determined[:] = True
        _leave_out(shooting.linearised(theta, scale)[1], theta, scale, determined, 1.0)
        while determined.any():
            theta = np.where(determined, theta, known)
            low, high = (bound[determined] / scale[determined] for bound in bounds)
            begin = np.clip(theta[determined] / scale[determined], low, high)
            found = least_squares(
                residual, begin, slope, bounds=(low, high), xtol=_CLOSE, ftol=_CLOSE, gtol=None, max_nfev=_MOST_STEPS
            )
            theta = whole(found.x)
            final, over = shooting.linearised(theta, scale)
            if not _leave_out(over, theta, scale, determined, _spread(final, determined)):
                break
        if not determined.any():
            raise ValueError(
                "the log determines no parameter: the simulated arm does not fit it; check units and signs"
            )
        lost = _lost(final)
        left = final.reshape(len(measured), measured.shape[1], -1) * noise[:, np.newaxis]
        noise = np.maximum(np.sqrt(np.mean(left**2, axis=(0, 2))), 1e-3 * noise)
    error, (relative, condition) = np.full(len(theta), np.nan), _errors(over, determined, _spread(final, determined))
    error[determined] = relative * scale[determined]
    (low, high), near, rms = bounds, 1e-6 * scale, np.sqrt(np.mean(left**2, axis=(0, 2)))
    scaled = left / rms[:, np.newaxis]
    return Fit(
        theta=theta,
        error=error,
        determined=determined,
        at_bound=determined & ((theta <= low + near) | (theta >= high - near)),
        condition=condition,
        noise=rms,
        correlation=float(np.mean(scaled[1:] * scaled[:-1])),
        residual=left.transpose(2, 0, 1).reshape(-1, left.shape[1]),
    )


def _lost(residual: np.ndarray) -> np.ndarray:
    """Return which segments (S,) fit far worse than the median: their initial states were found in a wrong stick phase.

    The sum of the squares of N residuals of white noise deviates by a share √(2/N). If segments are many and more than
    one, the equations are wrong rather than the states, and none counts as lost.
    """
    cost = np.sum(residual**2, axis=0)
    lost: np.ndarray = cost > (1.0 + _WORSE * math.sqrt(2.0 / len(residual))) * np.median(cost)
    return lost if np.sum(lost) <= max(_MOST_LOST * len(lost), 1.0) else np.zeros_like(lost)


def _stacked(over_theta: np.ndarray, determined: np.ndarray) -> np.ndarray:
    """Return the derivatives of all residuals over the determined entries of θ, (rows S, determined)."""
    over = over_theta[:, determined]
    return np.asarray(np.moveaxis(over, 1, -1).reshape(-1, over.shape[1]))


def _scale(start: np.ndarray, motion: Motion) -> np.ndarray:
    """Return the scale of each entry of θ: the value of the start; for friction at least a share of the torque."""
    torque, speed = np.sqrt(np.mean(motion.torque**2, axis=0)), np.sqrt(np.mean(motion.dq**2, axis=0))
    least = np.full(len(start), 1e-6)
    for k, one in enumerate(UNKNOWNS):
        if one.joint is not None and one.field in ("coulomb_friction", "static_friction"):
            least[k] = 0.02 * torque[one.joint]
        if one.joint is not None and one.field == "viscous_friction":
            least[k] = 0.02 * torque[one.joint] / max(speed[one.joint], 1e-6)
    scale: np.ndarray = np.maximum(np.abs(start), least)
    return scale


def _spread(residual: np.ndarray, determined: np.ndarray) -> float:
    """Return s², which is 1 if the model explains the log down to its noise."""
    free = residual.size - _STATES * residual.shape[1] - int(determined.sum())
    return float(np.sum(residual**2) / max(free, 1))


def _errors(over_theta: np.ndarray, determined: np.ndarray, spread: float) -> tuple[np.ndarray, float]:
    """Return standard errors of the determined entries of θ in units of the scale, and the condition number."""
    singular, turn = np.linalg.svd(_stacked(over_theta, determined), full_matrices=False)[1:]
    inverse = 1.0 / np.maximum(singular, max(1e-12 * float(singular[0]), _NOTHING))
    error: np.ndarray = np.sqrt(spread * np.sum((inverse[:, np.newaxis] * turn) ** 2, axis=0))
    return error, float(inverse[-1] / inverse[0])


def _leave_out(
    over_theta: np.ndarray, theta: np.ndarray, scale: np.ndarray, determined: np.ndarray, spread: float
) -> bool:
    """Clear the entries of `determined` whose 95 % interval is wider than the value, widest first; return if any."""
    before = int(determined.sum())
    while determined.any():
        error, _ = _errors(over_theta, determined, spread)
        width = DEVIATIONS * error * scale[determined] / np.maximum(np.abs(theta[determined]), scale[determined])
        if not float(width.max()) > 1.0:
            break
        determined[np.flatnonzero(determined)[int(np.argmax(width))]] = False
    return int(determined.sum()) < before
