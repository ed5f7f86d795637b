"""The rigid arm from a log: weighted linear least squares on the inverse dynamics.

With motor and link as one body, the torques are linear in nine base parameters π:

    Γ = Y(q, q̇, q̈) π,    π = (c1 + I_a1, m2 r2, c3, I_a2, m1 r1 + m2 L1, f_v1, f_v2, Γ_fc1, Γ_fc2)

with c1 and c3 of (3). The lengths and gravity are known; c1 and I_a1 appear only as a sum while nothing bends.
Samples of a joint that is slower than three Stribeck velocities of the start are left out of its equation.

A vector θ holds the parameters that a log of the motors may determine. Lengths, masses and gravity keep the values of
the start: eight numbers describe two links in a plane, and the torques of the motors depend on four combinations of
them only, m1 r1² + I1 + m2 L1², m2 r2² + I2, m1 r1 + m2 L1 and m2 r2. Measured lengths and masses give the other four;
mass centers and moments of inertia follow.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.dynamics import Plant, lump, plant_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, flat
from fuzzyarm.identification.log import Motion

__all__ = [
    "BASE", "KEPT", "UNKNOWNS", "RigidFit", "arm_of", "base_of", "bounds_of", "constants_of", "fit_rigid", "regressor",
    "rigid_arm", "start_of",
]  # fmt: skip

_SMALLEST = 1e-9  # share of the scale of a parameter that must be positive


class _Unknown(NamedTuple):
    """A number of the arm that a log may determine: a field of `ArmParameters`, and the joint (None: both)."""

    field: str
    joint: int | None

    @property
    def name(self) -> str:
        """The field with its index, as in the messages of `ArmParameters`."""
        return self.field if self.joint is None else f"{self.field}[{self.joint}]"

    @property
    def unit(self) -> str:
        fields = {field.name: field for field in dataclasses.fields(ArmParameters)}
        return str(fields[self.field].metadata["unit"])


# A slow, strong motion of both joints determines the first five fields already; a log that does not is refused.
_FIELDS = (
    "inertia", "mass_center", "motor_inertia", "viscous_friction", "coulomb_friction",
    "static_friction", "stiffness", "damping",
)  # fmt: skip
UNKNOWNS = (*(_Unknown(field, joint) for field in _FIELDS for joint in (0, 1)), _Unknown("stribeck_velocity", None))
"""In the order of θ, shape (17,)."""

KEPT = tuple(f.name for f in dataclasses.fields(ArmParameters) if f.name not in {one.field for one in UNKNOWNS})
"""Fields that no log of the motors determines; they keep the values of the start."""


def start_of(arm: ArmParameters) -> np.ndarray:
    """Return θ of an arm, shape (17,), each entry in its unit."""
    return np.array([np.atleast_1d(getattr(arm, one.field))[one.joint or 0] for one in UNKNOWNS], dtype=float)


def bounds_of(arm: ArmParameters, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper bounds of θ, (17,) each: above 0; a mass center lies within its link or at the start's."""
    low, high = _SMALLEST * scale, np.full(len(UNKNOWNS), np.inf)
    for k, one in enumerate(UNKNOWNS):
        if one.field == "mass_center" and one.joint is not None:
            high[k] = max(arm.length[one.joint], arm.mass_center[one.joint])
    return low, high


def arm_of(theta: np.ndarray, arm: ArmParameters) -> ArmParameters:
    """Return `arm` with the entries of θ (17,); static friction is raised to Coulomb friction where it is below it.

    ValueError: an entry is out of range for `ArmParameters`.
    """
    values: dict[str, Any] = {}
    for one, number in zip(UNKNOWNS, theta.tolist(), strict=True):
        if one.joint is None:
            values[one.field] = number
        else:
            values[one.field] = (*values.get(one.field, ()), number)
    pairs = zip(values["static_friction"], values["coulomb_friction"], strict=True)
    values["static_friction"] = tuple(max(static, coulomb) for static, coulomb in pairs)
    return dataclasses.replace(arm, **values)


