"""Inertias of a robot at sampled angles, from which a design proposes bounds; `inertia_bounds` proves them."""

from __future__ import annotations

import dataclasses

import numpy as np

from fuzzyarm.envs.physics.rigid_body import frames, mass_matrix
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.fuzzy_policy.proof.box_cover import widened
from fuzzyarm.fuzzy_policy.proof.kinetic_energy import TWIST, inertia_polynomial
from fuzzyarm.fuzzy_policy.proof.trigonometric import TrigMatrix
from fuzzyarm.synthesis.extremes import angles_in

__all__ = ["InertiaSamples", "twist_map"]


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
        q = angles_in(widened(np.array([joint.angle_range for joint in robot.joints])), count, seed)
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
