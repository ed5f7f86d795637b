"""Rigid-body and joint dynamics of the arm, equations (1) to (3) with the signs of the descriptor form (5).

Angles are measured from the hanging position: the x axis of (26) points down and gravity pulls along +x.
All equations are written for single numbers and for arrays, see `friction`.
"""

import dataclasses
import functools
from collections.abc import Sized
from typing import Any, Literal, NamedTuple

import numpy as np

from fuzzyarm.common import checks
from fuzzyarm.envs.physics.friction import DryFriction, dry_friction_of, friction_torque
from fuzzyarm.envs.physics.parameters import ArmParameters, keep_quantities, quantity
from fuzzyarm.envs.physics.records import PerJoint, record_type

__all__ = [
    "Arm", "Motor", "Payload", "Plant", "arm_constants", "coriolis_torque", "gravity_torque",
    "inertia_and_gravity", "joint_torque", "loaded", "lump", "mass_matrix", "motor_friction", "motors", "plant_of",
    "rigid_inverse_dynamics", "solve_mass_matrix", "tip_force_torque", "tip_jacobian", "tip_position",
]  # fmt: skip

_PLACES = ("tip", "link")


@dataclasses.dataclass(frozen=True)
class Payload:
    """A point mass on link 2, unknown to the controller (Case 3).

    On the two-joint arm, any object with `mass` and ``radius(arm)``, its distance [m] from joint 2, is a payload.

    Attributes:
        mass: carried mass [kg], >= 0.
        at: ``"tip"``, a point mass at the end of link 2, or ``"link"``, added to m_2 at its mass center r_2
            (the other reading of "a variation of the effector mass m_2 of 55.6 %").
    """

    mass: float = quantity("kg", 0.0, low=0.0)
    at: Literal["tip", "link"] = "tip"

    def __post_init__(self) -> None:
        keep_quantities(self, "payload ")
        checks.choice("payload at", self.at, _PLACES)

    def radius(self, parameters: ArmParameters) -> float:
        """Return the distance of the payload from joint 2 [m] on a given arm."""
        return parameters.length[1] if self.at == "tip" else parameters.mass_center[1]


class Motor(NamedTuple):
    """A motor, its friction and its spring; in an `Arm`, the names of these fields end in the joint number."""

    motor_inertia: Any  # I_a [kg m²]
    viscous: Any  # f_v [N m s/rad]
    stiffness: Any  # k_t [N m/rad]
    damping: Any  # b_t [N m s/rad]
    dry_friction: DryFriction  # parameters of its friction curve


class Arm(NamedTuple):
    """The constants that the equations of motion use; each entry is a scalar or an array with one value per lane.

    c1..c3 are the inertias of the mass matrix [kg m²], c4 and c5 the gravity torques [N m]. Then follow motor inertias
    [kg m²], viscous friction [N m s/rad], stiffness [N m/rad] and damping [N m s/rad], `DryFriction`, lengths [m].
    """

    c1: Any
    c2: Any
    c3: Any
    c4: Any
    c5: Any
    motor_inertia1: Any
    motor_inertia2: Any
    viscous1: Any
    viscous2: Any
    stiffness1: Any
    stiffness2: Any
    damping1: Any
    damping2: Any
    dry_friction1: DryFriction
    dry_friction2: DryFriction
    length1: Any
    length2: Any


_UNLOADED = Arm._fields.index("motor_inertia1")  # a payload changes neither this field nor those after it

Plant: Any = record_type(
    "Plant", **{f.name: PerJoint if isinstance(f.default, tuple) else Any for f in dataclasses.fields(ArmParameters)}
)
"""The fields of `ArmParameters` in their order; every number a scalar, or an array with one value per lane."""


