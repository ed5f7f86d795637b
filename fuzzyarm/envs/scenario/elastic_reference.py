"""The motor reference that makes the elastic arm's links follow a reference exactly, if it is known in advance.

The links need the torque τ_d = M_b(q_d) q̈_d + C(q_d, q̇_d) q̇_d + g(q_d). The joints provide it when deflected by δ =
θ_d - q_d with B_t δ̇ + K_t δ = τ_d, equation (2). Its solution after the transient of the start is, with b = B_t/K_t,

    δ(t) = 1/K_t ∫_0^∞ e⁻ˣ τ_d(t - b x) dx,      δ̇ = (τ_d - K_t δ)/B_t,      δ̈ = (τ̇_d - K_t δ̇)/B_t,

and δ = τ_d/K_t where B_t = 0. The integral is a Gauss-Laguerre quadrature; where a corner of q̈_d is near,
Gauss quadratures over panels that end at the corners.
"""

import dataclasses
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev, laguerre, legendre
from numpy.typing import ArrayLike

from fuzzyarm.common.checks import instance
from fuzzyarm.envs.physics.dynamics import arm_constants, rigid_inverse_dynamics
from fuzzyarm.envs.physics.equations import robot_of
from fuzzyarm.envs.physics.rigid_body import inverse_dynamics
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.kinematics import angle_ranges, velocity_limits
from fuzzyarm.envs.scenario.reference import JointReference, Reference, ReferenceSample

__all__ = ["CHECKED_INSTANTS", "ElasticReference"]

CHECKED_INSTANTS = 501  # evenly spaced instants at which a new reference is checked against the box
_PANELS = np.linspace(0.0, 36.0, 19)  # end of the integral over x; e⁻³⁶ is at the level of rounding errors
_NODES = 10  # of each panel, and of the Gauss-Laguerre quadrature of a smooth torque
_SMOOTH = 1e-3  # share of the duration; up to this time constant, the torque counts as smooth between corners
_STENCIL, _REACH = 9, 2e-3  # Chebyshev points within ± this share of the duration, for τ̇_d and τ̈_d


