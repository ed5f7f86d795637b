"""The rigid arm from logs: weighted linear least squares on the inverse dynamics, and the vector θ of the parameters.

With motor and link as one body, the torques are linear in nine base parameters π, none of which is negative:

    Γ = Y(q, q̇, q̈) π,    π = (c1 + I_a1, m2 r2, c3, I_a2, m1 r1 + m2 L1, f_v1, f_v2, Γ_fc1, Γ_fc2)

with c1 and c3 of `dynamics.Arm`. Lengths and gravity are known. Samples at which a joint is slow are left out of
that joint's equation. The noise of a torque includes a share of each of its terms; samples that fit badly have less
weight (Huber). The starting arm is a prior for the first five entries, with a standard deviation of half the value, or
twice it for I_a2.

The vector θ contains the parameters that logs of the motors can determine. Lengths, masses and gravity keep their
starting values: eight parameters describe two links in a plane, but the motors' torques depend only on four
combinations, m1 r1² + I1 + m2 L1², m2 r2² + I2, m1 r1 + m2 L1 and m2 r2.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from fuzzyarm.envs.physics.dynamics import Arm, Plant, lump, plant_of, rigid_inverse_dynamics
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.records import PerJoint, filled, flat, size
from fuzzyarm.identification.log import Motion

__all__ = [
    "UNKNOWNS", "arm_of", "base_of", "constants_of", "fit_rigid", "regressor", "rigid_arm", "rotor_share", "start_of",
    "static_ratio",
]  # fmt: skip


class _Unknown(NamedTuple):
    """A parameter of the arm that a log may determine: a field of `ArmParameters`, and the joint (None: both)."""

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


_FIELDS = (
    "inertia", "mass_center", "motor_inertia", "viscous_friction", "coulomb_friction",
    "static_friction", "stiffness", "damping",
)  # fmt: skip
UNKNOWNS = (*(_Unknown(field, joint) for field in _FIELDS for joint in (0, 1)), _Unknown("stribeck_velocity", None))
"""The entries of θ (17,), in order."""


def start_of(arm: ArmParameters) -> np.ndarray:
    """Return the vector θ (17,) of an arm: the values of `UNKNOWNS`, each in its unit."""
    return np.array([np.atleast_1d(getattr(arm, one.field))[one.joint or 0] for one in UNKNOWNS], dtype=float)


def arm_of(theta: np.ndarray, arm: ArmParameters) -> ArmParameters:
    """Return `arm` with its parameters replaced by θ (17,); static friction below Coulomb friction is raised to it.

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
    """Return the constants of the equations of motion (21, lanes), as listed in `dynamics.Arm`, for θ (17, lanes)."""
    fields: dict[str, Any] = plant_of(arm)._asdict()
    for field in dict.fromkeys(one.field for one in UNKNOWNS):
        rows = [row for one, row in zip(UNKNOWNS, theta, strict=True) if one.field == field]
        fields[field] = PerJoint(*rows) if len(rows) > 1 else rows[0]
    rows = flat(lump(Plant(**fields)))
    return np.stack([np.broadcast_to(np.asarray(row, dtype=float), theta.shape[1:]) for row in rows])


_SLOWEST = 0.1  # rad/s, least speed of a joint
_FEWEST = 10  # samples of a joint
_LIKELY, _LIKELY_ROTOR = 0.5, 2.0  # standard deviations of the prior, as shares of its values
_LEAST_NOISE, _TURN_NOISE = 0.02, 0.04  # noise: share of the largest torque; share of each term of a torque
_HUBER = 2.5  # standard deviations
_PASSES = 4
_MEDIAN_SQUARE = 0.455  # of a standard normal variable
_INERTIAL, _ROTOR = 5, 3  # number of entries of π before those of friction; index of rotor 2
_LEAST = 1e-3  # lower bound of a positive parameter, in scales


def rotor_share(arm: ArmParameters) -> float:
    """Return the share [0, 1] of rotor 1 in the inertia of rotor and link 1, which no log of a rigid arm determines."""
    return arm.motor_inertia[0] / (arm.motor_inertia[0] + arm.inertia[0])


def static_ratio(arm: ArmParameters) -> np.ndarray:
    """Return the ratio of static to Coulomb friction of each joint, (2,); 1 without friction."""
    static, coulomb = np.array(arm.static_friction), np.array(arm.coulomb_friction)
    return np.asarray(np.divide(static, coulomb, out=np.ones(2), where=coulomb > 0.0))


