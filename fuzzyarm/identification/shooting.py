"""Multiple shooting: the log in segments, each simulated from a state of its own under the logged torques.

    r(θ, x) = (measured - simulated) / σ,    x the states at the beginnings of the segments

The links are not measured, and an arm held against gravity runs away from a simulation without feedback within a
second: short segments stay with it. Over θ the states are a nuisance, so they are eliminated (variable projection): for
each θ a few Gauss-Newton steps find the best x of each segment, and the derivative of what is left over θ is that of r,
without its part in the space of the states (Kaufman's approximation). Derivatives are differences of simulations, which
run as lanes of one batch. The plant is the project's own: elastic joints, exact stick, torques held between samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fuzzyarm.envs.periods import default_substeps
from fuzzyarm.envs.physics.dynamics import Arm, rigid_inverse_dynamics
from fuzzyarm.envs.physics.hold import force_line, hold_of
from fuzzyarm.envs.physics.records import size
from fuzzyarm.envs.physics.two_joints import two_joints
from fuzzyarm.identification.log import Log
from fuzzyarm.identification.motion import Motion

__all__ = ["Linearised", "Shooting", "segments_of", "starts_of"]

STATES = 8
_MEASURED = np.array([0, 1, 4, 5])  # motor angles and velocities in a state
_SMALL_TURN = 1e-6  # of a scale, for differences
_REACH = np.array([0.05] * 4 + [1.0] * 4)[:, np.newaxis]  # rad and rad/s that a state may be from its first guess
_PASSES = 40
_LEAST = 1e-6  # damping beside slopes of 10³ and more
_LOST = 1e9  # residual of a simulation that has run away
_GOOD = 1e-7  # decrease of the cost, as a share of it, at which the states count as found


class Linearised(NamedTuple):
    """Residuals of all segments without unit, shape (rows, S), and their derivatives over θ without the states.

    These have the shape (rows, |θ|, S).
    """

    residual: np.ndarray
    over_theta: np.ndarray


@dataclasses.dataclass(eq=False)
class Shooting:
    """The segments of a log.

    Attributes:
        measured: angles [rad] and, if there are any, velocities [rad/s] of the motors, shape (steps + 1, 2 or 4, S).
        torque: held from an instant to the next [N m], shape (steps, 2, S).
        period: between two instants [s].
        states: first guesses of the states at the beginnings, shape (8, S); kept at the best found so far.
        noise: σ of each measured quantity, shape (2 or 4,).
        constants: returns the constants of the arm, shape (20, lanes), for θ of shape (|θ|, lanes).
        rate: the fastest of the arm [rad/s], which limits the sub-step, see `fastest_mode`.
    """

    measured: np.ndarray
    torque: np.ndarray
    period: float
    states: np.ndarray
    noise: np.ndarray
    constants: Callable[[np.ndarray], np.ndarray]
    rate: float = 0.0

    def __post_init__(self) -> None:
        """Prepare the simulation; the search for states begins at those of the last linearisation."""
        self.kept = self.states
        self._hold = hold_of(two_joints())
        self._substeps = default_substeps(self.period, self.rate)

    @property
    def count(self) -> int:
        """Segments."""
        return len(self.states.T)

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Return the residuals (rows, S) at θ (|θ|,) and the best states, which are kept in `states`."""
        return self._eliminated(theta)[0]

    def linearised(self, theta: np.ndarray, steps: np.ndarray) -> Linearised:
        """Return the residuals and their derivatives over θ (|θ|,), by differences of the length of `steps` (|θ|,)."""
        residual, over_states = self._eliminated(theta)
        self.kept = self.states
        moved = theta[:, np.newaxis] + np.diag(steps)
        lanes, every = np.tile(self.states, (1, len(theta))), np.arange(self.count)
        ahead = self._simulated(np.repeat(moved, self.count, axis=1), lanes, every)
        ahead = ahead.reshape(len(residual), len(theta), self.count)
        over_theta = (ahead - residual[:, np.newaxis]) / steps[:, np.newaxis]
        normal, slope = _normal(over_states, np.full(self.count, _LEAST))
        shared = np.linalg.solve(normal, np.einsum("rks,rps->skp", slope, over_theta))
        return Linearised(residual, over_theta - np.einsum("rks,skp->rps", slope, shared))

    def _eliminated(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals (rows, S) and their derivatives over the states (rows, 8, S) at the best states.

        Levenberg's method in each segment for itself: a step that does not help is taken back, and the next is shorter.
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
        lanes = np.tile(states, (1, STATES + 1))
        for k in range(STATES):
            lanes[k, (k + 1) * count : (k + 2) * count] += steps[k]
        found = self._simulated(np.repeat(theta[:, np.newaxis], lanes.shape[1], axis=1), lanes, chosen)
        found = found.reshape(len(found), STATES + 1, count)
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
    return np.einsum("rks,rls->skl", slope, slope) + damping[:, np.newaxis, np.newaxis] * np.eye(STATES), slope


def segments_of(log: Log, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return instants of the beginnings (S,), measurements (steps + 1, 2 or 4, S) and torques (steps, 2, S).

    The segments have a length [s] and follow one another; what is left at the end is not used.
    """
    samples = max(round(length / log.period), 20)
    beginnings = np.arange(0, len(log.angle) - samples + 1, samples)
    parts = [log.angle] if log.velocity is None else [log.angle, log.velocity]
    rows = beginnings + np.arange(samples)[:, np.newaxis]
    measured = np.concatenate([part[rows] for part in parts], axis=-1).transpose(0, 2, 1)
    return beginnings, np.ascontiguousarray(measured), log.torque[rows[:-1]].transpose(0, 2, 1)


def starts_of(motion: Motion, beginnings: np.ndarray, arm: Arm) -> np.ndarray:
    """Return first guesses of the states (8, S) [rad, rad/s]: the smooth motion, links bent by the torque they need."""
    load = rigid_inverse_dynamics(motion.q, motion.dq, motion.ddq, arm)
    bending = load / np.array([arm.stiffness1, arm.stiffness2])
    parts = motion.q, motion.q - bending, motion.dq, motion.dq
    return np.concatenate([part[beginnings].T for part in parts])