def inertia_and_gravity(length: Any, mass: Any, mass_center: Any, inertia: Any, gravity: Any) -> tuple[Any, ...]:
    """Return c1..c5 of (3) from pairs of length L, mass m, mass center r and inertia I, numbers of any type.

    c1 = m1 r1² + I1 + m2 L1² + m2 r2² + I2, c2 = m2 L1 r2, c3 = m2 r2² + I2, c4 = m1 g r1 + m2 g L1, c5 = m2 g r2.
    """
    (l1, _), (m1, m2), (r1, r2), (i1, i2) = length, mass, mass_center, inertia
    c3 = m2 * r2 * r2 + i2
    return (
        m1 * r1 * r1 + i1 + m2 * l1 * l1 + c3,
        m2 * l1 * r2,
        c3,
        m1 * gravity * r1 + m2 * gravity * l1,
        m2 * gravity * r2,
    )


def lump(plant: Any) -> Arm:
    """Return the `Arm` of a plant without payload: c1..c5 of (3), then its other constants."""
    c1, c2, c3, c4, c5 = inertia_and_gravity(plant.length, plant.mass, plant.mass_center, plant.inertia, plant.gravity)
    return Arm(
        c1, c2, c3, c4, c5, plant.motor_inertia[0], plant.motor_inertia[1], plant.viscous_friction[0],
        plant.viscous_friction[1], plant.stiffness[0], plant.stiffness[1], plant.damping[0], plant.damping[1],
        dry_friction_of(plant, 0), dry_friction_of(plant, 1), plant.length[0], plant.length[1],
    )  # fmt: skip


def loaded(arm: Arm, mass: Any, radius: Any, gravity: Any) -> Arm:
    """Return `arm` with a mass m [kg] at r [m] from joint 2: c1..c5 plus m (L1² + r²), m L1 r, m r², m g L1, m g r."""
    length = arm.length1
    return Arm(
        arm.c1 + mass * (length * length + radius * radius),
        arm.c2 + mass * length * radius,
        arm.c3 + mass * (radius * radius),
        arm.c4 + mass * gravity * length,
        arm.c5 + mass * gravity * radius,
        *arm[_UNLOADED:],
    )


def arm_constants(parameters: ArmParameters, payload: Payload | None = None) -> Arm:
    """Return the `Arm` of these parameters with a payload, see `lump` and `loaded`."""
    arm = _unloaded(parameters)
    if payload is not None:
        arm = loaded(arm, payload.mass, payload.radius(parameters), parameters.gravity)
    return arm


@functools.lru_cache(maxsize=64)
def _unloaded(parameters: ArmParameters) -> Arm:
    """Return the `Arm` of these parameters without payload; cached, because simulations need it at every step."""
    arm: Arm = lump(plant_of(parameters))
    return arm


def plant_of(parameters: ArmParameters) -> Any:
    """Return the parameters as a `Plant`, the form used by the equations."""
    values = (getattr(parameters, field.name) for field in dataclasses.fields(parameters))
    return Plant(*(PerJoint(*value) if isinstance(value, tuple) else value for value in values))


def mass_matrix(cos2: Any, arm: Arm) -> tuple[Any, Any, Any]:
    """Return the entries (M11, M12, M22) of the links' mass matrix M_b [kg m²] of (3), at the cosine of q2."""
    return arm.c1 + 2.0 * arm.c2 * cos2, arm.c3 + arm.c2 * cos2, arm.c3 + 0.0 * cos2


def coriolis_torque(sin2: Any, velocity1: Any, velocity2: Any, arm: Arm) -> tuple[Any, Any]:
    """Return C(q, q̇) q̇ [N m]: (-c2 sin q2 (2 q̇1 q̇2 + q̇2²), c2 sin q2 q̇1²), the signs of (5)-(6)."""
    coupling = arm.c2 * sin2
    return -coupling * velocity2 * (2.0 * velocity1 + velocity2), coupling * velocity1 * velocity1


def gravity_torque(sin1: Any, sin12: Any, arm: Arm) -> tuple[Any, Any]:
    """Return the gravity torques g(q) = (c4 sin q1 + c5 sin q12, c5 sin q12) [N m], with q12 = q1 + q2."""
    second = arm.c5 * sin12
    return arm.c4 * sin1 + second, second


