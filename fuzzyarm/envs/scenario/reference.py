"""The interface of references, and the reference of the two-joint arm: a tip path, by inverse kinematics (26).

    p(q) = p(s(t)),  q̇ = J⁻¹ ṗ,  q̈ = J⁻¹ (p̈ - J̇ q̇),  s(t) as below

References of other robots are in `robot_reference`. The default motion is that of section 6.1.3 of the paper; values
not printed there (start angle, direction, elbow) were found from the paper's peak torques, see `paths.Circle`.

The time law leads every reference from rest to rest:

    s(t) = 10 x³ - 15 x⁴ + 6 x⁵,  x = t/T;      p(t) = p(s(t)),   ṗ = p' ṡ,   p̈ = p'' ṡ² + p' s̈
"""

import abc
import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.dynamics import tip_jacobian, tip_position
from fuzzyarm.envs.physics.equations import bounds_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.scenario.kinematics import solved
from fuzzyarm.envs.scenario.paths import Circle, Placed, TipPath

__all__ = [
    "CHECKED_INSTANTS", "LONGEST", "SHORTEST", "JointReference", "PathReference", "Reference", "ReferenceSample",
    "TipSample", "along", "check_limits", "corner_times", "joint_angles", "quintic_time_law", "time_at",
    "time_law",
]  # fmt: skip

SHORTEST, LONGEST = 1e-6, 1e6  # s, allowed durations