def constants_of(theta: np.ndarray, arm: ArmParameters) -> np.ndarray:
    """Return the constants of the equations, rows of `dynamics.Arm`, (21, lanes), for θ of shape (17, lanes)."""
    fields: dict[str, Any] = plant_of(arm)._asdict()
    for field in dict.fromkeys(one.field for one in UNKNOWNS):
        rows = [row for one, row in zip(UNKNOWNS, theta, strict=True) if one.field == field]
        fields[field] = PerJoint(*rows) if len(rows) > 1 else rows[0]
    rows = flat(lump(Plant(**fields)))
    return np.stack([np.broadcast_to(np.asarray(row, dtype=float), theta.shape[1:]) for row in rows])


BASE = (
    "inertia[0]", "mass_center[1]", "inertia[1]", "motor_inertia[1]", "mass_center[0]", "viscous_friction[0]",
    "viscous_friction[1]", "coulomb_friction[0]", "coulomb_friction[1]",
)  # fmt: skip
"""The arm parameter that each entry of π determines if the other parameters are known."""

_SLOWEST = 3.0  # Stribeck velocities
# A joint has to be faster at this share of the samples, forwards and backwards; otherwise the log says nothing of it.
_LEAST_MOVING = 0.02
# A base parameter counts as undetermined if its standard error is above a third of it and moves the torque by more than
# this share of its own root mean square.
_LEAST_SHARE = 1e-2
_PASSES = 3
_LEAST_INERTIA = 0.05  # share of what its link would have as a rod, where least squares give less than nothing


class RigidFit(NamedTuple):
    """The estimate by least squares."""

    base: np.ndarray  # π, (9,)
    error: np.ndarray  # standard errors of π, (9,)
    condition: float  # condition number of Y with columns of length 1 and rows in units of the noise
    residual: np.ndarray  # root mean square of Γ - Y π of each joint [N m], (2,)
    undetermined: tuple[str, ...]  # names of `BASE` that the motion does not excite