def solve_mass_matrix(cos2: Any, torque1: Any, torque2: Any, arm: Arm) -> tuple[Any, Any]:
    """Return (q̈1, q̈2) = M_b⁻¹ τ [rad/s²] for link torques τ [N m] and M_b of `mass_matrix`; `cos2` is cos q2."""
    m11, m12, m22 = mass_matrix(cos2, arm)
    inverse = 1.0 / (m11 * m22 - m12 * m12)
    return (m22 * torque1 - m12 * torque2) * inverse, (m11 * torque2 - m12 * torque1) * inverse


def tip_force_torque(
    sin1: Any, cos1: Any, sin12: Any, cos12: Any, force_x: Any, force_y: Any, arm: Arm
) -> tuple[Any, Any]:
    """Return the joint torques J(q)ᵀ F [N m] of a force F [N] on the tip, J the Jacobian of (26), q12 = q1 + q2."""
    second = arm.length2 * (cos12 * force_y - sin12 * force_x)
    return arm.length1 * (cos1 * force_y - sin1 * force_x) + second, second


def motors(arm: Any, joints: Sized) -> list[Motor]:
    """Return the motors of an arm, one for each entry of `joints`."""
    return [Motor(*(getattr(arm, f"{name}{k}") for name in Motor._fields)) for k in range(1, len(joints) + 1)]


def joint_torque(state: Any, arm: Any) -> Any:
    """Return Γ_t = K_t (q_a - q_b) + B_t (q̇_a - q̇_b) [N m], equation (2), for each joint."""
    return type(state.motor)(
        *(
            own.stiffness * (motor - link) + own.damping * (motor_velocity - link_velocity)
            for own, motor, link, motor_velocity, link_velocity in zip(motors(arm, state.motor), *state, strict=True)
        )
    )


def motor_friction(state: Any, torque: Any, bias: Any, arm: Any) -> Any:
    """Return the friction torques Γ_f [N m] of an arm's motors, given motor torques and `bias` added to them [N m]."""
    joint = joint_torque(state, arm)
    return type(joint)(
        *(
            friction_torque(velocity, given + beside - load, own.dry_friction)
            for velocity, given, beside, load, own in zip(
                state.motor_velocity, torque, bias, joint, motors(arm, joint), strict=True
            )
        )
    )


def rigid_inverse_dynamics(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, arm: Arm) -> np.ndarray:
    """Return the link torque M_b(q) q̈ + C(q, q̇) q̇ + g(q) [N m], shape (..., 2), for motions of shape (..., 2)."""
    q1, q2 = q[..., 0], q[..., 1]
    m11, m12, m22 = mass_matrix(np.cos(q2), arm)
    c1, c2 = coriolis_torque(np.sin(q2), dq[..., 0], dq[..., 1], arm)
    g1, g2 = gravity_torque(np.sin(q1), np.sin(q1 + q2), arm)
    return np.stack(
        [m11 * ddq[..., 0] + m12 * ddq[..., 1] + c1 + g1, m12 * ddq[..., 0] + m22 * ddq[..., 1] + c2 + g2], axis=-1
    )


def tip_position(q: np.ndarray, length: tuple[float, float]) -> np.ndarray:
    """Return the tip (x, y) [m] of (26), shape (..., 2), for joint angles of shape (..., 2); x points down."""
    q1, q12 = q[..., 0], q[..., 0] + q[..., 1]
    return np.stack(
        [length[0] * np.cos(q1) + length[1] * np.cos(q12), length[0] * np.sin(q1) + length[1] * np.sin(q12)], axis=-1
    )


def tip_jacobian(q: np.ndarray, length: tuple[float, float]) -> np.ndarray:
    """Return the Jacobian of the tip, J = ∂(x, y)/∂q [m], shape (..., 2, 2), at joint angles of shape (..., 2)."""
    q1, q12 = q[..., 0], q[..., 0] + q[..., 1]
    column2 = np.stack([-length[1] * np.sin(q12), length[1] * np.cos(q12)], axis=-1)
    column1 = np.stack([-length[0] * np.sin(q1), length[0] * np.cos(q1)], axis=-1) + column2
    return np.stack([column1, column2], axis=-1)