def quintic_time_law(t: ArrayLike, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return s = 10 x³ - 15 x⁴ + 6 x⁵, ṡ [1/s] and s̈ [1/s²], x = t/duration clamped to [0, 1]; shapes as t [s].

    ṡ and s̈ vanish at both ends and beyond; the largest ṡ is 1.875 / duration, half-way.
    """
    return time_law(np.clip(np.asarray(t, dtype=float) / duration, 0.0, 1.0), duration)


def time_law(x: Any, duration: float) -> tuple[Any, Any, Any]:
    """Return s, ṡ [1/s] and s̈ [1/s²] of `quintic_time_law` at x = t/duration in [0, 1]; x may have any number type."""
    s = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    ds = 30.0 * (x * (1.0 - x)) ** 2 / duration
    dds = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / duration**2
    return s, ds, dds


def along(curve: TipPath, t: ArrayLike, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return p, ṗ = p' ṡ and p̈ = p'' ṡ² + p' s̈, each (..., d), along a curve p(s(t)) at times t [s] (...,)."""
    s, ds, dds = quintic_time_law(t, duration)
    p, dp, ddp = curve.points(s)
    ds, dds = ds[..., np.newaxis], dds[..., np.newaxis]
    return p, dp * ds, ddp * ds**2 + dp * dds


def corner_times(corners: ArrayLike, duration: float) -> np.ndarray:
    """Return the times (k,) [s] at which p̈ has a corner, ascending: both ends, and where s(t) is one of `corners`."""
    return np.unique([0.0, *time_at(corners, duration), duration])


def time_at(s: ArrayLike, duration: float) -> np.ndarray:
    """Return the times [s], shape (...,), at which s(t) has values of shape (...,) in [0, 1]."""
    from scipy.special import betaincinv

    # s(x) is the regularised incomplete beta function I_x(3, 3).
    return np.asarray(duration * betaincinv(3.0, 3.0, np.asarray(s, dtype=float)))


# The whole path must keep |q2| in [margin, π - margin] rad: det J = L1 L2 sin q2 vanishes at 0 and π.
_SINGULARITY_MARGIN = 0.05

# Instants, evenly spaced over the duration, at which a new reference is checked.
CHECKED_INSTANTS = 2001


class ReferenceSample(NamedTuple):
    """Joint angles [rad], velocities [rad/s] and accelerations [rad/s²], each of shape (..., n) for n joints."""

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


class TipSample(NamedTuple):
    """Tip position [m] and velocity [m/s], each of shape (..., 2) in the plane of the two-joint arm, else (..., 3)."""

    position: np.ndarray
    velocity: np.ndarray


class Reference(abc.ABC):
    """A twice differentiable motion of the joints from rest to rest, and the motion of the tip.

    Every value depends only on its own t. The arm rests at the start before t = 0, and at the end after t = T.

    Attributes:
        duration: T [s].
    """

    duration: float

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return int(self.sample(0.0).q.shape[-1])

    @property
    def circle(self) -> tuple[np.ndarray, float] | None:
        """Center (2,) or (3,) [m] and radius [m] of the tip's path; None if it is not a circle."""
        return None

    @abc.abstractmethod
    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return q, q̇ and q̈, shapes (..., n), at times t [s] of shape (...,)."""

    @abc.abstractmethod
    def tip(self, t: ArrayLike) -> TipSample:
        """Return position [m] and velocity [m/s] of the tip, shapes (..., 2) or (..., 3), at times t [s] (...)."""

    @abc.abstractmethod
    def normals(self, t: ArrayLike) -> np.ndarray:
        """Return the unit normals (..., 2) or (..., 3) of the tip's curve, which define the sign of a deviation."""

    @abc.abstractmethod
    def corners(self) -> np.ndarray:
        """Return the times [s] at which q̈ has a corner, ascending, the ends included."""


class PathReference(Reference):
    """A reference whose tip follows a path, p(s(t)).

    Attributes:
        path: the curve, see `paths`.
    """

    path: TipPath

    def checked_instants(self, size: int) -> np.ndarray:
        """Return evenly spaced instants (k,) [s] of the motion; ValueError for a wrong T or number of coordinates."""
        if not isinstance(self.path, TipPath):
            raise TypeError(
                f"path = {checks.shown(self.path)} must have a method points(s) that returns points of shape (..., "
                f"{size}); see fuzzyarm.envs.scenario.paths.TipPath"
            )
        checks.keep(self, "duration", checks.real("duration", self.duration, "s", low=SHORTEST, high=LONGEST))
        t = np.linspace(0.0, self.duration, CHECKED_INSTANTS)
        _check_points(self.path, quintic_time_law(t, self.duration)[0], size)
        return t

    @property
    def circle(self) -> tuple[np.ndarray, float] | None:
        """Center [m] and radius [m] if the path is a `Circle`, `Placed` or not; else None."""
        return self.path.circle if isinstance(self.path, Circle | Placed) else None

    def tip(self, t: ArrayLike) -> TipSample:
        """Return position p(s(t)) [m] and velocity ṗ = p' ṡ [m/s] at times t [s] of shape (...,)."""
        return TipSample(*along(self.path, t, self.duration)[:2])

    def corners(self) -> np.ndarray:
        """Return the times [s] at which q̈ has a corner, ascending: the ends, and where the path has one (`TipPath`)."""
        return corner_times(getattr(self.path, "corners", ()), self.duration)


@dataclasses.dataclass(frozen=True)
class JointReference(PathReference):
    """Joint motion q(t), q̇(t), q̈(t) that moves the tip along a path, from rest to rest; default: the paper's motion.

    Attributes:
        path: tip curve (`paths`).
        duration: T [s], 1e-6 to 1e6.
        elbow_sign: sign of q2 along the whole path: +1 (the paper's motion) or -1, the mirrored elbow.
        parameters: the arm; its lengths, joint limits and velocity limits are used.

    Raises:
        TypeError: `path` has no method ``points``.
        ValueError: `duration` or `elbow_sign` is out of range, or the path is out of reach, too close to a singular
            configuration (`_SINGULARITY_MARGIN`), or outside the limits of the joints or of their velocities.

    Examples:
        >>> sample = JointReference(Circle(radius=0.1), duration=2.0).sample(2.0)
        >>> float(abs(sample.dq).max())
        0.0
    """

    path: TipPath = dataclasses.field(default_factory=Circle)
    duration: float = 1.5
    elbow_sign: int = 1
    parameters: ArmParameters = dataclasses.field(default_factory=ArmParameters)

    def __post_init__(self) -> None:
        checks.instance("parameters", self.parameters, ArmParameters)
        if not checks.is_real(self.elbow_sign) or self.elbow_sign not in (1, -1):
            raise ValueError(
                f"elbow_sign = {checks.shown(self.elbow_sign)} is out of range; allowed: 1 (q2 > 0) or -1 (q2 < 0)"
            )
        t = self.checked_instants(2)
        _check_reach(t, self.tip(t).position, self.parameters.length)
        motion = self.sample(t)
        low, high, speed, _ = bounds_of(self.parameters)
        names = [f"joint{number}" for number in range(1, self.joints + 1)]
        advice = "Move the path, choose the other elbow_sign, or raise the joint_limit of the parameters"
        check_limits(names, (low, high, speed), t, motion._replace(q=np.unwrap(motion.q, axis=0)), advice)

    def sample(self, t: ArrayLike) -> ReferenceSample:
        """Return q, q̇ = J⁻¹ ṗ and q̈ = J⁻¹ (p̈ - J̇ q̇), shapes (..., 2), at times t [s] of shape (...,)."""
        position, velocity, acceleration = along(self.path, t, self.duration)
        length = self.parameters.length
        q = joint_angles(position, length, self.elbow_sign)
        jacobian = tip_jacobian(q, length)
        dq = solved(jacobian, velocity)
        # J̇ q̇ is centripetal: each link, at angle φ and turning at ω, adds -L ω² (cos φ, sin φ).
        phi, omega = np.cumsum(q, axis=-1), np.cumsum(dq, axis=-1)
        pull = np.array(length) * omega**2
        centripetal = -np.stack([np.sum(pull * np.cos(phi), axis=-1), np.sum(pull * np.sin(phi), axis=-1)], axis=-1)
        return ReferenceSample(q, dq, solved(jacobian, acceleration - centripetal))

    def normals(self, t: ArrayLike) -> np.ndarray:
        """Return the left unit normals of the path, (..., 2), at times t [s] of shape (...,)."""
        _, derivative, _ = self.path.points(quintic_time_law(t, self.duration)[0])
        length = np.hypot(derivative[..., 0], derivative[..., 1])[..., np.newaxis]
        return np.stack([-derivative[..., 1], derivative[..., 0]], axis=-1) / length


def joint_angles(position: np.ndarray, length: tuple[float, float], elbow_sign: int) -> np.ndarray:
    """Return the joint angles [rad] that put the tip at `position` [m], both of shape (..., 2): the inverse of (26).

    With r = |p|: q2 = ±2 atan sqrt(((L1 + L2)² - r²) / (r² - (L1 - L2)²)), with the sign `elbow_sign`; q1 is the angle
    of p in the frame of the bent arm, in [-π, π], and within the joint limits never crosses the branch cut. Both angles
    are nan where r is outside [|L1 - L2|, L1 + L2].
    """
    x, y = position[..., 0], position[..., 1]
    r, outer, inner = np.hypot(x, y), length[0] + length[1], abs(length[0] - length[1])
    with np.errstate(invalid="ignore"):
        folded, stretched = np.sqrt((outer - r) * (outer + r)), np.sqrt((r - inner) * (r + inner))
    q2 = elbow_sign * 2.0 * np.arctan2(folded, stretched)
    # The tip of the arm with q1 = 0; q1 turns it onto p.
    x0, y0 = length[0] + length[1] * np.cos(q2), length[1] * np.sin(q2)
    return np.stack([np.arctan2(y * x0 - x * y0, x * x0 + y * y0), q2], axis=-1)


def _check_points(path: TipPath, s: np.ndarray, size: int) -> None:
    """Raise TypeError or ValueError unless `path`, at s (k,), returns p, dp/ds and d²p/ds² as arrays (k, `size`)."""
    parts = path.points(s)
    if not isinstance(parts, tuple | list) or len(parts) != 3 or not all(isinstance(one, np.ndarray) for one in parts):
        raise TypeError(f"path.points(s) returned {checks.shown(parts)}; needed: three NumPy arrays p, dp/ds, d²p/ds²")
    for name, part in zip(("p", "dp/ds", "d²p/ds²"), parts, strict=True):
        if part.shape != (*s.shape, size):
            found = f"{name} of shape {part.shape} for s of shape {s.shape}"
            raise ValueError(f"path.points(s) returned {found}; needed: shape {(*s.shape, size)}")
        if part.dtype.kind not in "fiu":
            raise TypeError(f"path.points(s) returned {name} = {checks.shown(part)}; needed: real numbers [m]")
    if not all(np.isfinite(part).all() for part in parts[1:]):  # p is checked with the reach
        raise ValueError("path.points(s) returned derivatives that are not finite")


def _check_reach(t: np.ndarray, position: np.ndarray, length: tuple[float, float]) -> None:
    """Raise ValueError unless links of `length` [m] reach all points (k, 2) [m], at t [s], away from singularities."""
    distance = np.hypot(position[:, 0], position[:, 1])
    most_folded, most_stretched = [0.0, math.pi - _SINGULARITY_MARGIN], [0.0, _SINGULARITY_MARGIN]
    low, high = np.linalg.norm(tip_position(np.array([most_folded, most_stretched]), length), axis=-1)
    outside = ~((low < distance) & (distance < high))  # nan counts as outside
    if outside.any():
        k = int(np.argmax(outside))
        raise ValueError(
            f"the path leaves the reach of the arm at t = {t[k]:.4g} s: point ({position[k, 0]:.6g}, "
            f"{position[k, 1]:.6g}) m is {distance[k]:.6g} m from the base; allowed: ({low:.6g}, {high:.6g}) m. "
            f"The arm reaches {abs(length[0] - length[1]):g} to {length[0] + length[1]:g} m from its base, and a "
            f"margin of {_SINGULARITY_MARGIN} rad in q2 is kept at both limits. Move or shrink the path"
        )


def check_limits(
    names: Sequence[str],
    limits: tuple[np.ndarray, np.ndarray, np.ndarray],
    t: np.ndarray,
    motion: ReferenceSample,
    advice: str,
) -> None:
    """Raise ValueError if an angle [rad] leaves its joint's range or a velocity [rad/s] exceeds its limit.

    `limits` are lowest and highest angles and largest velocities, each (n,). The motion is (k, n) at times t (k,) [s];
    the last time is the duration. The message suggests a remedy: for an angle, `advice`.
    """
    (low, high, speed), duration = limits, float(t[-1])
    beyond = np.maximum(motion.q - high, low - motion.q)
    k, joint = map(int, np.unravel_index(np.argmax(beyond), beyond.shape))
    if beyond[k, joint] > 0.0:
        first = int(np.argmax(beyond[:, joint] > 0.0))
        raise ValueError(
            f"{names[joint]} leaves its range at t = {t[first]:.4g} s and is farthest outside at t = {t[k]:.4g} s: "
            f"its angle is {motion.q[k, joint]:.6g} rad there, {beyond[k, joint]:.3g} rad beyond the limit; allowed: "
            f"[{low[joint]:.6g}, {high[joint]:.6g}] rad. {advice}"
        )
    share = np.abs(motion.dq) / speed
    k, joint = map(int, np.unravel_index(np.argmax(share), share.shape))
    if share[k, joint] > 1.0:
        needed = math.ceil(duration * share[k, joint] * 1000.0) / 1000.0
        raise ValueError(
            f"{names[joint]} turns at {motion.dq[k, joint]:.6g} rad/s at t = {t[k]:.4g} s, "
            f"{100.0 * (share[k, joint] - 1.0):.3g} % beyond its velocity limit; allowed: [-{speed[joint]:g}, "
            f"{speed[joint]:g}] rad/s. Raise duration = {duration:g} s to {needed:.3f} s or more"
        )
