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
    """

    joints: int  # their number n
    axes: int  # of the tip's space, 2 or 3
    digest: str  # text that tells compiled functions of these equations from those of others
    # a function and its arguments that return this very object: copies and pickles hold these
    made_by: tuple[Callable[..., Physics], tuple[Any, ...]]
    Plant: Any  # record of what domain randomisation multiplies, and of limits; the parameters of an arm
    Arm: Any  # record of the constants that the equations use
    Limits: Any  # record of the limits of angles [rad], velocities [rad/s] and torques [N m]
    plant_of: Callable[..., Any]  # returns the `Plant` (floats) of an arm's parameters
    step: Callable[..., Any]  # ``step(state, torque, force, arm, h)``, the `State` a sub-step h [s] later
    # ``loaded_step(state, torque, load, arm, h)``, the same with torques on the links for the tip force
    loaded_step: Callable[..., Any]
    tip: Callable[..., Any]  # ``tip(angles, arm)``, the `Point` of the tip [m]
    tip_velocity: Callable[..., Any]  # ``tip_velocity(angles, rates, arm)``, the `Point` of its velocity [m/s]
    tip_load: Callable[..., Any]  # ``tip_load(angles, force, arm)``, J(q)ᵀ F of a force on the tip
    gravity: Callable[..., Any]  # ``gravity(angles, arm)``, g(q)
    motor_friction: Callable[..., Any]  # ``motor_friction(state, torque, bias, arm)``, Γ_f of the motors
    # ``inverse_dynamics(angles, rates, accelerations, arm)``, M(q) q̈ + C(q, q̇) q̇ + g(q)
    inverse_dynamics: Callable[..., Any]
    mass_matrix: Callable[..., Any]  # ``mass_matrix(angles, arm)``, M(q) [kg m²], a tuple of rows
    # returns where a payload is on an arm with given parameters, as one number for `constants`
    payload_place: Callable[..., float]
    # ``constants(plant, payload, place, tip_payload)``, those of the plant with a point mass [kg] at a place
    # and another one at the tip
    constants: Callable[..., Any]
    stiffness: Callable[..., Any]  # ``stiffness(plant)``, of the joints [N m/rad]
    limits: Callable[..., Any]  # ``limits(plant)``
    angle_range: Callable[..., Any]  # ``angle_range(limits)``, the lowest and the highest angles
    varied: Callable[..., Any]  # ``varied(plant, draw)``, the plant with the factors of a `randomisation.draw_record`
    PerJoint: Any = dataclasses.field(init=False)  # record of one number for each joint
    Point: Any = dataclasses.field(init=False)  # record of a vector in the tip's space
    State: Any = dataclasses.field(init=False)  # record of motor and link angles and their velocities

    def __post_init__(self) -> None:
        """Take the records of so many joints and axes; attributes, because torch compiles no look-up in a cache."""
        for name, kind in (("PerJoint", per_joint), ("State", state_record)):
            object.__setattr__(self, name, kind(self.joints))
        object.__setattr__(self, "Point", point(self.axes))

    def __reduce__(self) -> tuple[Callable[..., Physics], tuple[Any, ...]]:
        """Leave the functions behind."""
        return self.made_by
