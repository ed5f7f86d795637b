"""Trajectories of the rigid loop, with the integrals that its certificate bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.scenario.reference import ReferenceSample
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.fuzzy_policy.states import POSITION, VELOCITY

__all__ = ["STEP", "Disturbance", "Motion", "Run", "simulate"]

STEP = 5e-4  # [s]; the fastest poles of the shipped loops lie near -250 rad/s
FLOOR = 1e-20  # share of V(0) below which a rate of decay is not read: there rounding shows
INTEGRALS = 3  # of zᵀz, wᵀw and V, integrated along with the error

Disturbance = Callable[[np.ndarray], np.ndarray]
"""Times (k,) [s] to torques (k, lanes or 1, 2) [N m]; smooth, or with kinks at multiples of the step only."""


class Motion(Protocol):
    """A reference: `JointReference`, a held posture, ..."""

    def sample(self, t: np.ndarray) -> ReferenceSample:
        """Return angles, velocities, accelerations, (k, 2) or (k, lanes, 2) each, at times t (k,) [s]."""


@dataclasses.dataclass(frozen=True)
class Run:
    """Trajectories at times t (k,) [s]: errors ē (k, lanes, n_e), and (k, lanes) for all else.

    Attributes:
        V: Lyapunov function.
        output: ∫ zᵀz dt [rad² s].
        input: ∫ wᵀw dt [N² m² s].
        dissipation: V - V(0) + ∫ (zᵀz - γ² wᵀw + 2αV) dt, at most zero if the claim holds.
        in_box: whether q and q̇ have been in the box (25) up to here.
    """

    t: np.ndarray
    error: np.ndarray
    V: np.ndarray
    output: np.ndarray
    input: np.ndarray
    dissipation: np.ndarray
    in_box: np.ndarray

    @property
    def gain(self) -> np.ndarray:
        """‖z‖₂/‖w‖₂ [rad/(N m)] up to each instant, (k, lanes), 0 where w was zero; a gain only from zero error."""
        squared = np.divide(self.output, self.input, out=np.zeros_like(self.input), where=self.input > 0.0)
        return np.asarray(np.sqrt(squared))

    @property
    def rate(self) -> np.ndarray:
        """-d ln V / 2dt [1/s] over each step, (k - 1, lanes); inf out of the box and below `FLOOR`."""
        readable = self.in_box[1:] & (self.V[1:] > FLOOR * self.V[0])
        ratio = np.divide(self.V[:-1], self.V[1:], out=np.full_like(self.V[1:], np.inf), where=readable)
        return np.asarray(np.log(ratio) / (2.0 * np.diff(self.t)[:, np.newaxis]))


def simulate(
    loop: RigidLoop,
    motion: Motion,
    start: np.ndarray,
    disturbance: Disturbance,
    duration: float,
    *,
    total: bool = True,
    step: float = STEP,
) -> Run:
    """Integrate ē and the integrals of `Run` by the classical Runge-Kutta method of order 4 with fixed steps.

    The unknown is the error, not the angle: an error of 1e-12 rad decays as accurately as one of 0.1 rad.

    Args:
        loop: arm and controller.
        motion: the reference, twice differentiable.
        start: ē at t = 0, (lanes, n_e).
        disturbance: torque over time, w or d as `total` says, see `RigidLoop.error_rate`.
        duration: [s], rounded to whole steps.
        total: whether the disturbance is w of the certificate.
        step: [s].
    """
    steps, n = round(duration / step), loop.states
    half = 0.5 * step * np.arange(2 * steps + 1)
    targets, torques = motion.sample(half), disturbance(half)

    def rate(k: int, y: np.ndarray) -> np.ndarray:
        error = y[:, :n]
        change, w = loop.error_rate(error, ReferenceSample(*(part[k] for part in targets)), torques[k], total=total)
        integrands = [np.sum(error[:, POSITION] ** 2, axis=1), np.sum(w**2, axis=1), loop.lyapunov(error)]
        return np.column_stack([change, *integrands])

    path = np.zeros((steps + 1, len(start), n + INTEGRALS))
    path[0, :, :n] = start
    for k in range(steps):
        y = path[k]
        k1 = rate(2 * k, y)
        k2 = rate(2 * k + 1, y + 0.5 * step * k1)
        k3 = rate(2 * k + 1, y + 0.5 * step * k2)
        k4 = rate(2 * k + 2, y + step * k3)
        path[k + 1] = y + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return _evaluate(loop, half[::2], ReferenceSample(*(part[::2] for part in targets)), path)


def _evaluate(loop: RigidLoop, t: np.ndarray, targets: ReferenceSample, path: np.ndarray) -> Run:
    controller, n = loop.controller, loop.states
    error, (output, taken, stored) = path[..., :n], np.moveaxis(path[..., n:], -1, 0)
    V, limits = loop.lyapunov(error), controller.model.parameters
    supply = output - controller.gamma**2 * taken + 2.0 * controller.alpha * stored
    q, dq = (part.reshape(len(t), -1, JOINTS) for part in targets[:2])
    inside = (np.abs(q + error[..., POSITION]) <= limits.joint_limit) & (
        np.abs(dq + error[..., VELOCITY]) <= limits.velocity_limit
    )
    in_box = np.logical_and.accumulate(inside.all(axis=-1), axis=0)
    return Run(t, error, V, output, taken, V - V[0] + supply, in_box)
