"""The rigid arm in continuous time under a controller of the consistent form: the loop its certificate describes.

    (M_b(q) + I_a) q̈ + C(q, q̇) q̇ + f_v q̇ + g(q) = u + d,      u = K_hv e + H_hv x_I + L_hv r,      ẋ_I = q - q_d,

with continuous feedback and no torque limit. d holds all other torques on the joints: dry friction, tip forces, a
payload. Equation (5) and the feedforward make of this, for ē = (e, x_I) and without any approximation,

    Ē(z) ē' = (Ā(z) + B̄ K̄_hv) ē + B̄ w,      w = d + ρ,      ρ = [A(z) x_r - E(z) ẋ_r]_3:4 + L_hv r,

x_r = (q_d, q̇_d). ρ is the feedforward residual of the dropped premises, zero if none is. The certificate states for
this w

    V' + zᵀz - γ² wᵀw + 2αV < 0,      V = ēᵀ P⁻¹ ē,      z = q - q_d,      while q and q̇ stay in the box (25).

With its premises frozen at a state of the box, the loop is a linear system, and a search finds the worst one:

    ē' = F ē + G w,      F = Ē(z)⁻¹ (Ā(z) + B̄ K̄_hv),      G = Ē(z)⁻¹ B̄,      z from (q, q̇).

The certificate bounds each of these systems: every pole lies left of -α, V decays at α at least, and with s = jω - α

    ‖C (sI - F)⁻¹ G‖ <= γ  for every ω,     C ē = q - q_d;

without the shift by α the same norm is the L2 gain of the frozen loop, which is smaller.

Rollouts of the rigid loop carry the integrals that the certificate bounds. The slowest decay and the largest gain of
all rollouts stand beside the certified bounds; one of the disturbances is the worst torque that a search finds. The
report of an evaluation and ``benchmarks/certified_bounds.py`` use these functions with different time steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.dynamics import arm_constants, coriolis_torque, gravity_torque, mass_matrix
from fuzzyarm.envs.scenario.reference import ReferenceSample
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.states import INTEGRAL, PLANT, PLANT_STATES, POSITION, VELOCITY
from fuzzyarm.fuzzy_policy.ts_model import descriptor_terms, premises, rule_products

__all__ = [
    "Motion", "RigidLoop", "Run", "decay_rates", "disturbed_run", "gain_at", "library", "worst_posture",
    "worst_torque",
]  # fmt: skip


_LARGEST_FREQUENCY = 500.0  # [rad/s]; the gains fall beyond 100 rad/s
GENERATIONS, _POPULATION = 150, 16  # of the search; a second seed changes no result in the fourth digit


class _WorstPoint(NamedTuple):
    """Where in the box a `value` is largest: q [rad] and q̇ [rad/s] (2,), and the frequency ω [rad/s] if it has one."""

    value: float
    q: np.ndarray
    dq: np.ndarray
    omega: float


_STEP = 5e-4  # [s]; the fastest poles of the shipped loops lie near -250 rad/s
_FLOOR = 1e-20  # share of V(0) below which a rate of decay is not read: there rounding shows
_INTEGRALS = 3  # of zᵀz, wᵀw and V, integrated along with the error

_Disturbance = Callable[[np.ndarray], np.ndarray]  # times (k,) [s] to torques (k, lanes or 1, 2) [N m]


class Motion(Protocol):
    """A reference: `JointReference`, a held posture, ..."""

    def sample(self, t: np.ndarray) -> ReferenceSample:
        """Return angles, velocities, accelerations, (k, 2) or (k, lanes, 2) each, at times t (k,) [s]."""


@dataclasses.dataclass(frozen=True)
class Run:
    """Trajectories at times t (k,) [s]: errors ē (k, lanes, n_e), and (k, lanes) for all else."""

    t: np.ndarray
    error: np.ndarray
    V: np.ndarray  # Lyapunov function
    output: np.ndarray  # ∫ zᵀz dt [rad² s]
    input: np.ndarray  # ∫ wᵀw dt [N² m² s]
    dissipation: np.ndarray  # V - V(0) + ∫ (zᵀz - γ² wᵀw + 2αV) dt, at most zero if the claim holds
    in_box: np.ndarray  # whether q and q̇ have been in the box (25) up to here

    @property
    def gain(self) -> np.ndarray:
        """‖z‖₂/‖w‖₂ [rad/(N m)] up to each instant, (k, lanes), 0 where w was zero; a gain only from zero error."""
        squared = np.divide(self.output, self.input, out=np.zeros_like(self.input), where=self.input > 0.0)
        return np.asarray(np.sqrt(squared))

    @property
    def rate(self) -> np.ndarray:
        """-d ln V / 2dt [1/s] over each step, (k - 1, lanes); inf out of the box and below `_FLOOR`."""
        readable = self.in_box[1:] & (self.V[1:] > _FLOOR * self.V[0])
        ratio = np.divide(self.V[:-1], self.V[1:], out=np.full_like(self.V[1:], np.inf), where=readable)
        return np.asarray(np.log(ratio) / (2.0 * np.diff(self.t)[:, np.newaxis]))


class RigidLoop:
    """The closed loop of the module's docstring, for states in lanes."""

    def __init__(self, controller: Controller) -> None:
        """Take a controller of the consistent form."""
        if controller.form != "consistent":
            raise ValueError(f"a controller of the {controller.form} form; needed: the consistent form")
        self.controller, parameters = controller, controller.model.parameters
        self.states = int(controller.gains.shape[-1])  # n_e of ē: 6 with the integral, 4 without
        self.arm, self._terms = arm_constants(parameters), descriptor_terms(parameters)
        both = np.concatenate([controller.gains, controller.feedforward_gains], axis=-1)
        self._vertices = both.reshape(-1, JOINTS * both.shape[-1])  # [K̄_ik L_ik] as rows, i slow and k fast
        self._root = np.linalg.inv(np.linalg.cholesky(controller.P)).T  # S with S Sᵀ = P⁻¹

    def law(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return K̄_hv (lanes, 2, n_e) and L_hv (lanes, 2, 6), the convex sums at premises z (lanes, 5)."""
        model = self.controller.model
        low, high = model.bounds.T
        omega = np.clip((z - low) / (high - low), 0.0, 1.0)
        weights = rule_products((omega[:, index] for index in [*model.kept_in_E, *model.kept_in_A]), (len(z),))
        blended = (weights @ self._vertices).reshape(len(z), JOINTS, -1)
        return blended[..., : self.states], blended[..., self.states :]

    def descriptor(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return E(z) and A(z) of (5), (lanes, 4, 4) each, at premises z (lanes, 5)."""
        (E, E_slopes), (A, A_slopes) = self._terms["E"], self._terms["A"]
        return np.asarray(E + np.tensordot(z, E_slopes, axes=1)), np.asarray(A + np.tensordot(z, A_slopes, axes=1))

    def acceleration(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Return q̈ = (M_b + I_a)⁻¹ (τ - C q̇ - f_v q̇ - g) [rad/s²] for torques τ = u + d [N m], (lanes, 2) each."""
        arm, (dq1, dq2) = self.arm, dq.T
        m11, m12, m22 = mass_matrix(np.cos(q[:, 1]), arm)
        m11, m22 = m11 + arm.motor_inertia1, m22 + arm.motor_inertia2
        c1, c2 = coriolis_torque(np.sin(q[:, 1]), dq1, dq2, arm)
        g1, g2 = gravity_torque(np.sin(q[:, 0]), np.sin(q[:, 0] + q[:, 1]), arm)
        t1 = torque[:, 0] - c1 - arm.viscous1 * dq1 - g1
        t2 = torque[:, 1] - c2 - arm.viscous2 * dq2 - g2
        return np.asarray(np.stack([m22 * t1 - m12 * t2, m11 * t2 - m12 * t1] / (m11 * m22 - m12 * m12), axis=1))

    def error_rate(
        self, error: np.ndarray, target: ReferenceSample, torque: np.ndarray, *, total: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ē' (lanes, n_e) and w [N m] (lanes, 2) for errors ē (lanes, n_e) from a target, (2,) or (lanes, 2).

        `torque` is w itself if `total`, so that d = w - ρ acts on the arm; otherwise it is d, and w = d + ρ.
        """
        q, dq = target.q + error[:, POSITION], target.dq + error[:, VELOCITY]
        z = premises(q, dq, self.controller.model.parameters)
        gain, feedforward = self.law(z)
        r = np.concatenate([np.broadcast_to(part, q.shape) for part in target], axis=1)
        forward = (feedforward @ r[..., np.newaxis])[..., 0]
        E, A = self.descriptor(z)
        x_r, ddq_d = r[:, PLANT, np.newaxis], r[:, PLANT.stop :, np.newaxis]
        rho = (A[:, VELOCITY] @ x_r - E[:, VELOCITY, VELOCITY] @ ddq_d)[..., 0] + forward
        d, w = (torque - rho, np.broadcast_to(torque, q.shape)) if total else (torque, torque + rho)
        u = (gain @ error[..., np.newaxis])[..., 0] + forward
        rates = [error[:, VELOCITY], self.acceleration(q, dq, u + d) - target.ddq, error[:, POSITION]]
        return np.concatenate(rates[: self.states // JOINTS], axis=1), w

    def lyapunov(self, error: np.ndarray) -> np.ndarray:
        """Return V = ēᵀ P⁻¹ ē for errors (..., n_e)."""
        return np.asarray(np.sum((error @ self._root) ** 2, axis=-1))

    def frozen(self, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return F (lanes, n_e, n_e) and G (lanes, n_e, 2) at angles [rad] and velocities [rad/s] (lanes, 2)."""
        z = premises(q, dq, self.controller.model.parameters)
        (E, A), (gain, _), n = self.descriptor(z), self.law(z), self.states
        inverse = np.linalg.inv(E[:, VELOCITY, VELOCITY])
        F, G = np.zeros((len(z), n, n)), np.zeros((len(z), n, JOINTS))
        F[:, POSITION, VELOCITY] = np.eye(JOINTS)
        F[:, INTEGRAL, POSITION] = np.eye(n - PLANT_STATES, JOINTS)
        gain = gain.copy()
        gain[:, :, PLANT] += A[:, VELOCITY]
        F[:, VELOCITY], G[:, VELOCITY] = inverse @ gain, inverse
        return F, G

    def worst_point(self, objective: Callable[..., np.ndarray], *, moving: bool = True) -> _WorstPoint:
        """Return where `objective` is largest over the box (25) and ω in [0, 500] rad/s, by differential evolution.

        The objective maps F, G and ω of many lanes to a number for each lane. Without `moving` the arm is at rest.
        """
        limits = self.controller.model.parameters
        scale = np.array([*limits.joint_limit, *(float(moving) * np.array(limits.velocity_limit)), 1.0])

        def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            point = scale * x.T
            return point[:, POSITION], point[:, VELOCITY], _LARGEST_FREQUENCY * (0.5 + 0.5 * point[:, -1]) ** 2

        def loss(x: np.ndarray, /) -> Any:
            q, dq, omega = split(x)
            return -objective(*self.frozen(q, dq), omega)

        found = differential_evolution(
            loss, Bounds([-1.0] * len(scale), [1.0] * len(scale)), vectorized=True, updating="deferred", polish=False,
            rng=0, init="sobol", maxiter=GENERATIONS, popsize=_POPULATION, tol=0.0,
        )  # fmt: skip
        q, dq, omega = split(found.x[:, np.newaxis])
        return _WorstPoint(-float(found.fun), q[0], dq[0], float(omega[0]))

    def simulate(
        self,
        motion: Motion,
        start: np.ndarray,
        disturbance: _Disturbance,
        duration: float,
        *,
        total: bool = True,
        step: float = _STEP,
    ) -> Run:
        """Integrate ē and the integrals of `Run` by the classical Runge-Kutta method of order 4 with fixed steps [s].

        The unknown is the error, not the angle: an error of 1e-12 rad decays as accurately as one of 0.1 rad. The
        motion is twice differentiable and ē starts at `start` (lanes, n_e). The disturbance is w of the certificate if
        `total`, else d; it is smooth, or has kinks at steps only. The duration [s] is rounded to whole steps.
        """
        steps, n = round(duration / step), self.states
        half = 0.5 * step * np.arange(2 * steps + 1)
        targets, torques = motion.sample(half), disturbance(half)

        def rate(k: int, y: np.ndarray) -> np.ndarray:
            error = y[:, :n]
            change, w = self.error_rate(error, ReferenceSample(*(part[k] for part in targets)), torques[k], total=total)
            integrands = [np.sum(error[:, POSITION] ** 2, axis=1), np.sum(w**2, axis=1), self.lyapunov(error)]
            return np.column_stack([change, *integrands])

        path = np.zeros((steps + 1, len(start), n + _INTEGRALS))
        path[0, :, :n] = start
        for k in range(steps):
            y = path[k]
            k1 = rate(2 * k, y)
            k2 = rate(2 * k + 1, y + 0.5 * step * k1)
            k3 = rate(2 * k + 1, y + 0.5 * step * k2)
            k4 = rate(2 * k + 2, y + step * k3)
            path[k + 1] = y + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        controller, limits = self.controller, self.controller.model.parameters
        error, (output, taken, stored) = path[..., :n], np.moveaxis(path[..., n:], -1, 0)
        V, supply = self.lyapunov(error), output - controller.gamma**2 * taken + 2.0 * controller.alpha * stored
        q, dq = (part[::2].reshape(steps + 1, -1, JOINTS) for part in targets[:2])
        fast, far = np.abs(dq + error[..., VELOCITY]), np.abs(q + error[..., POSITION])
        inside = (far <= limits.joint_limit) & (fast <= limits.velocity_limit)
        in_box = np.logical_and.accumulate(inside.all(axis=-1), axis=0)
        return Run(half[::2], error, V, output, taken, V - V[0] + supply, in_box)


def _growth(F: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return the symmetric matrix (lanes, n_e, n_e) of V'/2V in S⁻¹ ē, for S Sᵀ = P."""
    scaled = np.linalg.solve(root, F @ root)
    return np.asarray(0.5 * (scaled + np.swapaxes(scaled, 1, 2)))


def _lyapunov_rate(F: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the smallest -V'/2V [1/s] over all errors (lanes,): the decay of V at its slowest instant."""
    return np.asarray(-np.linalg.eigvalsh(_growth(F, np.linalg.cholesky(P)))[:, -1])


def _slowest_error(F: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the error ē (lanes, n_e) [rad, rad/s, rad s], V = 1, at which V decays at `_lyapunov_rate`."""
    root = np.linalg.cholesky(P)
    return np.asarray(np.linalg.eigh(_growth(F, root))[1][:, :, -1] @ root.T)


def gain_at(F: np.ndarray, G: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return ‖C (sI - F)⁻¹ G‖ [rad/(N m)] (lanes,) at s (lanes,) [1/s]."""
    response = np.linalg.solve(s[:, np.newaxis, np.newaxis] * np.eye(F.shape[-1]) - F, G)[:, POSITION]
    return np.asarray(np.linalg.norm(response, ord=2, axis=(1, 2)))


_FREQUENCIES = (1.0, 3.0, 10.0, 20.0, 40.0, 60.0, 80.0, 120.0, 200.0, 400.0)  # [rad/s]
_WAYS = {"joint 1": (1.0, 0.0), "joint 2": (0.0, 1.0), "in phase": (0.7, 0.7), "antiphase": (0.7, -0.7)}
_PULSE = 0.02  # [s]
_HELD = 2e-3  # [s], one torque of the power iteration
_POWER_STEPS = 40  # of the power iteration; twice as many raise the gains by 0.5 % at most


class _Uniform(NamedTuple):
    """q_d = q + q̇ t: postures held, or passed at constant velocity; q [rad] and q̇ [rad/s] are (lanes, 2)."""

    q: np.ndarray
    dq: np.ndarray

    def sample(self, t: np.ndarray) -> ReferenceSample:
        """Return the motion (k, lanes, 2) at times t (k,) [s]."""
        q = self.q + t[:, np.newaxis, np.newaxis] * self.dq
        return ReferenceSample(q, np.broadcast_to(self.dq, q.shape), np.zeros(q.shape))


def library(duration: float, step: float = _STEP) -> dict[str, np.ndarray]:
    """Return torques (k, 2) [N m] of size 1 at the instants 0, step, ..., duration, for `disturbed_run`."""
    t, rng = np.arange(round(duration / step) + 1) * step, np.random.default_rng(0)
    shapes = {"step": np.ones_like(t), "pulse": (t <= _PULSE).astype(float)}
    shapes |= {f"sine {omega:g} rad/s": np.sin(omega * t) for omega in _FREQUENCIES}
    probes = {
        f"{name}, {way}": shape[:, np.newaxis] * np.array(direction)
        for name, shape in shapes.items()
        for way, direction in _WAYS.items()
    }
    return probes | {f"noise {k}": rng.normal(size=(len(t), JOINTS)) for k in range(4)}


def _joined(torques: np.ndarray, step: float = _STEP) -> _Disturbance:
    """Return the disturbance that joins torques (k, lanes, 2) [N m], `step` [s] apart, by straight lines."""

    def disturbance(t: np.ndarray) -> np.ndarray:
        place = np.clip(t / step, 0.0, len(torques) - 1.0)
        left = np.minimum(np.floor(place + 1e-9).astype(int), len(torques) - 2)
        share = (place - left)[:, np.newaxis, np.newaxis]
        return np.asarray((1.0 - share) * torques[left] + share * torques[left + 1])

    return disturbance


def worst_torque(
    loop: RigidLoop, motion: Motion, duration: float, *, stored: bool = False, step: float = _STEP
) -> np.ndarray:
    """Return the torque (k, 2) [N m], largest value 1, that small errors about a motion of one lane amplify most.

    About zero error the loop is linear, with the F(t), G(t) of `RigidLoop.frozen`. Power iteration finds the largest
    singular value of its map from w to the position error: forward through the loop, backward through its adjoint. The
    output is z or, if `stored`, all that the dissipation inequality counts, (z, √(2α) P^(-1/2) ē). The search holds
    each torque for `_HELD`; the returned torques are `step` [s] apart.
    """
    middles = _HELD * (np.arange(round(duration / _HELD)) + 0.5)
    move, push = _discrete(loop, motion, middles)
    n, controller = loop.states, loop.controller
    weight = np.diag(np.arange(n) < POSITION.stop).astype(float)
    if stored:
        weight += 2.0 * controller.alpha * np.linalg.inv(controller.P)
    torque, errors = np.random.default_rng(0).normal(size=(len(middles), JOINTS)), np.zeros((len(middles), n))
    for _ in range(_POWER_STEPS):
        e, costate = np.zeros(n), np.zeros(n)
        for k in range(len(middles)):
            errors[k] = e = move[k] @ e + push[k] @ torque[k]
        counted = errors @ weight
        for k in reversed(range(len(middles))):
            costate += counted[k]
            torque[k] = costate @ push[k]
            costate = costate @ move[k]
        torque /= np.abs(torque).max()
    t = step * np.arange(round(duration / step) + 1)
    return np.column_stack([np.interp(t, middles, joint) for joint in torque.T])


def _discrete(loop: RigidLoop, motion: Motion, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the maps of ē (k, n_e, n_e) and of a held w (k, n_e, 2) over `_HELD`, by the implicit midpoint rule."""
    target, n = motion.sample(middles), loop.states
    F, G = loop.frozen(target.q.reshape(-1, JOINTS), target.dq.reshape(-1, JOINTS))
    half, unit = 0.5 * _HELD * F, np.eye(n)
    maps = np.linalg.solve(unit - half, np.concatenate([unit + half, _HELD * G], axis=2))
    return maps[..., :n], maps[..., n:]


_LANES, _DECAY_DURATION = 200, 0.2  # number of undisturbed rollouts from random states, and their duration [s]
_SLOWEST_DURATION, SLOWEST_STEP = 0.02, 2e-5  # [s], of the rollout from where V decays slowest
_AMPLITUDE = 100.0  # [N m], of the largest disturbance torque
_UNDISTURBED = _joined(np.zeros((2, 1, 2)))


class _DecayRates(NamedTuple):
    """Smallest rates -V'/2V [1/s] without disturbance; the certificate claims that all are at least α."""

    random: float  # of rollouts from random states of the box
    slowest: float  # of a rollout from the state and error at which V decays slowest
    in_box: float  # of all states of the box and all errors, found by a search without a rollout

    @property
    def observed(self) -> float:
        """Smallest rate of all rollouts."""
        return min(self.random, self.slowest)


def decay_rates(loop: RigidLoop, step: float = _STEP) -> _DecayRates:
    """Return the smallest decay rates of V; `step` is that of the random rollouts [s]."""
    P = loop.controller.P
    worst = loop.worst_point(lambda F, G, omega: -_lyapunov_rate(F, P))
    # The rollout starts slightly inside the box, so that it does not leave the box at once.
    q, dq = 0.999 * worst.q[np.newaxis], 0.999 * worst.dq[np.newaxis]
    error = 1e-4 * _slowest_error(loop.frozen(q, dq)[0], P)
    motion = _Uniform(q - error[:, POSITION], dq - error[:, VELOCITY])
    slowest = loop.simulate(motion, error, _UNDISTURBED, _SLOWEST_DURATION, step=SLOWEST_STEP)
    return _DecayRates(_random_decay(loop, step), float(slowest.rate.min()), -worst.value)


def worst_posture(loop: RigidLoop) -> _Uniform:
    """Return the held posture with the largest frozen gain, slightly inside the box."""
    worst = loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega), moving=False)
    return _Uniform(0.98 * worst.q[np.newaxis], np.zeros((1, 2)))


def disturbed_run(
    loop: RigidLoop, motion: Motion, probes: Mapping[str, np.ndarray], duration: float, step: float = _STEP
) -> Run:
    """Return the rollouts [s] from zero error, one lane for each torque (k, 2) of size 1 by name, see `library`."""
    torques = _AMPLITUDE * np.stack(list(probes.values()), axis=1)
    at_rest = np.zeros((len(probes), loop.states))
    return loop.simulate(motion, at_rest, _joined(torques, step), duration, step=step)


def _random_decay(loop: RigidLoop, step: float) -> float:
    """Return the smallest rate of rollouts whose errors are spread like the ellipsoid V = 1 and then scaled."""
    P, arm, rng = loop.controller.P, loop.controller.model.parameters, np.random.default_rng(0)
    q, dq = (rng.uniform(-0.6, 0.6, (_LANES, 2)) * limit for limit in (arm.joint_limit, arm.velocity_limit))
    errors = rng.normal(size=(_LANES, loop.states)) @ np.linalg.cholesky(P).T
    largest_angle = rng.uniform(0.01, 0.3, _LANES)  # [rad]
    errors *= (largest_angle / np.abs(errors[:, POSITION]).max(axis=1))[:, np.newaxis]
    return float(loop.simulate(_Uniform(q, dq), errors, _UNDISTURBED, _DECAY_DURATION, step=step).rate.min())
