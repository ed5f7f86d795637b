"""The loop that a certificate of the consistent form describes: the rigid arm in continuous time, simulated.

    (M_b(q) + I_a) q̈ + C(q, q̇) q̇ + f_v q̇ + g(q) = u + d,      u = K_hv e + H_hv x_I + L_hv r,      ẋ_I = q - q_d,

with continuous feedback and no torque limit. d holds all other torques on the joints. Equation (5) and the feedforward
make of this, for ē = (e, x_I) and without any approximation,

    ē' = F ē + G w,      F = Ē(z)⁻¹ (Ā(z) + B̄ K̄_hv),      G = Ē(z)⁻¹ B̄,      z from (q, q̇),      w = d + ρ,

where ρ is the feedforward residual of the dropped premises, zero if none is. The certificate states for this w

    V' + zᵀz - γ² wᵀw + 2αV < 0,      V = ēᵀ P⁻¹ ē,      z = q - q_d,      while q and q̇ stay in the box (25).

With F and G frozen at a state of the box, the loop is a linear system, whose poles lie left of -α, for which V decays
at α at least, and with ‖C (sI - F)⁻¹ G‖ <= γ for s = jω - α, C ē = q - q_d; without the shift by α the same norm is the
L2 gain of the frozen loop, which is smaller. A search finds the worst state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.scenario.reference import ReferenceSample
from fuzzyarm.fuzzy_policy.controller import Controller
from fuzzyarm.fuzzy_policy.ts_model import (
    INTEGRAL,
    PLANT,
    PLANT_STATES,
    POSITION,
    VELOCITY,
    _descriptor_terms,
    premises,
    rule_products,
)

GENERATIONS, POPULATION = 150, 16  # of the search; a second seed changes no result in the fourth digit
LARGEST_FREQUENCY = 500.0  # [rad/s]; the gains fall beyond 100 rad/s
STEP = 5e-4  # [s]; the fastest poles of the shipped loops lie near -250 rad/s
SLOWEST_STEP = 2e-5  # [s], of the rollout from where V decays slowest
FLOOR = 1e-20  # share of V(0) below which a rate of decay is not read: there rounding shows
HELD, POWER_STEPS = 2e-3, 40  # of the power iteration: how long it holds a torque [s]; twice the steps add 0.5 %
AMPLITUDE = 100.0  # [N m], of the largest disturbance torque
PULSE = 0.02  # [s]
FREQUENCIES = (1.0, 3.0, 10.0, 20.0, 40.0, 60.0, 80.0, 120.0, 200.0, 400.0)  # [rad/s]
WAYS = {"joint 1": (1.0, 0.0), "joint 2": (0.0, 1.0), "in phase": (0.7, 0.7), "antiphase": (0.7, -0.7)}


class Uniform(NamedTuple):
    """q_d = q + q̇ t: postures held, or passed at constant velocity; q [rad] and q̇ [rad/s] are (lanes, 2)."""

    q: np.ndarray
    dq: np.ndarray

    def sample(self, t: np.ndarray) -> ReferenceSample:
        """Return the motion (k, lanes, 2) at times t (k,) [s]."""
        q = self.q + t[:, np.newaxis, np.newaxis] * self.dq
        return ReferenceSample(q, np.broadcast_to(self.dq, q.shape), np.zeros(q.shape))


class Run(NamedTuple):
    """Trajectories at times t (k,) [s], (k, lanes) each."""

    t: np.ndarray
    V: np.ndarray  # Lyapunov function
    gain: np.ndarray  # ‖z‖₂/‖w‖₂ [rad/(N m)] so far, 0 where w was zero; a gain only from zero error
    input: np.ndarray  # ∫ wᵀw dt [N² m² s]
    dissipation: np.ndarray  # V - V(0) + ∫ (zᵀz - γ² wᵀw + 2αV) dt, at most zero if the claim holds
    in_box: np.ndarray  # whether q and q̇ have been in the box (25) so far

    @property
    def rate(self) -> np.ndarray:
        """-d ln V / 2dt [1/s] over each step, (k - 1, lanes); inf out of the box and below `FLOOR`."""
        readable = self.in_box[1:] & (self.V[1:] > FLOOR * self.V[0])
        ratio = np.divide(self.V[:-1], self.V[1:], out=np.full_like(self.V[1:], np.inf), where=readable)
        return np.asarray(np.log(ratio) / (2.0 * np.diff(self.t)[:, np.newaxis]))


class RigidLoop:
    """The closed loop of the module's docstring under a controller of the consistent form, for states in lanes."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.arm = controller, controller.model.parameters
        self.states = int(controller.gains.shape[-1])  # n_e of ē: 6 with the integral, 4 without
        self._terms = _descriptor_terms(self.arm)
        self._gains = controller.gains.reshape(-1, JOINTS * self.states)  # K̄_ik as rows, i slow and k fast
        self._root = np.linalg.inv(np.linalg.cholesky(controller.P)).T  # S with S Sᵀ = P⁻¹

    def frozen(self, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return F (lanes, n_e, n_e) and G (lanes, n_e, 2) at angles [rad] and velocities [rad/s] (lanes, 2)."""
        z, n, model = premises(q, dq, self.arm), self.states, self.controller.model
        E, A = ((base + np.tensordot(z, slopes, axes=1))[:, VELOCITY] for base, slopes in map(self._terms.get, "EA"))
        low, high = model.bounds.T
        omega = np.clip((z - low) / (high - low), 0.0, 1.0)
        weights = rule_products((omega[:, index] for index in [*model.kept_in_E, *model.kept_in_A]), (len(z),))
        acting = (weights @ self._gains).reshape(-1, JOINTS, n)
        acting[..., PLANT] += A
        inverse = np.linalg.inv(E[..., VELOCITY])
        F, G = np.zeros((len(z), n, n)), np.zeros((len(z), n, JOINTS))
        F[:, POSITION, VELOCITY] = np.eye(JOINTS)
        F[:, INTEGRAL, POSITION] = np.eye(n - PLANT_STATES, JOINTS)
        F[:, VELOCITY], G[:, VELOCITY] = inverse @ acting, inverse
        return F, G

    def worst_point(self, objective: Callable[..., np.ndarray], *, moving: bool = True) -> tuple[float, Uniform]:
        """Return the largest `objective` over the box (25) and ω in [0, 500] rad/s, and where it is attained.

        The objective maps F, G and ω of many lanes to a number for each lane. Without `moving` the arm is at rest.
        """
        scale = np.array([*self.arm.joint_limit, *(float(moving) * np.array(self.arm.velocity_limit)), 1.0])

        def loss(x: np.ndarray, /) -> Any:
            point = scale * x.T
            omega = LARGEST_FREQUENCY * (0.5 + 0.5 * point[:, -1]) ** 2
            return -objective(*self.frozen(point[:, POSITION], point[:, VELOCITY]), omega)

        found = differential_evolution(
            loss, Bounds([-1.0] * len(scale), [1.0] * len(scale)), vectorized=True, updating="deferred", polish=False,
            rng=0, init="sobol", maxiter=GENERATIONS, popsize=POPULATION, tol=0.0,
        )  # fmt: skip
        point = scale * found.x[np.newaxis]
        return -float(found.fun), Uniform(point[:, POSITION], point[:, VELOCITY])

    def simulate(
        self, motion: Any, start: np.ndarray, duration: float, step: float, torques: np.ndarray | None = None
    ) -> Run:
        """Integrate ē and the integrals of `Run` by the classical Runge-Kutta method of order 4 with fixed steps [s].

        The unknown is the error, not the angle: an error of 1e-12 rad decays as accurately as one of 0.1 rad. The
        motion, such as `JointReference` or `Uniform`, is twice differentiable; ē starts at `start` (lanes, n_e). w is
        zero, or joins `torques` (k, lanes, 2) [N m] at the ends of the steps by straight lines.
        """
        steps, n = round(duration / step), self.states
        half = 0.5 * step * np.arange(2 * steps + 1)
        target = motion.sample(half)
        ends = np.zeros((steps + 1, 1, JOINTS)) if torques is None else torques
        w = np.repeat(ends, 2, axis=0)[:-1]
        w[1::2] = 0.5 * (ends[:-1] + ends[1:])

        def rate(k: int, y: np.ndarray) -> np.ndarray:
            e = y[:, :n]
            F, G = self.frozen(target.q[k] + e[:, POSITION], target.dq[k] + e[:, VELOCITY])
            change = (F @ e[..., np.newaxis] + G @ w[k][..., np.newaxis])[..., 0]
            supplied = np.broadcast_to(np.sum(w[k] ** 2, axis=1), len(e))
            return np.column_stack([change, np.sum(e[:, POSITION] ** 2, axis=1), supplied, self._lyapunov(e)])

        path = np.zeros((steps + 1, len(start), n + 3))  # ē, then the integrals of zᵀz, wᵀw and V
        path[0, :, :n] = start
        for k in range(steps):
            y = path[k]
            k1 = rate(2 * k, y)
            k2 = rate(2 * k + 1, y + 0.5 * step * k1)
            k3 = rate(2 * k + 1, y + 0.5 * step * k2)
            k4 = rate(2 * k + 2, y + step * k3)
            path[k + 1] = y + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        e, (output, taken, stored) = path[..., :n], np.moveaxis(path[..., n:], -1, 0)
        q, dq = (part[::2].reshape(steps + 1, -1, JOINTS) for part in target[:2])
        far, fast = np.abs(q + e[..., POSITION]), np.abs(dq + e[..., VELOCITY])
        inside = ((far <= self.arm.joint_limit) & (fast <= self.arm.velocity_limit)).all(axis=-1)
        V, in_box = self._lyapunov(e), np.logical_and.accumulate(inside, axis=0)
        gain = np.sqrt(np.divide(output, taken, out=np.zeros_like(taken), where=taken > 0.0))
        supply = output - self.controller.gamma**2 * taken + 2.0 * self.controller.alpha * stored
        return Run(half[::2], V, gain, taken, V - V[0] + supply, in_box)

    def _lyapunov(self, error: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum((error @ self._root) ** 2, axis=-1))


def growth(F: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest V'/2V [1/s] (lanes,) of all errors, and the error (lanes, n_e) with V = 1 that attains it."""
    root = np.linalg.cholesky(P)
    scaled = np.linalg.solve(root, F @ root)
    values, vectors = np.linalg.eigh(0.5 * (scaled + np.swapaxes(scaled, 1, 2)))
    return values[:, -1], vectors[:, :, -1] @ root.T


def gain_at(F: np.ndarray, G: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return ‖C (sI - F)⁻¹ G‖ [rad/(N m)] (lanes,) at s (lanes,) [1/s]."""
    response = np.linalg.solve(s[:, np.newaxis, np.newaxis] * np.eye(F.shape[-1]) - F, G)[:, POSITION]
    return np.asarray(np.linalg.norm(response, ord=2, axis=(1, 2)))


def random_errors(loop: RigidLoop, rng: np.random.Generator, lanes: int) -> np.ndarray:
    """Return errors (lanes, n_e) spread like the ellipsoid V = 1 and scaled to largest angles of 0.01 to 0.3 rad."""
    errors = rng.normal(size=(lanes, loop.states)) @ np.linalg.cholesky(loop.controller.P).T
    return errors * (rng.uniform(0.01, 0.3, lanes) / np.abs(errors[:, POSITION]).max(axis=1))[:, np.newaxis]


def random_decay(loop: RigidLoop, lanes: int = 200, duration: float = 0.2) -> Run:
    """Return undisturbed rollouts from random errors about random postures, passed at constant velocity."""
    rng = np.random.default_rng(0)
    q, dq = (rng.uniform(-0.6, 0.6, (lanes, 2)) * limit for limit in (loop.arm.joint_limit, loop.arm.velocity_limit))
    return loop.simulate(Uniform(q, dq), random_errors(loop, rng, lanes), duration, STEP)


def slowest_decay(loop: RigidLoop) -> tuple[float, Run]:
    """Return the smallest -V'/2V [1/s] of all states of the box and all errors, and the rollout from there."""
    P = loop.controller.P
    value, (q, dq) = loop.worst_point(lambda F, G, omega: growth(F, P)[0])
    q, dq = 0.999 * q, 0.999 * dq  # so that the arm does not leave the box at once
    error = 1e-4 * growth(loop.frozen(q, dq)[0], P)[1]
    motion = Uniform(q - error[:, POSITION], dq - error[:, VELOCITY])
    return -value, loop.simulate(motion, error, 0.02, SLOWEST_STEP)


def worst_posture(loop: RigidLoop) -> Uniform:
    """Return the held posture with the largest frozen gain, slightly inside the box."""
    _, worst = loop.worst_point(lambda F, G, omega: gain_at(F, G, 1j * omega), moving=False)
    return Uniform(0.98 * worst.q, np.zeros((1, 2)))


def library(duration: float) -> dict[str, np.ndarray]:
    """Return torques (k, 2) [N m] of size 1 at the instants 0, `STEP`, ..., duration [s]."""
    t, rng = STEP * np.arange(round(duration / STEP) + 1), np.random.default_rng(0)
    shapes = {"step": np.ones_like(t), "pulse": (t <= PULSE).astype(float)}
    shapes |= {f"sine {omega:g} rad/s": np.sin(omega * t) for omega in FREQUENCIES}
    probes = {f"{name}, {way}": np.outer(shape, WAYS[way]) for name, shape in shapes.items() for way in WAYS}
    return probes | {f"noise {k}": rng.normal(size=(len(t), JOINTS)) for k in range(4)}


def worst_torque(loop: RigidLoop, motion: Any, duration: float, *, stored: bool = False) -> np.ndarray:
    """Return the torque (k, 2) [N m], largest value 1, that small errors about a motion of one lane amplify most.

    About zero error the loop is linear, with F(t) and G(t) frozen on the motion. Power iteration finds the largest
    singular value of its map from w to the position error: forward through the loop, backward through its adjoint. The
    output is z or, if `stored`, all that the dissipation inequality counts, (z, √(2α) P^(-1/2) ē). The search holds
    each torque for `HELD`; the returned torques are `STEP` apart.
    """
    middles, n = HELD * (np.arange(round(duration / HELD)) + 0.5), loop.states
    move, push = discrete(loop, motion, middles)
    weight = np.diag(np.arange(n) < POSITION.stop).astype(float)
    if stored:
        weight += 2.0 * loop.controller.alpha * np.linalg.inv(loop.controller.P)
    torque, errors = np.random.default_rng(0).normal(size=(len(middles), JOINTS)), np.zeros((len(middles), n))
    for _ in range(POWER_STEPS):
        e, costate = np.zeros(n), np.zeros(n)
        for k in range(len(middles)):
            errors[k] = e = move[k] @ e + push[k] @ torque[k]
        counted = errors @ weight
        for k in reversed(range(len(middles))):
            costate += counted[k]
            torque[k] = costate @ push[k]
            costate = costate @ move[k]
        torque /= np.abs(torque).max()
    t = STEP * np.arange(round(duration / STEP) + 1)
    return np.column_stack([np.interp(t, middles, joint) for joint in torque.T])


def discrete(loop: RigidLoop, motion: Any, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the maps of ē (k, n_e, n_e) and of a held w (k, n_e, 2) over `HELD`, by the implicit midpoint rule."""
    target, n = motion.sample(middles), loop.states
    F, G = loop.frozen(target.q.reshape(-1, JOINTS), target.dq.reshape(-1, JOINTS))
    half, unit = 0.5 * HELD * F, np.eye(n)
    maps = np.linalg.solve(unit - half, np.concatenate([unit + half, HELD * G], axis=2))
    return maps[..., :n], maps[..., n:]


def disturbed(loop: RigidLoop, motion: Any, duration: float) -> tuple[list[str], Run]:
    """Return rollouts [s] from zero error under the `library` and the worst torques for gain and supply, with names."""
    worst = {f"worst {of}": worst_torque(loop, motion, duration, stored=of == "supply") for of in ("gain", "supply")}
    torques = library(duration) | worst
    stacked = AMPLITUDE * np.stack(list(torques.values()), axis=1)
    return [*torques], loop.simulate(motion, np.zeros((len(torques), loop.states)), duration, STEP, stacked)
