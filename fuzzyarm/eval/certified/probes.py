"""Motions and disturbance torques for tests of the rigid loop, among them the worst torque that is found."""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.scenario.reference import ReferenceSample
from fuzzyarm.eval.certified.frozen import freeze
from fuzzyarm.eval.certified.rigid import RigidLoop
from fuzzyarm.eval.certified.rigid_rollout import STEP, Disturbance, Motion
from fuzzyarm.fuzzy_policy.states import POSITION

__all__ = ["Uniform", "joined", "library", "worst_torque"]

FREQUENCIES = (1.0, 3.0, 10.0, 20.0, 40.0, 60.0, 80.0, 120.0, 200.0, 400.0)  # [rad/s]
DIRECTIONS = {"joint 1": (1.0, 0.0), "joint 2": (0.0, 1.0), "in phase": (0.7, 0.7), "antiphase": (0.7, -0.7)}
PULSE = 0.02  # [s]
HELD = 2e-3  # [s], one torque of the power iteration
POWER_STEPS = 40  # of the power iteration; twice as many raise the gains by 0.5 % at most


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
    return probes | {f"noise {k}": rng.normal(size=(len(t), JOINTS)) for k in range(4)}


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
    """Return the torque (k, 2) [N m], largest value 1, that small errors about a motion amplify most.

    About zero error the loop is linear, with the F(t), G(t) of `freeze`. Power iteration finds the largest singular
    value of its map from w to the position error: forward through the loop, backward through its adjoint.

    Args:
        loop: arm and controller.
        motion: the reference, of one lane.
        duration: [s].
        stored: whether the output is all that the dissipation inequality counts, (z, √(2α) P^(-1/2) ē), or z.
        step: [s], between the torques returned; those searched are held for `HELD`.
    """
    middles = HELD * (np.arange(round(duration / HELD)) + 0.5)
    move, push = _discrete(loop, motion, middles)
    n, controller = loop.states, loop.controller
    weight = np.diag(np.arange(n) < POSITION.stop).astype(float)
    if stored:
        weight += 2.0 * controller.alpha * np.linalg.inv(controller.P)
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
    t = step * np.arange(round(duration / step) + 1)
    return np.column_stack([np.interp(t, middles, joint) for joint in torque.T])


def _discrete(loop: RigidLoop, motion: Motion, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the maps of ē (k, n_e, n_e) and of a held w (k, n_e, 2) over `HELD`, by the implicit midpoint rule."""
    target, n = motion.sample(middles), loop.states
    F, G = freeze(loop, target.q.reshape(-1, JOINTS), target.dq.reshape(-1, JOINTS))
    half, unit = 0.5 * HELD * F, np.eye(n)
    maps = np.linalg.solve(unit - half, np.concatenate([unit + half, HELD * G], axis=2))
    return maps[..., :n], maps[..., n:]
