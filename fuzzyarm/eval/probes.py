"""Motions and disturbance torques that put the rigid loop to the test, a worst one among them."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import expm

from fuzzyarm.envs.reference import ReferenceSample
from fuzzyarm.eval.frozen import frozen
from fuzzyarm.eval.rigid import STEP, Disturbance, Motion, RigidLoop

FREQUENCIES = (1.0, 3.0, 10.0, 20.0, 40.0, 60.0, 80.0, 120.0, 200.0, 400.0)  # [rad/s]
DIRECTIONS = {"joint 1": (1.0, 0.0), "joint 2": (0.0, 1.0), "in phase": (0.7, 0.7), "antiphase": (0.7, -0.7)}
PULSE = 0.02  # [s]
POWER_STEPS = 40  # of the power iteration; twice as many raise the gain in the fourth digit


@dataclasses.dataclass(frozen=True)
class Uniform:
    """q_d = q + q̇ t: postures held, or passed at constant velocity; q [rad] and q̇ [rad/s] are (lanes, 2)."""

    q: np.ndarray
    dq: np.ndarray

    def sample(self, t: np.ndarray) -> ReferenceSample:
        """Return the motion (k, lanes, 2) at times t (k,) [s]."""
        q = self.q + t[:, np.newaxis, np.newaxis] * self.dq
        return ReferenceSample(q, np.broadcast_to(self.dq, q.shape), np.zeros(q.shape))


def library(duration: float, step: float = STEP, seed: int = 0) -> dict[str, np.ndarray]:
    """Return torques (k, 2) [N m] of size 1 at the instants 0, step, ..., duration, to be joined by `joined`."""
    t, rng = np.arange(round(duration / step) + 1) * step, np.random.default_rng(seed)
    shapes = {"step": np.ones_like(t), "pulse": (t <= PULSE).astype(float)}
    shapes |= {f"sine {omega:g} rad/s": np.sin(omega * t) for omega in FREQUENCIES}
    probes = {
        f"{name}, {way}": shape[:, np.newaxis] * np.array(direction)
        for name, shape in shapes.items()
        for way, direction in DIRECTIONS.items()
    }
    return probes | {f"noise {k}": rng.normal(size=(len(t), 2)) for k in range(4)}


def joined(torques: np.ndarray, step: float = STEP) -> Disturbance:
    """Return the disturbance that joins torques (k, lanes, 2) [N m], `step` [s] apart, by straight lines."""

    def disturbance(t: np.ndarray) -> np.ndarray:
        place = np.clip(t / step, 0.0, len(torques) - 1.0)
        left = np.minimum(np.floor(place + 1e-9).astype(int), len(torques) - 2)
        share = (place - left)[:, np.newaxis, np.newaxis]
        return np.asarray((1.0 - share) * torques[left] + share * torques[left + 1])

    return disturbance


def worst_torque(
    loop: RigidLoop, motion: Motion, duration: float, *, stored: bool = False, step: float = STEP
) -> np.ndarray:
    """Return the torque (k, 2) [N m], largest value 1, of largest gain for small errors about a motion of one lane.

    About zero error the loop is linear with F(t), G(t) of `frozen`. The largest singular value of its map from w to
    the position error is found by power iteration: forward through the loop, backward through its adjoint.

    Args:
        loop: arm and controller.
        motion: the reference.
        duration: [s].
        stored: whether what comes out is (z, √(2α) P^(-1/2) ē), all that the dissipation inequality counts, or z.
        step: [s], over which the torque is held here.
    """
    steps, n, controller = round(duration / step), loop.states, loop.controller
    target = motion.sample(step * (np.arange(steps) + 0.5))
    F, G = frozen(loop, target.q.reshape(-1, 2), target.dq.reshape(-1, 2))
    both = expm(step * np.concatenate([np.concatenate([F, G], axis=2), np.zeros((steps, 2, n + 2))], axis=1))
    move, push = both[:, :n, :n], both[:, :n, n:]
    C = np.eye(n)[:2]
    weight = C.T @ C + (2.0 * controller.alpha * np.linalg.inv(controller.P) if stored else 0.0)
    torque = np.random.default_rng(0).normal(size=(steps, 2))
    for _ in range(POWER_STEPS):
        errors, e, costate = np.zeros((steps, n)), np.zeros(n), np.zeros(n)
        for k in range(steps):
            errors[k] = e = move[k] @ e + push[k] @ torque[k]
        counted = errors @ weight
        for k in reversed(range(steps)):
            costate = costate + counted[k]
            torque[k] = push[k].T @ costate
            costate = move[k].T @ costate
        torque /= np.abs(torque).max()
    return np.vstack([torque, torque[-1:]])
