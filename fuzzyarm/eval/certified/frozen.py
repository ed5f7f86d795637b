"""The rigid loop with its premises frozen at a state of the box, a linear system, and a search for the worst one.

    ē' = F ē + G w,      F = Ē(z)⁻¹ (Ā(z) + B̄ K̄_hv),      G = Ē(z)⁻¹ B̄,      z from (q, q̇).

The certificate bounds each of these systems: every pole lies left of -α, V decays at α at least, and with s = jω - α

    ‖C (sI - F)⁻¹ G‖ <= γ  for every ω,     C ē = q - q_d;

without the shift by α the same norm is the L2 gain of the frozen loop, which is smaller.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.fuzzy_policy.states import INTEGRAL, PLANT, PLANT_STATES, POSITION, VELOCITY
from fuzzyarm.fuzzy_policy.ts_model import premises

__all__ = [
    "Objective",
    "WorstPoint",
    "find_worst_point",
    "freeze",
    "gain_at",
    "lyapunov_rate",
    "pole_rate",
    "slowest_error",
]

LARGEST_FREQUENCY = 500.0  # [rad/s]; the gains fall beyond 100 rad/s
GENERATIONS, POPULATION = 150, 16  # of the search; a second seed changes no result in the fourth digit


def freeze(loop: RigidLoop, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return F (lanes, n_e, n_e) and G (lanes, n_e, 2) at angles [rad] and velocities [rad/s] (lanes, 2)."""
    z = premises(q, dq, loop.controller.model.parameters)
    (E, A), (gain, _), n = loop.descriptor(z), loop.law(z), loop.states
    inverse = np.linalg.inv(E[:, VELOCITY, VELOCITY])
    F, G = np.zeros((len(z), n, n)), np.zeros((len(z), n, JOINTS))
    F[:, POSITION, VELOCITY] = np.eye(JOINTS)
    F[:, INTEGRAL, POSITION] = np.eye(n - PLANT_STATES, JOINTS)
    gain = gain.copy()
    gain[:, :, PLANT] += A[:, VELOCITY]
    F[:, VELOCITY], G[:, VELOCITY] = inverse @ gain, inverse
    return F, G


def pole_rate(F: np.ndarray) -> np.ndarray:
    """Return -max Re λ [1/s] (lanes,): the asymptotic decay rate of small errors."""
    return np.asarray(-np.linalg.eigvals(F).real.max(axis=-1))


def lyapunov_rate(F: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the smallest -V'/2V [1/s] over all errors (lanes,): the decay of V at its slowest instant."""
    root = np.linalg.cholesky(P)
    scaled = np.linalg.solve(root, F @ root)
    return np.asarray(-np.linalg.eigvalsh(0.5 * (scaled + np.swapaxes(scaled, 1, 2)))[:, -1])


def slowest_error(F: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Return the error ē (lanes, n_e) [rad, rad/s, rad s], V = 1, at which V decays at `lyapunov_rate`."""
    root = np.linalg.cholesky(P)
    scaled = np.linalg.solve(root, F @ root)
    return np.asarray(np.linalg.eigh(0.5 * (scaled + np.swapaxes(scaled, 1, 2)))[1][:, :, -1] @ root.T)


def gain_at(F: np.ndarray, G: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return ‖C (sI - F)⁻¹ G‖ [rad/(N m)] (lanes,) at s (lanes,) [1/s]."""
    response = np.linalg.solve(s[:, np.newaxis, np.newaxis] * np.eye(F.shape[-1]) - F, G)[:, POSITION]
    return np.asarray(np.linalg.norm(response, ord=2, axis=(1, 2)))


@dataclasses.dataclass(frozen=True)
class WorstPoint:
    """Where in the box a `value` is largest: q [rad] and q̇ [rad/s] (2,), and the frequency ω [rad/s] if it has one."""

    value: float
    q: np.ndarray
    dq: np.ndarray
    omega: float


Objective = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""F, G and ω, with lanes, to what is to be largest (lanes,)."""


def find_worst_point(loop: RigidLoop, objective: Objective, *, moving: bool = True, seed: int = 0) -> WorstPoint:
    """Return where `objective` is largest over the box (25) and ω in [0, LARGEST_FREQUENCY], by differential evolution.

    Args:
        loop: arm and controller.
        objective: see `Objective`.
        moving: whether q̇ is searched too; False: the arm at rest.
        seed: of the search.
    """
    limits = loop.controller.model.parameters
    scale = np.array([*limits.joint_limit, *(float(moving) * np.array(limits.velocity_limit)), 1.0])

    def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        point = scale * x.T
        return point[:, POSITION], point[:, VELOCITY], LARGEST_FREQUENCY * (0.5 + 0.5 * point[:, -1]) ** 2

    def loss(x: np.ndarray, /) -> Any:
        q, dq, omega = split(x)
        return -objective(*freeze(loop, q, dq), omega)

    found = differential_evolution(
        loss, Bounds([-1.0] * len(scale), [1.0] * len(scale)), vectorized=True, updating="deferred", polish=False,
        rng=seed, init="sobol", maxiter=GENERATIONS, popsize=POPULATION, tol=0.0,
    )  # fmt: skip
    q, dq, omega = split(found.x[:, np.newaxis])
    return WorstPoint(-float(found.fun), q[0], dq[0], float(omega[0]))
