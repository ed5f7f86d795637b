"""What the network of `learned-observer` sees an arm in: units in which its signals are of order 1.

Of the two-joint arm they were chosen for Table 1; torques are shares of the limits of any arm. Of a robot by its frames
every unit is that of Table 1 times a ratio of the robot to Table 1:

    forces, payload    r_F, r_m, see `scale_of`
    innovations        Γ_j/I_j of the joint's torque limit and motor inertia over that of the first joint: what a torque
                       does to a motor within a sample
    q̇_d, q̈_d           the joint's velocity limit
    lengths, tip       the reach
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fuzzyarm.envs.physics.equations import AnyArm, equations_of, robot_of
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.envs.physics.robot import Robot
from fuzzyarm.envs.scenario.cases import load_scale
from fuzzyarm.envs.scenario.kinematics import reach, velocity_limits
from fuzzyarm.fuzzy_policy.known_arm import per_joint_of
from fuzzyarm.fuzzy_policy.laws.adaptive.belief import mass_of, unit_force

__all__ = ["GAP_SHARE", "QUIET", "Scale", "Units", "scale_of", "turns_of", "units_of"]

GAP_SHARE = 0.05
"""Share of R that is the unit of u_a - u_o."""

QUIET = 1.0 / 600.0
"""Share of the torques R: for a load d̂ below it the elastic observer all but acts alone."""

_FINE = (5e-7, 2e-6, 1e-3, 4e-3)  # s of angles [rad] and velocities [rad/s] of the two-joint arm
_COARSE = (1e-5, 4e-5, 2e-2, 8e-2)  # S
_BEYOND = 1.2  # R over the torque limits
_FORCE, _MASS = 20.0, 1.0  # N and kg, l_1 of the arm of Table 1
_FASTEST, _JERKIEST = 3.0, 30.0  # units of q̇_d [rad/s] and of q̈_d [rad/s²]
_SLOW, _SLOW_TIP = 0.05, 0.02  # rad/s and m/s: below it a direction fades
_REST = 1e-4  # m/s, v_1
_PARALLEL = 1e-9  # how far the cosine between parallel axes may be from 1


class Scale(NamedTuple):
    """How large an arm is, in arms of Table 1: forces at its tip, masses, and lengths."""

    force: float
    mass: float
    length: float


def scale_of(arm: AnyArm) -> Scale:
    """Return the scale of an arm.

    Of the two-joint arm these are ratios of the first motor's limit over the reach, of the links' mass, and of the
    reach. A robot's last motors may be far weaker than its first ones: its forces and masses are those that ask for the
    same share of a torque limit as Table 1's, see `load_scale`.
    """
    paper = ArmParameters()
    if isinstance(arm, Robot):
        return Scale(*load_scale(arm), reach(arm) / sum(paper.length))
    force, mass = unit_force(arm) / unit_force(paper), mass_of(arm) / mass_of(paper)
    return Scale(force, mass, sum(arm.length) / sum(paper.length))


class Units(NamedTuple):
    """What signals are seen in; n joints, and a tip in a space of some axes.

    Attributes:
        torque: R (n,), 1.2 of the torque limits [N m]: of loads and of residual torques, whose largest values it is.
        load: l_1 (axes + 2,), of the forces along the direction of travel and along each axis [N], and the payload
            [kg].
        fine: s (2 n,) of the innovation of angles [rad] and velocities [rad/s].
        coarse: S (2 n,) of what is large among them.
        velocity: of q̇_d (n,) [rad/s].
        acceleration: of q̈_d (n,) [rad/s²].
        slow: joint velocities (n,) [rad/s] below which the direction of a joint fades.
        slow_tip: v_0 [m/s].
        rest: v_1 [m/s].
        length: of the levers Jᵀ e [m].
    """

    torque: Any
    load: Any
    fine: Any
    coarse: Any
    velocity: Any
    acceleration: Any
    slow: Any
    slow_tip: Any
    rest: Any
    length: Any


def units_of(arm: AnyArm) -> Units:
    """Return the units for an arm."""
    limit, scale, paper = per_joint_of(arm, "torque_limit"), scale_of(arm), ArmParameters()
    length, speed, fine, coarse, axes = 1.0, np.ones(len(limit)), np.array(_FINE), np.array(_COARSE), len(paper.length)
    if isinstance(arm, Robot):
        quickness = limit / per_joint_of(arm, "motor_inertia") * (paper.motor_inertia[0] / paper.torque_limit[0])
        fine, coarse = (np.concatenate([unit[0] * quickness, unit[2] * quickness]) for unit in (_FINE, _COARSE))
        length, speed = scale.length, velocity_limits(arm) / paper.velocity_limit[0]
        axes = equations_of(arm).axes
    return Units(
        torque=_BEYOND * limit,
        load=np.array([*[_FORCE * scale.force] * (axes + 1), _MASS * scale.mass]),
        fine=fine,
        coarse=coarse,
        velocity=_FASTEST * speed,
        acceleration=_JERKIEST * speed,
        slow=_SLOW * speed,
        slow_tip=_SLOW_TIP * length,
        rest=_REST * length,
        length=length,
    )


def turns_of(arm: AnyArm) -> np.ndarray:
    """Return by how much the angle ψ of the joint before adds to that of each joint (n,): ψ_j = θ_j + σ_j ψ_(j-1).

    σ_j is 1 where both axes are parallel, -1 where they are opposite, else 0; the first is 0.
    """
    now = robot_of(arm).arrays
    cosine = np.einsum("ja,jab,jb->j", now.axis[:-1], now.rotation[1:], now.axis[1:])
    parallel = np.abs(np.abs(cosine) - 1.0) < _PARALLEL
    return np.concatenate([[0.0], np.where(parallel, np.rint(cosine), 0.0)])
