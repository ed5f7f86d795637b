"""The motor reference with which the links of the elastic arm follow a reference exactly, if it is known in advance.

The links need the torque τ_d = M_b(q_d) q̈_d + C(q_d, q̇_d) q̇_d + g(q_d). The joints provide it if they are bent by
δ = θ_d - q_d with B_t δ̇ + K_t δ = τ_d, equation (2). Its stationary solution, after the transient of the start, is,
with b = B_t/K_t,

    δ(t) = 1/K_t ∫_0^∞ e⁻ˣ τ_d(t - b x) dx,      δ̇ = (τ_d - K_t δ)/B_t,      δ̈ = (τ̇_d - K_t δ̇)/B_t,

and δ = τ_d/K_t where B_t = 0. The integral is a Gauss quadrature whose panels end at the corners of q̈_d.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev, legendre
from numpy.typing import ArrayLike

from fuzzyarm.common.checks import instance
from fuzzyarm.envs.physics.dynamics import Arm, arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.scenario.reference import JointReference, ReferenceSample

__all__ = ["CHECKED_INSTANTS", "ElasticReference"]

CHECKED_INSTANTS = 501  # evenly spaced instants at which a new reference is checked against the box
PANELS = np.linspace(0.0, 36.0, 19)  # end of the integral over x; e⁻³⁶ is at the level of rounding errors
NODES = 10  # of each panel
STENCIL, REACH = 9, 2e-3  # Chebyshev points within ± this share of the duration, for τ̇_d and τ̈_d


@dataclasses.dataclass(frozen=True)
class ElasticReference:
    """θ_d(t), θ̇_d(t), θ̈_d(t) of the motors for a reference of the links; see the module.

    As for the reference itself, every value depends on its own t alone; before t = 0 and long after T the arm rests.

    Attributes:
        reference: the motion of the links; its `parameters` are the arm.

    Raises:
        TypeError: `reference` is no `JointReference`.
        ValueError: θ_d or θ̇_d leaves the box (25), on which the certificates hold.
    """

    reference: JointReference

    def __post_init__(self) -> None:
        """Check θ_d against the box at `CHECKED_INSTANTS` instants."""
        instance("reference", self.reference, JointReference)
        t, limits = np.linspace(0.0, self.duration, CHECKED_INSTANTS), self.reference.parameters
        motion = self.sample(t)
        for name, unit, values, limit in (
            ("theta", "rad", np.unwrap(motion.q, axis=0), limits.joint_limit),
            ("dtheta", "rad/s", motion.dq, limits.velocity_limit),
        ):
            k, joint = np.unravel_index(np.argmax(np.abs(values) / limit), values.shape)
            if abs(values[k, joint]) > limit[joint]:
                raise ValueError(
                    f"{name}_d{joint + 1} = {values[k, joint]:.6g} {unit} at t = {t[k]:.4g} s, where the motor must be "
                    f"for the links to follow, leaves the box; allowed: [-{limit[joint]:g}, {limit[joint]:g}] {unit}. "
                    "Move the path, raise its duration, or stiffen the joints"
                )

    @property
    def duration(self) -> float:
        """T [s] of the reference."""
        return self.reference.duration

    @property
    def box_use(self) -> float:
        """Largest share of the box (25) that θ_d and θ̇_d use; 1 is at its border."""
        motion, limits = self.sample(np.linspace(0.0, self.duration, CHECKED_INSTANTS)), self.reference.parameters
        shares = [np.abs(motion.q) / limits.joint_limit, np.abs(motion.dq) / limits.velocity_limit]
        return float(np.max(shares))

    def torque(self, t: ArrayLike) -> np.ndarray:
        """Return τ_d [N m], shape (..., 2), at times t [s] of shape (...,)."""
        return rigid_inverse_dynamics(*self.reference.sample(t), self._arm)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return θ_d [rad], θ̇_d [rad/s] and θ̈_d [rad/s²], shapes (..., 2), at times t [s] of shape (...,).

        θ̈_d jumps where q̈_d has a corner, without damping θ̇_d too; there it is the value on the right.
        """
        times = np.atleast_1d(np.asarray(t, dtype=float))
        flat = times.ravel()
        motion, torque = self.reference.sample(flat), self.torque(flat)
        rate, curvature = self._torque_rates(flat)
        stiffness, damping = np.array(self.reference.parameters.stiffness), np.array(self.reference.parameters.damping)
        delta, velocity, acceleration = torque / stiffness, rate / stiffness, curvature / stiffness
        for joint in np.flatnonzero(damping > 0.0):
            k, b = stiffness[joint], damping[joint]
            delta[:, joint] = self._relaxed(flat, b / k)[:, joint] / k
            velocity[:, joint] = (torque[:, joint] - k * delta[:, joint]) / b
            acceleration[:, joint] = (rate[:, joint] - k * velocity[:, joint]) / b
        shape = (*np.shape(t), 2)
        parts = (motion.q + delta, motion.dq + velocity, motion.ddq + acceleration)
        return ReferenceSample(*(part.reshape(shape) for part in parts))

    def _relaxed(self, t: np.ndarray, time_constant: float) -> np.ndarray:
        """Return ∫_0^∞ e⁻ˣ τ_d(t - b x) dx [N m], (n, 2)."""
        corners = (t[:, np.newaxis] - self._corners) / time_constant
        inside = np.clip(corners, PANELS[0], PANELS[-1])  # a corner out of reach makes an empty panel
        edges = np.sort(np.concatenate([np.tile(PANELS, (len(t), 1)), inside], axis=1), axis=1)
        nodes, weights = legendre.leggauss(NODES)
        half = 0.5 * np.diff(edges, axis=1)[..., np.newaxis]
        x = edges[:, :-1, np.newaxis] + half * (1.0 + nodes)
        torque = self.torque(t[:, np.newaxis, np.newaxis] - time_constant * x)
        weight = half * weights * np.exp(-x)
        # The remainder beyond the last panel is added, so that the weights sum to one.
        return np.asarray(np.einsum("tpn,tpnj->tj", weight, torque) / np.sum(weight, axis=(1, 2))[:, np.newaxis])

    def _torque_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return τ̇_d [N m/s] and τ̈_d [N m/s²], (n, 2), from a polynomial through points between two corners."""
        corners = np.concatenate([[-np.inf], self._corners, [np.inf]])
        piece = np.searchsorted(corners, t, side="right")
        reach = REACH * self.duration
        low, high = np.maximum(t - reach, corners[piece - 1]), np.minimum(t + reach, corners[piece])
        points = chebyshev.chebpts1(STENCIL)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        torque = self.torque(middle[:, np.newaxis] + half[:, np.newaxis] * points)
        fit = np.linalg.inv(chebyshev.chebvander(points, STENCIL - 1))
        coefficients = np.einsum("ij,tjk->itk", fit, torque)
        place = ((t - middle) / half)[:, np.newaxis]
        first, second = (
            np.stack(
                [
                    chebyshev.chebval(place[:, 0], chebyshev.chebder(coefficients[..., joint], order), tensor=False)
                    for joint in range(2)
                ],
                axis=1,
            )
            for order in (1, 2)
        )
        return first / half[:, np.newaxis], second / half[:, np.newaxis] ** 2

    @cached_property
    def _corners(self) -> np.ndarray:
        return self.reference.corners()

    @cached_property
    def _arm(self) -> Arm:
        return arm_constants(self.reference.parameters)