@dataclasses.dataclass(frozen=True)
class ElasticReference:
    """The motor motion θ_d(t), θ̇_d(t), θ̈_d(t) that makes the links follow their reference; see the module.

    As for the links' reference, a value depends only on its t; before t = 0 and long after T the arm rests.

    Raises:
        ValueError: θ_d or θ̇_d leaves the box (25), on which the certificates hold, or the ranges of a robot's joints.
    """

    reference: Reference  # the motion of the links of an arm or a robot

    def __post_init__(self) -> None:
        instance("reference", self.reference, Reference)  # type: ignore[type-abstract]
        t = np.linspace(0.0, self.duration, CHECKED_INSTANTS)
        motion = self.sample(t)
        for name, unit, values, (low, high) in (
            ("theta", "rad", np.unwrap(motion.q, axis=0), self._box[0]),
            ("dtheta", "rad/s", motion.dq, self._box[1]),
        ):
            share = _box_share(values, low, high)
            k, joint = np.unravel_index(np.argmax(share), values.shape)
            if share[k, joint] > 1.0:
                raise ValueError(
                    f"{name}_d{joint + 1} = {values[k, joint]:.6g} {unit} at t = {t[k]:.4g} s, which the motor must "
                    f"reach for the links to follow the path, is outside the range of the joint; allowed: "
                    f"[{low[joint]:g}, {high[joint]:g}] {unit}. Move the path, raise its duration, or stiffen the "
                    "joints"
                )

    @property
    def duration(self) -> float:
        """Duration T [s] of the reference."""
        return self.reference.duration

    @property
    def box_use(self) -> float:
        """Largest fraction of the box (25) that θ_d or θ̇_d uses; 1 is the border of the box."""
        motion = self.sample(np.linspace(0.0, self.duration, CHECKED_INSTANTS))
        return float(np.max([_box_share(*one) for one in zip(motion[:2], *np.swapaxes(self._box, 0, 1), strict=True)]))

    def torque(self, t: ArrayLike) -> np.ndarray:
        """Return the torque τ_d [N m] that the links need, shape (..., n), at times t [s] of shape (...,)."""
        return self.links_torque(self.reference.sample(t))

    def links_torque(self, motion: ReferenceSample) -> np.ndarray:
        """Return M_b q̈ + C q̇ + g [N m], shape (..., n), that the links need for a motion with shapes (..., n)."""
        if isinstance(self.reference, JointReference):
            return rigid_inverse_dynamics(*motion, arm_constants(self.reference.parameters))
        return inverse_dynamics(self._robot, *motion)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return θ_d [rad], θ̇_d [rad/s] and θ̈_d [rad/s²], shapes (..., n), at times t [s] of shape (...,).

        θ̈_d, and without damping also θ̇_d, jumps where q̈_d has a corner; the value there is the right limit.
        """
        times = np.atleast_1d(np.asarray(t, dtype=float))
        flat = times.ravel()
        motion, torque = self.reference.sample(flat), self.torque(flat)
        rate, curvature = self._torque_rates(flat)
        stiffness, damping = self._robot.drive("stiffness"), self._robot.drive("damping")
        delta, velocity, acceleration = torque / stiffness, rate / stiffness, curvature / stiffness
        time_constants = damping / stiffness
        for time_constant in np.unique(time_constants[damping > 0.0]):  # joints with equal ones are computed together
            relaxed = self._relaxed(flat, time_constant)
            for joint in np.flatnonzero(time_constants == time_constant):
                k, b = stiffness[joint], damping[joint]
                delta[:, joint] = relaxed[:, joint] / k
                velocity[:, joint] = (torque[:, joint] - k * delta[:, joint]) / b
                acceleration[:, joint] = (rate[:, joint] - k * velocity[:, joint]) / b
        shape = (*np.shape(t), self.reference.joints)
        parts = (motion.q + delta, motion.dq + velocity, motion.ddq + acceleration)
        return ReferenceSample(*(part.reshape(shape) for part in parts))

    def _relaxed(self, t: np.ndarray, time_constant: float) -> np.ndarray:
        """Return ∫_0^∞ e⁻ˣ τ_d(t - b x) dx [N m], (times, n), at times t [s], with b the time constant [s]."""
        corners = (t[:, np.newaxis] - self._corners) / time_constant
        near = ((corners > _PANELS[0]) & (corners < _PANELS[-1])).any(axis=1)
        if time_constant > _SMOOTH * self.duration:
            near[:] = True
        relaxed = np.empty((len(t), self.reference.joints))
        relaxed[near] = self._by_panels(t[near], corners[near], time_constant)
        nodes, weights = laguerre.laggauss(_NODES)
        torque = self.torque(t[~near, np.newaxis] - time_constant * nodes)
        relaxed[~near] = np.einsum("n,tnj->tj", weights, torque)
        return relaxed

    def _by_panels(self, t: np.ndarray, corners: np.ndarray, time_constant: float) -> np.ndarray:
        """Return the integral of `_relaxed` (times, n) by panels of x that end at corners of τ_d.

        `corners` (times, corners): for each time t, the x of the corners.
        """
        inside = np.clip(corners, _PANELS[0], _PANELS[-1])  # a corner out of reach makes an empty panel
        edges = np.sort(np.concatenate([np.tile(_PANELS, (len(t), 1)), inside], axis=1), axis=1)
        nodes, weights = legendre.leggauss(_NODES)
        half = 0.5 * np.diff(edges, axis=1)[..., np.newaxis]
        x = edges[:, :-1, np.newaxis] + half * (1.0 + nodes)
        torque = self.torque(t[:, np.newaxis, np.newaxis] - time_constant * x)
        weight = half * weights * np.exp(-x)
        # The remainder beyond the last panel is added, so that the weights sum to one.
        return np.asarray(np.einsum("tpn,tpnj->tj", weight, torque) / np.sum(weight, axis=(1, 2))[:, np.newaxis])

    def _torque_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return τ̇_d [N m/s] and τ̈_d [N m/s²], (times, n), at times t [s].

        They are derivatives of a polynomial through values of τ_d near t, with no corner in between.
        """
        corners = np.concatenate([[-np.inf], self._corners, [np.inf]])
        piece = np.searchsorted(corners, t, side="right")
        reach = _REACH * self.duration
        low, high = np.maximum(t - reach, corners[piece - 1]), np.minimum(t + reach, corners[piece])
        points = chebyshev.chebpts1(_STENCIL)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        torque = self.torque(middle[:, np.newaxis] + half[:, np.newaxis] * points)
        fit = np.linalg.inv(chebyshev.chebvander(points, _STENCIL - 1))
        coefficients = np.einsum("ij,tjk->itk", fit, torque)
        place = ((t - middle) / half)[:, np.newaxis]
        first, second = (chebyshev.chebval(place, chebyshev.chebder(coefficients, order), False) for order in (1, 2))
        return first / half[:, np.newaxis], second / half[:, np.newaxis] ** 2

    @cached_property
    def _corners(self) -> np.ndarray:
        return self.reference.corners()

    @cached_property
    def _robot(self) -> Robot:
        """The robot, or the two-joint arm as a robot."""
        if isinstance(self.reference, JointReference):
            return robot_of(self.reference.parameters)
        return instance("reference.robot", getattr(self.reference, "robot", None), Robot)

    @cached_property
    def _box(self) -> np.ndarray:
        """Ranges of the joints' angles [rad], then of their velocities [rad/s], (2, 2, n); each: lowest, highest."""
        fastest = velocity_limits(self._robot)
        return np.array([angle_ranges(self._robot), [-fastest, fastest]])


def _box_share(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the distance (..., n) of each value from the middle of its range, as a fraction of half the range."""
    return np.asarray(np.abs(values - 0.5 * (low + high)) / (0.5 * (high - low)))