def regressor(
    q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, length: float, gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of Y for torque 1 and for torque 2, (N, 9) each, for q, q̇ and q̈ (N, 2), L1 [m] and g [m/s²]."""
    q1, q2 = q.T
    v1, v2 = dq.T
    a1, a2 = ddq.T
    cos2, sin2, sin12, none = np.cos(q2), np.sin(q2), np.sin(q1 + q2), np.zeros_like(q1)
    turned = length * (cos2 * (2.0 * a1 + a2) - sin2 * v2 * (2.0 * v1 + v2)) + gravity * sin12
    pulled = length * (cos2 * a1 + sin2 * v1 * v1) + gravity * sin12
    first = (a1, turned, a2, none, gravity * np.sin(q1), v1, none, np.sign(v1), none)
    second = (none, pulled, a1 + a2, a2, none, none, v2, none, np.sign(v2))
    return np.stack(first, axis=-1), np.stack(second, axis=-1)


def base_of(arm: ArmParameters) -> np.ndarray:
    """Return π of an arm, shape (9,)."""
    (m1, m2), (r1, r2), (i1, i2), l1 = arm.mass, arm.mass_center, arm.inertia, arm.length[0]
    (ia1, ia2), c3 = arm.motor_inertia, m2 * r2 * r2 + i2
    links = m1 * r1 * r1 + i1 + m2 * l1 * l1 + c3 + ia1, m2 * r2, c3, ia2, m1 * r1 + m2 * l1
    return np.array([*links, *arm.viscous_friction, *arm.coulomb_friction])


def fit_rigid(motion: Motion, start: ArmParameters) -> RigidFit:
    """Return the base parameters of a motion, each joint's equations weighted by their own residual."""
    q, dq, ddq = (part[motion.settled] for part in (motion.q, motion.dq, motion.ddq))
    rows = regressor(q, dq, ddq, start.length[0], start.gravity)
    fast = np.abs(dq) > _SLOWEST * start.stribeck_velocity
    torque = motion.torque[motion.settled]
    kept = [fast[:, joint] | ~fast[:, joint].any() for joint in range(2)]
    parts = [(rows[joint][kept[joint]], torque[kept[joint], joint]) for joint in range(2)]
    noise = np.array([max(float(np.std(part)), 1e-12) for _, part in parts])
    for _ in range(_PASSES):
        stacked = np.concatenate([y / sigma for (y, _), sigma in zip(parts, noise, strict=True)])
        known = np.concatenate([value / sigma for (_, value), sigma in zip(parts, noise, strict=True)])
        size = np.linalg.norm(stacked, axis=0)
        exciting = np.count_nonzero(size)
        size[size == 0.0] = 1.0
        scaled, _, _, singular = np.linalg.lstsq(stacked / size, known, rcond=1e-12)
        base = scaled / size
        found = [float(np.sqrt(np.mean((value - y @ base) ** 2))) for y, value in parts]
        noise = np.maximum(found, 1e-9 * np.maximum([np.abs(value).max() for _, value in parts], 1e-9))
    share = motion.independent / len(torque)
    information = (stacked / size).T @ (stacked / size) * share
    error = np.sqrt(np.abs(np.diag(np.linalg.pinv(information, rcond=1e-14, hermitian=True)))) / size
    moves = error * size / np.linalg.norm(known)
    undetermined = (error > np.abs(base) / 3.0) & (moves > _LEAST_SHARE)
    for joint in range(2):
        ways = [np.mean(fast[:, joint] & (side * dq[:, joint] > 0.0)) for side in (-1.0, 1.0)]
        undetermined |= (min(ways) < _LEAST_MOVING) & np.array([f"[{joint}]" in name for name in BASE])
    condition = float(singular[0] / max(singular[exciting - 1], 1e-300))
    return RigidFit(base, error, condition, np.array(found), tuple(np.array(BASE)[undetermined].tolist()))


def rigid_arm(base: np.ndarray, start: ArmParameters) -> ArmParameters:
    """Return the arm with base parameters π (9,), the rest as in `start`.

    The motor's share of c1 + I_a1, and the ratio of static to Coulomb friction, are those of `start`. Impossible values
    (an inertia below 0, a mass center beyond the link unless that of `start` is) are moved into the range in which the
    refinement may begin.
    """
    total, mr2, c3, rotor2, mr1, *friction = base.tolist()
    (m1, m2), (l1, l2), before = start.mass, start.length, float(base_of(start)[0])
    rotor1 = start.motor_inertia[0] / before * total
    r2 = min(max(mr2 / m2, 0.02 * l2), max(0.98 * l2, start.mass_center[1]))
    r1 = min(max((mr1 - m2 * l1) / m1, 0.02 * l1), max(0.98 * l1, start.mass_center[0]))
    i2 = max(c3 - m2 * r2 * r2, _LEAST_INERTIA * m2 * l2 * l2 / 12.0)
    i1 = max(total - rotor1 - c3 - m2 * l1 * l1 - m1 * r1 * r1, _LEAST_INERTIA * m1 * l1 * l1 / 12.0)
    viscous1, viscous2, coulomb1, coulomb2 = (max(value, 0.0) for value in friction)
    ratio1, ratio2 = (
        static / dry if dry > 0.0 else 1.0
        for static, dry in zip(start.static_friction, start.coulomb_friction, strict=True)
    )
    return dataclasses.replace(
        start,
        inertia=(i1, i2),
        mass_center=(r1, r2),
        motor_inertia=(max(rotor1, 1e-6), max(rotor2, 1e-3 * max(c3, 1e-6))),
        viscous_friction=(viscous1, viscous2),
        coulomb_friction=(coulomb1, coulomb2),
        static_friction=(coulomb1 * ratio1, coulomb2 * ratio2),
    )