def regressor(
    q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, length: float, gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of Y in Γ = Y π for torques 1 and 2, (N, 9) each, for q, q̇ and q̈ (N, 2), L1 [m] and g [m/s²].

    Column k is the torque when base parameter k is 1 and all other base parameters are 0.
    """
    nothing = filled(Arm, np.zeros(size(Arm)))
    ones = ({"c1": 1.0}, {"c2": length, "c5": gravity}, {"c3": 1.0}, {"c4": gravity})
    links = [rigid_inverse_dynamics(q, dq, ddq, nothing._replace(**one)) for one in ones]
    links.insert(3, ddq * [0.0, 1.0])  # the rotor of joint 2
    friction = [part * own for part in (dq, np.sign(dq)) for own in ([1.0, 0.0], [0.0, 1.0])]
    first, second = np.stack([*links, *friction], axis=-1).swapaxes(0, 1)
    return first, second


def base_of(arm: ArmParameters) -> np.ndarray:
    """Return the base parameters π (9,) of an arm, in SI units and the order in the docstring of the module."""
    constants = lump(plant_of(arm))
    (m1, m2), (r1, r2) = arm.mass, arm.mass_center
    rotor1, rotor2 = arm.motor_inertia
    links = constants.c1 + rotor1, m2 * r2, constants.c3, rotor2, m1 * r1 + m2 * arm.length[0]
    return np.array([*links, *arm.viscous_friction, *arm.coulomb_friction])


def fit_rigid(motions: Sequence[Motion], start: ArmParameters) -> np.ndarray:
    """Return the base parameters π (9,) that fit motions of one arm, with the lengths and gravity of `start`."""
    prior, largest = base_of(start), max(float(np.std(motion.torque)) for motion in motions)
    samples = []  # for each motion and joint: rows of Y, torques, and the weight of a sample
    for motion in motions:
        every = max(1, int((motion.settled.stop - motion.settled.start) / (2.0 * motion.independent)))
        q, dq, ddq, torque = (part[motion.settled][::every] for part in motion[:4])
        for joint, Y in enumerate(regressor(q, dq, ddq, start.length[0], start.gravity)):
            moving = np.abs(dq[:, joint]) > _SLOWEST
            if np.sum(moving) >= _FEWEST:
                samples.append((Y[moving], torque[moving, joint], motion.independent / len(q)))
    likely = _LIKELY * prior[:_INERTIAL]
    likely[_ROTOR] = _LIKELY_ROTOR * prior[_ROTOR]
    base, scale = prior, 1.0
    for k in range(_PASSES):
        normal, gain, squares = np.zeros((len(prior), len(prior))), np.zeros(len(prior)), [np.zeros(0)]
        for Y, torque, counts in samples:
            turn = np.sqrt(np.sum((Y[:, :_INERTIAL] * base[:_INERTIAL]) ** 2, axis=1))
            noise = np.hypot(_LEAST_NOISE * largest, _TURN_NOISE * turn)
            residual = np.abs(torque - Y @ base) / noise
            squares.append(residual**2)
            weight = counts / (noise * scale) ** 2
            if k:
                weight *= np.minimum(1.0, _HUBER * scale / np.maximum(residual, 1e-9))
            normal += (Y.T * weight) @ Y
            gain += Y.T @ (weight * torque)
        normal[range(_INERTIAL), range(_INERTIAL)] += likely**-2
        gain[:_INERTIAL] += prior[:_INERTIAL] / likely**2
        sizes = np.sqrt(np.diag(normal))
        sizes[sizes == 0.0] = 1.0  # friction of a joint at rest
        lower = np.linalg.cholesky(normal / np.outer(sizes, sizes) + 1e-9 * np.eye(len(sizes)))
        base = nnls(lower.T, np.linalg.solve(lower, gain / sizes), maxiter=500)[0] / sizes
        if k and samples:
            scale = max(float(np.sqrt(np.median(np.concatenate(squares)) / _MEDIAN_SQUARE)), 1e-3)
    return base


def rigid_arm(base: np.ndarray, start: ArmParameters) -> ArmParameters:
    """Return the arm with base parameters π (9,) and other parameters as in `start`.

    The share of rotor 1 in the sum of the inertias of rotor 1 and link 1, and the ratio of static to Coulomb friction,
    are those of `start`. Impossible values are moved to the nearest possible ones.
    """
    total, mr2, c3, rotor2, mr1, *friction = base.tolist()
    (m1, m2), (l1, l2), share = start.mass, start.length, rotor_share(start)
    r2, r1 = max(mr2 / m2, _LEAST * l2), max((mr1 - m2 * l1) / m1, _LEAST * l1)
    i2 = max(c3 - m2 * r2 * r2, _LEAST * c3, 1e-12)
    own = max(total - m2 * r2 * r2 - i2 - m2 * l1 * l1 - m1 * r1 * r1, _LEAST * total, 1e-12)
    viscous1, viscous2, *coulomb = friction
    static = tuple(dry * ratio for dry, ratio in zip(coulomb, static_ratio(start), strict=True))
    return dataclasses.replace(
        start,
        inertia=((1.0 - share) * own, i2),
        mass_center=(r1, r2),
        motor_inertia=(share * own, max(rotor2, _LEAST * c3, 1e-12)),
        viscous_friction=(viscous1, viscous2),
        coulomb_friction=tuple(coulomb),
        static_friction=static,
    )
