"""The rigid arm in continuous time under a controller of the consistent form: the loop its certificate speaks of.

    (M_b(q) + I_a) q̈ + C(q, q̇) q̇ + f_v q̇ + g(q) = u + d,      u = K_hv e + H_hv x_I + L_hv r,      ẋ_I = q - q_d,

with feedback at every instant and no torque limit. d holds whatever else turns the joints: dry friction, tip forces,
a payload. Equation (5) and the feedforward make of this, for ē = (e, x_I) and without any approximation,

    Ē(z) ē' = (Ā(z) + B̄ K̄_hv) ē + B̄ w,      w = d + ρ,      ρ = [A(z) x_r - E(z) ẋ_r]_3:4 + L_hv r,

x_r = (q_d, q̇_d). ρ is the feedforward residual of the dropped premises, zero if none is. The certificate says of this w

    V' + zᵀz - γ² wᵀw + 2αV < 0,      V = ēᵀ P⁻¹ ē,      z = q - q_d,      while q and q̇ stay in the box (25).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np

from fuzzyarm.envs.dynamics import Arm, arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.reference import ReferenceSample
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import descriptor_terms, premises

STEP = 5e-4  # [s]; the fastest poles of the shipped loops lie near -250 rad/s
FLOOR = 1e-20  # share of V(0) below which a rate of decay is not read: there rounding shows

Disturbance = Callable[[np.ndarray], np.ndarray]
"""Times (k,) [s] to torques (k, lanes or 1, 2) [N m]; smooth, or with kinks at multiples of the step only."""


class Motion(Protocol):
    """A reference: `JointReference`, a held posture, ..."""

    def sample(self, t: np.ndarray) -> ReferenceSample:
        """Return angles, velocities, accelerations, (k, 2) or (k, lanes, 2) each, at times t (k,) [s]."""


@dataclasses.dataclass(frozen=True)
class RigidLoop:
    """The closed loop of the module for states in lanes; the controller's law in plain NumPy."""

    controller: Controller

    def __post_init__(self) -> None:
        """Refuse the paper's form, whose V and residual are others."""
        if self.controller.form != "consistent":
            raise ValueError(f"a controller of the {self.controller.form} form; needed: the consistent form")

    @cached_property
    def arm(self) -> Arm:
        """The constants of (3)."""
        return arm_constants(self.controller.model.parameters)

    @property
    def states(self) -> int:
        """Size n_e of ē: 6 with the integral, 4 without."""
        return self.controller.gains.shape[-1]

    def law(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return K̄_hv (lanes, 2, n_e) and L_hv (lanes, 2, 6), the convex sums at premises z (lanes, 5)."""
        model = self.controller.model
        low, high = model.bounds.T
        omega = np.clip((z - low) / (high - low), 0.0, 1.0)
        weights = np.ones((len(z), 1))
        for index in [*model.kept_in_E, *model.kept_in_A]:  # the first one changes fastest, as in `TSModel`
            ratio = omega[:, index : index + 1]
            weights = np.concatenate([weights * (1.0 - ratio), weights * ratio], axis=1)
        blended = (weights @ self._vertices).reshape(len(z), 2, -1)
        return blended[..., : self.states], blended[..., self.states :]

    @cached_property
    def _vertices(self) -> np.ndarray:
        """[K̄_ik L_ik] as rows, i slow and k fast."""
        both = np.concatenate([self.controller.gains, self.controller.feedforward_gains], axis=-1)
        return both.reshape(-1, 2 * both.shape[-1])

    def descriptor(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return E(z) and A(z) of (5), (lanes, 4, 4) each, at premises z (lanes, 5)."""
        E, A = (base + np.tensordot(z, slopes, axes=1) for base, slopes in self._terms.values())
        return E, A

    @cached_property
    def _terms(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        return descriptor_terms(self.controller.model.parameters)

    def acceleration(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return q̈ = (M_b + I_a)⁻¹ (τ - C q̇ - f_v q̇ - g) [rad/s²] for torques τ = u + d [N m], (lanes, 2) each."""
        arm, (dq1, dq2) = self.arm, dq.T
        m11, m12, m22 = mass_matrix(np.cos(q[:, 1]), arm)
        m11, m22 = m11 + arm.motor_inertia1, m22 + arm.motor_inertia2
        c1, c2 = coriolis_torque(np.sin(q[:, 1]), dq1, dq2, arm)
        g1, g2 = gravity_torque(np.sin(q[:, 0]), np.sin(q[:, 0] + q[:, 1]), arm)
        t1 = torque[:, 0] - c1 - arm.viscous1 * dq1 - g1
        t2 = torque[:, 1] - c2 - arm.viscous2 * dq2 - g2
        return np.stack([m22 * t1 - m12 * t2, m11 * t2 - m12 * t1], axis=1) / (m11 * m22 - m12 * m12)[:, np.newaxis]

    def error_rate(
        self, error: np.ndarray, target: ReferenceSample, torque: np.ndarray, *, total: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ē' (lanes, n_e) and w [N m] (lanes, 2) for errors (lanes, n_e) from a target.

        Args:
            error: ē = (q - q_d, q̇ - q̇_d, x_I).
            target: q_d, q̇_d, q̈_d, (2,) or (lanes, 2).
            torque: w itself if `total`, so that d = w - ρ acts on the arm; otherwise d, and w = d + ρ.
            total: which of the two `torque` is.
        """
        q, dq = target.q + error[:, :2], target.dq + error[:, 2:4]
        z = premises(q, dq, self.controller.model.parameters)
        gain, feedforward = self.law(z)
        r = np.concatenate([np.broadcast_to(part, q.shape) for part in target], axis=1)
        forward = (feedforward @ r[..., np.newaxis])[..., 0]
        E, A = self.descriptor(z)
        rho = (A[:, 2:] @ r[:, :4, np.newaxis] - E[:, 2:, 2:] @ r[:, 4:, np.newaxis])[..., 0] + forward
        d, w = (torque - rho, np.broadcast_to(torque, q.shape)) if total else (torque, torque + rho)
        u = (gain @ error[..., np.newaxis])[..., 0] + forward
        rates = [error[:, 2:4], self.acceleration(q, dq, u + d) - target.ddq, error[:, :2]]
        return np.concatenate(rates[: self.states // 2], axis=1), w

    def lyapunov(self, error: np.ndarray) -> np.ndarray:
        """Return V = ēᵀ P⁻¹ ē for errors (..., n_e)."""
        return np.asarray(np.sum((error @ self._root) ** 2, axis=-1))

    @cached_property
    def _root(self) -> np.ndarray:
        """S with S Sᵀ = P⁻¹."""
        return np.linalg.inv(np.linalg.cholesky(self.controller.P)).T


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
        return np.sqrt(np.divide(self.output, self.input, out=np.zeros_like(self.input), where=self.input > 0.0))

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
        integrands = [np.sum(error[:, :2] ** 2, axis=1), np.sum(w**2, axis=1), loop.lyapunov(error)]
        return np.column_stack([change, *integrands])

    path = np.zeros((steps + 1, len(start), n + 3))
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
    q, dq = (part.reshape(len(t), -1, 2) for part in targets[:2])
    inside = (np.abs(q + error[..., :2]) <= limits.joint_limit) & (
        np.abs(dq + error[..., 2:4]) <= limits.velocity_limit
    )
    in_box = np.logical_and.accumulate(inside.all(axis=-1), axis=0)
    return Run(t, error, V, output, taken, V - V[0] + supply, in_box)
