"""Inertias of a robot at sampled angles, and the smallest value of a function of angles: a design's proposals.

Nothing of this is a proof; `inertia_bounds` proves the bounds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fuzzyarm.envs.physics.rigid_body import frames, mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.proof.box_cover import widened
from fuzzyarm.fuzzy_policy.proof.kinetic_energy import TWIST, inertia_polynomial
from fuzzyarm.fuzzy_policy.proof.trigonometric import TrigMatrix

__all__ = ["InertiaSamples", "smallest_value", "twist_map"]

KEPT = 40  # samples that the search goes on from
FIRST_STEP, STEPS = 0.2, 25  # rad, halved where no step helps


@dataclasses.dataclass(frozen=True)
class InertiaSamples:
    """The inertia M̄ = near + Jᵀ D J of a chain that is split behind link a, at sampled angles.

    Attributes:
        q: angles (B, n) [rad].
        near: of the links up to a, with the rotors, (B, n, n) [kg m²].
        twist: J (B, 6 + n - a, n), from q̇ to the twist of link a in its own frame and the rates beyond.
        distal: D (B, 6 + n - a, 6 + n - a), of the links beyond; of no size without a split.
    """

    q: np.ndarray
    near: np.ndarray
    twist: np.ndarray
    distal: np.ndarray

    @classmethod
    def of(cls, robot: Robot, split: int, count: int, seed: int) -> InertiaSamples:
        """Return `count` samples of the robot's box."""
        n = len(robot)
        q = _angles_in(widened(np.array([joint.angle_range for joint in robot.joints])), count, seed)
        whole = mass_matrix(robot, q) + np.diag(robot.drive("motor_inertia"))
        if split == n:
            return cls(q, whole, np.zeros((count, 0, n)), np.zeros((count, 0, 0)))
        twist = twist_map(robot, q, split)
        distal = TrigMatrix(inertia_polynomial(robot, split, n)).at(q[:, split:])
        return cls(q, whole - np.swapaxes(twist, 1, 2) @ distal @ twist, twist, distal)

    def inertia(self, distal: np.ndarray | None = None) -> np.ndarray:
        """Return M̄ (B, n, n), with a constant (6 + n - a, 6 + n - a) in place of D if one is given."""
        D = self.distal if distal is None else distal
        return np.asarray(self.near + np.swapaxes(self.twist, 1, 2) @ D @ self.twist)


def twist_map(robot: Robot, q: np.ndarray, split: int) -> np.ndarray:
    """Return J of `InertiaSamples` (B, 6 + n - a, n) at angles (B, n) [rad]."""
    n = len(robot)
    links = frames(robot, q)
    back = np.swapaxes(links.rotation[..., split - 1, :, :], -1, -2)
    directions = np.einsum("...kij,kj->...ik", links.rotation, robot.arrays.axis)[..., :split]
    arms = np.swapaxes(links.origin[..., split - 1 : split, :] - links.origin[..., :split, :], -1, -2)
    result = np.zeros((*q.shape[:-1], TWIST + n - split, n))
    result[..., :TWIST, :split] = np.concatenate(
        [back @ np.cross(directions, arms, axis=-2), back @ directions], axis=-2
    )
    result[..., TWIST:, split:] = np.eye(n - split)
    return result


def _angles_in(ranges: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return angles (count, d) in `ranges` (d, 2) [rad]: half at random, half on multiples of π/4 and on the faces."""
    generator = np.random.default_rng(seed)
    low, high = ranges.T
    q = generator.uniform(low, high, (count, len(ranges)))
    snapped = np.clip(np.round(q * 4.0 / np.pi) * np.pi / 4.0, low, high)
    ends = np.where(generator.random(q.shape) < 0.5, low, high)
    snapped = np.where(generator.random(q.shape) < 0.15, ends, snapped)
    return np.where((np.arange(count) % 2 == 0)[:, np.newaxis], q, snapped)


def smallest_value(
    function: Callable[[np.ndarray], np.ndarray], ranges: np.ndarray, *, count: int = 3000, seed: int = 1
) -> float:
    """Return the smallest value found.

    Args:
        function: of angles (B, d) [rad], returns (B,).
        ranges: of the angles, (d, 2) [rad].
        count: samples.
        seed: of the samples.
    """
    q = _angles_in(ranges, count, seed)
    values = function(q)
    best = np.argsort(values)[:KEPT]
    q, values = q[best], values[best]
    d = len(ranges)
    directions = np.concatenate([np.eye(d), -np.eye(d)])
    step = FIRST_STEP
    for _ in range(STEPS if d else 0):
        tried = np.clip(q[:, np.newaxis] + step * directions, ranges[:, 0], ranges[:, 1])
        found = function(tried.reshape(-1, d)).reshape(len(q), -1)
        place, every = np.argmin(found, axis=1), np.arange(len(q))
        better = found[every, place] < values
        q = np.where(better[:, np.newaxis], tried[every, place], q)
        values = np.where(better, found[every, place], values)
        if not better.any():
            step *= 0.5
    return float(values.min())
