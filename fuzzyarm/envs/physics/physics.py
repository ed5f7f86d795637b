"""The equations of one kind of arm, as the environment uses them: everything that is stepped is made from them.

`two_joints` has the equations of the paper's arm, written by hand.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from fuzzyarm.envs.physics.friction import DRY_TORQUES
from fuzzyarm.envs.physics.records import per_joint, point, state_record

__all__ = ["VARIED", "Physics"]

VARIED = {
    "mass": "mass",
    "inertia": "mass",
    "motor_inertia": "motor_inertia",
    "stiffness": "stiffness",
    "damping": "damping",
    "viscous_friction": "viscous_friction",
    **dict.fromkeys(DRY_TORQUES, "dry_friction"),
}
"""By quantity of a plant, the factor of a draw that multiplies it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Physics:
    """The equations of motion of arms of one structure, and the records they are written with.

    All functions are elementwise, see `elementwise`: the same lines take numbers, arrays and tensors of lanes, and are
    compiled into kernels. Forces on the tip are a `Point` [N], torques a `PerJoint` [N m], angles a `PerJoint` [rad].

    Attributes:
        joints: their number n.
        axes: of the tip's space, 2 or 3.
        digest: text that tells compiled functions of these equations from those of others.
        made_by: a function and its arguments that return this very object: copies and pickles hold these.
        Plant: record of what domain randomisation multiplies, and of limits; the parameters of an arm.
        Arm: record of the constants that the equations use.
        Limits: record of the limits of angles [rad], velocities [rad/s] and torques [N m].
        plant_of: returns the `Plant` (floats) of an arm's parameters.
        step: ``step(state, torque, force, arm, h)``, the `State` a sub-step h [s] later.
        loaded_step: ``loaded_step(state, torque, load, arm, h)``, the same with torques on the links for the tip force.
        tip: ``tip(angles, arm)``, the `Point` of the tip [m].
        tip_velocity: ``tip_velocity(angles, rates, arm)``, the `Point` of its velocity [m/s].
        tip_load: ``tip_load(angles, force, arm)``, J(q)ᵀ F of a force on the tip.
        gravity: ``gravity(angles, arm)``, g(q).
        motor_friction: ``motor_friction(state, torque, bias, arm)``, Γ_f of the motors.
        inverse_dynamics: ``inverse_dynamics(angles, rates, accelerations, arm)``, M(q) q̈ + C(q, q̇) q̇ + g(q).
        mass_matrix: ``mass_matrix(angles, arm)``, M(q) [kg m²], a tuple of rows.
        payload_place: returns where a payload is on an arm with given parameters, as one number for `constants`.
        constants: ``constants(plant, payload, place, tip_payload)``, those of the plant with a point mass [kg] at a
            place and another one at the tip.
        stiffness: ``stiffness(plant)``, of the joints [N m/rad].
        limits: ``limits(plant)``.
        angle_range: ``angle_range(limits)``, the lowest and the highest angles.
        varied: ``varied(plant, draw)``, the plant with the factors of a `randomisation.draw_record`.
        PerJoint: record of one number for each joint.
        Point: record of a vector in the tip's space.
        State: record of motor and link angles and their velocities.
    """

    joints: int
    axes: int
    digest: str
    made_by: tuple[Callable[..., Physics], tuple[Any, ...]]
    Plant: Any
    Arm: Any
    Limits: Any
    plant_of: Callable[..., Any]
    step: Callable[..., Any]
    loaded_step: Callable[..., Any]
    tip: Callable[..., Any]
    tip_velocity: Callable[..., Any]
    tip_load: Callable[..., Any]
    gravity: Callable[..., Any]
    motor_friction: Callable[..., Any]
    inverse_dynamics: Callable[..., Any]
    mass_matrix: Callable[..., Any]
    payload_place: Callable[..., float]
    constants: Callable[..., Any]
    stiffness: Callable[..., Any]
    limits: Callable[..., Any]
    angle_range: Callable[..., Any]
    varied: Callable[..., Any]
    PerJoint: Any = dataclasses.field(init=False)
    Point: Any = dataclasses.field(init=False)
    State: Any = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        """Take the records of so many joints and axes; attributes, because torch compiles no look-up in a cache."""
        for name, kind in (("PerJoint", per_joint), ("State", state_record)):
            object.__setattr__(self, name, kind(self.joints))
        object.__setattr__(self, "Point", point(self.axes))

    def __reduce__(self) -> tuple[Callable[..., Physics], tuple[Any, ...]]:
        """Leave the functions behind."""
        return self.made_by
